//! What the pipeline gives out, and what it is asked for; faults in a stream that a sound board never shows, and their effect
//! on the poses.

use slitpose_head::foreign::printable;
use slitpose_model::{DegradedReason, Filtered, NoTwist, Outcome, Pose, SceneError, Solution, Tracked, TwistEstimate};
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

// One scan has six data more than unknowns, and an error of one cell hides from them at some poses. The tool moves on, and
// the same error shows: so a pose is in doubt while several scans shortly before it contradicted the scene, even if its own
// residuals are small. An error too small to contradict in any scan shows in the mean of their residuals.

/// So many contradictions are no chance: of a sound head's scans one in 10⁵ has one, and three come within a thousand scans
/// once in 2·10⁹, which is once in six days at 4 kHz.
const CONTRADICTIONS: usize = 3;

/// Within this time: a hand moves the tool by centimetres meanwhile, and the error to where it shows.
const WITHIN_S: f64 = 0.25;

/// Mean χ² over redundancy above which scans contradict together: that of a sound head is about 1, and 1.3 when it is 20 K
/// warmer. It may be larger by six standard deviations of the mean besides, as chance makes it once in 10⁹; a smaller redundancy
/// of all is too far from a normal distribution to say so.
const MISFIT: f64 = 1.5;
const CHANCE: f64 = 6.0;
const LEAST_REDUNDANCY: f64 = 40.0;

/// Most that a scan counts for, in units of its redundancy: what is beyond contradicts by itself.
const MOST_MISFIT: f64 = 10.0;

/// From so many cells on their light has one pose, or contradicts the scene.
const CELLS: usize = 6;

/// Least number of scans that this time stands for.
const MIN_SCANS: u64 = 8;

/// Follows the scans of a session in the order of their numbers.
#[derive(Clone, Debug)]
pub(super) struct Doubt {
    within: u64,
    /// Numbers of the latest contradictions, the oldest first.
    latest: [Option<u64>; CONTRADICTIONS],
    /// Of the half of this time under way, and of the one before.
    residuals: [Residuals; 2],
}

/// χ² and redundancy of the scans of one half of the time within which contradictions count.
#[derive(Clone, Copy, Debug, Default)]
struct Residuals {
    half: u64,
    chi2: f64,
    redundancy: f64,
}

impl Residuals {
    fn contradict(&self) -> bool {
        self.redundancy >= LEAST_REDUNDANCY
            && self.chi2 > MISFIT * self.redundancy + CHANCE * (2.0 * self.redundancy).sqrt()
    }
}

impl Doubt {
    /// Of a board that takes a scan each `frame_s`.
    pub(super) fn new(frame_s: f64) -> Self {
        Self {
            within: ((WITHIN_S / frame_s) as u64).max(MIN_SCANS),
            latest: [None; CONTRADICTIONS],
            residuals: Default::default(),
        }
    }

    /// Counts the scan `sequence`, which has this solution.
    pub(super) fn count(&mut self, sequence: u64, solution: &Solution) {
        // What counts no more leaves no trace, nor residuals after the end of the half that follows theirs: the state is that of a
        // session which has not seen them.
        for latest in &mut self.latest {
            *latest = latest.filter(|latest| sequence.abs_diff(*latest) <= self.within);
        }
        if contradicts(&solution.outcome, solution.cells_used.count()) {
            self.latest.rotate_left(1);
            self.latest[CONTRADICTIONS - 1] = Some(sequence);
        }
        let half = sequence / (self.within / 2);
        let now = self.residuals[0];
        if now.half != half {
            let before = if now.half + 1 == half { now } else { Residuals::default() };
            self.residuals = [Residuals { half, ..Residuals::default() }, before];
        }
        if has_residuals(&solution.outcome) {
            let redundancy = solution.redundancy as f64;
            self.residuals[0].redundancy += redundancy;
            self.residuals[0].chi2 += solution.chi2.min(MOST_MISFIT * redundancy);
        }
    }

