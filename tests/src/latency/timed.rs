//! A board that notes when it wrote each scan.

use std::sync::{Arc, Mutex, PoisonError};

use nix::time::{ClockId, clock_gettime};
use slitpose_protocol::{Decoder, MAX_MESSAGE_BYTES, Message, Schedule};

use super::{Received, Way};
use crate::terminal::Device;

/// A board that notes when it wrote each scan.
#[derive(Debug)]
pub struct Timed<D> {
    board: D,
    decoder: Decoder<MAX_MESSAGE_BYTES>,
    schedule: Option<Schedule>,
    written: Arc<Mutex<Written>>,
}

/// What a board has written.
#[derive(Clone, Debug, Default)]
pub struct Written {
    /// When, CLOCK_MONOTONIC in ns.
    pub writes_ns: Vec<u64>,
    /// For each scan in order: its number, which write it was in, and how many were ahead of it there.
    pub scans: Vec<(u64, usize, usize)>,
}

/// Gives what was written when the board has gone.
#[derive(Debug)]
pub struct Notes(Arc<Mutex<Written>>);

impl Notes {
    /// All notes so far.
    pub fn take(&self) -> Written {
        std::mem::take(&mut self.0.lock().unwrap_or_else(PoisonError::into_inner))
    }
}

impl<D: Device> Timed<D> {
    /// `board`, and its notes.
    pub fn new(board: D) -> (Self, Notes) {
        let written = Arc::default();
        let notes = Notes(Arc::clone(&written));
        (Self { board, decoder: Decoder::new(), schedule: None, written }, notes)
    }
}

impl<D: Device> Device for Timed<D> {
    fn act(&mut self, received: &[u8], now_s: f64, sent: &mut Vec<u8>) -> bool {
        let start = sent.len();
        let plugged = self.board.act(received, now_s, sent);
        let mut written = self.written.lock().unwrap_or_else(PoisonError::into_inner);
        let (mut bytes, write, mut place) = (&sent[start..], written.writes_ns.len(), 0);
        while let Some(message) = self.decoder.next::<Message<'_>>(&mut bytes) {
            match (message.expect("undamaged"), &self.schedule) {
                (Message::Hello(hello), _) => self.schedule = Some(hello.schedule),
                (Message::Batch(batch), Some(schedule)) => {
                    for scan in batch.scans(schedule).expect("readable") {
                        written.scans.push((scan.sequence, write, place));
                        place += 1;
                    }
                }
                _ => {}
            }
        }
        if place > 0 {
            // The write is what its caller does next.
            written.writes_ns.push(now_ns());
        }
        plugged
    }
}

impl Written {
    /// The whole way of a pose.
    ///
    /// # Panics
    /// If its scan was never written.
    pub fn way_of(&self, received: Received) -> Way {
        let at = self.scans.binary_search_by_key(&received.sequence, |(sequence, ..)| *sequence);
        let (_, write, place) = self.scans[at.expect("a scan that was written")];
        Way { written_ns: self.writes_ns[write], place, received }
    }
}

fn now_ns() -> u64 {
    let now = clock_gettime(ClockId::CLOCK_MONOTONIC).expect("a clock");
    now.tv_sec() as u64 * 1_000_000_000 + now.tv_nsec() as u64
}
