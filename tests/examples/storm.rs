//! The daemon with several faulty boards, suspended, killed, without a disk, and its wall clock set, at random: a table on
//! stdout, exit code 1 if anything was lost silently, grew, or did not come back.
//!
//! ```text
//! cargo build --release -p slitpose
//! cargo run --release -p slitpose-tests --example storm -- [--duration 20m] [--disk FOLDER] [--picture FILE.svg]
//! ```
//!
//! Each daemon's capture is counted and removed when it ends, so that a day needs as much disk as the longest life of one.

use std::fs;
use std::path::PathBuf;
use std::process::ExitCode;
use std::time::Duration;

use clap::Parser;
use slitpose_tests::acceptance::live_pages::{Page, look};
use slitpose_tests::acceptance::storm::{Conditions, study};
use slitpose_tests::process::Slitpose;
use slitpose_tests::verdicts::Verdicts;

#[derive(Parser)]
#[command(about = "Faulty boards, and a daemon that is suspended, killed, without a disk, and whose clock is set")]
struct Options {
    /// Boards, simulated, each at 4 kHz
    #[arg(long, default_value_t = 4)]
    boards: usize,
    /// For how long, such as 20m or 24h
    #[arg(long, default_value = "20m", value_parser = humantime::parse_duration)]
    duration: Duration,
    /// Seed of faults and blows
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// A mounted file system of its own, for captures; it is frozen now and then, which needs root
    #[arg(long, value_name = "FOLDER")]
    disk: Option<PathBuf>,
    /// Each daemon may take so many MiB of memory
    #[arg(long, default_value_t = 160)]
    most_mib: u64,
    /// Write the looks at the daemon as CSV
    #[arg(long, value_name = "FILE")]
    csv: Option<PathBuf>,
    /// Draw them as SVG
    #[arg(long, value_name = "FILE")]
    picture: Option<PathBuf>,
    /// The command to test [default: the one beside this example]
    #[arg(long)]
    slitpose: Option<PathBuf>,
}

fn main() -> ExitCode {
    let options = Options::parse();
    let conditions = Conditions {
        boards: options.boards,
        duration: options.duration,
        least_blows: 0,
        seed: options.seed,
        pause_s: 8.0..25.0,
        live: Some(look([Page::Takes]).to_string()),
        disk: options.disk,
        most_bytes: options.most_mib << 20,
    };
    let report = study(Slitpose::given_or_beside(options.slitpose), &conditions);
    print!("{report}");
    for (path, text) in [(options.csv, report.csv()), (options.picture, report.picture())] {
        if let Some(path) = path {
            fs::write(&path, text).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
        }
    }
    let mut verdicts = Verdicts::default();
    report.check(&mut verdicts);
    verdicts.end()
}