    /// Degrades a pose that seems sound and is in doubt. By as much as the residuals are larger than they should be, its
    /// covariance is, too, and those of twist and filtered pose.
    pub(super) fn apply(&self, sequence: u64, tracked: &mut Tracked) {
        let half = sequence / (self.within / 2);
        let recent = self.residuals.map(|residuals| {
            let is_recent = half.checked_sub(residuals.half).is_some_and(|halves| halves <= 1);
            if is_recent { residuals } else { Residuals::default() }
        });
        let [now, before] = recent;
        let both = Residuals { half, chi2: now.chi2 + before.chi2, redundancy: now.redundancy + before.redundancy };
        let contradicting = [now, before, both].into_iter().filter(Residuals::contradict);
        let misfit = contradicting.map(|residuals| residuals.chi2 / residuals.redundancy).reduce(f64::max);
        let is_doubted = self.latest[0].is_some_and(|oldest| sequence.abs_diff(oldest) <= self.within);
        let solution = &mut tracked.solution;
        if !has_residuals(&solution.outcome) || !(is_doubted || misfit.is_some()) {
            return;
        }
        if solution.outcome == Outcome::Converged {
            solution.outcome = Outcome::Degraded(DegradedReason::Doubted);
        }
        let filtered = tracked.filtered.iter_mut();
        let twists = tracked.twist.iter_mut().map(|twist| &mut twist.covariance);
        let covariances = solution.estimate.iter_mut().map(|estimate| &mut estimate.covariance).chain(twists);
        let covariances = covariances.chain(filtered.flat_map(|filtered| {
            let twist = filtered.twist.iter_mut().map(|twist| &mut twist.covariance);
            twist.chain([&mut filtered.estimate.covariance])
        }));
        covariances.flat_map(|covariance| covariance.as_flattened_mut()).for_each(|element| {
            *element *= misfit.unwrap_or(1.0);
        });
    }
}

/// Whether the residuals of a scan are those of all cells with light, and passed the gate of χ².
fn has_residuals(outcome: &Outcome) -> bool {
    matches!(outcome, Outcome::Converged | Outcome::Degraded(DegradedReason::FewerCells))
}

/// Whether the scene does not explain a scan: it has outliers, identified or not. Of few cells none is found because they
/// leave too much open.
fn contradicts(outcome: &Outcome, cells: usize) -> bool {
    match outcome {
        Outcome::Diverged => cells >= CELLS,
        outcome => matches!(outcome, Outcome::Degraded(DegradedReason::Misfit | DegradedReason::CellExcluded)),
    }
}

#[cfg(test)]
mod tests {
    use slitpose_model::{Cells, Estimate};

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

    fn solution(outcome: Outcome, cells: u16, chi2: f64) -> Solution {
        let pose = Pose { translation_m: Default::default(), rotation: Default::default() };
        let estimate = outcome.has_pose().then_some(Estimate { pose, covariance: [[1.0; 6]; 6] });
        Solution::reported(outcome, estimate, chi2, Cells::from_bits((1 << cells) - 1), Cells::default())
    }

    fn applied(doubt: &Doubt, sequence: u64, solution: Solution) -> Solution {
        let mut tracked = Tracked { solution, twist: Err(NoTwist::NoPose), filtered: None, light_level: None };
        doubt.apply(sequence, &mut tracked);
        tracked.solution
    }

    /// Covariance of each scan of these solutions, at 100 Hz, that is doubted.
    fn doubted(solutions: impl Iterator<Item = Solution>) -> Vec<(u64, f64)> {
        let mut doubt = Doubt::new(0.01);
        let doubted = |(sequence, solution): (u64, Solution)| {
            doubt.count(sequence, &solution);
            let solution = applied(&doubt, sequence, solution);
            let is_doubted = solution.outcome == Outcome::Degraded(DegradedReason::Doubted);
            solution.estimate.filter(|_| is_doubted).map(|estimate| (sequence, estimate.covariance[0][0]))
        };
        (0..).zip(solutions).filter_map(doubted).collect()
    }

