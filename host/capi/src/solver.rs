//! What stands behind a handle.

#![forbid(unsafe_code)]

use std::fmt::{self, Write};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::Path;

use slitpose_calibration::{CalibrationFileError, Head};
use slitpose_head::scene_file::{SceneFile, SceneFileError};
use slitpose_model::{NoTwist, Pair, Photocurrents, SceneError, Tier, Tracker};
use slitpose_tracking::pipeline::PipelineOptions;
use slitpose_tracking::solving::{self, RowSolver, STREAM_TOLERANCE, head_by};
use thiserror::Error;

use crate::solution::{ErrorCode, PoseSolution};

/// As `slitpose solve` and `run` do unless told otherwise.
const TIER: Tier = Tier::Exact { tolerance: STREAM_TOLERANCE };

/// Longest text about an error, bytes.
const MAX_TEXT: usize = 1024;

/// Rates at which frames can be tracked, Hz.
const MIN_RATE_HZ: f64 = 1.0;
const MAX_RATE_HZ: f64 = 1e6;

/// Why a solver cannot be opened.
#[derive(Debug, Error)]
pub(crate) enum OpenError {
    #[error("the {0} is NULL; give its path")]
    Null(&'static str),
    #[error("the path of the {0} is not UTF-8; give it as UTF-8")]
    Text(&'static str),
    #[error(transparent)]
    Scene(#[from] SceneFileError),
    #[error(transparent)]
    Calibration(#[from] CalibrationFileError),
    #[error(transparent)]
    Optics(#[from] SceneError),
    #[error("{DEFECT}")]
    Defect,
}

const DEFECT: &str = "a defect of slitpose_solver, described on standard error: close the solver, and report it";

/// Why a call is refused.
#[derive(Debug, Error)]
pub(crate) enum Refusal {
    #[error("{0} is NULL; give its address")]
    Null(&'static str),
    #[error("{given} {what} for {cells} cells; give {needed}")]
    Count { what: &'static str, given: usize, cells: usize, needed: usize },
    #[error("current I_X{} of cell {cell} is {value}; give amperes, 0 for a cell that was not measured", electrode + 1)]
    Current { cell: usize, electrode: usize, value: f64 },
    #[error("{what} = {value}; give {wanted}")]
    Range { what: &'static str, value: f64, wanted: &'static str },
    #[error("no frame rate is known; call slitpose_solver_start() first")]
    NotStarted,
    #[error(
        "the frame at {time_ns} ns is less than half a period after the one at {before_ns} ns; give later instants, or call \
        slitpose_solver_reset() first"
    )]
    Time { time_ns: u64, before_ns: u64 },
    #[error(transparent)]
    Optics(#[from] SceneError),
}

impl Refusal {
    fn code(&self) -> ErrorCode {
        match self {
            Self::Null(_) => ErrorCode::Null,
            Self::Count { .. } => ErrorCode::Count,
            Self::Current { .. } => ErrorCode::NotFinite,
            Self::Range { value, .. } if !value.is_finite() => ErrorCode::NotFinite,
            Self::Range { .. } => ErrorCode::Range,
            Self::NotStarted => ErrorCode::NotStarted,
            Self::Time { .. } => ErrorCode::Time,
            Self::Optics(_) => ErrorCode::Defect,
        }
    }
}

/// A head, and what solves its currents. One thread at a time may use it.
pub struct Solver {
    rows: RowSolver,
    tracking: Option<Tracking>,
    error: Text,
    is_defective: bool,
}

struct Tracking {
    tracker: Tracker<f64>,
    /// As it was before the first frame.
    fresh: Tracker<f64>,
    period_ns: f64,
    /// Number and instant of the frame before.
    before: Option<(u64, u64)>,
}

const fn assert_send<T: Send>() {}
const _: () = assert_send::<Solver>();

impl Solver {
    pub(crate) fn open(scene: &str, calibration: Option<&str>) -> Result<Self, OpenError> {
        let usual = |file| Ok::<_, OpenError>(Head::as_scene_says(file)?);
        let head = head_by(calibration.map(Path::new), SceneFile::open(scene)?, usual)?;
        let rows = RowSolver::new(head, TIER, false)?;
        Ok(Self { rows, tracking: None, error: Text::new(), is_defective: false })
    }

    pub(crate) fn cells(&self) -> usize {
        self.rows.cells()
    }

    pub(crate) fn name(&self) -> &str {
        &self.rows.head().file.name
    }

    pub(crate) fn error(&self) -> &str {
        self.error.as_str()
    }

    /// Does `work`. After a panic in it the solver does nothing any more.
    pub(crate) fn attempt(&mut self, work: impl FnOnce(&mut Self) -> Result<(), Refusal>) -> ErrorCode {
        if self.is_defective {
            return ErrorCode::Defect;
        }
        match catch_unwind(AssertUnwindSafe(|| work(self))) {
            Ok(Ok(())) => ErrorCode::Ok,
            Ok(Err(refusal)) => {
                self.error.set(&refusal);
                refusal.code()
            }
            Err(_) => {
                self.is_defective = true;
                self.error.set(&DEFECT);
                ErrorCode::Defect
            }
        }
    }

    pub(crate) fn solve(&self, currents_a: &[f64]) -> Result<PoseSolution, Refusal> {
        let readings = self.readings(currents_a)?;
        let solution = self.rows.with_frames(1.0)?.solve(&readings);
        Ok(PoseSolution::new(0, &solution, &Err(NoTwist::NoPose), None))
    }

    /// `exposures_s`: empty if all cells are exposed at the instant of a frame.
    pub(crate) fn start(&mut self, rate_hz: f64, exposures_s: &[f64]) -> Result<(), Refusal> {
        if !(MIN_RATE_HZ..=MAX_RATE_HZ).contains(&rate_hz) {
            return Err(Refusal::Range { what: "rate_hz", value: rate_hz, wanted: "1 to 1000000 Hz" });
        }
        let period_s = rate_hz.recip();
        let is_within = |exposure_s: &&f64| (-period_s..=period_s).contains(*exposure_s);
        if let Some(value) = exposures_s.iter().find(|exposure_s| !is_within(exposure_s)) {
            return Err(Refusal::Range { what: "an exposure", value: *value, wanted: "seconds, at most a period" });
        }
        let simultaneous = vec![0.0; self.cells()];
        let exposures_s = if exposures_s.is_empty() { &simultaneous } else { exposures_s };
        let head = self.rows.head();
        let tracker =
            solving::tracker(head, &head.file.scene, TIER, PipelineOptions::default(), exposures_s, period_s)?;
        let fresh = tracker.clone();
        self.tracking = Some(Tracking { tracker, fresh, period_ns: 1e9 * period_s, before: None });
        Ok(())
    }

    pub(crate) fn reset(&mut self) -> Result<(), Refusal> {
        let tracking = self.tracking.as_mut().ok_or(Refusal::NotStarted)?;
        tracking.tracker.clone_from(&tracking.fresh);
        tracking.before = None;
        Ok(())
    }

    pub(crate) fn track(&mut self, time_ns: u64, currents_a: &[f64]) -> Result<PoseSolution, Refusal> {
        let readings = self.readings(currents_a)?;
        let tracking = self.tracking.as_mut().ok_or(Refusal::NotStarted)?;
        let frame = match tracking.before {
            None => 0,
            Some((frame, before_ns)) => {
                let passed_ns = time_ns.saturating_sub(before_ns) as f64;
                match (passed_ns / tracking.period_ns).round() as u64 {
                    0 => return Err(Refusal::Time { time_ns, before_ns }),
                    frames => frame.saturating_add(frames),
                }
            }
        };
        tracking.before = Some((frame, time_ns));
        let mut tracked = tracking.tracker.track(frame, &readings);
        self.rows.head().complete_tracked(&mut tracked);
        Ok(PoseSolution::new(time_ns, &tracked.solution, &tracked.twist, tracked.light_level))
    }

    fn readings(&self, currents_a: &[f64]) -> Result<Photocurrents, Refusal> {
        if let Some(at) = currents_a.iter().position(|current_a| !current_a.is_finite()) {
            return Err(Refusal::Current { cell: at / 2, electrode: at % 2, value: currents_a[at] });
        }
        let (pairs, _) = currents_a.as_chunks::<2>();
        let pairs = pairs.iter().map(|&[i_x1_a, i_x2_a]| Some(Pair { i_x1_a, i_x2_a }));
        Ok(solving::readings(self.rows.head(), pairs))
    }
}

/// Text of a fixed size, which takes no heap.
pub(crate) struct Text {
    bytes: [u8; MAX_TEXT],
    length: usize,
}

impl Text {
    const fn new() -> Self {
        Self { bytes: [0; MAX_TEXT], length: 0 }
    }

    fn set(&mut self, text: &dyn fmt::Display) {
        self.length = 0;
        // It takes what it has room for.
        let _ = write!(self, "{text}");
    }

    fn as_str(&self) -> &str {
        str::from_utf8(&self.bytes[..self.length]).unwrap_or_default()
    }
}

impl Write for Text {
    fn write_str(&mut self, text: &str) -> fmt::Result {
        let room = text.len().min(MAX_TEXT - self.length);
        let taken = (0..=room).rev().find(|&at| text.is_char_boundary(at)).unwrap_or(0);
        self.bytes[self.length..self.length + taken].copy_from_slice(&text.as_bytes()[..taken]);
        self.length += taken;
        if taken < text.len() { Err(fmt::Error) } else { Ok(()) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_panic_becomes_a_code_and_ends_the_solver() {
        let mut solver = Solver::open("wide", None).unwrap();
        assert_eq!(solver.attempt(|_| panic!("on purpose")), ErrorCode::Defect);
        assert_eq!(solver.error(), DEFECT);
        assert_eq!(solver.attempt(|_| Ok(())), ErrorCode::Defect);
    }

    #[test]
    fn a_text_too_long_is_cut_at_a_letter() {
        let mut text = Text::new();
        text.set(&"µ".repeat(MAX_TEXT));
        assert_eq!(text.as_str(), "µ".repeat(MAX_TEXT / 2));
    }
}
