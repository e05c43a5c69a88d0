//! The queue of one board to the recorder, in chunks of 20 ms.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use slitpose_protocol::{Hello, MAX_MESSAGE_BYTES, Message, encode};

use super::buffer_pool::Producer;
use crate::link::{DeviceId, Segment};
use crate::pipeline::Record;

/// A chunk holds the bytes read within this time, …
const CHUNK: Duration = Duration::from_millis(20);

/// … or this many bytes, if they come sooner.
const CHUNK_BYTES: usize = 1 << 15;

/// Ordinary length of a chunk of a board at 4 kHz, including true poses of a simulated board.
const ORDINARY_BYTES: usize = 12 << 10;

/// A part of the stream of one board, for the capture.
#[derive(Debug, Default)]
pub(super) struct CaptureChunk {
    /// The number of the board among those followed.
    pub(super) board: usize,
    /// The board, once it has introduced itself.
    pub(super) device: Option<DeviceId>,
    /// The board's hello packet, if the capture does not have it yet.
    pub(super) hello: Vec<u8>,
    /// Time of the chunk's first scan by the board's clock, nanoseconds.
    pub(super) device_ns: u64,
    /// The bytes of the link.
    pub(super) segment: Segment,
    /// Poses of the chunk, at the rate to be recorded.
    pub(super) poses: Vec<Record>,
}

impl CaptureChunk {
    /// An empty chunk with room for ordinary contents.
    pub(super) fn with_capacity() -> Self {
        Self { segment: Segment::with_capacity(ORDINARY_BYTES), poses: Vec::with_capacity(2), ..Self::default() }
    }

    fn clear(&mut self) {
        self.hello.clear();
        self.segment.clear();
        self.poses.clear();
    }
}

/// What to do with a chunk while the recorder is behind.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Overflow {
    /// The board's threads wait, and device time with them.
    Wait,
    /// The chunk is dropped and the capture notes it: a slow disk must not delay poses.
    Drop,
}

/// What a board needs of the recorder.
#[derive(Clone, Debug)]
pub(super) struct RecorderEnds {
    /// The queue.
    pub(super) chunks: Producer<CaptureChunk>,
    /// Whether there is a capture now.
    pub(super) recording: Arc<AtomicBool>,
    /// Device time between recorded poses, seconds.
    pub(super) pose_every_s: f64,
}

/// The board's end of the queue.
#[derive(Debug)]
pub(super) struct CaptureQueue {
    board: usize,
    chunks: Producer<CaptureChunk>,
    /// Whether there is a capture now.
    recording: Arc<AtomicBool>,
    /// The same when the segment in hand began.
    is_on: bool,
    overflow: Overflow,
    pose_every_s: f64,
    next_pose_s: f64,
    under_way: Option<CaptureChunk>,
    /// The current chunk is long enough; poses of its last scans may still come.
    is_full: bool,
    begun: Instant,
    device: Option<DeviceId>,
    device_ns: u64,
    /// The board's last hello packet.
    hello: Vec<u8>,
    /// Whether bytes were dropped since the last chunk.
    has_gap: bool,
    bytes_dropped: u64,
}

impl CaptureQueue {
    /// The queue of the board of this number.
    pub(super) fn new(board: usize, ends: RecorderEnds, overflow: Overflow) -> Self {
        let RecorderEnds { chunks, recording, pose_every_s } = ends;
        Self {
            board,
            chunks,
            recording,
            is_on: true,
            overflow,
            pose_every_s,
            next_pose_s: f64::NEG_INFINITY,
            under_way: None,
            is_full: false,
            begun: Instant::now(),
            device: None,
            device_ns: 0,
            hello: Vec::new(),
            has_gap: false,
            bytes_dropped: 0,
        }
    }

    /// Prepares for the next segment; `opened`: the link was opened anew.
    pub(super) fn begin(&mut self, opened: bool) {
        self.is_on = self.recording.load(Ordering::Relaxed);
        if opened || self.is_full || !self.is_on {
            self.hand_over();
        }
        if !self.is_on {
            // A capture that begins later begins within the stream.
            self.has_gap = true;
            return;
        }
        if self.under_way.is_some() {
            return;
        }
        let spare = match self.overflow {
            Overflow::Wait => self.chunks.spare(),
            Overflow::Drop => self.chunks.spare_now(),
        };
        self.under_way = spare.map(|mut chunk| {
            chunk.clear();
            chunk.board = self.board;
            chunk.device = self.device;
            chunk.device_ns = self.device_ns;
            if std::mem::take(&mut self.has_gap) {
                // The next bytes do not continue the last chunk, and may be of another configuration.
                chunk.segment.opened = true;
                chunk.hello.extend_from_slice(&self.hello);
            }
            chunk
        });
        self.begun = Instant::now();
    }

    /// Bytes dropped because no chunk was free.
    pub(super) fn bytes_dropped(&self) -> u64 {
        self.bytes_dropped
    }

    /// Keeps the board's hello.
    pub(super) fn hello(&mut self, hello: &Hello<'_>) {
        self.device = Some(DeviceId(hello.device_id));
        let mut buffer = [0; MAX_MESSAGE_BYTES];
        // It arrived in a packet, so it fits a packet.
        if let Ok(packet) = encode(&Message::Hello(hello.clone()), &mut buffer) {
            self.hello.clear();
            self.hello.extend_from_slice(packet);
        }
        if let Some(chunk) = &mut self.under_way {
            chunk.device = self.device;
        }
    }

    /// Keeps a pose if one is due.
    pub(super) fn pose(&mut self, record: &Record) {
        let time_s = record.device_time_s;
        // Saturates.
        self.device_ns = (time_s * 1e9) as u64;
        // Device time may restart.
        let is_due = time_s >= self.next_pose_s || time_s < self.next_pose_s - 2.0 * self.pose_every_s;
        if let (true, Some(chunk)) = (is_due, &mut self.under_way) {
            // One period after the last one was due, so that the rate does not drift.
            let next_s = self.next_pose_s + self.pose_every_s;
            self.next_pose_s = if next_s > time_s && next_s.is_finite() { next_s } else { time_s + self.pose_every_s };
            chunk.poses.push(*record);
        }
    }

    /// Keeps the bytes of a segment.
    pub(super) fn keep(&mut self, segment: &Segment) {
        let Some(chunk) = &mut self.under_way else {
            if self.is_on {
                self.bytes_dropped += segment.bytes.len() as u64;
                self.has_gap = true;
            }
            return;
        };
        chunk.segment.append(segment);
        if chunk.segment.bytes.len() >= CHUNK_BYTES || self.begun.elapsed() >= CHUNK {
            self.is_full = true;
        }
    }

    /// Hands over the current chunk if its time is over.
    pub(super) fn hand_over_old(&mut self) {
        if self.begun.elapsed() >= CHUNK {
            self.hand_over();
        }
    }

    /// Hands over the current chunk.
    pub(super) fn hand_over(&mut self) {
        self.is_full = false;
        if let Some(chunk) = self.under_way.take() {
            self.chunks.hand_over(chunk);
        }
    }
}

impl Drop for CaptureQueue {
    fn drop(&mut self) {
        self.hand_over();
    }
}
