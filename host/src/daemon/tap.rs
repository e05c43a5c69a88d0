//! Taps on the streams of boards: queues to the recorder, in chunks of 20 ms.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use slitpose_protocol::{Hello, MAX_MESSAGE_BYTES, Message, encode};

use super::handoff::Producer;
use slitpose_tracking::capture::PoseRate;
use slitpose_tracking::link::{DeviceId, Segment};
use slitpose_tracking::pipeline::Record;

/// A chunk holds the bytes read within this time, by the host's clock or by the board's.
const CHUNK: Duration = Duration::from_millis(20);

/// A chunk holds no more than about this many.
const CHUNK_BYTES: usize = 1 << 15;

/// Ordinary length of a chunk of a board at 4 kHz, including true poses of a simulated board.
const ORDINARY_BYTES: usize = 12 << 10;

/// A part of the stream of one board.
#[derive(Debug, Default)]
pub(super) struct TapChunk {
    /// The number of the board among those followed.
    pub(super) board: usize,
    /// The board, once it has introduced itself.
    pub(super) device: Option<DeviceId>,
    /// The board's hello packet, if the recorder may not have it yet.
    pub(super) hello: Vec<u8>,
    /// Time of the chunk's first scan by the board's clock, nanoseconds.
    pub(super) device_ns: u64,
    pub(super) segment: Segment,
    /// Poses of the chunk, at the rate asked for.
    pub(super) poses: Vec<Record>,
}

impl TapChunk {
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

/// What a board needs of the recorder.
#[derive(Clone, Debug)]
pub(super) struct TapEnds {
    pub(super) chunks: Producer<TapChunk>,
    pub(super) is_wanted: Arc<AtomicBool>,
    pub(super) pose_every_s: f64,
}

#[derive(Debug)]
pub(super) struct Tap {
    board: usize,
    ends: TapEnds,
    /// The same when the segment in hand began.
    is_on: bool,
    /// Whether the board keeps time: then a chunk is dropped while the recorder is behind, and the next one says so, for a
    /// slow disk must not delay poses. Else the board's threads wait, and device time with them.
    keeps_time: bool,
    rate: PoseRate,
    under_way: Option<TapChunk>,
    /// The current chunk is long enough; poses of its last scans may still come.
    is_full: bool,
    begun: Instant,
    device: Option<DeviceId>,
    device_ns: u64,
    hello: Vec<u8>,
    /// Whether bytes were dropped since the last chunk.
    has_gap: bool,
    /// Because no chunk was free.
    pub(super) bytes_dropped: u64,
}

impl Tap {
    /// The queue of the board of this number.
    pub(super) fn new(board: usize, ends: TapEnds, keeps_time: bool) -> Self {
        Self {
            board,
            rate: PoseRate::every(ends.pose_every_s),
            ends,
            is_on: true,
            keeps_time,
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
        self.is_on = self.ends.is_wanted.load(Ordering::Relaxed);
        if opened || self.is_full || !self.is_on {
            self.hand_over();
        }
        if !self.is_on {
            // What is wanted later begins within the stream.
            self.has_gap = true;
            return;
        }
        if self.under_way.is_some() {
            return;
        }
        let chunks = &self.ends.chunks;
        let spare = if self.keeps_time { chunks.spare_now() } else { chunks.spare() };
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
        // Of a simulated board that does not keep time.
        let chunk_ns = self.under_way.as_ref().map_or(0, |chunk| self.device_ns.abs_diff(chunk.device_ns));
        self.is_full |= u128::from(chunk_ns) >= CHUNK.as_nanos();
        if let Some(chunk) = &mut self.under_way
            && self.rate.is_due(time_s)
        {
            chunk.poses.push(*record);
        }
    }

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

    pub(super) fn hand_over(&mut self) {
        self.is_full = false;
        if let Some(chunk) = self.under_way.take() {
            self.ends.chunks.hand_over(chunk);
        }
    }
}

impl Drop for Tap {
    fn drop(&mut self) {
        self.hand_over();
    }
}
