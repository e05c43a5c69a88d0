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

const fn key(name: &'static str, unit: Unit, default: &'static str) -> Key {
    Key { name, unit, default: Some(default) }
}

const CELL: Key = Key { name: "cell", unit: Unit::Number, default: None };

/// Of each packet, that something happens to it.
const RATE: Key = key("rate", Unit::Rate, "0.01");

/// What is seen where packets are missing or damaged.
const DAMAGE: &str = "gap in seq, counted as missing and damaged";
const GAP: &str = "gap in seq, counted as missing";

const EXCLUDED: &str = "degraded (cell_excluded, doubted); health: excluded";

/// What kinds of a layer have in common, unless the table says otherwise.
const WIRE: Kind = Kind {
    name: "",
    layer: Layer::Wire,
    keys: &[RATE],
    lasts: Lasts::ToTheEnd,
    what: "",
    sees: DAMAGE,
    exit: 3,
    example: "",
};
const WORDS: Kind = Kind { layer: Layer::Words, keys: &[CELL], sees: EXCLUDED, exit: 0, ..WIRE };
const LIGHT: Kind = Kind { layer: Layer::Light, ..WORDS };
const BOARD: Kind = Kind { layer: Layer::Board, keys: &[], lasts: Lasts::Instant, ..WIRE };

