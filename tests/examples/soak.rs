//! The daemon with several boards for a long time: a table on stdout, exit code 1 if anything was lost or
//! grew.
//!
//! ```text
//! cargo build --release -p slitpose
//! cargo run --release -p slitpose-tests --example soak -- [--boards 4] [--duration 10m]
//! ```

use std::path::PathBuf;
use std::process::ExitCode;
use std::time::Duration;

use clap::Parser;
use slitpose_tests::acceptance::soak::{Conditions, study};
use slitpose_tests::process::Slitpose;
use slitpose_tests::verdicts::Verdicts;

#[derive(Parser)]
#[command(about = "Several boards for a long time")]
struct Options {
    /// Boards, each at 4 kHz on a pseudo-terminal
    #[arg(long, default_value_t = 4)]
    boards: u8,
    /// For how long, such as 10m
    #[arg(long, default_value = "10m", value_parser = humantime::parse_duration)]
    duration: Duration,
    /// Memory may grow by so many KiB from the second quarter to the last
    #[arg(long, default_value_t = 2048.0)]
    most_growth_kib: f64,
    /// The command to test [default: the one beside this example]
    #[arg(long)]
    slitpose: Option<PathBuf>,
}

fn main() -> ExitCode {
    let options = Options::parse();
    let conditions = Conditions {
        boards: options.boards,
        duration: options.duration,
        every: Duration::from_secs(1),
        most_growth_bytes: options.most_growth_kib * 1024.0,
    };
    let report = study(Slitpose::given_or_beside(options.slitpose), &conditions);
    print!("{report}");
    let mut verdicts = Verdicts::default();
    report.check(&mut verdicts);
    verdicts.end()
}
