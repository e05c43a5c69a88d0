//! `slitpose run` whose output nobody reads: control loops get new poses all the same, nothing is lost, and
//! an interrupt ends it.
#![cfg(target_os = "linux")]

use std::path::Path;
use std::process::Child;
use std::time::{Duration, Instant};

use nix::sys::signal::Signal;
use slitpose::datagram::PoseDatagram;
use slitpose_tests::daemon::Follower;
use slitpose_tests::ndjson;
use slitpose_tests::process::{Finished, name_in, signal};
use slitpose_tests::slitpose;
use slitpose_tests::studies::scan_table;
use slitpose_tests::terminal::{Board, Terminal};

/// However busy the machine is. Nothing is judged by it but what would never come.
const PATIENCE: Duration = Duration::from_secs(120);

/// Scans of more than half a second are on their way to an output that is not read: the pipe and all
/// buffers are full by then.
const FULL: u64 = 4_000;

/// The datagram's flags, and its bit for scans that were passed over, as `slitpose_pose.h` has them.
const FLAGS_AT: usize = 8;
const BEHIND: u32 = 32;
const SEQUENCE_AT: usize = 48;

/// A daemon on a virtual board, with a client that follows; nobody reads what it prints.
struct Unread {
    child: Child,
    client: Follower,
    since: Instant,
}

impl Unread {
    fn start(terminal: &Terminal, folder: &Path, arguments: &[&str]) -> Self {
        let server = name_in(folder, "pose");
        let publish = format!("unix:{server}");
        let first = ["run", "--device", &terminal.path, "--format", "ndjson", "--publish", &publish];
        let child = slitpose!().spawn(first.iter().chain(arguments));
        Self { child, client: Follower::of(server.into()), since: Instant::now() }
    }

    /// The number and the flags of the next pose.
    fn next(&mut self) -> (u64, u32) {
        let mut datagram = [0; PoseDatagram::BYTES];
        while !self.client.receive(&mut datagram) {
            assert!(self.since.elapsed() < PATIENCE, "no pose comes");
        }
        let flags = u32::from_le_bytes(datagram[FLAGS_AT..][..4].try_into().expect("four bytes"));
        let sequence = u64::from_le_bytes(datagram[SEQUENCE_AT..][..8].try_into().expect("eight bytes"));
        (sequence, flags)
    }
}

#[test]
fn who_does_not_read_standard_output_keeps_no_control_loop_waiting() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let terminal = Terminal::serve(Board::wide(80));
    let mut unread = Unread::start(&terminal, folder.path(), &["--duration", "3s"]);
    let (mut last, mut behind) = (None, 0);
    // Nothing has been read when the last scans come; one of each read is given in this case.
    while last.is_none_or(|last| last < 11_900) {
        let (sequence, flags) = unread.next();
        assert!(last.is_none_or(|last| last < sequence), "scan {sequence} after {last:?}");
        behind += u64::from(flags & BEHIND != 0);
        last = Some(sequence);
    }
    assert!(behind > 0, "it does not say that scans were passed over");
    // Standard output never drops.
    let finished = Finished::of(unread.child);
    terminal.closed();
    let lines = ndjson::parse(&finished.done());
    assert_eq!(lines.len(), 12_000);
    lines.iter().zip(lines[0].sequence..).for_each(|(line, expected)| assert_eq!(line.sequence, expected));
}

#[test]
fn an_interrupt_ends_a_run_whose_output_nobody_reads() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let capture = name_in(folder.path(), "run.mcap");
    let terminal = Terminal::serve(Board::wide(81));
    let mut unread = Unread::start(&terminal, folder.path(), &["--record", &capture]);
    let mut last = 0;
    while last < 2 * FULL {
        last = unread.next().0;
    }
    signal(&unread.child, Signal::SIGINT);
    let since = Instant::now();
    // Nothing is read before it has ended.
    while unread.child.try_wait().expect("status").is_none() {
        assert!(since.elapsed() < PATIENCE, "the interrupt is not answered");
        std::thread::sleep(Duration::from_millis(10));
    }
    println!("ended {:?} after the interrupt", since.elapsed());
    let finished = Finished::of(unread.child);
    terminal.closed();
    assert_eq!(finished.code, 1, "{}", finished.stderr);
    assert!(finished.stderr.contains("nobody reads what is printed"), "{}", finished.stderr);
    // What was not solved is in the capture.
    let (boards, replayed) = scan_table::count(slitpose!(), &capture, &[]);
    assert_eq!(replayed.code, 0, "{}", replayed.stderr);
    let scans = boards.into_values().next().expect("a board");
    assert!(scans.jumps == 0 && scans.first + scans.count > last, "{scans:?}, {last} was sent");
    assert_eq!(scans.poses, scans.count);
}
