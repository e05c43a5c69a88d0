//! A thread that hands the streams of all boards to a taker, which may be slow: no other thread waits for it.

use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::thread::JoinHandle;
use std::time::Duration;

use super::buffer_pool::{Empty, buffer_pool};
use super::error::BoardError;
use super::spawn;
use super::tap::{TapChunk, TapEnds};
use slitpose_head::threads::join;

/// Time of a chunk: as short as allows a few messages a millisecond of four boards.
const CHUNK: Duration = Duration::from_millis(2);

/// Most chunks on their way: a quarter of a second of one board.
const CHUNKS_A_BOARD: usize = 128;

/// Longest wait without anything to take.
const IDLE: Duration = Duration::from_millis(100);

/// Takes the streams of all boards.
pub(crate) trait TakesChunks: Send {
    /// Takes the next chunk of a board.
    fn chunk(&mut self, chunk: &TapChunk);

    /// Called after each chunk, and ten times a second without.
    fn tick(&mut self);
}

/// A taker of all bytes.
pub(crate) struct StreamPlan {
    pub(crate) taker: Box<dyn TakesChunks>,
    /// Device time between the poses that it takes, seconds.
    pub(crate) pose_every_s: f64,
}

/// The thread of a taker.
pub(super) struct StreamerThread(JoinHandle<()>);

impl StreamerThread {
    /// Starts the thread; returns what boards need of it.
    pub(super) fn start(plan: StreamPlan, boards: usize) -> Result<(Self, TapEnds), BoardError> {
        let (producer, consumer) = buffer_pool(CHUNKS_A_BOARD * boards.max(1), TapChunk::with_capacity);
        let StreamPlan { mut taker, pose_every_s } = plan;
        let stream = move || {
            loop {
                match consumer.next(IDLE) {
                    Ok(chunk) => {
                        taker.chunk(&chunk);
                        consumer.give_back(chunk);
                    }
                    Err(Empty::ForNow) => {}
                    Err(Empty::Closed) => return,
                }
                taker.tick();
            }
        };
        let thread = spawn("stream".to_owned(), stream)?;
        let is_wanted = Arc::new(AtomicBool::new(true));
        Ok((Self(thread), TapEnds { chunks: producer, is_wanted, pose_every_s, span: CHUNK, tells_hello: true }))
    }

    /// Waits for the end; all boards must have ended.
    pub(super) fn end(self) {
        join(self.0);
    }
}
