//! Queues that allocate nothing: a fixed number of containers goes round between two threads, full
//! one way and empty the other.
//!
//! The end that empties sleeps until it is woken. The channels' own waiting turns round for some
//! microseconds before it sleeps, and gives the processor away four times: at a thousand pieces a second
//! that costs more than the pieces.

use std::sync::atomic::{AtomicBool, Ordering, fence};
use std::sync::{Arc, OnceLock};
use std::thread::{self, Thread};
use std::time::{Duration, Instant};

use crossbeam_channel::{Receiver, Sender, TryRecvError, TrySendError, bounded};

/// A circuit of `count` containers, each made by `make`: at most that many are full at a time. They go round
/// in turn, so that all of them are soon as large as they get.
pub(super) fn circuit<T>(count: usize, make: impl Fn() -> T) -> (Filler<T>, Drainer<T>) {
    let (full_out, full_in) = bounded(count);
    let (empty_out, empty_in) = bounded(count);
    for _ in 0..count {
        // There is room for all of them.
        let _ = empty_out.try_send(make());
    }
    let sleeper = Arc::<Sleeper>::default();
    let alarm = Alarm(Arc::clone(&sleeper));
    (Filler { full: full_out, empty: empty_in, alarm }, Drainer { full: full_in, empty: empty_out, sleeper })
}

/// The thread that empties, as far as it sleeps.
#[derive(Debug, Default)]
struct Sleeper {
    thread: OnceLock<Thread>,
    is_asleep: AtomicBool,
    /// It is to look about although nothing was handed over.
    is_called: AtomicBool,
}

impl Sleeper {
    /// Wakes it. What it is woken for has been handed over before.
    fn wake(&self) {
        // Either it sees what was handed over, or it is seen to sleep: the counterpart is in `sleep`.
        fence(Ordering::SeqCst);
        if self.is_asleep.load(Ordering::Relaxed)
            && let Some(thread) = self.thread.get()
        {
            thread.unpark();
        }
    }

    /// Wakes it, or keeps it from falling asleep once.
    fn call(&self) {
        self.is_called.store(true, Ordering::Relaxed);
        self.wake();
    }

    /// Sleeps until it is woken, `timeout` has passed, or for no reason; not if `has_come`. Always on the same
    /// thread.
    fn sleep(&self, timeout: Duration, has_come: impl FnOnce() -> bool) {
        self.thread.get_or_init(thread::current);
        self.is_asleep.store(true, Ordering::Relaxed);
        fence(Ordering::SeqCst);
        if !has_come() {
            thread::park_timeout(timeout);
        }
        self.is_asleep.store(false, Ordering::Relaxed);
    }
}

/// Wakes the end that empties when the end that fills has gone.
#[derive(Clone, Debug)]
struct Alarm(Arc<Sleeper>);

impl Drop for Alarm {
    fn drop(&mut self) {
        self.0.call();
    }
}

/// The end that fills; there may be several.
#[derive(Debug)]
pub(super) struct Filler<T> {
    full: Sender<T>,
    empty: Receiver<T>,
    /// Behind `full`, and so dropped after it.
    alarm: Alarm,
}

/// The end that empties.
#[derive(Debug)]
pub(super) struct Drainer<T> {
    full: Receiver<T>,
    empty: Sender<T>,
    sleeper: Arc<Sleeper>,
}

/// Why nothing came out of a circuit.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Dry {
    /// Nothing yet.
    Yet,
    /// Nothing ever again: the other end has gone.
    Forever,
}

impl<T> Clone for Filler<T> {
    fn clone(&self) -> Self {
        Self { full: self.full.clone(), empty: self.empty.clone(), alarm: self.alarm.clone() }
    }
}

impl<T> Filler<T> {
    /// An empty container, as soon as there is one; `None` if the other end has gone.
    pub(super) fn spare(&self) -> Option<T> {
        self.empty.recv().ok()
    }

    /// An empty container if there is one at once.
    pub(super) fn spare_now(&self) -> Option<T> {
        self.empty.try_recv().ok()
    }

    /// An empty container, after a wait of `timeout` at most.
    pub(super) fn spare_within(&self, timeout: Duration) -> Option<T> {
        self.empty.recv_timeout(timeout).ok()
    }

    /// Whether all that was handed over has been taken.
    pub(super) fn is_empty(&self) -> bool {
        self.full.is_empty()
    }

