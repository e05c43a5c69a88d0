//! How readings are solved: choices that commands and other programs offer.

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::{Arc, Mutex};
use std::time::Duration;

use clap::{Args, ValueEnum};
use slitpose_calibration::{Calibration, CalibrationFileError, Head};
use slitpose_head::board_head::{self, BoardHeadError};
use slitpose_head::scene_file::SceneFile;
use slitpose_head::threads::lock;
use slitpose_model::{
    Batch, MotionPrior, Pair, Photocurrents, Reading, Scene, SceneError, Solution, Solver, Starts, Tier,
};
use slitpose_protocol::{AdcScaling, Hashes, Schedule};

use crate::pipeline::Following;

/// Streams are solved to a tolerance below their noise.
pub const STREAM_TOLERANCE: f64 = 1e-6;

/// Tables of currents are made once and kept, so they get nearly all the digits there are.
pub const MODEL_TOLERANCE: f64 = 1e-10;

/// In place of a calibration: the head is as its scene says.
pub(crate) const NOT_CALIBRATED: &str = "none";

/// How exactly the optics are evaluated.
#[derive(Args, Clone, Copy, Debug, Default)]
pub struct TierOptions {
    /// Equations as printed in the source paper, or integrated over the spot
    #[arg(long, value_enum)]
    pub tier: Option<TierName>,
    /// Relative error of the exact tier's integrals; given alone it means the exact tier
    #[arg(long, value_name = "T", value_parser = parse_tolerance)]
    pub tolerance: Option<f64>,
}

/// A [`Tier`] without its tolerance.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum TierName {
    /// Equations (1) to (6) of De La Cruz et al. 2018
    Paper,
    /// Integrated over the spot
    Exact,
}

impl TierOptions {
    /// The tier asked for; exact to `default_tolerance` if nothing is asked.
    pub fn tier(self, default_tolerance: f64) -> Tier {
        self.tier_or(Tier::Exact { tolerance: default_tolerance })
    }

    /// The tier asked for; what is not asked for is as `usual`, or as usual for streams.
    pub fn tier_or(self, usual: Tier) -> Tier {
        let usual_tolerance = match usual {
            Tier::Exact { tolerance } => tolerance,
            Tier::Paper => STREAM_TOLERANCE,
        };
        match (self.tier, self.tolerance) {
            (Some(TierName::Paper), _) => Tier::Paper,
            (Some(TierName::Exact), tolerance) => Tier::Exact { tolerance: tolerance.unwrap_or(usual_tolerance) },
            (None, Some(tolerance)) => Tier::Exact { tolerance },
            (None, None) => usual,
        }
    }
}

/// Whether a tolerance of the exact tier is possible.
pub fn is_tolerance(tolerance: f64) -> bool {
    tolerance > 0.0 && tolerance < 1.0
}

fn parse_tolerance(text: &str) -> Result<f64, &'static str> {
    let tolerance = text.parse().ok().filter(|&tolerance| is_tolerance(tolerance));
    tolerance.ok_or("give a number between 0 and 1, such as 1e-10")
}

/// How scans are solved.
#[derive(Args, Clone, Copy, Debug, Default)]
pub struct Solving {
    /// Also estimate each pose from many scans, by a parabola through about this long, such as 5ms;
    /// or off
    #[arg(long, value_name = "TIME", value_parser = parse_filter)]
    pub filter: Option<Filter>,
    /// Leave out cells whose light falls on an end of the detector
    #[arg(long)]
    pub without_clipped: bool,
    /// How exactly the optics are evaluated.
    #[command(flatten)]
    pub tier: TierOptions,
}

/// Memory of the filter, seconds; `None`: no filter.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Filter(pub Option<f64>);

fn parse_filter(text: &str) -> Result<Filter, String> {
    Ok(Filter(if text == "off" { None } else { Some(parse_duration(text)?) }))
}

impl Solving {
    /// How scans are followed: as they were, unless asked otherwise.
    pub fn following_or(&self, recorded: Option<Following>) -> Following {
        let recorded = recorded.unwrap_or_default();
        Following {
            source: recorded.source,
            filter_s: match self.filter {
                Some(Filter(filter_s)) => filter_s,
                None => recorded.filter_s,
            },
            without_clipped: self.without_clipped || recorded.without_clipped,
        }
    }

    /// An option that was given for poses found by this program.
    pub(crate) fn for_this_program(&self) -> Option<&'static str> {
        [(matches!(self.filter, Some(Filter(Some(_)))), "--filter"), (self.without_clipped, "--without-clipped")]
            .into_iter()
            .find_map(|(is_given, option)| is_given.then_some(option))
    }

    /// The tier to solve in: as it was, unless asked otherwise.
    pub fn tier_or(&self, recorded: Option<Tier>) -> Tier {
        self.tier.tier_or(recorded.unwrap_or(Tier::Exact { tolerance: STREAM_TOLERANCE }))
    }
}

/// The head of `file` by the calibration at the path `calibration`, or as its scene says if that is `none`; without
/// either by `usual`.
///
/// # Errors
/// A calibration that cannot be read, or of another scene; and those of `usual`.
pub fn head_by<E: From<CalibrationFileError>>(
    calibration: Option<&Path>,
    file: SceneFile,
    usual: impl FnOnce(SceneFile) -> Result<Head, E>,
) -> Result<Head, E> {
    match calibration {
        None => usual(file),
        Some(path) if path == NOT_CALIBRATED => Ok(file.into()),
        Some(path) => Ok(Head::open_calibrated(file, path)?),
    }
}

