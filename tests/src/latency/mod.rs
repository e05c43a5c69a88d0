//! From a board's bytes to a control loop in C: how long a pose takes.
//!
//! ```text
//! virtual board ──terminal──▶ slitpose run ──datagram──▶ client in C
//!      written                 read, published              received
//! ```
//!
//! Each of the three is a process, or as good as one, and notes when it had each scan, by
//! CLOCK_MONOTONIC. The board writes what it has once a millisecond, as one on USB does: four scans
//! at 4 kHz. What it costs to simulate it is taken from the same processors.

mod client;
mod distribution;
mod timed;

use std::path::{Path, PathBuf};
use std::process::Child;
use std::time::{Duration, Instant};

use nix::sys::signal::{Signal, kill};
use nix::unistd::Pid;
use tempfile::TempDir;

pub use client::Received;
pub use distribution::Distribution;
pub use timed::{Timed, Written};

use crate::acceptance::usage::Usage;
use crate::process::{Finished, Slitpose};
use crate::terminal::{Board, Terminal};

/// The daemon is ready within this, or never.
const READY_WITHIN: Duration = Duration::from_secs(20);

/// What is measured.
#[derive(Clone, Debug)]
pub struct Plan {
    /// Poses that are left out at the start: the link's and the caches'.
    pub warm_up: usize,
    /// Poses that are measured.
    pub poses: usize,
    /// Whether all is recorded meanwhile.
    pub recorded: bool,
    /// More options of `slitpose run`.
    pub options: Vec<String>,
}

/// The way of one pose. All times are CLOCK_MONOTONIC, ns.
#[derive(Clone, Copy, Debug)]
pub struct Way {
    /// Its scan was on its way to the terminal.
    pub written_ns: u64,
    /// How many scans were ahead of it in the same write.
    pub place: usize,
    /// What the client got.
    pub received: Received,
}

/// What was measured.
#[derive(Clone, Debug)]
pub struct Measurement {
    /// Poses in the order in which the client got them.
    pub ways: Vec<Way>,
    /// When the board wrote, ns.
    pub writes_ns: Vec<u64>,
    /// Share of a processor that the daemon takes from when it is up.
    pub processor_share: f64,
    /// How the daemon ended.
    pub daemon: Finished,
    /// Length of the capture.
    pub capture_bytes: u64,
}

/// Measures `slitpose run` as `plan` says.
///
/// # Panics
/// If a part of it cannot be started, or fails.
pub fn measure(slitpose: Slitpose, plan: &Plan) -> Measurement {
    let folder = TempDir::new().expect("temporary folder");
    let client = client::compile(folder.path());
    let socket = folder.path().join("pose");
    let capture = folder.path().join("latency.mcap");
    let (board, written) = Timed::new(Board::wide(70));
    let terminal = Terminal::serve(board);

    let publish = format!("unix:{}", socket.display());
    let mut arguments = vec!["run", "--config", "none", "--device", &terminal.path, "--format", "none"];
    arguments.extend(["--publish", &publish]);
    if plan.recorded {
        arguments.extend(["--record", capture.to_str().expect("UTF-8")]);
    }
    arguments.extend(plan.options.iter().map(String::as_str));
    let mut daemon = slitpose.command(arguments).spawn().expect("slitpose starts");
    let is_up = await_file(&socket, &mut daemon);
    let (since, begun_s) = (Instant::now(), processor_s(&daemon));
    let received = match is_up {
        true => client::follow(&client, &publish, plan, folder.path()),
        false => Err("it has nobody to follow".to_owned()),
    };
    let processor_share = (processor_s(&daemon) - begun_s) / since.elapsed().as_secs_f64();

    // Fails if it has ended already.
    let _ = kill(Pid::from_raw(i32::try_from(daemon.id()).expect("an id")), Signal::SIGINT);
    let daemon = Finished::from(daemon.wait_with_output().expect("ends"));
    let received = received.unwrap_or_else(|error| panic!("the client: {error}; slitpose: {}", daemon.stderr));
    terminal.closed();

    let written = written.take();
    let ways = received.into_iter().map(|received| written.way_of(received)).collect();
    Measurement {
        ways,
        writes_ns: written.writes_ns,
        processor_share,
        daemon,
        capture_bytes: std::fs::metadata(&capture).map_or(0, |metadata| metadata.len()),
    }
}

/// Whether the daemon makes this file before it ends.
fn await_file(path: &Path, daemon: &mut Child) -> bool {
    let since = Instant::now();
    while !path.exists() {
        if daemon.try_wait().expect("status").is_some() || since.elapsed() > READY_WITHIN {
            return false;
        }
        std::thread::sleep(Duration::from_millis(5));
    }
    true
}

/// Processor time that a process has taken; 0 of one that has ended.
fn processor_s(process: &Child) -> f64 {
    Usage::of(process.id()).map_or(0.0, |usage| usage.cpu_s)
}

/// A file of the repository.
fn repository(path: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("..").join(path)
}
