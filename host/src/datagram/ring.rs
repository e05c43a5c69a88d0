//! The last poses of each board in shared memory, as [`super`] describes it.

use std::path::Path;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex};

use anyhow::Result;

use super::PoseDatagram;
use super::slot;
use crate::platform::SharedMemory;
use slitpose_head::threads::lock;

const HEAD: [u8; 8] = *b"SLPM\x01\0\0\0";

/// Most boards whose poses one memory takes.
pub const MAX_BOARDS: usize = 8;

/// Records of a ring: 64 ms of a board at 4 kHz.
const RECORDS: u64 = 256;

/// More poses than ever come, whose versions do not overflow.
const MAX_COUNT: u64 = 1 << 62;

// In words of eight bytes. The head of the file, that of a ring, and a record each begin a cache line of 64 bytes.
const AT_GENERATION: usize = 1;
const HEAD_WORDS: usize = 8;
const POSE_WORDS: usize = PoseDatagram::BYTES / size_of::<u64>();
const RECORD_WORDS: usize = (1 + POSE_WORDS).next_multiple_of(8);
const RING_WORDS: usize = HEAD_WORDS + RECORDS as usize * RECORD_WORDS;
const WORDS: usize = HEAD_WORDS + MAX_BOARDS * RING_WORDS;

/// A memory with a ring for each board.
#[derive(Debug)]
pub(super) struct Memory {
    shared: SharedMemory,
    /// First words of the rings that nobody writes.
    free: Mutex<Vec<usize>>,
}

impl Memory {
    /// Begins a new generation of the memory at `path`: its rings are empty.
    pub(super) fn open(path: &Path) -> Result<Self> {
        let shared = SharedMemory::open(path, HEAD, WORDS * size_of::<u64>())?;
        let free: Vec<usize> = (HEAD_WORDS..WORDS).step_by(RING_WORDS).rev().collect();
        free.iter().for_each(|&ring| empty(shared.word(ring)));
        shared.word(AT_GENERATION).fetch_add(1, Ordering::Release);
        Ok(Self { shared, free: Mutex::new(free) })
    }

    /// A ring of its own for a board; `None` if [`MAX_BOARDS`] have one.
    pub(super) fn ring(self: &Arc<Self>) -> Option<Ring> {
        let first = lock(&self.free).pop()?;
        // Of a damaged file the count may be anything.
        let count = self.shared.word(first).load(Ordering::Relaxed) % MAX_COUNT;
        Some(Ring { memory: Arc::clone(self), first, count })
    }
}

/// Empties a ring whose count is `count`: behind so many records that do not exist, readers find none of the past.
fn empty(count: &AtomicU64) {
    count.fetch_add(RECORDS, Ordering::Release);
}

/// The writer of a ring. It waits for nobody, and makes no call to the system.
#[derive(Debug)]
pub(super) struct Ring {
    memory: Arc<Memory>,
    first: usize,
    count: u64,
}

impl Ring {
    pub(super) fn store(&mut self, datagram: &PoseDatagram) {
        let shared = &self.memory.shared;
        let record = self.first + HEAD_WORDS + (self.count % RECORDS) as usize * RECORD_WORDS;
        self.count += 1;
        let words = (record + 1..).map(|number| shared.word(number));
        slot::store(shared.word(record), 2 * self.count, words, datagram);
        shared.word(self.first).store(self.count, Ordering::Release);
    }
}

impl Drop for Ring {
    fn drop(&mut self) {
        empty(self.memory.shared.word(self.first));
        lock(&self.memory.free).push(self.first);
    }
}
