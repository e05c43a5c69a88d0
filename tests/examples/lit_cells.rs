//! What each scan costs, whatever the head sees: one table on stdout; exit code 1 if a case takes longer
//! than it may, or falls behind. Times are a thread's own, so that other programs are not in them.
//!
//! `cargo run --release -p slitpose-tests --example lit_cells -- [SCENE...] [--runs 10] [--scans 1000] [--passes 3] [--seed S]`

use std::process::ExitCode;

use clap::Parser;
use slitpose_head::scene_file::SceneFile;
use slitpose_tests::lit_cells::{Report, cases, intake_us, study, table};
use slitpose_tests::monte_carlo::trials::Trials;

/// What a scan may take, 99 % of all scans, µs.
const MOST_P99_US: f64 = 100.0;

/// A scan that waits for longer is late, µs, as `slitpose run` has it. The system may stop a thread for less.
const LATE_US: f64 = 5000.0;

#[derive(Parser)]
#[command(about = "What each scan costs a tracker, whatever the head sees")]
struct Options {
    /// Names of shipped scenes, or scene files
    #[arg(default_value = "wide")]
    scenes: Vec<String>,
    /// Runs of each case
    #[arg(long, default_value_t = 10)]
    runs: usize,
    /// Scans of each run
    #[arg(long, default_value_t = 1000)]
    scans: usize,
    /// Times that each run is made; a scan counts with the least
    #[arg(long, default_value_t = 3, value_parser = clap::value_parser!(u8).range(1..))]
    passes: u8,
    /// Scans with all cells well before each run of a second set of cases
    #[arg(long, default_value_t = 20)]
    healthy: usize,
    /// Seed of everything that is drawn
    #[arg(long, default_value_t = 20_180_718)]
    seed: u64,
}

fn main() -> ExitCode {
    let options = Options::parse();
    let trials = Trials { count: options.runs, seed: options.seed };
    let mut reports = Vec::new();
    for scene in &options.scenes {
        let file = SceneFile::open(scene).unwrap_or_else(|error| panic!("{error}"));
        let [median_us, of_99_us] = intake_us(&file, options.seed);
        println!(
            "{scene}: besides its tracker a scan costs {median_us:.1} us, 99 % {of_99_us:.1} us; the latter is in all that follows"
        );
        let studied = cases(&file, options.healthy, options.scans)
            .into_iter()
            .map(|case| study(&case, trials, usize::from(options.passes)));
        reports.extend(studied.map(|report| report.with_besides(of_99_us)));
    }
    println!(
        "{} runs of {} scans each, seed {}; each scan with the least time of {} passes",
        options.runs, options.scans, options.seed, options.passes
    );
    print!("{}", table(&reports));
    let is_late = |report: &&Report| report.cost_us(0.99) > MOST_P99_US || report.most_lag_us() > LATE_US;
    let (late, cases) = (reports.iter().filter(is_late).count(), reports.len());
    println!("99 % within {MOST_P99_US} us, none later than {LATE_US} us: {} of {cases} cases", cases - late);
    ExitCode::from(u8::from(late > 0))
}
