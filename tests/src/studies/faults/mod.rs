//! What becomes of injected faults: each kind of `slitpose faults` against the whole chain, judged by the truth of the
//! simulator. All times are device time. Those that cost the link or the board need a daemon that finds it again: they are
//! in the study `storm`, and their exit codes in a test.
//!
//! * `in_memory`: board, injector and pipeline in one thread, with a clock of the host that is device time. Nothing
//!   depends on how fast the machine is.
//! * `Report`: what was injected, who noticed, what was lost, and when poses were sound again.

mod report;
mod runs;

use clap::{Args, ValueEnum};
use slitpose_head::faults::{KINDS, Kind, Lasts};
use slitpose_head::scene_file::SceneFile;
use slitpose_head::simulator::TrajectoryKind;
use slitpose_model::Tier;

use super::Verdicts;
use crate::capture::STREAM;
use report::{Report, Scan, Trace, table};
use runs::in_memory;

/// A pose farther from the truth than this is wrong, in σ of its worst axis: of sound poses one in 10¹⁴ is.
const WRONG_SIGMAS: f64 = 8.0;

/// Faults whose errors may be so small that the redundancy of six cells does not reveal each of them, with the most
/// poses of half a second at 2 kHz that were wrong and unflagged. What such a pose says of itself covers its error all the
/// same.
const SUBTLE: [(&str, usize); 4] = [("noisy", 200), ("swap-electrodes", 5), ("swap-cells", 5), ("move", 100)];

#[derive(Debug, Args)]
pub struct Options {
    /// Name of a shipped scene, or a scene file
    #[arg(long, default_value = "wide")]
    scene: String,
    /// Frames a second, instead of the scene's: packets, and so faults of the wire, are as many less
    #[arg(long)]
    rate_hz: Option<f64>,
    /// Equations of light and solver
    #[arg(long, value_enum, default_value_t = Equations::Exact)]
    tier: Equations,
    /// Spans in which each fault acts
    #[arg(long, default_value_t = 10)]
    spans: usize,
    /// Motion of the tool
    #[arg(long, default_value = "smooth", value_parser = motion)]
    motion: TrajectoryKind,
    /// Seed of motion, noise and faults
    #[arg(long, default_value_t = 20_180_718)]
    seed: u64,
    /// Only faults whose name contains this
    #[arg(long, default_value = "")]
    only: String,
}

fn motion(name: &str) -> Result<TrajectoryKind, String> {
    let names = TrajectoryKind::NAMED.map(|(name, _)| name).join(", ");
    TrajectoryKind::named(name).ok_or(format!("no such motion; give one of {names}"))
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum Equations {
    Paper,
    Exact,
}

/// Under what conditions a fault is studied.
struct Conditions {
    /// The head, with the frame rate of its front end.
    file: SceneFile,
    tier: Tier,
    motion: TrajectoryKind,
    seed: u64,
    spans: Spans,
}

/// When the fault of a study acts: device time, seconds.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Spans {
    /// Begin of the first span.
    pub from_s: f64,
    pub for_s: f64,
    /// From the begin of a span to that of the next: health looks back a second.
    pub every_s: f64,
    pub count: usize,
}

impl Spans {
    /// So many spans of half a second, two seconds apart.
    fn of(count: usize) -> Self {
        Self { from_s: 1.5, for_s: 0.5, every_s: 2.0, count }
    }

    fn begin_s(&self, span: usize) -> f64 {
        self.from_s + span as f64 * self.every_s
    }

    /// End of the last, and time to recover.
    fn duration_s(&self) -> f64 {
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

pub fn study(options: &Options) -> Verdicts {
    let mut file = SceneFile::open(&options.scene).unwrap_or_else(|error| panic!("{error}"));
    let front_end = file.front_end.as_mut().expect("the scene has a front end");
    front_end.frame_rate_hz = options.rate_hz.unwrap_or(front_end.frame_rate_hz);
    let rate_hz = front_end.frame_rate_hz;
    let tier = match options.tier {
        Equations::Paper => Tier::Paper,
        Equations::Exact => STREAM,
    };
    let spans = Spans::of(options.spans);
    let conditions = Conditions { file, tier, motion: options.motion, seed: options.seed, spans };
    let sound = Report::of("none", &Spans { count: 1, ..spans }, false, &in_memory(&conditions, ""));
    let mut reports = vec![sound];
    for kind in KINDS.iter().filter(|kind| kind.name.contains(&options.only) && !needs_daemon(kind)) {
        let trace = in_memory(&conditions, &spans.spec(kind));
        reports.push(Report::of(kind.name, &spans, kind.lasts == Lasts::Instant, &trace));
    }
    println!("{options:?}, {} s a span", spans.for_s);
    print!("{}", table(&reports));
    let mut verdicts = Verdicts::default();
    let (sound, faulty) = reports.split_at(1);
    let is_sound = |report: &Report| report.by.is_empty() && report.unflagged + report.flagged == 0;
    verdicts.check(sound.iter().all(is_sound), "nothing is noticed where there is no fault, and no pose is wrong");
    // Of many jumps of a clock the first, second, fourth, eighth … are reported.
    let noticed = |report: &Report| match report.fault.as_str() {
        "step" => report.detected > report.injected.ilog2() as usize,
        // Poses stay right, and the board reports its temperature.
        "warm" => report.unflagged + report.flagged == 0,
        _ => report.detected == report.injected,
    };
    verdicts.check(
        faulty.iter().all(noticed),
        "each fault that does harm is noticed, of jumps of the clock those that are reported",
    );
    verdicts.check(reports.iter().all(|report| report.silently_lost == 0), "no scan is lost silently");
    verdicts.check(reports.iter().all(|report| report.out_of_order == 0), "poses come in the order of their scans");
    for report in faulty {
        let subtle = SUBTLE.iter().find(|(name, _)| report.fault == *name).map_or(0, |(_, most)| *most);
        let most = (subtle * options.spans) as f64 * rate_hz / 2000.0;
        let Report { fault, unflagged, .. } = report;
        verdicts.check(*unflagged as f64 <= most, format!("{fault}: {unflagged} wrong poses unflagged, {most} may be"));
    }
    let beyond = reports.iter().all(|report| report.beyond == 0);
    verdicts.check(beyond, "wrong poses that are unflagged cover their error by their unnoticed_sigmas");
    verdicts.check(faulty.iter().all(|report| report.recovery_s.most().is_finite()), "poses are sound again");
    verdicts
}
