//! A buffer pool between producers and one consumer: a fixed number of buffers circulates, full one way and empty the
//! other. Nothing is allocated after the start.
//!
//! The consumer sleeps until it is woken. A channel's blocking receive would spin for some microseconds and yield the
//! processor four times before it sleeps: at a thousand buffers per second that costs more than the work on them.

use std::sync::Arc;
use std::time::{Duration, Instant};

use crossbeam_channel::{Receiver, Sender, TryRecvError, TrySendError, bounded};

use super::sleeper::Sleeper;

/// A pool of `count` buffers, each made by `make`. They are used in turn, so that all of them soon reach their
/// final capacity.
pub(super) fn buffer_pool<T>(count: usize, make: impl Fn() -> T) -> (Producer<T>, Consumer<T>) {
    let (full_out, full_in) = bounded(count);
    let (empty_out, empty_in) = bounded(count);
    for _ in 0..count {
        // The channel has room for all of them.
        let _ = empty_out.try_send(make());
    }
    let sleeper = Arc::<Sleeper>::default();
    let alarm = Alarm(Arc::clone(&sleeper));
    (Producer { full: full_out, empty: empty_in, alarm }, Consumer { full: full_in, empty: empty_out, sleeper })
}

/// Wakes the consumer when the producer is dropped.
#[derive(Clone, Debug)]
struct Alarm(Arc<Sleeper>);

impl Drop for Alarm {
    fn drop(&mut self) {
        self.0.call();
    }
}

/// Fills buffers; there may be several producers.
#[derive(Debug)]
pub(super) struct Producer<T> {
    full: Sender<T>,
    empty: Receiver<T>,
    /// Declared after `full`, and therefore dropped after it.
    alarm: Alarm,
}

#[derive(Debug)]
pub(super) struct Consumer<T> {
    full: Receiver<T>,
    empty: Sender<T>,
    sleeper: Arc<Sleeper>,
}

/// Why there is no full buffer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Empty {
    /// No buffer has been handed over yet.
    ForNow,
    Closed,
}

impl<T> Clone for Producer<T> {
    fn clone(&self) -> Self {
        Self { full: self.full.clone(), empty: self.empty.clone(), alarm: self.alarm.clone() }
    }
}

impl<T> Producer<T> {
    /// Waits for an empty buffer; `None` if the consumer is dropped.
    pub(super) fn spare(&self) -> Option<T> {
        self.empty.recv().ok()
    }

    /// An empty buffer, if there is one now.
    pub(super) fn spare_now(&self) -> Option<T> {
        self.empty.try_recv().ok()
    }

    /// Waits for an empty buffer, for `timeout` at most.
    pub(super) fn spare_within(&self, timeout: Duration) -> Option<T> {
        self.empty.recv_timeout(timeout).ok()
    }

    /// Whether no full buffer waits for the consumer.
    pub(super) fn is_empty(&self) -> bool {
        self.full.is_empty()
    }

    /// Wakes the consumer although no buffer is handed over.
    pub(super) fn call(&self) {
        self.alarm.0.call();
    }

    /// Hands a full buffer over, or drops it if the consumer is dropped.
    pub(super) fn hand_over(&self, buffer: T) {
        match self.full.try_send(buffer) {
            Ok(()) => self.alarm.0.wake(),
            Err(TrySendError::Disconnected(_)) => {}
            Err(TrySendError::Full(_)) => unreachable!("more buffers than the pool was made with"),
        }
    }
}

impl<T> Consumer<T> {
    /// Waits for the next full buffer, for `timeout` at most.
    pub(super) fn next(&self, timeout: Duration) -> Result<T, Empty> {
        let until = Instant::now() + timeout;
        loop {
            let next = self.next_now();
            let left = until.saturating_duration_since(Instant::now());
            if !matches!(next, Err(Empty::ForNow)) || left.is_zero() {
                return next;
            }
            self.wait(left);
        }
    }

    /// Waits until there is a full buffer, a producer calls or the last one is dropped, or `timeout` has passed; may
    /// wake spuriously.
    pub(super) fn wait(&self, timeout: Duration) {
        self.sleeper.sleep(timeout, || !self.full.is_empty());
    }

    /// The next full buffer, if there is one now.
    pub(super) fn next_now(&self) -> Result<T, Empty> {
        self.full.try_recv().map_err(|error| match error {
            TryRecvError::Empty => Empty::ForNow,
            TryRecvError::Disconnected => Empty::Closed,
        })
    }

    /// Whether no full buffer waits.
    pub(super) fn is_empty(&self) -> bool {
        self.full.is_empty()
    }

    pub(super) fn give_back(&self, buffer: T) {
        // Without a producer the buffer is not needed.
        let _ = self.empty.try_send(buffer);
    }
}

#[cfg(test)]
mod tests {
    use std::thread;

    use super::*;

    const AT_ONCE: Duration = Duration::ZERO;

    #[test]
    fn buffers_circulate_until_the_producer_is_dropped() {
        let (producer, consumer) = buffer_pool(2, Vec::<u8>::new);
        for round in 0..10 {
            let mut first = producer.spare().unwrap();
            first.push(round);
            producer.hand_over(first);
            producer.hand_over(producer.spare().unwrap());
            assert_eq!(producer.spare_now(), None, "a third buffer");
            for _ in 0..2 {
                let mut full = consumer.next(AT_ONCE).unwrap();
                full.clear();
                consumer.give_back(full);
            }
            assert_eq!(consumer.next(AT_ONCE), Err(Empty::ForNow));
        }
        drop(producer);
        assert_eq!(consumer.next(AT_ONCE), Err(Empty::Closed));
    }

    #[test]
    fn a_sleeping_consumer_is_woken_by_each_buffer_and_by_the_end() {
        const EACH: u64 = 20_000;
        // A consumer that is not woken sleeps for longer than any test may take.
        const LONG: Duration = Duration::from_secs(3600);
        let (producer, consumer) = buffer_pool(2, || (0, 0));
        let received = thread::scope(|scope| {
            let consumes = scope.spawn(move || {
                let mut last = [0; 2];
                while let Ok((of, number)) = consumer.next(LONG) {
                    assert_eq!(number, last[of] + 1);
                    last[of] = number;
                    consumer.give_back((of, number));
                }
                last
            });
            for of in 0..2 {
                let producer = producer.clone();
                scope.spawn(move || {
                    for number in 1..=EACH {
                        producer.spare().unwrap();
                        producer.hand_over((of, number));
                        // Now and then the consumer falls asleep.
                        if number % 64 == 0 {
                            thread::sleep(Duration::from_micros(50));
                        }
                    }
                });
            }
            drop(producer);
            consumes.join().unwrap()
        });
        assert_eq!(received, [EACH; 2]);
    }

    #[test]
    fn full_buffers_arrive_after_the_producer_is_dropped() {
        let (producer, consumer) = buffer_pool(1, Vec::<u8>::new);
        producer.hand_over(producer.spare().unwrap());
        drop(producer);
        assert_eq!(consumer.next(AT_ONCE), Ok(Vec::new()));
        assert_eq!(consumer.next(AT_ONCE), Err(Empty::Closed));
        let (producer, consumer) = buffer_pool(1, Vec::<u8>::new);
        let buffer = producer.spare().unwrap();
        drop(consumer);
        producer.hand_over(buffer);
        assert_eq!(producer.spare(), None);
    }
}