    #[test]
    fn three_contradictions_within_a_quarter_second_put_what_follows_in_doubt() {
        let doubted = |contradictions: &[u64]| {
            doubted((0..100).map(|sequence| match contradictions.contains(&sequence) {
                true => solution(Outcome::Degraded(DegradedReason::Misfit), 6, 60.0),
                false => solution(Outcome::Converged, 6, 6.0),
            }))
        };
        let follow = |scans: std::ops::RangeInclusive<u64>| scans.map(|scan| (scan, 1.0)).collect::<Vec<_>>();
        assert_eq!(doubted(&[10, 20]), []);
        // 25 scans from the first of the latest three on; their own status stays.
        assert_eq!(doubted(&[10, 20, 30]), follow(31..=35));
        assert_eq!(doubted(&[10, 11, 12, 40, 41]), follow(13..=35), "two are forgotten");
        assert_eq!(doubted(&[10, 22, 36]), [], "too far apart");
    }

    #[test]
    fn residuals_that_are_too_large_on_average_put_poses_in_doubt_and_their_covariance_grows() {
        let with = |misfit: f64| move |_| solution(Outcome::Converged, 6, misfit * 6.0);
        assert_eq!(doubted((0..1000).map(with(1.5))), []);
        // Seven scans have a redundancy of 42.
        let doubtful = doubted((0..36).map(with(3.0)).chain((36..100).map(with(1.0))));
        assert_eq!(
            doubtful,
            (6..=47).map(|scan| (scan, 3.0)).collect::<Vec<_>>(),
            "and until the half after them is over"
        );
        // One bad scan does not outweigh all.
        let one_in = |length: u64| (0..240).map(move |scan| with(if scan % length == 0 { 1e9 } else { 1.0 })(scan));
        assert_eq!(doubted(one_in(12)), []);
        assert_ne!(doubted(one_in(4)), []);
        // A slow board has four scans a half, of which two halves are enough; and what was long ago counts no more.
        let mut slow = Doubt::new(1.0);
        (0..8).for_each(|scan| slow.count(scan, &with(9.0)(scan)));
        let misfit = |scan: u64, cells| applied(&slow, scan, solution(Outcome::Converged, cells, 6.0)).outcome;
        assert_eq!([7, 8, 500].map(|scan| misfit(scan, 6) == Outcome::Converged), [false, true, true]);
        // With a dark cell the status stays, and the covariance grows.
        let fewer = Outcome::Degraded(DegradedReason::FewerCells);
        let estimate = applied(&slow, 7, solution(fewer, 5, 4.0)).estimate.expect("a pose");
        assert_eq!((misfit(7, 5), estimate.covariance[0][0]), (Outcome::Degraded(DegradedReason::Doubted), 9.0));
    }

    #[test]
    fn only_poses_that_seem_sound_are_put_in_doubt() {
        let after_three = |first: Solution, outcome: Outcome| {
            doubted([first, first, first, solution(outcome, 6, 6.0)].into_iter()).len()
        };
        assert_eq!(
            after_three(solution(Outcome::Diverged, 5, 0.0), Outcome::Converged),
            0,
            "five cells leave a pose open"
        );
        let diverged = solution(Outcome::Diverged, 6, 0.0);
        assert_eq!(after_three(diverged, Outcome::Converged), 1);
        for kept in [Outcome::Ambiguous, Outcome::TooDark, Outcome::Degraded(DegradedReason::FewerCells)] {
            assert_eq!(after_three(diverged, kept), 0, "{kept:?}");
        }
        let mut slow = Doubt::new(1.0);
        (3..6).for_each(|sequence| slow.count(sequence, &diverged));
        let last = applied(&slow, 8, solution(Outcome::Converged, 6, 6.0));
        assert_ne!(last.outcome, Outcome::Converged, "a slow board has eight scans");
    }
}
