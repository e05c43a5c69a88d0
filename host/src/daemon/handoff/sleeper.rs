//! A thread that sleeps until others wake it.

use std::sync::OnceLock;
use std::time::Duration;

// Of the parent, so that `tests/tests/lock_free.rs` can try all orders of these.
use super::atomic::{AtomicBool, Ordering, fence};
use super::thread::{self, Thread};

/// The consumer's thread, and whether it sleeps.
#[derive(Debug, Default)]
pub(super) struct Sleeper {
    thread: OnceLock<Thread>,
    is_asleep: AtomicBool,
    /// Set to wake the consumer although no buffer was handed over.
    is_called: AtomicBool,
}

impl Sleeper {
    /// Wakes the consumer, after a buffer was handed over.
    pub(super) fn wake(&self) {
        // With the fence in `sleep`: either the consumer sees the buffer, or this thread sees that it sleeps.
        fence(Ordering::SeqCst);
        if self.is_asleep.load(Ordering::Relaxed)
            && let Some(thread) = self.thread.get()
        {
            thread.unpark();
        }
    }

    /// Wakes the consumer, or prevents its next sleep.
    pub(super) fn call(&self) {
        // What the caller has written before is seen by who is woken: without that it could look, see nothing, and sleep on.
        self.is_called.store(true, Ordering::Release);
        self.wake();
    }

    /// Sleeps until woken or until `timeout` has passed, possibly shorter; not at all if it was called, or if
    /// `has_come`. To be called on one thread only.
    pub(super) fn sleep(&self, timeout: Duration, has_come: impl FnOnce() -> bool) {
        self.thread.get_or_init(thread::current);
        self.is_asleep.store(true, Ordering::Relaxed);
        fence(Ordering::SeqCst);
        if !self.is_called.swap(false, Ordering::Acquire) && !has_come() {
            thread::park_timeout(timeout);
        }
        self.is_asleep.store(false, Ordering::Relaxed);
    }
}