/// All kinds, by layer.
pub const KINDS: [Kind; 27] = [
    Kind {
        name: "flip",
        keys: &[key("rate", Unit::Rate, "1e-5")],
        what: "inverts each bit with probability RATE",
        example: "flip:rate=1e-5",
        ..WIRE
    },
    Kind {
        name: "drop",
        what: "loses each packet with probability RATE",
        sees: GAP,
        example: "drop:rate=0.01",
        ..WIRE
    },
    Kind {
        name: "duplicate",
        what: "delivers each packet twice with probability RATE",
        sees: "repeats are left out and counted",
        example: "duplicate:rate=0.01",
        ..WIRE
    },
    Kind {
        name: "reorder",
        what: "delivers each packet behind the next with probability RATE",
        sees: "gap in seq, counted as missing; late scans are left out and counted",
        example: "reorder:rate=0.01",
        ..WIRE
    },
    Kind {
        name: "truncate",
        what: "cuts the end off each packet with probability RATE",
        example: "truncate:rate=0.01",
        ..WIRE
    },
    Kind {
        name: "burst",
        keys: &[RATE, key("bytes", Unit::Count, "64")],
        what: "replaces BYTES by noise, from each packet on with probability RATE",
        example: "burst:rate=0.01,bytes=300",
        ..WIRE
    },
    Kind {
        name: "stall",
        keys: &[],
        lasts: Lasts::For("200ms"),
        what: "holds all bytes back, and then delivers them at once",
        sees: "poses come late; none is missing",
        exit: 0,
        example: "stall:from=1s,for=300ms",
        ..WIRE
    },
    Kind {
        name: "hangup",
        keys: &[],
        lasts: Lasts::For("200ms"),
        what: "breaks the link; the port is back later",
        sees: "link lost, reconnects counted; gap in seq; needs --patience, else the run fails",
        example: "hangup:from=1s,for=300ms",
        ..WIRE
    },
    Kind {
        name: "drift",
        keys: &[key("ppm", Unit::Ppm, "100ppm")],
        what: "lets the board's clock gain PPM",
        sees: "device times drift; drift_ppm in /status in real time",
        exit: 0,
        example: "drift:ppm=-300ppm",
        ..WIRE
    },
    Kind {
        name: "step",
        keys: &[key("by", Unit::TimeStep, "10ms")],
        lasts: Lasts::Instant,
        what: "sets the board's clock forward BY a time, or back",
        sees: "event: the board's clock jumped",
        exit: 0,
        example: "step:from=1s,by=-5ms",
        ..WIRE
    },
    Kind {
        name: "occlude",
        what: "takes all light from a cell",
        sees: "degraded (fewer_cells); health: dark",
        example: "occlude:cell=2,from=1s,for=500ms",
        ..WORDS
    },
    Kind {
        name: "dim",
        keys: &[CELL, key("to", Unit::Ratio, "0.5")],
        what: "dims the light of a cell TO a share",
        example: "dim:cell=0,to=0.7",
        ..WORDS
    },
    Kind {
        name: "saturate",
        what: "drives a cell's converter to the end of its range",
        sees: "degraded (fewer_cells); health: saturated",
        example: "saturate:cell=1,every=10ms,for=1ms",
        ..WORDS
    },
    Kind {
        name: "glint",
        keys: &[CELL, key("current", Unit::Current, "1uA")],
        what: "adds a reflection of its own emitter to electrode 1 of a cell",
        example: "glint:cell=3,current=500nA",
        ..WORDS
    },
    Kind {
        name: "stray",
        keys: &[CELL, key("current", Unit::Current, "400nA")],
        what: "adds CURRENT of other light to each electrode of a cell in all slots",
        sees: "poses hold; health: stray_rising",
        example: "stray:cell=3,current=400nA,from=2s",
        ..WORDS
    },
    Kind {
        name: "noisy",
        keys: &[CELL, key("rms", Unit::Current, "20nA")],
        what: "adds noise to each word of a cell",
        sees: "degraded (misfit, cell_excluded, doubted); health: excluded or noisy",
        example: "noisy:cell=4,rms=20nA",
        ..WORDS
    },
    Kind {
        name: "stuck",
        what: "lets the words of a cell stay as they are",
        sees: "degraded (cell_excluded, doubted); health: stuck",
        example: "stuck:cell=5,from=1s",
        ..WORDS
    },
    Kind {
        name: "swap-electrodes",
        what: "exchanges the electrodes of a cell",
        sees: "degraded (cell_excluded, doubted); health: swapped",
        example: "swap-electrodes:cell=0",
        ..WORDS
    },
    Kind {
        name: "swap-cells",
        keys: &[CELL, Key { name: "with", unit: Unit::Number, default: None }],
        what: "exchanges two cells",
        sees: "degraded (misfit, doubted) or no pose; health: swapped",
        example: "swap-cells:cell=0,with=3",
        ..WORDS
    },
    Kind {
        name: "dead",
        keys: &[Key { name: "emitter", unit: Unit::Number, default: None }],
        what: "lets an emitter fail",
        sees: "degraded (fewer_cells); health: dark",
        example: "dead:emitter=4,from=1s",
        ..LIGHT
    },
    Kind {
        name: "move",
        keys: &[CELL, key("by", Unit::Length, "50um")],
        what: "moves the slit of a cell along its detector",
        example: "move:cell=2,by=30um,from=1s",
        ..LIGHT
    },
    Kind {
        name: "warm",
        keys: &[key("by", Unit::Kelvin, "20K"), key("over", Unit::Time, "1s")],
        what: "warms head and board within OVER: emitters weaken, dark currents rise",
        sees: "temperature in status; poses stay right: the light level is an unknown of each scan",
        example: "warm:by=20K,over=2s",
        ..LIGHT
    },
    Kind {
        name: "overrun",
        keys: &[key("scans", Unit::Count, "8")],
        what: "has the converters overwrite SCANS before they are collected",
        sees: "gap in seq, counted as missing; lost scans and overruns in status",
        example: "overrun:scans=8,every=500ms",
        ..BOARD
    },
    Kind {
        name: "reset",
        keys: &[key("boot", Unit::Time, "20ms")],
        what: "resets the board by its watchdog; the link stays open",
        sees: "restart counted; the board is started again; needs --patience, else the run fails",
        example: "reset:from=1s",
        ..BOARD
    },
    Kind {
        name: "restart",
        lasts: Lasts::For("300ms"),
        what: "takes the board's supply away; the port is gone, too",
        sees: "link lost, reconnects counted; restart counted; needs --patience, else the run fails",
        example: "restart:from=1s,for=300ms",
        ..BOARD
    },
    Kind {
        name: "slow",
        keys: &[key("poll", Unit::Time, "30ms")],
        lasts: Lasts::ToTheEnd,
        what: "lets the board look after its scans only every POLL",
        sees: "scans come late; beyond 21 ms at 4 kHz a gap in seq, overruns in status",
        example: "slow:poll=30ms,from=1s,for=200ms",
        ..BOARD
    },
    Kind {
        name: "stop",
        what: "has the converters fail: the board stops and goes dark",
        sees: "event of the board; it is started again; needs --patience, else the run fails",
        example: "stop:from=1s",
        ..BOARD
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
