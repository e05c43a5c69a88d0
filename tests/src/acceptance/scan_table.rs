//! What `replay --format csv` says of a capture, counted while it comes: there may be millions of rows.

use std::collections::BTreeMap;
use std::io::{BufRead, BufReader};
use std::process::ChildStdout;

use crate::process::{Finished, Slitpose};

/// The scans of one board.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Scans {
    /// Number of the first.
    pub first: u64,
    /// How many.
    pub count: u64,
    /// How many have a pose.
    pub poses: u64,
    /// How many do not follow the one before.
    pub jumps: u64,
    /// Numbers that are missing between others.
    pub missing: u64,
    next: Option<u64>,
}

/// Replays the capture at `path`, in the equations of its recording unless `arguments` say otherwise, and
/// counts scans, by board.
///
/// # Panics
/// If replay cannot be started, or prints no table.
pub fn count(slitpose: Slitpose, path: &str, arguments: &[&str]) -> (BTreeMap<String, Scans>, Finished) {
    let replay = ["replay", path, "--format", "csv"];
    let mut child = slitpose.command(replay.iter().chain(arguments)).spawn().expect("slitpose starts");
    let stdout = child.stdout.take().expect("piped");
    // Replay says little.
    let scans = read(stdout);
    (scans, child.wait_with_output().expect("ends").into())
}

fn read(stdout: ChildStdout) -> BTreeMap<String, Scans> {
    let mut rows = BufReader::with_capacity(1 << 16, stdout);
    let mut line = String::new();
    rows.read_line(&mut line).expect("UTF-8");
    let header: Vec<&str> = line.trim_end().split(',').collect();
    let mut boards = BTreeMap::<String, Scans>::new();
    if header == [""] {
        return boards;
    }
    let column = |name| header.iter().position(|column| *column == name).unwrap_or_else(|| panic!("no column {name}"));
    let [sequence, device, x] = ["seq", "device", "tx_mm"].map(column);
    loop {
        line.clear();
        if rows.read_line(&mut line).expect("UTF-8") == 0 {
            return boards;
        }
        let field = |number: usize| line.trim_end().split(',').nth(number).unwrap_or_else(|| panic!("short: {line}"));
        let (number, board) = (field(sequence).parse::<u64>().expect("a number"), field(device));
        if !boards.contains_key(board) {
            boards.insert(board.to_owned(), Scans { first: number, ..Scans::default() });
        }
        let scans = boards.get_mut(board).expect("inserted");
        scans.count += 1;
        scans.poses += u64::from(!field(x).is_empty());
        scans.missing += scans.next.map_or(0, |next| number.saturating_sub(next));
        scans.jumps += u64::from(scans.next.is_some_and(|next| next != number));
        scans.next = Some(number + 1);
    }
}
