//! The newest datagram of a board.

// Of the parent, so that `tests/tests/lock_free.rs` can try all orders of these.
use super::atomic::{AtomicU64, Ordering, fence};
use super::{ATTEMPTS, PoseDatagram};

const WORDS: usize = PoseDatagram::BYTES / size_of::<u64>();

const _: () = assert!(WORDS * size_of::<u64>() == PoseDatagram::BYTES);

/// A datagram that one thread writes and others copy. The writer never waits: a reader that was
/// disturbed sees that the version has changed, and copies again. This is a sequence lock of atomic
/// words: Boehm, "Can seqlocks get along with programming language memory models?" (MSPC 2012),
/// figure 6.
#[derive(Debug)]
pub(super) struct Slot {
    /// Twice the number of datagrams stored, and one more while the next is being stored.
    version: AtomicU64,
    words: [AtomicU64; WORDS],
}

impl Slot {
    pub(super) fn new() -> Self {
        Self { version: AtomicU64::new(0), words: std::array::from_fn(|_| AtomicU64::new(0)) }
    }

    /// Stores a datagram. To be called from one thread only: two would mix their words.
    pub(super) fn store(&self, datagram: &PoseDatagram) {
        store(&self.version, self.version.load(Ordering::Relaxed) + 2, self.words.iter(), datagram);
    }

    /// The last datagram stored; `None` before the first, or if the writer disturbed all attempts.
    pub(super) fn load(&self) -> Option<PoseDatagram> {
        (0..ATTEMPTS).find_map(|_| {
            let before = self.version.load(Ordering::Acquire);
            let mut bytes = [0; PoseDatagram::BYTES];
            for (word, bytes) in self.words.iter().zip(bytes.chunks_exact_mut(size_of::<u64>())) {
                bytes.copy_from_slice(&word.load(Ordering::Relaxed).to_ne_bytes());
            }
            // No word is read after the version.
            fence(Ordering::Acquire);
            let after = self.version.load(Ordering::Relaxed);
            let is_whole = before == after && before.is_multiple_of(2) && before > 0;
            is_whole.then(|| PoseDatagram::from_bytes(bytes))
        })
    }
}

/// Stores `datagram` in `words` and its version, `even` and greater than the last, in `version`. For one thread only.
pub(super) fn store<'a>(
    version: &AtomicU64,
    even: u64,
    words: impl Iterator<Item = &'a AtomicU64>,
    datagram: &PoseDatagram,
) {
    version.store(even - 1, Ordering::Relaxed);
    // No word becomes visible before the odd version.
    fence(Ordering::Release);
    for (bytes, word) in datagram.as_bytes().chunks_exact(size_of::<u64>()).zip(words) {
        let mut value = [0; size_of::<u64>()];
        value.copy_from_slice(bytes);
        word.store(u64::from_ne_bytes(value), Ordering::Relaxed);
    }
    version.store(even, Ordering::Release);
}
