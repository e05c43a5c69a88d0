//! What the host shares between threads without a lock, in every order of steps, and every order in which memory may show
//! them (loom).
//!
//! The source is that of the host: it takes atomics from its parent, which here is loom's.

use std::sync::Arc;

use loom::model::Builder;

mod atomic {
    pub use loom::sync::atomic::{AtomicU64, Ordering, fence};
}

#[path = "../../host/src/datagram/slot.rs"]
mod slot;

/// Of a reader that is disturbed.
const ATTEMPTS: usize = 1;

/// One of two words.
#[derive(Debug, PartialEq)]
struct PoseDatagram([u8; Self::BYTES]);

impl PoseDatagram {
    const BYTES: usize = 16;

    fn of(number: u8) -> Self {
        Self([number; Self::BYTES])
    }

    fn from_bytes(bytes: [u8; Self::BYTES]) -> Self {
        Self(bytes)
    }

    fn as_bytes(&self) -> &[u8] {
        &self.0
    }
}

#[test]
fn a_reader_sees_whole_datagrams_and_never_an_older_one() {
    let mut builder = Builder::new();
    // In every order in which the threads are interrupted at most twice.
    builder.preemption_bound = Some(2);
    builder.check(|| {
        let slot = Arc::new(slot::Slot::new());
        let reads = Arc::clone(&slot);
        let reader = loom::thread::spawn(move || {
            let mut last = 0;
            for _ in 0..2 {
                let Some(datagram) = reads.load() else { continue };
                let number = datagram.0[0];
                assert_eq!(datagram, PoseDatagram::of(number), "words of two datagrams");
                assert!((1..=2).contains(&number) && number >= last, "{number} after {last}");
                last = number;
            }
        });
        slot.store(&PoseDatagram::of(1));
        slot.store(&PoseDatagram::of(2));
        reader.join().expect("reader");
        // Nothing disturbs this one.
        assert_eq!(slot.load(), Some(PoseDatagram::of(2)));
    });
}