    /// Makes the other end look about.
    pub(super) fn call(&self) {
        self.alarm.0.call();
    }

    /// Hands a full container over. It is dropped if the other end has gone.
    pub(super) fn hand_over(&self, container: T) {
        match self.full.try_send(container) {
            Ok(()) => self.alarm.0.wake(),
            Err(TrySendError::Disconnected(_)) => {}
            Err(TrySendError::Full(_)) => unreachable!("more containers than the circuit was made with"),
        }
    }
}

impl<T> Drainer<T> {
    /// The next full container, after a wait of `timeout` at most.
    pub(super) fn next(&self, timeout: Duration) -> Result<T, Dry> {
        let until = Instant::now() + timeout;
        loop {
            let next = self.next_now();
            let left = until.saturating_duration_since(Instant::now());
            if !matches!(next, Err(Dry::Yet)) || left.is_zero() {
                return next;
            }
            self.wait(left);
        }
    }

    /// Waits until there is a full container, the other end calls or has gone, `timeout` has passed, or for no
    /// reason.
    pub(super) fn wait(&self, timeout: Duration) {
        let is_called = || self.sleeper.is_called.swap(false, Ordering::Relaxed);
        self.sleeper.sleep(timeout, || is_called() || !self.full.is_empty());
    }

    /// The next full container if there is one at once.
    pub(super) fn next_now(&self) -> Result<T, Dry> {
        self.full.try_recv().map_err(|error| match error {
            TryRecvError::Empty => Dry::Yet,
            TryRecvError::Disconnected => Dry::Forever,
        })
    }

    /// Whether nothing waits to be drained.
    pub(super) fn is_empty(&self) -> bool {
        self.full.is_empty()
    }

    /// Gives an emptied container back.
    pub(super) fn give_back(&self, container: T) {
        // Nobody wants it if the other end has gone.
        let _ = self.empty.try_send(container);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const AT_ONCE: Duration = Duration::ZERO;

    #[test]
    fn containers_go_round() {
        let (filler, drainer) = circuit(2, Vec::<u8>::new);
        for round in 0..10 {
            let mut first = filler.spare().unwrap();
            first.push(round);
            filler.hand_over(first);
            filler.hand_over(filler.spare().unwrap());
            assert_eq!(filler.spare_now(), None, "a third container");
            for _ in 0..2 {
                let mut full = drainer.next(AT_ONCE).unwrap();
                full.clear();
                drainer.give_back(full);
            }
            assert_eq!(drainer.next(AT_ONCE), Err(Dry::Yet));
        }
        drop(filler);
        assert_eq!(drainer.next(AT_ONCE), Err(Dry::Forever));
    }

    #[test]
    fn the_end_that_empties_is_woken_for_each_container_and_for_the_end() {
        const EACH: u64 = 20_000;
        // An end that is not woken sleeps for longer than any test may take.
        const LONG: Duration = Duration::from_secs(3600);
        let (filler, drainer) = circuit(2, || (0, 0));
        let received = thread::scope(|scope| {
            let drains = scope.spawn(move || {
                let mut last = [0; 2];
                while let Ok((of, number)) = drainer.next(LONG) {
                    assert_eq!(number, last[of] + 1);
                    last[of] = number;
                    drainer.give_back((of, number));
                }
                last
            });
            for of in 0..2 {
                let filler = filler.clone();
                scope.spawn(move || {
                    for number in 1..=EACH {
                        filler.spare().unwrap();
                        filler.hand_over((of, number));
                        // Now and then the other end falls asleep.
                        if number % 64 == 0 {
                            thread::sleep(Duration::from_micros(50));
                        }
                    }
                });
            }
            drop(filler);
            drains.join().unwrap()
        });
        assert_eq!(received, [EACH; 2]);
    }

    #[test]
    fn what_is_under_way_arrives_after_the_filler_has_gone() {
        let (filler, drainer) = circuit(1, Vec::<u8>::new);
        filler.hand_over(filler.spare().unwrap());
        drop(filler);
        assert_eq!(drainer.next(AT_ONCE), Ok(Vec::new()));
        assert_eq!(drainer.next(AT_ONCE), Err(Dry::Forever));
        let (filler, drainer) = circuit(1, Vec::<u8>::new);
        let container = filler.spare().unwrap();
        drop(drainer);
        filler.hand_over(container);
        assert_eq!(filler.spare(), None);
    }
}
