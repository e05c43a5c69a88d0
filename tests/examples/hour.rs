//! How fast a long capture is solved on one core, and in how much memory: a table on stdout, exit code 1 if
//! it is slower than required or takes more.
//!
//! ```text
//! cargo build --release -p slitpose
//! cargo run --release -p slitpose-tests --example hour -- [--duration 10m]
//! ```

use std::path::PathBuf;
use std::process::ExitCode;
use std::time::Duration;

use clap::Parser;
use slitpose_tests::acceptance::hour::{Conditions, study};
use slitpose_tests::process::Slitpose;
use slitpose_tests::verdicts::Verdicts;

#[derive(Parser)]
#[command(about = "Long captures, fast and in little memory")]
struct Options {
    /// Device time of the capture, such as 1h
    #[arg(long, default_value = "10m", value_parser = humantime::parse_duration)]
    duration: Duration,
    /// Each command may take so many MiB
    #[arg(long, default_value_t = 64)]
    most_mib: u64,
    /// What to run the command by
    #[arg(long, default_value = "taskset -c 0")]
    by: String,
    /// The command to test [default: the one beside this example]
    #[arg(long)]
    slitpose: Option<PathBuf>,
}

fn main() -> ExitCode {
    let Options { duration, most_mib, by, slitpose } = Options::parse();
    let wrapper = by.split_whitespace().map(str::to_owned).collect();
    let conditions = Conditions { duration, most_bytes: most_mib << 20, wrapper };
    let report = study(Slitpose::given_or_beside(slitpose), &conditions);
    print!("{report}");
    let mut verdicts = Verdicts::default();
    report.check(&mut verdicts);
    verdicts.end()
}
