//! A board that is unplugged in all manners and comes back at another port: a table on stdout, exit code 1
//! if it took too long or anything leaked.
//!
//! ```text
//! cargo build --release -p slitpose
//! cargo run --release -p slitpose-tests --example replug -- [--cycles 1000] [--seed S]
//! ```

use std::path::PathBuf;
use std::process::ExitCode;
use std::time::Duration;

use clap::Parser;
use slitpose_tests::acceptance::replug::{Conditions, study};
use slitpose_tests::process::Slitpose;
use slitpose_tests::verdicts::Verdicts;

#[derive(Parser)]
#[command(about = "A board that goes and comes back")]
struct Options {
    /// Times
    #[arg(long, default_value_t = 1000)]
    cycles: usize,
    /// Of the pauses
    #[arg(long, default_value_t = 20_180_718)]
    seed: u64,
    /// Poses must be there again within this
    #[arg(long, default_value = "1s", value_parser = humantime::parse_duration)]
    within: Duration,
    /// Memory may grow by so many KiB from the second quarter to the last
    #[arg(long, default_value_t = 1024.0)]
    most_growth_kib: f64,
    /// The command to test [default: the one beside this example]
    #[arg(long)]
    slitpose: Option<PathBuf>,
}

fn main() -> ExitCode {
    let Options { cycles, seed, within, most_growth_kib, slitpose } = Options::parse();
    let conditions = Conditions { cycles, seed, within, most_growth_bytes: most_growth_kib * 1024.0 };
    let report = study(Slitpose::given_or_beside(slitpose), &conditions);
    print!("{report}");
    let mut verdicts = Verdicts::default();
    report.check(&mut verdicts);
    verdicts.end()
}
