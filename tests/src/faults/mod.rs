//! What becomes of injected faults: each kind of `slitpose faults` against the whole chain, judged by the truth of the
//! simulator.
//!
//! * [`memory`]: board, injector and pipeline in one thread, with a clock of the host that is device time. Nothing
//!   depends on how fast the machine is.
//! * [`process`]: faults that cost the link or the board need a daemon that finds it again.
//! * [`Report`]: what was injected, who noticed, what was lost, and when poses were sound again.

pub mod memory;
pub mod process;
mod report;

use slitpose_head::faults::{KINDS, Kind};

pub use report::{Report, Scan, Sign, Trace, table};

/// A pose farther from the truth than this is wrong, in σ of its worst axis: of sound poses one in 10¹⁴ is.
pub const WRONG_SIGMAS: f64 = 8.0;

/// When the fault of a study acts: device time, seconds.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Spans {
    /// Begin of the first span.
    pub from_s: f64,
    /// Duration of a span.
    pub for_s: f64,
    /// From the begin of a span to that of the next: health looks back a second.
    pub every_s: f64,
    /// Number of spans.
    pub count: usize,
}

impl Spans {
    /// So many spans of half a second, two seconds apart.
    pub fn of(count: usize) -> Self {
        Self { from_s: 1.5, for_s: 0.5, every_s: 2.0, count }
    }

    /// Begin of a span, seconds.
    pub fn begin_s(&self, span: usize) -> f64 {
        self.from_s + span as f64 * self.every_s
    }

    /// End of the last, and time to recover.
    pub fn duration_s(&self) -> f64 {
        self.begin_s(self.count) - 0.1
    }

    /// The text of a fault of `kind` in these spans.
    pub fn spec(&self, kind: &Kind) -> String {
        let Self { from_s, for_s, every_s, .. } = *self;
        let lasts = if kind.key_names().any(|key| key == "for") { format!("for={for_s}s,") } else { String::new() };
        format!("{}:{}{lasts}from={from_s}s,every={every_s}s", kind.name, parameters(kind))
    }
}

/// The parameters of a kind: those of its example, unless these are rare.
fn parameters(kind: &Kind) -> String {
    let own = match kind.name {
        "flip" => "rate=1e-4",
        "drop" | "duplicate" | "reorder" | "truncate" => "rate=0.05",
        "burst" => "rate=0.05,bytes=300",
        "drift" => "ppm=2000ppm",
        "warm" => "by=20K,over=100ms",
        _ => kind.example.split_once(':').map_or("", |(_, keys)| keys),
    };
    let schedule = ["from=", "for=", "every="];
    own.split(',')
        .filter(|key| !schedule.iter().any(|name| key.starts_with(name)))
        .map(|key| format!("{key},"))
        .collect()
}

/// Kinds after which the host must find its board, or start it, again.
pub fn needs_daemon(kind: &Kind) -> bool {
    matches!(kind.name, "hangup" | "reset" | "restart" | "stop")
}

/// All kinds that need none.
pub fn kinds_in_memory() -> impl Iterator<Item = &'static Kind> {
    KINDS.iter().filter(|kind| !needs_daemon(kind))
}
