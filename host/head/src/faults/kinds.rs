//! The table of faults: what each does, what its text may say, and what a user sees of it.

use super::text::Unit;

/// Where a fault acts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Layer {
    /// On the bytes between the board and the decoder.
    Wire,
    /// On the words that the board's converters deliver.
    Words,
    /// On the light that falls on the detectors.
    Light,
    /// In the board.
    Board,
}

impl Layer {
    /// The heading above its faults.
    pub fn title(self) -> &'static str {
        match self {
            Self::Wire => "on the wire, between the board and the decoder",
            Self::Words => "in the head, seen in the words of the converters",
            Self::Light => "in the head, seen in the light",
            Self::Board => "in the board",
        }
    }
}

/// A key of a fault besides those of its schedule.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Key {
    /// Its name.
    pub name: &'static str,
    /// What it takes.
    pub unit: Unit,
    /// Its value if it is not given; `None`: it must be.
    pub default: Option<&'static str>,
}

/// How long a fault lasts unless `for` says otherwise.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Lasts {
    /// An instant; it takes no `for`.
    Instant,
    /// To the end.
    ToTheEnd,
    /// This long.
    For(&'static str),
}

/// One kind of fault.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Kind {
    /// Its name.
    pub name: &'static str,
    /// Where it acts.
    pub layer: Layer,
    /// Its keys.
    pub keys: &'static [Key],
    /// How long it lasts.
    pub lasts: Lasts,
    /// What it does, in a phrase.
    pub what: &'static str,
    /// What the user sees of it: status of poses, health, event.
    pub sees: &'static str,
    /// The exit code of a run that it befell, if nothing else did.
    pub exit: u8,
    /// A fault of this kind.
    pub example: &'static str,
}

macro_rules! kinds {
    ($($name:literal, $layer:ident, [$($key:ident: $unit:ident $(= $default:literal)?),*], $lasts:expr, $exit:literal,
        $example:literal, $what:literal, $sees:literal;)*) => {
        [$(Kind {
            name: $name,
            layer: Layer::$layer,
            keys: &[$(Key { name: stringify!($key), unit: Unit::$unit, default: kinds!(default $($default)?) }),*],
            lasts: $lasts,
            what: $what,
            sees: $sees,
            exit: $exit,
            example: $example,
        }),*]
    };
    (default) => { None };
    (default $default:literal) => { Some($default) };
}

