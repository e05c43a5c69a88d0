//! What `replay --format csv` says of a capture, counted while it comes: there may be millions of rows.

use std::collections::BTreeMap;

use crate::process::{Finished, Slitpose};

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Scans {
    pub first: u64,
    pub count: u64,
    pub poses: u64,
    /// How many do not follow the one before.
    pub jumps: u64,
    /// Numbers that are missing between others.
    pub missing: u64,
    next: Option<u64>,
}

/// Replays the capture at `path`, in the equations of its recording unless `arguments` say otherwise, and
/// counts scans, by board.
pub fn count(slitpose: Slitpose, path: &str, arguments: &[&str]) -> (BTreeMap<String, Scans>, Finished) {
    let mut child = slitpose.spawn(["replay", path, "--format", "csv"].iter().chain(arguments));
    let mut rows = csv::Reader::from_reader(child.stdout.take().expect("piped"));
    let header = rows.headers().expect("a header").clone();
    let columns = ["seq", "device", "tx_mm"].map(|name| header.iter().position(|column| column == name));
    let mut boards = BTreeMap::<String, Scans>::new();
    let mut row = csv::StringRecord::new();
    while rows.read_record(&mut row).expect("a row") {
        let [number, board, x] = columns.map(|column| &row[column.expect("a column")]);
        let number: u64 = number.parse().expect("a number");
        if !boards.contains_key(board) {
            boards.insert(board.to_owned(), Scans { first: number, ..Scans::default() });
        }
        let scans = boards.get_mut(board).expect("inserted");
        scans.count += 1;
        scans.poses += u64::from(!x.is_empty());
        scans.missing += scans.next.map_or(0, |next| number.saturating_sub(next));
        scans.jumps += u64::from(scans.next.is_some_and(|next| next != number));
        scans.next = Some(number + 1);
    }
    // Replay says little: its talk waits for the end.
    (boards, Finished::of(child))
}

/// Whether a replay that says this found nothing but who the boards are, or not even that: nothing was flushed yet.
pub fn is_empty(stderr: &str) -> bool {
    stderr.contains("holds no scan") || stderr.contains("empty")
}
