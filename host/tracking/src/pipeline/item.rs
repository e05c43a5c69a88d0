//! What the pipeline gives out, and what it is asked for.

use slitpose_head::foreign::printable;
use slitpose_model::{Filtered, Pose, SceneError, Solution, TwistEstimate};
use slitpose_protocol::schema::SchemaMismatch;
use slitpose_protocol::{Hello, ScalingError, ScheduleError, Severity, Status};
use thiserror::Error;

use super::{Oddity, Scan};
use crate::clock::{HostInstant, HostTime};
use crate::link::{DeviceId, Versions};

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
pub struct PipelineOptions {
    /// Who finds the poses. The options that follow are for poses found here.
    pub source: PoseSource,
    /// Memory of a filter over many scans, seconds; `None` for no filter.
    pub filter_s: Option<f64>,
    /// Whether cells whose light falls on an end of the detector are left out.
    pub without_clipped: bool,
}

/// Why the pipeline cannot go on.
#[derive(Debug, Error)]
#[allow(missing_docs, reason = "the texts say what each is")]
pub enum PipelineError {
    #[error("board `{}` and this program disagree on the protocol: {versions}", printable(board))]
    Schema { board: String, versions: Versions, source: SchemaMismatch },
    #[error("board `{}` announces a schedule that contradicts itself; update its firmware", printable(board))]
    Schedule { board: String, source: ScheduleError },
    #[error("board `{}` announces an ADC scaling that cannot be used; update its firmware", printable(board))]
    Scaling { board: String, source: ScalingError },
    #[error(
        "board `{}` samples {board_cells} cells, scene `{scene}` has {scene_cells}; give the scene of this head",
        printable(board)
    )]
    Cells {
        board: String,
        /// The board's number of cells.
        board_cells: usize,
        scene: String,
        /// The scene's number of cells.
        scene_cells: usize,
    },
    #[error(
        "board `{}` belongs to the scene with hash {board_hash:016x}, but `{scene}` has {scene_hash:016x}; \
         give the scene it belongs to with --scene",
        printable(board)
    )]
    SceneHash { board: String, board_hash: u64, scene: String, scene_hash: u64 },
    #[error(
        "board `{}` belongs to the calibration with hash {board_hash:016x}, but {} has {calibration_hash:016x}; give the \
         calibration it belongs to with --calibration, or store this one with `slitpose device set --scene … --calibration …`",
        printable(board),
        printable(calibration)
    )]
    CalibrationHash { board: String, board_hash: u64, calibration: String, calibration_hash: u64 },
    #[error(transparent)]
    Scene(#[from] SceneError),
}