/// All kinds, by layer: name, layer, keys with unit and default, how long, exit code, example; what it does, what is seen.
pub const KINDS: [Kind; 27] = kinds! {
    "flip", Wire, [rate: Rate = "1e-5"], Lasts::ToTheEnd, 3, "flip:rate=1e-5",
        "inverts each bit with probability RATE", "gap in seq, counted as missing and damaged";
    "drop", Wire, [rate: Rate = "0.01"], Lasts::ToTheEnd, 3, "drop:rate=0.01",
        "loses each packet with probability RATE", "gap in seq, counted as missing";
    "duplicate", Wire, [rate: Rate = "0.01"], Lasts::ToTheEnd, 3, "duplicate:rate=0.01",
        "delivers each packet twice with probability RATE", "repeats are left out and counted";
    "reorder", Wire, [rate: Rate = "0.01"], Lasts::ToTheEnd, 3, "reorder:rate=0.01",
        "delivers each packet behind the next with probability RATE",
        "gap in seq, counted as missing; late scans are left out and counted";
    "truncate", Wire, [rate: Rate = "0.01"], Lasts::ToTheEnd, 3, "truncate:rate=0.01",
        "cuts the end off each packet with probability RATE", "gap in seq, counted as missing and damaged";
    "burst", Wire, [rate: Rate = "0.01", bytes: Count = "64"], Lasts::ToTheEnd, 3, "burst:rate=0.01,bytes=300",
        "replaces BYTES by noise, from each packet on with probability RATE",
        "gap in seq, counted as missing and damaged";
    "stall", Wire, [], Lasts::For("200ms"), 0, "stall:from=1s,for=300ms",
        "holds all bytes back, and then delivers them at once", "poses come late; none is missing";
    "hangup", Wire, [], Lasts::For("200ms"), 3, "hangup:from=1s,for=300ms",
        "breaks the link; the port is back later",
        "link lost, reconnects counted; gap in seq; needs --patience, else the run fails";
    "drift", Wire, [ppm: Ppm = "100ppm"], Lasts::ToTheEnd, 0, "drift:ppm=-300ppm",
        "lets the board's clock gain PPM", "device times drift; drift_ppm in /status in real time";
    "step", Wire, [by: TimeStep = "10ms"], Lasts::Instant, 0, "step:from=1s,by=-5ms",
        "sets the board's clock forward BY a time, or back", "event: the board's clock jumped";
    "occlude", Words, [cell: Number], Lasts::ToTheEnd, 0, "occlude:cell=2,from=1s,for=500ms",
        "takes all light from a cell", "degraded (fewer_cells); health: dark";
    "dim", Words, [cell: Number, to: Ratio = "0.5"], Lasts::ToTheEnd, 0, "dim:cell=0,to=0.7",
        "dims the light of a cell TO a share", "degraded (cell_excluded, doubted); health: excluded";
    "saturate", Words, [cell: Number], Lasts::ToTheEnd, 0, "saturate:cell=1,every=10ms,for=1ms",
        "drives a cell's converter to the end of its range", "degraded (fewer_cells); health: saturated";
    "glint", Words, [cell: Number, current: Current = "1uA"], Lasts::ToTheEnd, 0, "glint:cell=3,current=500nA",
        "adds a reflection of its own emitter to electrode 1 of a cell",
        "degraded (cell_excluded, doubted); health: excluded";
    "stray", Words, [cell: Number, current: Current = "400nA"], Lasts::ToTheEnd, 0, "stray:cell=3,current=400nA,from=2s",
        "adds CURRENT of other light to each electrode of a cell in all slots", "poses hold; health: stray_rising";
    "noisy", Words, [cell: Number, rms: Current = "20nA"], Lasts::ToTheEnd, 0, "noisy:cell=4,rms=20nA",
        "adds noise to each word of a cell", "degraded (misfit, cell_excluded, doubted); health: excluded or noisy";
    "stuck", Words, [cell: Number], Lasts::ToTheEnd, 0, "stuck:cell=5,from=1s",
        "lets the words of a cell stay as they are", "degraded (cell_excluded, doubted); health: stuck";
    "swap-electrodes", Words, [cell: Number], Lasts::ToTheEnd, 0, "swap-electrodes:cell=0",
        "exchanges the electrodes of a cell", "degraded (cell_excluded, doubted); health: swapped";
    "swap-cells", Words, [cell: Number, with: Number], Lasts::ToTheEnd, 0, "swap-cells:cell=0,with=3",
        "exchanges two cells", "degraded (misfit, doubted) or no pose; health: swapped";
    "dead", Light, [emitter: Number], Lasts::ToTheEnd, 0, "dead:emitter=4,from=1s",
        "lets an emitter fail", "degraded (fewer_cells); health: dark";
    "move", Light, [cell: Number, by: Length = "50um"], Lasts::ToTheEnd, 0, "move:cell=2,by=30um,from=1s",
        "moves the slit of a cell along its detector", "degraded (cell_excluded, doubted); health: excluded";
    "warm", Light, [by: Kelvin = "20K", over: Time = "1s"], Lasts::ToTheEnd, 0, "warm:by=20K,over=2s",
        "warms head and board within OVER: emitters weaken, dark currents rise",
        "temperature in status; poses stay right: the light level is an unknown of each scan";
    "overrun", Board, [scans: Count = "8"], Lasts::Instant, 3, "overrun:scans=8,every=500ms",
        "has the converters overwrite SCANS before they are collected",
        "gap in seq, counted as missing; lost scans and overruns in status";
    "reset", Board, [boot: Time = "20ms"], Lasts::Instant, 3, "reset:from=1s",
        "resets the board by its watchdog; the link stays open",
        "restart counted; the board is started again; needs --patience, else the run fails";
    "restart", Board, [], Lasts::For("300ms"), 3, "restart:from=1s,for=300ms",
        "takes the board's supply away; the port is gone, too",
        "link lost, reconnects counted; restart counted; needs --patience, else the run fails";
    "slow", Board, [poll: Time = "30ms"], Lasts::ToTheEnd, 3, "slow:poll=30ms,from=1s,for=200ms",
        "lets the board look after its scans only every POLL",
        "scans come late; beyond 21 ms at 4 kHz a gap in seq, overruns in status";
    "stop", Board, [], Lasts::Instant, 3, "stop:from=1s",
        "has the converters fail: the board stops and goes dark",
        "event of the board; it is started again; needs --patience, else the run fails";
};

impl Kind {
    /// The kind with this name.
    pub fn named(name: &str) -> Option<&'static Self> {
        KINDS.iter().find(|kind| kind.name == name)
    }

    /// Its keys, those of the schedule included.
    pub fn key_names(&self) -> impl Iterator<Item = &'static str> {
        let schedule: &[_] = match self.lasts {
            Lasts::Instant => &["from", "every", "seed"],
            Lasts::ToTheEnd | Lasts::For(_) => &["from", "for", "every", "seed"],
        };
        self.keys.iter().map(|key| key.name).chain(schedule.iter().copied())
    }

    /// Why it cannot be injected into a recording; `None` if it can.
    pub fn not_in_recordings(&self) -> Option<&'static str> {
        match (self.layer, self.name) {
            (Layer::Light, _) => {
                Some("recorded words do not say how the light was mixed; use `run --device sim` or `simulate`")
            }
            (Layer::Board, _) => Some("its board has run already; use `run --device sim`"),
            (Layer::Wire, "hangup") => Some("nobody can open the link to its board again; use `run --device sim`"),
            (Layer::Wire | Layer::Words, _) => None,
        }
    }

    /// Why it cannot be injected into a board that `simulate` records; `None` if it can.
    pub fn not_in_simulate(&self) -> Option<&'static str> {
        matches!(self.name, "hangup" | "reset" | "restart" | "stop").then_some(
            "`simulate` starts its board once; use `run --device sim --speed max --patience 5s --record FILE`",
        )
    }
}
