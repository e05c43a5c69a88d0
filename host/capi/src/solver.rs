//! What stands behind a handle.

#![forbid(unsafe_code)]

use std::fmt::Write;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::Path;

use heapless::String;
use slitpose_calibration::{CalibrationFileError, Head};
use slitpose_head::scene_file::{SceneFile, SceneFileError};
use slitpose_model::{NoTwist, Pair, Photocurrents, SceneError, Tier, Tracker};
use slitpose_tracking::pipeline::PipelineOptions;
use slitpose_tracking::solving::{self, RowSolver, STREAM_TOLERANCE, head_by};
use thiserror::Error;

use crate::ErrorCode;
use crate::solution::PoseSolution;

/// As `slitpose solve` and `run` do unless told otherwise.
const TIER: Tier = Tier::Exact { tolerance: STREAM_TOLERANCE };

/// Why a call is refused.
#[derive(Debug, Error)]
pub(crate) enum Refusal {
    #[error("{0} is NULL; give its address")]
    Null(&'static str),
    #[error("the path is not UTF-8; give it as UTF-8")]
    Text(#[from] std::str::Utf8Error),
    #[error("{given} {what} for {cells} cells; give {needed}")]
    Count { what: &'static str, given: usize, cells: usize, needed: usize },
    #[error("current I_X{} of cell {cell} is {value}; give amperes, 0 for a cell that was not measured", electrode + 1)]
    Current { cell: usize, electrode: usize, value: f64 },
    #[error("{what} = {value}; give {wanted}")]
    Range { what: &'static str, value: f64, wanted: &'static str },
    #[error("no frame rate is known; call slitpose_solver_start() first")]
    NotStarted,
    #[error("{time_ns} ns is less than half a period after {before_ns} ns; give later instants, or reset the solver")]
    Time { time_ns: u64, before_ns: u64 },
    #[error(transparent)]
    Scene(#[from] SceneFileError),
    #[error(transparent)]
    Calibration(#[from] CalibrationFileError),
    #[error(transparent)]
    Optics(#[from] SceneError),
    #[error("a defect of slitpose_solver, described on standard error: close the solver, and report it")]
    Defect,
}

impl Refusal {
    fn code(&self) -> ErrorCode {
        match self {
            Self::Null(_) => ErrorCode::Null,
            Self::NotStarted => ErrorCode::NotStarted,
            Self::Time { .. } => ErrorCode::Time,
            Self::Defect => ErrorCode::Defect,
            _ => ErrorCode::Argument,
        }
    }
}

/// A head, and what solves its currents. One thread at a time may use it.
pub struct Solver {
    rows: RowSolver,
    tracking: Option<Tracking>,
    /// Longer ones than fit are cut off.
    pub(crate) error: String<512>,
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
    pub(crate) fn open(scene: &str, calibration: Option<&str>) -> Result<Self, Refusal> {
        let usual = |file| Ok::<_, Refusal>(Head::as_scene_says(file)?);
        let head = head_by(calibration.map(Path::new), SceneFile::open(scene)?, usual)?;
        Ok(Self { rows: RowSolver::new(head, TIER, false)?, tracking: None, error: String::new(), is_defective: false })
    }

    pub(crate) fn cells(&self) -> usize {
        self.rows.cells()
    }

    pub(crate) fn name(&self) -> &str {
        &self.rows.head().file.name
    }

    /// Does `work`. After a panic in it the solver does nothing any more.
    pub(crate) fn attempt(&mut self, work: impl FnOnce(&mut Self) -> Result<(), Refusal>) -> ErrorCode {
        let work = || if self.is_defective { Err(Refusal::Defect) } else { work(self) };
        let Err(refusal) = catch_unwind(AssertUnwindSafe(work)).unwrap_or(Err(Refusal::Defect)) else {
            return ErrorCode::Ok;
        };
        self.is_defective |= matches!(refusal, Refusal::Defect);
        self.error.clear();
        // It takes what it has room for.
        let _ = write!(self.error, "{refusal}");
        refusal.code()
    }

    pub(crate) fn solve(&self, currents_a: &[f64]) -> Result<PoseSolution, Refusal> {
        let readings = self.readings(currents_a)?;
        let solution = self.rows.with_frames(1.0)?.solve(&readings);
        Ok(PoseSolution::new(&solution, &Err(NoTwist::NoPose), None))
    }

    /// Makes ready for frames; without exposures all cells are exposed at the instant of a frame.
    pub(crate) fn start(&mut self, rate_hz: f64, exposures_s: Option<&[f64]>) -> Result<(), Refusal> {
        let period_s = rate_hz.recip();
        if !(1.0..=1e6).contains(&rate_hz) {
            return Err(Refusal::Range { what: "rate_hz", value: rate_hz, wanted: "1 to 1000000 Hz" });
        }
        let exposures_s = exposures_s.map_or_else(|| vec![0.0; self.cells()], <[f64]>::to_vec);
        self.check_count("exposures_s", exposures_s.len(), 1)?;
        if let Some(&value) = exposures_s.iter().find(|s| !(-period_s..=period_s).contains(*s)) {
            return Err(Refusal::Range { what: "an exposure", value, wanted: "seconds, at most a period" });
        }
        let head = self.rows.head();
        let options = PipelineOptions::default();
        let tracker = solving::tracker(head, &head.file.scene, TIER, options, &exposures_s, period_s)?;
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
                match (time_ns.saturating_sub(before_ns) as f64 / tracking.period_ns).round() as u64 {
                    0 => return Err(Refusal::Time { time_ns, before_ns }),
                    frames => frame.saturating_add(frames),
                }
            }
        };
        tracking.before = Some((frame, time_ns));
        let mut tracked = tracking.tracker.track(frame, &readings);
        self.rows.head().complete_tracked(&mut tracked);
        let found = PoseSolution::new(&tracked.solution, &tracked.twist, tracked.light_level);
        Ok(PoseSolution { time_ns, ..found })
    }

    fn readings(&self, currents_a: &[f64]) -> Result<Photocurrents, Refusal> {
        self.check_count("currents_a", currents_a.len(), 2)?;
        if let Some(at) = currents_a.iter().position(|current_a| !current_a.is_finite()) {
            return Err(Refusal::Current { cell: at / 2, electrode: at % 2, value: currents_a[at] });
        }
        let pairs = currents_a.as_chunks::<2>().0.iter();
        Ok(solving::readings(self.rows.head(), pairs.map(|&[i_x1_a, i_x2_a]| Some(Pair { i_x1_a, i_x2_a }))))
    }

    fn check_count(&self, what: &'static str, given: usize, per_cell: usize) -> Result<(), Refusal> {
        let (cells, needed) = (self.cells(), per_cell * self.cells());
        if given == needed { Ok(()) } else { Err(Refusal::Count { what, given, cells, needed }) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use slitpose_model::{CompiledScene, Pose};

    #[test]
    fn a_row_and_a_frame_allocate_nothing() {
        let mut solver = Solver::open("wide", None).unwrap();
        let plan = CompiledScene::<f64>::compile(&solver.rows.head().file.scene, TIER).unwrap();
        let pairs = (0..6).map(|cell| plan.respond(cell, &Pose::HOME).currents);
        let row: Vec<f64> = pairs.flat_map(|pair| [pair.i_x1_a, pair.i_x2_a]).collect();
        solver.start(1000.0, None).unwrap();
        let info = allocation_counter::measure(|| {
            for frame in 0..100 {
                assert_eq!(solver.solve(&row).unwrap().has_pose, 1);
                assert_eq!(solver.track(1_000_000 * frame, &row).unwrap().has_pose, 1);
                assert_eq!(solver.attempt(|solver| solver.track(0, &row[1..]).map(drop)), ErrorCode::Argument);
            }
            solver.reset().unwrap();
        });
        assert_eq!(info.count_total, 0);
    }

    #[test]
    fn a_panic_becomes_a_code_and_ends_the_solver() {
        let mut solver = Solver::open("wide", None).unwrap();
        assert_eq!(solver.attempt(|_| panic!("on purpose")), ErrorCode::Defect);
        assert_eq!(solver.attempt(|_| Ok(())), ErrorCode::Defect);
        assert!(solver.error.contains("report it"), "{}", solver.error);
    }
}
