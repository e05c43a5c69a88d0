//! What the host shares between threads without a lock, in every order of steps, and every order in which memory may show
//! them (loom).
//!
//! The sources are those of the host: they take atomics and threads from their parent, which here is loom's.

use std::sync::Arc;
use std::time::Duration;

use atomic::{AtomicU64, Ordering};
use loom::model::Builder;

mod atomic {
    pub use loom::sync::atomic::{AtomicBool, AtomicU64, Ordering, fence};
}

mod thread {
    pub use loom::thread::{Thread, current};

    /// Without a timeout: a thread that is not woken is found as a deadlock.
    pub fn park_timeout(_: std::time::Duration) {
        loom::thread::park();
    }
}

#[path = "../../host/src/daemon/handoff/sleeper.rs"]
mod sleeper;
#[path = "../../host/src/datagram/slot.rs"]
mod slot;

/// A sleeper that is not woken sleeps for ever.
const LONG: Duration = Duration::from_secs(3600);

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

/// Runs it in every order in which the threads are interrupted at most `interruptions` times.
fn in_every_order(interruptions: Option<usize>, run: impl Fn() + Send + Sync + 'static) {
    let mut builder = Builder::new();
    builder.preemption_bound = interruptions;
    builder.check(run);
}

#[test]
fn a_reader_sees_whole_datagrams_and_never_an_older_one() {
    in_every_order(Some(2), || {
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

#[test]
fn a_sleeper_is_woken_by_what_is_handed_over() {
    in_every_order(None, || {
        let (sleeper, handed) = (Arc::new(sleeper::Sleeper::default()), Arc::new(AtomicU64::new(0)));
        let (sleeps, comes) = (Arc::clone(&sleeper), Arc::clone(&handed));
        let sleeping = loom::thread::spawn(move || {
            while comes.load(Ordering::Relaxed) == 0 {
                sleeps.sleep(LONG, || comes.load(Ordering::Relaxed) == 1);
            }
        });
        handed.store(1, Ordering::Relaxed);
        sleeper.wake();
        sleeping.join().expect("woken");
    });
}

#[test]
fn a_sleeper_that_is_called_sees_what_was_written_before() {
    in_every_order(None, || {
        let (sleeper, written) = (Arc::new(sleeper::Sleeper::default()), Arc::new(AtomicU64::new(0)));
        let (sleeps, reads) = (Arc::clone(&sleeper), Arc::clone(&written));
        let sleeping = loom::thread::spawn(move || {
            while reads.load(Ordering::Relaxed) == 0 {
                sleeps.sleep(LONG, || false);
            }
        });
        written.store(1, Ordering::Relaxed);
        sleeper.call();
        sleeping.join().expect("woken");
    });
}
