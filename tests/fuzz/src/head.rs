//! The head that a host sends to the board's solver.

use slitpose_firmware::pose::{HEAD_BYTES, Head, PoseSolver};
use slitpose_protocol::{Level, RawScan};

/// Bytes before the payload: magic, version, length, checksum.
const HEADER_BYTES: usize = 12;

/// Bytes are no head, or a head that the board loads, too, and that encodes to bytes that are again that head; it solves
/// scans or says why not. The first bytes are the words of scans; the bytes after them count as they are, and with
/// length and checksum put right.
pub(crate) fn head(bytes: &[u8]) {
    let (words, bytes) = bytes.split_at(bytes.len().min(4));
    judge(words, bytes);
    judge(words, &repaired(bytes));
}

fn judge(words: &[u8], bytes: &[u8]) {
    let mut board = PoseSolver::default();
    let loaded = board.load(bytes);
    let head = match Head::decode(bytes) {
        Ok(head) => head,
        Err(error) => return assert_eq!(loaded, Err(error)),
    };
    assert_eq!(loaded, Ok(()));
    let mut room = [0; HEAD_BYTES];
    let again = head.encode(&mut room).expect("no longer than it came").to_vec();
    assert!(again.len() <= bytes.len());
    let head = Head::decode(&again).expect("as it was written");
    assert_eq!(head.encode(&mut [0; HEAD_BYTES]).expect("the same"), again);
    let schedule = head.readout.schedule.clone();
    board.begin(&schedule);
    for (sequence, &word) in (0..).zip(words) {
        let mut scan = RawScan::new(schedule.cells.into(), schedule.dark_slot().is_some());
        scan.sequence = sequence;
        scan.levels_mut().fill(if word == 0 { Level(0) } else { Level::NOMINAL });
        let lit = scan.lit_mut().iter_mut().zip(1_u16..);
        lit.for_each(|(pair, cell)| *pair = [u16::from(word) << 8, (u16::from(word) << 7).wrapping_add(cell)]);
        let solved = board.solve(&scan).expect("the schedule is its own");
        assert_eq!(solved.sequence, sequence);
    }
}

/// With length and checksum of what follows the header.
fn repaired(bytes: &[u8]) -> Vec<u8> {
    let mut bytes = bytes[..bytes.len().min(HEAD_BYTES)].to_vec();
    if let Some((header, payload)) = bytes.split_first_chunk_mut::<HEADER_BYTES>() {
        header[6..8].copy_from_slice(&(payload.len() as u16).to_le_bytes());
        let sum = crc32fast::hash(&[&header[4..8], payload].concat());
        header[8..].copy_from_slice(&sum.to_le_bytes());
    }
    bytes
}