/// A duration such as `10s`, `500ms` or `2m`.
pub(crate) fn parse_duration(text: &str) -> Result<f64, String> {
    match humantime::parse_duration(text) {
        Ok(duration) if duration > Duration::ZERO => Ok(duration.as_secs_f64()),
        Ok(_) => Err("give more than nothing, such as 10s".to_owned()),
        Err(error) => Err(format!("{error}; give a duration such as 10s, 500ms or 2m")),
    }
}

/// The hashes of what `head` is made from.
pub(crate) fn hashes(head: &Head) -> Hashes {
    Hashes { scene: Some(head.file.hash), calibration: head.calibration().map(Calibration::hash) }
}

/// The bytes of `head` for a board that runs `schedule` with `scaling`.
pub(crate) fn compile(head: &Head, schedule: &Schedule, scaling: &AdcScaling) -> Result<Vec<u8>, BoardHeadError> {
    board_head::encode(&head.file, schedule, scaling, hashes(head))
}

/// Most numbers of averaged frames whose solvers are kept.
const MOST_SOLVERS: usize = 64;

/// Solves readings of one head that do not belong together.
pub struct RowSolver {
    head: Head,
    tier: Tier,
    without_clipped: bool,
    /// By the frames that a reading is the mean of.
    solvers: Mutex<BTreeMap<u64, Arc<Solver<f64>>>>,
}

impl RowSolver {
    /// For readings of `head`; `without_clipped`: cells whose light falls on an end of the detector are left out.
    ///
    /// # Errors
    /// A scene that cannot be computed.
    pub fn new(head: Head, tier: Tier, without_clipped: bool) -> Result<Self, SceneError> {
        let rows = Self { head, tier, without_clipped, solvers: Mutex::default() };
        rows.with_frames(1.0)?;
        Ok(rows)
    }

    /// How many cells the head has.
    pub fn cells(&self) -> usize {
        self.head.file.scene.cells.len()
    }

    /// Makes ready for readings that are the mean of `frames` frames.
    ///
    /// # Errors
    /// A scene that cannot be computed.
    pub fn with_frames(&self, frames: f64) -> Result<RowsOf<'_>, SceneError> {
        let key = frames.to_bits();
        let known = lock(&self.solvers).get(&key).cloned();
        let solver = match known {
            Some(solver) => solver,
            None => {
                let scene = &self.head.file.scene;
                let noise = scene.noise.map(|noise| noise.averaged(frames));
                let mut solver = Solver::new(&Scene { noise, ..scene.clone() }, self.tier)?;
                if self.without_clipped {
                    solver = solver.without_clipped();
                }
                let mut solvers = lock(&self.solvers);
                if solvers.len() >= MOST_SOLVERS {
                    solvers.clear();
                }
                Arc::clone(solvers.entry(key).or_insert(Arc::new(solver)))
            }
        };
        Ok(RowsOf { head: &self.head, solver })
    }
}

/// Solves readings that are means of as many frames.
#[derive(Clone)]
pub struct RowsOf<'a> {
    head: &'a Head,
    solver: Arc<Solver<f64>>,
}

impl RowsOf<'_> {
    /// One row, from the currents of each cell, dark current included; `None`: not measured.
    pub fn readings(&self, row: impl IntoIterator<Item = Option<Pair<f64>>>) -> Photocurrents {
        let reading = |(pair, cell): (Option<Pair<f64>>, &slitpose_model::Cell)| match pair {
            Some(Pair { i_x1_a, i_x2_a }) => {
                let half_dark_a = 0.5 * cell.detector.dark_current_a;
                Reading::Light(Pair { i_x1_a: i_x1_a - half_dark_a, i_x2_a: i_x2_a - half_dark_a })
            }
            None => Reading::Missing,
        };
        Photocurrents { cells: row.into_iter().zip(&self.head.file.scene.cells).map(reading).collect() }
    }

    /// Passes the solution of each of `rows` to `take`, in their order: the pose behind it, found from a cold start.
    pub fn solve(&self, rows: &[Photocurrents], mut take: impl FnMut(Solution)) {
        Batch::new(&self.solver).solve(rows, Starts::Cold, &MotionPrior::AT_REST, |_, mut solution| {
            self.head.complete(&mut solution);
            take(solution);
        });
    }

    /// Passes the condition number of each of `solutions` to `take`, in their order.
    pub fn conditions(&self, solutions: &[Solution], mut take: impl FnMut(Option<f64>)) {
        Batch::new(&self.solver).conditions(solutions, |_, condition| take(condition));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn durations_are_read_or_refused() {
        assert_eq!(parse_duration("10s"), Ok(10.0));
        assert_eq!(parse_duration("500ms"), Ok(0.5));
        for text in ["", "10", "0s", "-1s", "soon"] {
            assert!(parse_duration(text).is_err(), "{text}");
        }
        assert_eq!(parse_filter("off"), Ok(Filter(None)));
        assert_eq!(parse_filter("5ms"), Ok(Filter(Some(0.005))));
    }

    #[test]
    fn a_tolerance_lies_between_zero_and_one() {
        assert_eq!(parse_tolerance("1e-6"), Ok(1e-6));
        for text in ["0", "1", "-1e-3", "nan", "tight"] {
            assert!(parse_tolerance(text).is_err(), "`{text}` was taken for a tolerance");
        }
    }
}
