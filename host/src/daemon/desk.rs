//! Where the two threads of a board meet over its solver.
//!
//! The reading thread processes what it has read itself, as long as nothing else is waiting and processing is
//! quick: waking the other thread would cost more than the work. Slow work, and whatever arrives during it, is
//! left to the other thread, so that reading continues. A mutex around the worker lets one thread work at a time,
//! and the reading thread works only while the queue is empty: pieces are processed in the order of their arrival.

use std::sync::{Arc, Mutex, MutexGuard};

use super::circuit::{Drainer, Filler};
use slitpose_head::threads::lock;

/// Processes pieces, one after another.
pub(super) trait Worker {
    /// What comes.
    type Piece;

    /// Processes `piece`; `false` if that takes long and some of the work is left for the other thread.
    fn serve(&mut self, piece: &mut Self::Piece) -> bool;
}

/// The reading thread's end.
pub(super) struct Desk<W: Worker> {
    worker: Arc<Mutex<W>>,
    pieces: Filler<W::Piece>,
    /// The container that is filled next.
    own: Option<W::Piece>,
    /// Whether the reading thread processes pieces, too.
    serves: bool,
}

/// The other thread's end.
pub(super) struct Bench<W: Worker> {
    worker: Arc<Mutex<W>>,
    /// What was left to it.
    pub(super) pieces: Drainer<W::Piece>,
}

/// Both ends, around a circuit of containers. `serves`: the reading thread processes pieces, too.
pub(super) fn desk<W: Worker>(
    worker: W,
    (pieces, left): (Filler<W::Piece>, Drainer<W::Piece>),
    serves: bool,
) -> (Desk<W>, Bench<W>) {
    let worker = Arc::new(Mutex::new(worker));
    (Desk { worker: Arc::clone(&worker), pieces, own: None, serves }, Bench { worker, pieces: left })
}

impl<W: Worker> Desk<W> {
    /// The container to be filled next, as soon as there is one; `None` if the other end has gone.
    pub(super) fn piece(&mut self) -> Option<&mut W::Piece> {
        if self.own.is_none() {
            self.own = self.pieces.spare();
        }
        self.own.as_mut()
    }

    /// Processes the filled container, or leaves it to the other end.
    pub(super) fn pass_on(&mut self) {
        let Some(mut piece) = self.own.take() else {
            return;
        };
        if self.serves
            && let Ok(mut worker) = self.worker.try_lock()
            && self.pieces.is_empty()
        {
            let is_done = worker.serve(&mut piece);
            drop(worker);
            self.own = Some(piece);
            if !is_done {
                self.pieces.call();
            }
        } else {
            self.pieces.hand_over(piece);
        }
    }
}

impl<W: Worker> Bench<W> {
    /// The worker, once the other end does not use it. Take pieces only while holding it, or their order is lost.
    pub(super) fn worker(&self) -> MutexGuard<'_, W> {
        lock(&self.worker)
    }
}

#[cfg(test)]
mod tests {
    use std::thread;
    use std::time::Duration;

    use super::super::circuit::{Dry, circuit};
    use super::*;

    /// Of each eight pieces one takes long: then it is left.
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
        type Piece = u64;

        fn serve(&mut self, piece: &mut u64) -> bool {
            self.do_rest();
            self.served += 1;
            self.left = Some(*piece);
            if !piece.is_multiple_of(8) {
                self.do_rest();
            }
            self.left.is_none()
        }
    }

    fn pass(serves: bool, pieces: u64) -> Clerk {
        // One that is not called sleeps for longer than any test may take.
        const LONG: Duration = Duration::from_secs(3600);
        let (mut desk, bench) = desk(Clerk::default(), circuit(4, || 0), serves);
        thread::scope(|scope| {
            let works = scope.spawn(move || {
                loop {
                    let mut clerk = bench.worker();
                    clerk.do_rest();
                    let next = bench.pieces.next_now();
                    if let Ok(piece) = next {
                        clerk.done.push(piece);
                        bench.pieces.give_back(piece);
                        // While it works the other end leaves things to it.
                        thread::sleep(Duration::from_micros(20));
                    }
                    drop(clerk);
                    match next {
                        Ok(_) => {}
                        Err(Dry::Yet) => bench.pieces.wait(LONG),
                        Err(Dry::Forever) => return std::mem::take(&mut *bench.worker()),
                    }
                }
            });
            for number in 1..=pieces {
                *desk.piece().unwrap() = number;
                desk.pass_on();
                if number.is_multiple_of(50) {
                    thread::sleep(Duration::from_micros(50));
                }
            }
            // What was left is done without another piece.
            while desk.worker.lock().unwrap().done.len() < pieces as usize {
                thread::sleep(Duration::from_micros(50));
            }
            drop(desk);
            works.join().unwrap()
        })
    }

    #[test]
    fn pieces_are_processed_in_order_by_either_thread() {
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
    fn a_piece_in_the_queue_is_processed_before_a_new_one() {
        let (mut desk, bench) = desk(Clerk::default(), circuit(4, || 0), true);
        let mut pass_on = |number| {
            *desk.piece().unwrap() = number;
            desk.pass_on();
        };
        pass_on(1);
        let busy = bench.worker();
        pass_on(2);
        drop(busy);
        // The worker is free, and the second has still to be worked off.
        pass_on(3);
        assert_eq!((bench.pieces.next_now(), bench.pieces.next_now()), (Ok(2), Ok(3)));
        pass_on(4);
        assert_eq!(bench.worker().done, [1, 4]);
        assert_eq!(bench.pieces.next_now(), Err(Dry::Yet));
    }
}
