//! What the pipeline gives out, and what it is asked for; faults in a stream that a sound board never shows.

use slitpose_head::foreign::printable;
use slitpose_model::{Filtered, NoTwist, Pose, SceneError, Solution, TwistEstimate};
use slitpose_protocol::schema::SchemaMismatch;
use slitpose_protocol::{Hello, ScalingError, ScheduleError, Severity, Status};
use thiserror::Error;

use super::{PoseFault, Scan};
use crate::clock::{HostInstant, HostTime};
use crate::frame::View;
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
    /// Velocity at that instant, from this scan and those before.
    pub twist: Result<TwistEstimate, NoTwist>,
    /// Pose and velocity filtered over many scans, if requested.
    pub filtered: Option<Filtered>,
    /// How bright all light is, relative to the scene or the calibration; `None` where it is taken for known.
    pub light_level: Option<f64>,
    /// Whether the photocurrents were computed, not measured.
    pub simulated: bool,
    /// The true pose at that instant, from simulated boards only.
    pub truth: Option<Pose>,
    /// The frame and the point of the tool that poses, velocities and truth speak of; `None`: those of the head.
    pub view: Option<&'static View>,
}

/// An edge of a board's trigger input.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EdgeRecord {
    /// The board.
    pub device: DeviceId,
    /// Number of the edge, counted by the board from its start; a gap shows edges that were dropped on their way.
    pub number: u32,
    /// Its instant by the board's clock, seconds.
    pub device_time_s: f64,
    /// The same instant by the host's clocks; `None` while unknown.
    pub host_time: Option<HostTime>,
    /// Whether the line has risen.
    pub is_high: bool,
    /// Edges since the board's start that came too fast for it, at least; these have no numbers.
    pub missed: u32,
}

/// An output of the pipeline.
#[derive(Debug)]
#[allow(missing_docs, reason = "fields are named by what they are")]
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
    Event { severity: Severity, device_time_s: f64, text: &'a str },
    /// Something happened at the board's trigger input.
    Edge(EdgeRecord),
    /// A fault in the stream that a sound board never shows; at NaN if its time is not known.
    Oddity { device_time_s: f64, oddity: Oddity },
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
    /// Whether emitters are as bright as scene or calibration says, all together and each.
    pub known_light: bool,
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
    Cells { board: String, board_cells: usize, scene: String, scene_cells: usize },
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

/// A fault in a stream that a sound board never shows. Poses continue.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
#[allow(missing_docs, reason = "the texts say what each is")]
pub enum Oddity {
    #[error(
        "the board's clock jumped by {seconds:+.6} s between the scans {before} and {after}: device times before and \
         after it do not compare; if it comes again, reset the board"
    )]
    ClockJump { seconds: f64, before: u64, after: u64 },
    #[error(
        "the board says that it measures, and sends true poses as simulated ones do: they are left out; flash its \
         firmware anew"
    )]
    Truth,
    #[error(
        "the board's poses are of another head than that of the scene and the calibration given: they are left out; \
         store this head with `slitpose device set`, or give the scene and the calibration that the board has"
    )]
    OtherHead,
    #[error(
        "the board's pose of scan {sequence} cannot be right: {fault}; it is left out, as {count} in all so far; build \
         firmware and program from the same source, and use --stream raw until then"
    )]
    Pose { sequence: u64, fault: PoseFault, count: u64 },
    #[error(
        "the board calls itself {now} in the midst of its stream, and was {before}: the poses that follow are told as \
         those of {now}; see that one board alone is on this port, then reset it"
    )]
    Renamed { before: DeviceId, now: DeviceId },
}

/// Finds jumps of a board's clock: between two scans, the ticks must advance by one frame per number.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct ClockWatch {
    /// Number and tick of the last scan of this link and this session.
    last: Option<(u64, u64)>,
    jumps: u64,
}

impl ClockWatch {
    /// Restarts the check for another link, configuration or board.
    pub(super) fn begin_anew(&mut self) {
        self.last = None;
    }

    /// Checks the next scan of a board whose frames last `frame_ticks`. Of many jumps, the first, second, fourth,
    /// eighth … are reported.
    pub(super) fn check(&mut self, sequence: u64, tick: u64, frame_ticks: u32, tick_hz: f64) -> Option<Oddity> {
        let (before, before_tick) = self.last.replace((sequence, tick))?;
        // A number that goes back means that the board has restarted.
        let frames = sequence.checked_sub(before)?;
        let expected = i128::from(before_tick) + i128::from(frames) * i128::from(frame_ticks);
        let ahead = i128::from(tick) - expected;
        if ahead.unsigned_abs() <= u128::from(frame_ticks / 2) {
            return None;
        }
        self.jumps += 1;
        let seconds = ahead as f64 / tick_hz;
        self.jumps.is_power_of_two().then_some(Oddity::ClockJump { seconds, before, after: sequence })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn clock_jumps_are_reported_and_gaps_and_restarts_are_not() {
        let mut watch = ClockWatch::default();
        let mut check = |sequence, tick| watch.check(sequence, tick, 1000, 1e6);
        for (sequence, tick) in [(10, 500), (11, 1500), (20, 10_500), (0, 70), (1, 1070), (2, 2500), (3, 3100)] {
            assert_eq!(check(sequence, tick), None, "{sequence}");
        }
        assert_eq!(check(4, 5100), Some(Oddity::ClockJump { seconds: 1e-3, before: 3, after: 4 }));
        assert_eq!(check(5, 100), Some(Oddity::ClockJump { seconds: -6e-3, before: 4, after: 5 }));
        assert_eq!(check(6, 1100), None);
        // The third is not reported, the fourth is.
        assert_eq!(check(7, u64::MAX), None);
        assert!(matches!(check(8, 0), Some(Oddity::ClockJump { seconds, .. }) if seconds < -1e13));
        watch.begin_anew();
        assert_eq!(watch.check(9, 77, 1000, 1e6), None);
    }
}
