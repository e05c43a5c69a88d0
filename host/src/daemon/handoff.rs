//! Between threads: a buffer pool between producers and one consumer, and the handoff from the reading thread of a board to
//! its solving thread.
//!
//! A fixed number of buffers circulates, full one way and empty the other; nothing is allocated after the start. The
//! consumer sleeps until it is woken. A channel's blocking receive would spin for some microseconds and yield the
//! processor four times before it sleeps: at a thousand buffers per second that costs more than the work on them.
//!
//! The reading thread itself processes the chunks it has read, as long as the queue is empty and processing is quick:
//! waking the solving thread would cost more than the work. Slow work, and all chunks that arrive during it, are left
//! to the solving thread, so that reading continues. Chunks are processed in the order of their arrival: a mutex
//! around the worker lets one thread work at a time, and the reading thread works only while the queue is empty.

use std::sync::{Arc, Mutex, MutexGuard};
use std::time::{Duration, Instant};

use crossbeam_channel::{Receiver, Sender, TryRecvError, TrySendError, bounded};
use crossbeam_utils::sync::{Parker, Unparker};

use slitpose_head::threads::lock;

/// A pool of `count` buffers, each made by `make`. They are used in turn, so that all of them soon reach their
/// final capacity.
pub(super) fn buffer_pool<T>(count: usize, make: impl Fn() -> T) -> (Producer<T>, Consumer<T>) {
    let (full_out, full_in) = bounded(count);
    let (empty_out, empty_in) = bounded(count);
    for _ in 0..count {
        // The channel has room for all of them.
        let _ = empty_out.try_send(make());
    }
    let parker = Parker::new();
    let alarm = Alarm(parker.unparker().clone());
    (Producer { full: full_out, empty: empty_in, alarm }, Consumer { full: full_in, empty: empty_out, parker })
}

/// Wakes the consumer when the producer is dropped.
#[derive(Clone, Debug)]
struct Alarm(Unparker);

impl Drop for Alarm {
    fn drop(&mut self) {
        self.0.unpark();
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
    parker: Parker,
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
        self.alarm.0.unpark();
    }

    /// Hands a full buffer over, or drops it if the consumer is dropped.
    pub(super) fn hand_over(&self, buffer: T) {
        match self.full.try_send(buffer) {
            Ok(()) => self.alarm.0.unpark(),
            Err(TrySendError::Disconnected(_)) => {}
            Err(TrySendError::Full(_)) => unreachable!("more buffers than the pool was made with"),
        }
    }
}

impl<T> Consumer<T> {
    /// Waits for the next full buffer, for `timeout` at most.
    pub(super) fn next(&self, timeout: Duration) -> Result<T, TryRecvError> {
        let until = Instant::now() + timeout;
        loop {
            let next = self.next_now();
            let left = until.saturating_duration_since(Instant::now());
            if !matches!(next, Err(TryRecvError::Empty)) || left.is_zero() {
                return next;
            }
            self.wait(left);
        }
    }

    /// Waits until there is a full buffer, a producer calls or the last one is dropped, or `timeout` has passed; may
    /// wake spuriously.
    pub(super) fn wait(&self, timeout: Duration) {
        if self.full.is_empty() {
            self.parker.park_timeout(timeout);
        }
    }

    /// The next full buffer, if there is one now; disconnected once all producers are dropped, and all buffers taken.
    pub(super) fn next_now(&self) -> Result<T, TryRecvError> {
        self.full.try_recv()
    }

    pub(super) fn is_empty(&self) -> bool {
        self.full.is_empty()
    }

    pub(super) fn give_back(&self, buffer: T) {
        // Without a producer the buffer is not needed.
        let _ = self.empty.try_send(buffer);
    }
}

// The handoff.

pub(super) trait Worker {
    type Chunk;

    /// Whether it takes another chunk before the work that it has left to the solving thread is done.
    fn has_room(&self) -> bool;

    /// Processes `chunk`; `false` if long work is left to the solving thread.
    fn process(&mut self, chunk: &mut Self::Chunk) -> bool;
}

pub(super) struct ReaderEnd<W: Worker> {
    worker: Arc<Mutex<W>>,
    chunks: Producer<W::Chunk>,
    own: Option<W::Chunk>,
    /// Whether the reading thread processes chunks, too.
    processes: bool,
}

pub(super) struct SolverEnd<W: Worker> {
    worker: Arc<Mutex<W>>,
    pub(super) chunks: Consumer<W::Chunk>,
}

/// Both ends, around a pool of buffers; `processes` lets the reading thread process chunks, too.
pub(super) fn handoff<W: Worker>(
    worker: W,
    (chunks, left): (Producer<W::Chunk>, Consumer<W::Chunk>),
    processes: bool,
) -> (ReaderEnd<W>, SolverEnd<W>) {
    let worker = Arc::new(Mutex::new(worker));
    (ReaderEnd { worker: Arc::clone(&worker), chunks, own: None, processes }, SolverEnd { worker, chunks: left })
}

