//! What the pipeline gives out, and what it is asked for.

use slitpose_model::{Filtered, Pose, Solution, TwistEstimate};
use slitpose_protocol::{Hello, Severity, Status};

use super::{Oddity, Scan};
use crate::clock::{HostInstant, HostTime};
use crate::link::DeviceId;

/// The pose of one scan.
#[derive(Clone, Copy, Debug)]
pub struct Record {
    /// The board.
    pub device: DeviceId,
    /// Number of the scan, counted by the board.
    pub sequence: u64,
    /// The instant of the pose by the board's clock, seconds.
    pub device_time_s: f64,
    /// The same instant by the host's clocks; `None` while unknown.
    pub host_time: Option<HostTime>,
    /// The time at which the last byte of the scan's batch had been read.
    pub arrival: Option<HostInstant>,
    /// The solution from this scan alone.
    pub solution: Solution,
    /// Velocity at that instant, from this scan and a few before.
    pub twist: Option<TwistEstimate>,
    /// Pose and velocity filtered over many scans, if requested.
    pub filtered: Option<Filtered>,
    /// Whether the photocurrents were computed, not measured.
    pub simulated: bool,
    /// The true pose at that instant, from simulated boards only.
    pub truth: Option<Pose>,
}

/// An output of the pipeline.
#[derive(Debug)]
pub enum Item<'a> {
    /// A board introduced itself.
    Hello(&'a Hello<'a>),
    /// A scan arrived. It will be solved, or skipped.
    Scan(&'a Scan),
    /// A scan was solved: its pose, or the reason for none.
    Pose(&'a Record),
    /// The board's own counters.
    Status(&'a Status),
    /// Something happened on the board.
    Event {
        /// Its severity.
        severity: Severity,
        /// Its time by the board's clock, seconds.
        device_time_s: f64,
        /// Its description.
        text: &'a str,
    },
    /// A fault in the stream that a sound board never shows.
    Oddity {
        /// Its time by the board's clock, seconds; NaN if unknown.
        device_time_s: f64,
        /// The fault.
        oddity: Oddity,
    },
    /// The board answered a command.
    Reply(&'a slitpose_protocol::Reply),
}

/// How the pipeline treats a board whose stored scene differs from the one in use.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SceneMatch {
    /// A different hash is an error.
    Required,
    /// The user chose this scene knowingly.
    Waived,
}

/// Who finds the poses.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum PoseSource {
    /// This program, in the words of each scan.
    #[default]
    Host,
    /// The board; what words it sends besides are a sample to check its poses by.
    Board,
}

/// Options of the tracker.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Following {
    /// Who finds the poses. The options that follow are for poses found here.
    pub source: PoseSource,
    /// Memory of a filter over many scans, seconds; `None` for no filter.
    pub filter_s: Option<f64>,
    /// Whether cells whose light falls on an end of the detector are left out.
    pub without_clipped: bool,
}
