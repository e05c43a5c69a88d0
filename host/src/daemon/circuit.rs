//! Queues that allocate nothing: a fixed number of containers goes round between two threads, full
//! one way and empty the other.

use std::time::Duration;

use crossbeam_channel::{Receiver, RecvTimeoutError, Sender, TryRecvError, TrySendError, bounded};

/// A circuit of `count` containers, each made by `make`: at most that many are full at a time. They go round
/// in turn, so that all of them are soon as large as they get.
pub(super) fn circuit<T>(count: usize, make: impl Fn() -> T) -> (Filler<T>, Drainer<T>) {
    let (full_out, full_in) = bounded(count);
    let (empty_out, empty_in) = bounded(count);
    for _ in 0..count {
        // There is room for all of them.
        let _ = empty_out.try_send(make());
    }
    (Filler { full: full_out, empty: empty_in }, Drainer { full: full_in, empty: empty_out })
}

/// The end that fills; there may be several.
#[derive(Debug)]
pub(super) struct Filler<T> {
    full: Sender<T>,
    empty: Receiver<T>,
}

/// The end that empties.
#[derive(Debug)]
pub(super) struct Drainer<T> {
    full: Receiver<T>,
    empty: Sender<T>,
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
        Self { full: self.full.clone(), empty: self.empty.clone() }
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

    /// Hands a full container over. It is dropped if the other end has gone.
    pub(super) fn hand_over(&self, container: T) {
        match self.full.try_send(container) {
            Ok(()) | Err(TrySendError::Disconnected(_)) => {}
            Err(TrySendError::Full(_)) => unreachable!("more containers than the circuit was made with"),
        }
    }
}

impl<T> Drainer<T> {
    /// The next full container, after a wait of `timeout` at most.
    pub(super) fn next(&self, timeout: Duration) -> Result<T, Dry> {
        self.full.recv_timeout(timeout).map_err(|error| match error {
            RecvTimeoutError::Timeout => Dry::Yet,
            RecvTimeoutError::Disconnected => Dry::Forever,
        })
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
