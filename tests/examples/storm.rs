//! The daemon with several faulty boards, suspended, killed, and without a disk, at random: a table on stdout, exit code 1
//! if anything was lost silently, grew, or did not come back.
//!
//! ```text
//! cargo build --release -p slitpose
//! cargo run --release -p slitpose-tests --example storm -- [--duration 20m] [--disk FOLDER] [--picture FILE.svg]
//! ```
//!
//! Each daemon's capture is counted and removed when it ends, so that a day needs as much disk as the longest life of one.

use std::fs;
use std::net::{SocketAddr, TcpListener};
use std::path::PathBuf;
use std::process::ExitCode;
use std::thread::{sleep, spawn};
use std::time::Duration;

use clap::Parser;
use slitpose_tests::acceptance::storm::{Conditions, study};
use slitpose_tests::process::Slitpose;
use slitpose_tests::verdicts::Verdicts;
use tungstenite::Message;

#[derive(Parser)]
#[command(about = "Faulty boards, and a daemon that is suspended, killed, and without a disk")]
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

/// Messages that a page takes between two acknowledgements.
const ACKNOWLEDGED: usize = 8;

/// A live page that comes back whenever it loses its daemon; returns where it looks for one.
fn page() -> SocketAddr {
    let address = TcpListener::bind("127.0.0.1:0").and_then(|free| free.local_addr()).expect("a free port");
    spawn(move || {
        loop {
            if let Ok((mut page, _)) = tungstenite::connect(format!("ws://{address}/live")) {
                let mut taken = 0;
                let mut sent = page.send(Message::text(r#"{"kind":"hello"}"#));
                while sent.is_ok() && page.read().is_ok() {
                    taken += 1;
                    if taken % ACKNOWLEDGED == 0 {
                        sent = page.send(Message::text(format!(r#"{{"kind":"ack","messages":{taken}}}"#)));
                    }
                }
            }
            sleep(Duration::from_millis(100));
        }
    });
    address
}

fn main() -> ExitCode {
    let options = Options::parse();
    let conditions = Conditions {
        boards: options.boards,
        duration: options.duration,
        least_blows: 0,
        seed: options.seed,
        pause_s: 8.0..25.0,
        live: Some(page().to_string()),
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
