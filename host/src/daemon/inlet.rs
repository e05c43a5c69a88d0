//! What of a board goes into the capture, in pieces of some hundredths of a second.

use std::time::{Duration, Instant};

use slitpose_protocol::{Hello, MAX_MESSAGE_BYTES, Message, encode};

use super::circuit::Filler;
use crate::link::{DeviceId, Segment};
use crate::pipeline::Record;

/// What is read within this is one piece.
const PIECE: Duration = Duration::from_millis(20);

/// A piece is handed over at this length, however fast bytes come.
const PIECE_BYTES: usize = 1 << 15;

/// An ordinary piece of a board at 4 kHz, the truths of a simulated one included.
const ORDINARY_BYTES: usize = 12 << 10;

/// What a capture gets of one board in one piece.
#[derive(Debug, Default)]
pub(super) struct Parcel {
    /// The number of the board among those followed.
    pub(super) board: usize,
    /// The board, once it has introduced itself.
    pub(super) device: Option<DeviceId>,
    /// The packet with which it introduced itself, where the capture has missed it.
    pub(super) hello: Vec<u8>,
    /// When the first scan in it was taken, by the board's clock.
    pub(super) device_ns: u64,
    /// What came.
    pub(super) segment: Segment,
    /// Some of the poses in it.
    pub(super) poses: Vec<Record>,
}

impl Parcel {
    /// An empty one with room for an ordinary piece.
    pub(super) fn with_room() -> Self {
        Self { segment: Segment::with_capacity(ORDINARY_BYTES), poses: Vec::with_capacity(2), ..Self::default() }
    }

    fn clear(&mut self) {
        self.hello.clear();
        self.segment.clear();
        self.poses.clear();
    }
}

/// What becomes of a piece while the recorder is behind.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Overflow {
    /// Everything waits: device time can.
    Wait,
    /// The capture does without it, and says so: poses must not be late because a disk is slow.
    Drop,
}

/// Feeds the recorder with one board.
#[derive(Debug)]
pub(super) struct CaptureInlet {
    board: usize,
    parcels: Filler<Parcel>,
    overflow: Overflow,
    pose_every_s: f64,
    next_pose_s: f64,
    under_way: Option<Parcel>,
    /// What is under way is long enough; the poses of its last scans may still come.
    is_full: bool,
    begun: Instant,
    device: Option<DeviceId>,
    device_ns: u64,
    /// The packet with which the board introduced itself last.
    hello: Vec<u8>,
    /// The capture has missed something since the last piece.
    has_gap: bool,
    bytes_dropped: u64,
}

impl CaptureInlet {
    /// For the board of this number; a pose is kept every `pose_every_s` of device time.
    pub(super) fn new(board: usize, parcels: Filler<Parcel>, overflow: Overflow, pose_every_s: f64) -> Self {
        Self {
            board,
            parcels,
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

    /// Prepares for the next segment, which opens the link anew or not.
    pub(super) fn begin(&mut self, opened: bool) {
        if opened || self.is_full {
            self.hand_over();
        }
        if self.under_way.is_some() {
            return;
        }
        let spare = match self.overflow {
            Overflow::Wait => self.parcels.spare(),
            Overflow::Drop => self.parcels.spare_now(),
        };
        self.under_way = spare.map(|mut parcel| {
            parcel.clear();
            parcel.board = self.board;
            parcel.device = self.device;
            parcel.device_ns = self.device_ns;
            if std::mem::take(&mut self.has_gap) {
                // What comes does not follow what was kept last, and may be by another configuration.
                parcel.segment.opened = true;
                parcel.hello.extend_from_slice(&self.hello);
            }
            parcel
        });
        self.begun = Instant::now();
    }

    /// Bytes that no piece was left for.
    pub(super) fn bytes_dropped(&self) -> u64 {
        self.bytes_dropped
    }

    /// Keeps who the board is.
    pub(super) fn hello(&mut self, hello: &Hello<'_>) {
        self.device = Some(DeviceId(hello.device_id));
        let mut buffer = [0; MAX_MESSAGE_BYTES];
        // It has come as a packet, so it fits one.
        if let Ok(packet) = encode(&Message::Hello(hello.clone()), &mut buffer) {
            self.hello.clear();
            self.hello.extend_from_slice(packet);
        }
        if let Some(parcel) = &mut self.under_way {
            parcel.device = self.device;
        }
    }

    /// Keeps a pose if it is time for one.
    pub(super) fn pose(&mut self, record: &Record) {
        let time_s = record.device_time_s;
        // Saturates.
        self.device_ns = (time_s * 1e9) as u64;
        // Device time may begin anew.
        let is_due = time_s >= self.next_pose_s || time_s < self.next_pose_s - 2.0 * self.pose_every_s;
        if let (true, Some(parcel)) = (is_due, &mut self.under_way) {
            // At this distance from the last one, without drifting away from it.
            let next_s = self.next_pose_s + self.pose_every_s;
            self.next_pose_s = if next_s > time_s && next_s.is_finite() { next_s } else { time_s + self.pose_every_s };
            parcel.poses.push(*record);
        }
    }

    /// Keeps what came.
    pub(super) fn keep(&mut self, segment: &Segment) {
        let Some(parcel) = &mut self.under_way else {
            self.bytes_dropped += segment.bytes.len() as u64;
            self.has_gap = true;
            return;
        };
        parcel.segment.append(segment);
        if parcel.segment.bytes.len() >= PIECE_BYTES || self.begun.elapsed() >= PIECE {
            self.is_full = true;
        }
    }

    /// Hands over what is under way, if it is as long as a piece may be.
    pub(super) fn hand_over_old(&mut self) {
        if self.begun.elapsed() >= PIECE {
            self.hand_over();
        }
    }

    /// Hands over what is under way.
    pub(super) fn hand_over(&mut self) {
        self.is_full = false;
        if let Some(parcel) = self.under_way.take() {
            self.parcels.hand_over(parcel);
        }
    }
}

impl Drop for CaptureInlet {
    fn drop(&mut self) {
        self.hand_over();
    }
}
