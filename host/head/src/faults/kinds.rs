//! The table of faults: what each does, what its text may say, and what a user sees of it.

use super::quantity::Unit;

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

const fn key(name: &'static str, unit: Unit, default: &'static str) -> Key {
    Key { name, unit, default: Some(default) }
}

const CELL: Key = Key { name: "cell", unit: Unit::Number, default: None };

/// Of each packet, that something happens to it.
const RATE: Key = key("rate", Unit::Rate, "0.01");

/// What is seen where packets are missing or damaged.
const DAMAGE: &str = "gap in seq, counted as missing and damaged";
const GAP: &str = "gap in seq, counted as missing";

/// All kinds, by layer.
pub const KINDS: [Kind; 27] = [
    Kind {
        name: "flip",
        layer: Layer::Wire,
        keys: &[key("rate", Unit::Rate, "1e-5")],
        lasts: Lasts::ToTheEnd,
        what: "inverts each bit with probability RATE",
        sees: DAMAGE,
        exit: 3,
        example: "flip:rate=1e-5",
    },
    Kind {
        name: "drop",
        layer: Layer::Wire,
        keys: &[RATE],
        lasts: Lasts::ToTheEnd,
        what: "loses each packet with probability RATE",
        sees: GAP,
        exit: 3,
        example: "drop:rate=0.01",
    },
    Kind {
        name: "duplicate",
        layer: Layer::Wire,
        keys: &[RATE],
        lasts: Lasts::ToTheEnd,
        what: "delivers each packet twice with probability RATE",
        sees: "repeats are left out and counted",
        exit: 3,
        example: "duplicate:rate=0.01",
    },
    Kind {
        name: "reorder",
        layer: Layer::Wire,
        keys: &[RATE],
        lasts: Lasts::ToTheEnd,
        what: "delivers each packet behind the next with probability RATE",
        sees: "gap in seq, counted as missing; late scans are left out and counted",
        exit: 3,
        example: "reorder:rate=0.01",
    },
    Kind {
        name: "truncate",
        layer: Layer::Wire,
        keys: &[RATE],
        lasts: Lasts::ToTheEnd,
        what: "cuts the end off each packet with probability RATE",
        sees: DAMAGE,
        exit: 3,
        example: "truncate:rate=0.01",
    },
    Kind {
        name: "burst",
        layer: Layer::Wire,
        keys: &[RATE, key("bytes", Unit::Count, "64")],
        lasts: Lasts::ToTheEnd,
        what: "replaces BYTES by noise, from each packet on with probability RATE",
        sees: DAMAGE,
        exit: 3,
        example: "burst:rate=0.01,bytes=300",
    },
    Kind {
        name: "stall",
        layer: Layer::Wire,
        keys: &[],
        lasts: Lasts::For("200ms"),
        what: "holds all bytes back, and then delivers them at once",
        sees: "poses come late; none is missing",
        exit: 0,
        example: "stall:from=1s,for=300ms",
    },
    Kind {
        name: "hangup",
        layer: Layer::Wire,
        keys: &[],
        lasts: Lasts::For("200ms"),
        what: "breaks the link; the port is back later",
        sees: "link lost, reconnects counted; gap in seq; needs --patience, else the run fails",
        exit: 3,
        example: "hangup:from=1s,for=300ms",
    },
    Kind {
        name: "drift",
        layer: Layer::Wire,
        keys: &[key("ppm", Unit::Ppm, "100ppm")],
        lasts: Lasts::ToTheEnd,
        what: "lets the board's clock gain PPM",
        sees: "device times drift; drift_ppm in /status in real time",
        exit: 0,
        example: "drift:ppm=-300ppm",
    },
    Kind {
        name: "step",
        layer: Layer::Wire,
        keys: &[key("by", Unit::TimeStep, "10ms")],
        lasts: Lasts::Instant,
        what: "sets the board's clock forward BY a time, or back",
        sees: "event: the board's clock jumped",
        exit: 0,
        example: "step:from=1s,by=-5ms",
    },
    Kind {
        name: "occlude",
        layer: Layer::Words,
        keys: &[CELL],
        lasts: Lasts::ToTheEnd,
        what: "takes all light from a cell",
        sees: "degraded (fewer_cells); health: dark",
        exit: 0,
        example: "occlude:cell=2,from=1s,for=500ms",
    },
    Kind {
        name: "dim",
        layer: Layer::Words,
        keys: &[CELL, key("to", Unit::Ratio, "0.5")],
        lasts: Lasts::ToTheEnd,
        what: "dims the light of a cell TO a share",
        sees: "degraded (cell_excluded, doubted); health: excluded",
        exit: 0,
        example: "dim:cell=0,to=0.7",
    },
    Kind {
        name: "saturate",
        layer: Layer::Words,
        keys: &[CELL],
        lasts: Lasts::ToTheEnd,
        what: "drives a cell's converter to the end of its range",
        sees: "degraded (fewer_cells); health: saturated",
        exit: 0,
        example: "saturate:cell=1,every=10ms,for=1ms",
    },
    Kind {
        name: "glint",
        layer: Layer::Words,
        keys: &[CELL, key("current", Unit::Current, "1uA")],
        lasts: Lasts::ToTheEnd,
        what: "adds a reflection of its own emitter to electrode 1 of a cell",
        sees: "degraded (cell_excluded, doubted); health: excluded",
        exit: 0,
        example: "glint:cell=3,current=500nA",
    },
    Kind {
        name: "stray",
        layer: Layer::Words,
        keys: &[CELL, key("current", Unit::Current, "400nA")],
        lasts: Lasts::ToTheEnd,
        what: "adds CURRENT of other light to each electrode of a cell in all slots",
        sees: "poses hold; health: stray_rising",
        exit: 0,
        example: "stray:cell=3,current=400nA,from=2s",
    },
    Kind {
        name: "noisy",
        layer: Layer::Words,
        keys: &[CELL, key("rms", Unit::Current, "20nA")],
        lasts: Lasts::ToTheEnd,
        what: "adds noise to each word of a cell",
        sees: "degraded (misfit, cell_excluded, doubted); health: excluded or noisy",
        exit: 0,
        example: "noisy:cell=4,rms=20nA",
    },
    Kind {
        name: "stuck",
        layer: Layer::Words,
        keys: &[CELL],
        lasts: Lasts::ToTheEnd,
        what: "lets the words of a cell stay as they are",
        sees: "degraded (cell_excluded, doubted); health: stuck",
        exit: 0,
        example: "stuck:cell=5,from=1s",
    },
    Kind {
        name: "swap-electrodes",
        layer: Layer::Words,
        keys: &[CELL],
        lasts: Lasts::ToTheEnd,
        what: "exchanges the electrodes of a cell",
        sees: "degraded (cell_excluded, doubted); health: swapped",
        exit: 0,
        example: "swap-electrodes:cell=0",
    },
    Kind {
        name: "swap-cells",
        layer: Layer::Words,
        keys: &[CELL, Key { name: "with", unit: Unit::Number, default: None }],
        lasts: Lasts::ToTheEnd,
        what: "exchanges two cells",
        sees: "degraded (misfit, doubted) or no pose; health: swapped",
        exit: 0,
        example: "swap-cells:cell=0,with=3",
    },
    Kind {
        name: "dead",
        layer: Layer::Light,
        keys: &[Key { name: "emitter", unit: Unit::Number, default: None }],
        lasts: Lasts::ToTheEnd,
        what: "lets an emitter fail",
        sees: "degraded (fewer_cells); health: dark",
        exit: 0,
        example: "dead:emitter=4,from=1s",
    },
    Kind {
        name: "move",
        layer: Layer::Light,
        keys: &[CELL, key("by", Unit::Length, "50um")],
        lasts: Lasts::ToTheEnd,
        what: "moves the slit of a cell along its detector",
        sees: "degraded (cell_excluded, doubted); health: excluded",
        exit: 0,
        example: "move:cell=2,by=30um,from=1s",
    },
    Kind {
        name: "warm",
        layer: Layer::Light,
        keys: &[key("by", Unit::Kelvin, "20K"), key("over", Unit::Time, "1s")],
        lasts: Lasts::ToTheEnd,
        what: "warms head and board within OVER: emitters weaken, dark currents rise",
        sees: "degraded (misfit, doubted); temperature in status",
        exit: 0,
        example: "warm:by=20K,over=2s",
    },
    Kind {
        name: "overrun",
        layer: Layer::Board,
        keys: &[key("scans", Unit::Count, "8")],
        lasts: Lasts::Instant,
        what: "has the converters overwrite SCANS before they are collected",
        sees: "gap in seq, counted as missing; lost scans and overruns in status",
        exit: 3,
        example: "overrun:scans=8,every=500ms",
    },
    Kind {
        name: "reset",
        layer: Layer::Board,
        keys: &[key("boot", Unit::Time, "20ms")],
        lasts: Lasts::Instant,
        what: "resets the board by its watchdog; the link stays open",
        sees: "restart counted; the board is started again; needs --patience, else the run fails",
        exit: 3,
        example: "reset:from=1s",
    },
    Kind {
        name: "restart",
        layer: Layer::Board,
        keys: &[],
        lasts: Lasts::For("300ms"),
        what: "takes the board's supply away; the port is gone, too",
        sees: "link lost, reconnects counted; restart counted; needs --patience, else the run fails",
        exit: 3,
        example: "restart:from=1s,for=300ms",
    },
    Kind {
        name: "slow",
        layer: Layer::Board,
        keys: &[key("poll", Unit::Time, "30ms")],
        lasts: Lasts::ToTheEnd,
        what: "lets the board look after its scans only every POLL",
        sees: "scans come late; beyond 21 ms at 4 kHz a gap in seq, overruns in status",
        exit: 3,
        example: "slow:poll=30ms,from=1s,for=200ms",
    },
    Kind {
        name: "stop",
        layer: Layer::Board,
        keys: &[],
        lasts: Lasts::Instant,
        what: "has the converters fail: the board stops and goes dark",
        sees: "event of the board; it is started again; needs --patience, else the run fails",
        exit: 3,
        example: "stop:from=1s",
    },
];

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