impl<W: Worker> ReaderEnd<W> {
    /// Waits for an empty chunk to fill; `None` if the solving end is dropped.
    pub(super) fn chunk(&mut self) -> Option<&mut W::Chunk> {
        if self.own.is_none() {
            self.own = self.chunks.spare();
        }
        self.own.as_mut()
    }

    /// Processes the filled chunk, or leaves it to the solving thread.
    pub(super) fn pass_on(&mut self) {
        let Some(mut chunk) = self.own.take() else {
            return;
        };
        if self.processes
            && let Ok(mut worker) = self.worker.try_lock()
            && self.chunks.is_empty()
            && worker.has_room()
        {
            let is_done = worker.process(&mut chunk);
            drop(worker);
            self.own = Some(chunk);
            if !is_done {
                self.chunks.call();
            }
        } else {
            self.chunks.hand_over(chunk);
        }
    }
}

impl<W: Worker> SolverEnd<W> {
    /// Waits for the worker. To keep their order, take chunks only while holding it.
    pub(super) fn worker(&self) -> MutexGuard<'_, W> {
        lock(&self.worker)
    }
}

#[cfg(test)]
mod tests {
    use std::thread;

    use super::*;

    /// A worker that leaves one chunk in eight to the solving thread.
    #[derive(Default)]
    struct Clerk {
        done: Vec<u64>,
        left: Option<u64>,
        served: usize,
    }

    impl Clerk {
        fn do_rest(&mut self) {
            self.done.extend(self.left.take());
        }
    }

    impl Worker for Clerk {
        type Chunk = u64;

        fn has_room(&self) -> bool {
            true
        }

        fn process(&mut self, chunk: &mut u64) -> bool {
            self.do_rest();
            self.served += 1;
            self.left = Some(*chunk);
            if !chunk.is_multiple_of(8) {
                self.do_rest();
            }
            self.left.is_none()
        }
    }

    fn pass(processes: bool, chunks: u64) -> Clerk {
        // A solving thread that is not called sleeps for longer than any test may take.
        const LONG: Duration = Duration::from_secs(3600);
        let (mut handoff, solver_end) = handoff(Clerk::default(), buffer_pool(4, || 0), processes);
        thread::scope(|scope| {
            let works = scope.spawn(move || {
                loop {
                    let mut clerk = solver_end.worker();
                    clerk.do_rest();
                    let next = solver_end.chunks.next_now();
                    if let Ok(chunk) = next {
                        clerk.done.push(chunk);
                        solver_end.chunks.give_back(chunk);
                        // While this thread works the reading thread leaves chunks to it.
                        thread::sleep(Duration::from_micros(20));
                    }
                    drop(clerk);
                    match next {
                        Ok(_) => {}
                        Err(TryRecvError::Empty) => solver_end.chunks.wait(LONG),
                        Err(TryRecvError::Disconnected) => return std::mem::take(&mut *solver_end.worker()),
                    }
                }
            });
            for number in 1..=chunks {
                *handoff.chunk().unwrap() = number;
                handoff.pass_on();
                if number.is_multiple_of(50) {
                    thread::sleep(Duration::from_micros(50));
                }
            }
            // The work that was left is done without another chunk.
            while handoff.worker.lock().unwrap().done.len() < chunks as usize {
                thread::sleep(Duration::from_micros(50));
            }
            drop(handoff);
            works.join().unwrap()
        })
    }

    #[test]
    fn chunks_are_processed_in_order_by_either_thread() {
        const PIECES: u64 = 4_000;
        let expected: Vec<u64> = (1..=PIECES).collect();
        let both = pass(true, PIECES);
        assert_eq!(both.done, expected);
        println!("{} of {PIECES} by the thread that reads", both.served);
        assert!(both.served > 0);
        let one = pass(false, PIECES);
        assert_eq!((one.done, one.served), (expected, 0));
    }

    #[test]
    fn a_chunk_in_the_queue_is_processed_before_a_new_one() {
        let (mut handoff, solver_end) = handoff(Clerk::default(), buffer_pool(4, || 0), true);
        let mut pass_on = |number| {
            *handoff.chunk().unwrap() = number;
            handoff.pass_on();
        };
        pass_on(1);
        let busy = solver_end.worker();
        pass_on(2);
        drop(busy);
        // The worker is free, and the second chunk is still waiting.
        pass_on(3);
        assert_eq!((solver_end.chunks.next_now(), solver_end.chunks.next_now()), (Ok(2), Ok(3)));
        pass_on(4);
        assert_eq!(solver_end.worker().done, [1, 4]);
        assert_eq!(solver_end.chunks.next_now(), Err(TryRecvError::Empty));
    }
}
