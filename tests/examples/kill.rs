//! Daemons that are killed while they record, and what their captures hold: exit code 1 if one is not as it
//! should be.
//!
//! ```text
//! cargo build --release -p slitpose
//! cargo run --release -p slitpose-tests --example kill -- [--times 200] [--seed S]
//! ```

use std::path::PathBuf;
use std::process::ExitCode;
use std::time::Duration;

use clap::Parser;
use slitpose_tests::acceptance::kill::{Conditions, study};
use slitpose_tests::process::Slitpose;
use slitpose_tests::verdicts::Verdicts;

#[derive(Parser)]
#[command(about = "What captures hold of daemons that were killed")]
struct Options {
    /// Times
    #[arg(long, default_value_t = 200)]
    times: usize,
    /// Of the moments
    #[arg(long, default_value_t = 20_180_718)]
    seed: u64,
    /// Simulated boards of each daemon
    #[arg(long, default_value_t = 3)]
    boards: usize,
    /// Daemons at a time
    #[arg(long, default_value_t = 4)]
    at_once: usize,
    /// Most that was reported and may be missing in the capture, in device time
    #[arg(long, default_value = "1100ms", value_parser = humantime::parse_duration)]
    slack: Duration,
    /// The command to test [default: the one beside this example]
    #[arg(long)]
    slitpose: Option<PathBuf>,
}

fn main() -> ExitCode {
    let Options { times, seed, boards, at_once, slack, slitpose } = Options::parse();
    let conditions = Conditions { times, seed, boards, at_once };
    let report = study(Slitpose::given_or_beside(slitpose), &conditions);
    print!("{report}");
    let mut verdicts = Verdicts::default();
    report.check(&mut verdicts);
    let most_s = report.lost_s().last().copied().unwrap_or(0.0);
    verdicts.check(most_s <= slack.as_secs_f64(), &format!("{most_s:.2} s missing at most, {slack:?} allowed"));
    verdicts.end()
}
