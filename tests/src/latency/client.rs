//! The control loop: `tests/latency/latency.c`, compiled as a user would.

use std::path::{Path, PathBuf};
use std::process::Command;

use super::{Plan, repository};

/// Bits of a datagram's flags: the host's time of the scan is known, and scans before it were passed over.
const HAS_HOST_TIME: u64 = 4;
const BEHIND: u64 = 32;

/// What the client knows of a pose. Times are CLOCK_MONOTONIC, ns.
#[derive(Clone, Copy, Debug)]
pub struct Received {
    /// Number of the scan.
    pub sequence: u64,
    /// Number of the datagram: a gap is what the client missed.
    pub datagram: u64,
    /// Whether scans before it were passed over.
    pub is_behind: bool,
    /// When the scan was taken, as far as the daemon knew.
    pub taken_ns: Option<u64>,
    /// The daemon had read its bytes.
    pub arrival_ns: u64,
    /// The daemon had solved it.
    pub published_ns: u64,
    /// The client had it.
    pub received_ns: u64,
}

/// Compiles the client into `folder`.
pub(super) fn compile(folder: &Path) -> PathBuf {
    let program = folder.join("latency");
    let output = Command::new("cc")
        .args(["-O2", "-std=c11", "-I"])
        .arg(repository("host/include"))
        .arg("-o")
        .args([&program, &repository("tests/latency/latency.c")])
        .output()
        .expect("a C compiler, as `cc`");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    program
}

/// Receives the poses of `plan` from `address`, or tells what the client complains of.
pub(super) fn follow(program: &Path, address: &str, plan: &Plan, folder: &Path) -> Result<Vec<Received>, String> {
    let table = folder.join("received");
    let output = Command::new(program)
        .arg(address)
        .args([plan.poses.to_string(), plan.warm_up.to_string()])
        .arg(&table)
        .output()
        .expect("the client starts");
    if !output.status.success() {
        return Err(String::from_utf8_lossy(&output.stderr).into_owned());
    }
    let text = std::fs::read_to_string(&table).expect("a table");
    Ok(text.lines().map(received).collect())
}

fn received(line: &str) -> Received {
    let numbers: Vec<u64> = line.split(' ').map(|number| number.parse().expect("a number")).collect();
    let [sequence, datagram, flags, taken_ns, arrival_ns, published_ns, received_ns] = numbers[..] else {
        panic!("`{line}` is no line of seven numbers");
    };
    let taken_ns = (flags & HAS_HOST_TIME != 0).then_some(taken_ns);
    Received { sequence, datagram, is_behind: flags & BEHIND != 0, taken_ns, arrival_ns, published_ns, received_ns }
}
