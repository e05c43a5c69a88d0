//! Condenses a stream of poses to the pace of a screen.

use std::fmt::Debug;
use std::sync::Arc;

use slitpose_model::{Photocurrents, Pose};

use crate::clock::HostInstant;
use crate::pipeline::Record;

/// Samples per second of the host's clock.
pub(super) const FRAMES_HZ: u64 = 60;

/// The newest pose of a board, and the range of all since the sample before.
#[derive(Clone, Debug)]
pub(crate) struct Sample {
    /// The newest scan.
    pub(super) record: Record,
    /// Its photocurrents.
    pub(super) photocurrents: Photocurrents,
    /// Scans since the sample before.
    pub(super) scans: u32,
    /// Scans of these that had a pose.
    pub(super) poses: u32,
    /// Least and greatest coordinates of these poses: translation, rotation vector; metres, radians.
    pub(super) range: Option<[[f64; 6]; 2]>,
}

impl Sample {
    /// The pose of the newest scan; `None` if it has none.
    pub(crate) fn pose(&self) -> Option<Pose> {
        self.record.solution.estimate.map(|estimate| estimate.pose)
    }
}

/// Takes samples from the threads that solve.
pub(crate) trait TakesSamples: Debug + Send + Sync {
    /// Takes a sample of a board; `false` if it has no time. Never blocks.
    fn sample(&self, board: usize, sample: &Sample) -> bool;
}

/// Makes the samples of one board. Never blocks.
#[derive(Debug)]
pub(crate) struct Sampler {
    board: usize,
    taker: Arc<dyn TakesSamples>,
    due_ns: u64,
    newest: Option<Record>,
    scans: u32,
    poses: u32,
    range: Option<[[f64; 6]; 2]>,
}

impl Sampler {
    /// Samples of the board of this number, for `taker`.
    pub(crate) fn new(board: usize, taker: Arc<dyn TakesSamples>) -> Self {
        Self { board, taker, due_ns: 0, newest: None, scans: 0, poses: 0, range: None }
    }

    /// Adds the next solved scan.
    pub(crate) fn add(&mut self, record: &Record) {
        self.newest = Some(*record);
        self.scans += 1;
        if let Some(estimate) = &record.solution.estimate {
            self.poses += 1;
            let at = coordinates(&estimate.pose);
            let [low, high] = self.range.get_or_insert([at; 2]);
            for ((low, high), value) in low.iter_mut().zip(high).zip(at) {
                *low = low.min(value);
                *high = high.max(value);
            }
        }
    }

    /// Sends a sample if one is due; `photocurrents` are those of the scan added last.
    pub(crate) fn send(&mut self, photocurrents: Option<&Photocurrents>, now: HostInstant) {
        const PERIOD_NS: u64 = 1_000_000_000 / FRAMES_HZ;
        if now.monotonic_ns < self.due_ns {
            return;
        }
        let (Some(record), Some(photocurrents)) = (self.newest, photocurrents) else { return };
        let Self { board, scans, poses, range, .. } = *self;
        let photocurrents = photocurrents.clone();
        // A sample that is not taken in time is part of the next one.
        if self.taker.sample(board, &Sample { record, photocurrents, scans, poses, range }) {
            (self.newest, self.scans, self.poses, self.range) = (None, 0, 0, None);
        }
        self.due_ns = (self.due_ns + PERIOD_NS).max(now.monotonic_ns + PERIOD_NS / 2);
    }
}

/// Translation and rotation vector.
pub(super) fn coordinates(pose: &Pose) -> [f64; 6] {
    let ([tx, ty, tz], [rx, ry, rz]) = (pose.translation_m.to_array(), pose.rotation_rad().to_array());
    [tx, ty, tz, rx, ry, rz]
}
