//! Every kind of fault against the whole chain: one table on stdout; exit code 1 if one goes unnoticed, a scan is lost
//! silently, poses stay unsound, or one is wrong by more than its status and its `unnoticed_sigmas` say. All times are
//! device time.
//!
//! ```text
//! cargo build --release -p slitpose
//! cargo run --release -p slitpose-tests --example faults -- [--scene wide] [--spans 10] [--seed S]
//! ```

use std::path::PathBuf;
use std::process::ExitCode;

use clap::Parser;
use slitpose_head::faults::{KINDS, Lasts};
use slitpose_head::scene_file::SceneFile;
use slitpose_head::simulator::TrajectoryKind;
use slitpose_model::Tier;
use slitpose_tests::faults::memory::Conditions;
use slitpose_tests::faults::{Report, Spans, memory, needs_daemon, process, table};
use slitpose_tests::process::Slitpose;
use slitpose_tests::verdicts::Verdicts;

#[derive(Parser)]
#[command(about = "Every kind of fault against the whole chain")]
struct Options {
    /// Name of a shipped scene, or a scene file; boards that lose their link have the default one
    #[arg(long, default_value = "wide")]
    scene: String,
    /// Spans in which each fault acts
    #[arg(long, default_value_t = 10)]
    spans: usize,
    /// Motion of the tool
    #[arg(long, value_enum, default_value_t = TrajectoryKind::Smooth)]
    motion: TrajectoryKind,
    /// Seed of motion, noise and faults
    #[arg(long, default_value_t = 20_180_718)]
    seed: u64,
    /// Only faults whose name contains this
    #[arg(long, default_value = "")]
    only: String,
    /// The command to test [default: the one beside this example]
    #[arg(long)]
    slitpose: Option<PathBuf>,
}

fn main() -> ExitCode {
    let options = Options::parse();
    let file = Box::new(SceneFile::open(&options.scene).unwrap_or_else(|error| panic!("{error}")));
    let spans = Spans::of(options.spans);
    let (motion, seed) = (options.motion, options.seed);
    let conditions = Conditions { file, tier: Tier::Exact { tolerance: 1e-6 }, motion, seed, spans };
    let mut reports = vec![Report::of("none", &Spans { count: 1, ..spans }, false, &memory::run(&conditions, ""))];
    let mut codes = Vec::new();
    for kind in KINDS.iter().filter(|kind| kind.name.contains(&options.only)) {
        let is_instant = kind.lasts == Lasts::Instant;
        let trace = if needs_daemon(kind) {
            let slitpose = Slitpose::given_or_beside(options.slitpose.clone());
            let (trace, code) = process::run(slitpose, kind, &spans, seed);
            codes.push((kind.name, code, kind.exit));
            trace
        } else {
            memory::run(&conditions, &spans.spec(kind))
        };
        reports.push(Report::of(kind.name, &spans, is_instant, &trace));
    }
    println!("scene {}, {motion:?}, {} spans of {} s, seed {seed}", options.scene, spans.count, spans.for_s);
    print!("{}", table(&reports));
    let mut verdicts = Verdicts::default();
    let (sound, faulty) = reports.split_at(1);
    verdicts.check(sound.iter().all(|report| report.by.is_empty()), "nothing is noticed where there is no fault");
    // Of many jumps of a clock the first, second, fourth, eighth … are reported.
    let noticed = |report: &Report| match report.fault.as_str() {
        "step" => report.detected > report.injected.ilog2() as usize,
        _ => report.detected == report.injected,
    };
    verdicts.check(faulty.iter().all(noticed), "each fault is noticed, of jumps of the clock those that are reported");
    verdicts.check(reports.iter().all(|report| report.silently_lost == 0), "no scan is lost silently");
    verdicts.check(reports.iter().all(|report| report.out_of_order == 0), "poses come in the order of their scans");
    let unflagged: usize = reports.iter().map(|report| report.unflagged).sum();
    let beyond = reports.iter().all(|report| report.beyond == 0);
    let what = format!("{unflagged} wrong poses are unflagged, and each covers its error by its unnoticed_sigmas");
    verdicts.check(beyond, &what);
    verdicts.check(faulty.iter().all(|report| report.recovery().1.is_finite()), "poses are sound again");
    verdicts.check(codes.iter().all(|(_, code, exit)| *code == i32::from(*exit)), &format!("exit codes: {codes:?}"));
    verdicts.end()
}
