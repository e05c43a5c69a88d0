//! A thread that hands the streams of all boards to a taker, which may be slow: no other thread waits for it. And the
//! priority of threads that must not be late.

use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::thread::JoinHandle;
use std::time::Duration;

use slitpose_head::threads::join;
use thread_priority::{
    RealtimeThreadSchedulePolicy, ThreadPriority, ThreadPriorityValue, ThreadSchedulePolicy,
    set_thread_priority_and_policy, thread_native_id,
};

use super::board::BoardError;
use super::buffer_pool::{Empty, buffer_pool};
use super::spawn;
use super::tap::{TapChunk, TapEnds};

/// Time of a chunk: as short as allows a few messages a millisecond of four boards.
const CHUNK: Duration = Duration::from_millis(2);

/// Most chunks on their way: a quarter of a second of one board.
const CHUNKS_A_BOARD: usize = 128;

const IDLE: Duration = Duration::from_millis(100);

pub(crate) trait ChunkSink: Send {
    /// Takes the next chunk of a board.
    fn chunk(&mut self, chunk: &TapChunk);

    /// Called after each chunk, and ten times a second without.
    fn tick(&mut self);
}

/// A taker of all bytes.
pub(crate) struct StreamPlan {
    pub(crate) taker: Box<dyn ChunkSink>,
    /// Device time between the poses that it takes, seconds.
    pub(crate) pose_every_s: f64,
}

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

/// Gives the calling thread this priority (SCHED_FIFO, 1 to 99). The error is advice for the user.
pub(super) fn claim(priority: u8) -> Result<(), &'static str> {
    const REMEDY: &str = "no real-time priority for the threads of the board: allow it with LimitRTPRIO=99 in the \
                          systemd unit, or in /etc/security/limits.conf, or leave --real-time out";
    let value = ThreadPriorityValue::try_from(priority).map_err(|_| REMEDY)?;
    set_thread_priority_and_policy(
        thread_native_id(),
        ThreadPriority::Crossplatform(value),
        ThreadSchedulePolicy::Realtime(RealtimeThreadSchedulePolicy::Fifo),
    )
    .map_err(|_| REMEDY)
}
