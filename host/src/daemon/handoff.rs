//! The handoff from the reading thread of a board to its solving thread.
//!
//! The reading thread itself processes the chunks it has read, as long as the queue is empty and processing is quick:
//! waking the solving thread would cost more than the work. Slow work, and all chunks that arrive during it, are left
//! to the solving thread, so that reading continues. Chunks are processed in the order of their arrival: a mutex
//! around the worker lets one thread work at a time, and the reading thread works only while the queue is empty.

use std::sync::{Arc, Mutex, MutexGuard};

use super::buffer_pool::{Consumer, Producer};
use slitpose_head::threads::lock;

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
    use std::time::Duration;

    use super::super::buffer_pool::{Empty, buffer_pool};
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
                        Err(Empty::ForNow) => solver_end.chunks.wait(LONG),
                        Err(Empty::Closed) => return std::mem::take(&mut *solver_end.worker()),
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
        assert_eq!(solver_end.chunks.next_now(), Err(Empty::ForNow));
    }
}
