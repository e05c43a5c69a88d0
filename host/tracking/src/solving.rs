//! How readings are solved: choices that commands and other programs offer.

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::{Arc, Mutex};

use slitpose_calibration::{Basis, Calibration, CalibrationFileError, Head};
use slitpose_head::board_head::{self, BoardHeadError};
use slitpose_head::scene_file::SceneFile;
use slitpose_head::threads::lock;
use slitpose_model::{
    CompiledScene, Estimate, MotionPrior, Pair, Photocurrents, Pose, Reading, Scene, SceneError, Solution, Solver,
    Start, Tier, Tracker,
};
use slitpose_protocol::{AdcScaling, Hashes, Schedule};

use crate::pipeline::PipelineOptions;

/// Streams are solved to a tolerance below their noise.
pub const STREAM_TOLERANCE: f64 = 1e-6;

/// Tables of currents are made once and kept, so they get nearly all the digits there are.
pub const MODEL_TOLERANCE: f64 = 1e-10;

/// In place of a calibration: the head is as its scene says.
pub const NOT_CALIBRATED: &str = "none";

/// How exactly the optics are evaluated, as far as it was chosen.
#[derive(Clone, Copy, Debug, Default)]
pub enum TierChoice {
    /// As usual.
    #[default]
    Usual,
    /// Equations (1) to (6) of De La Cruz et al. 2018.
    Paper,
    /// Integrated over the spot, to a relative error, or to the usual one.
    Exact(Option<f64>),
}

impl TierChoice {
    /// The tier chosen; exact to `default_tolerance` if none was.
    pub fn tier(self, default_tolerance: f64) -> Tier {
        self.tier_or(Tier::Exact { tolerance: default_tolerance })
    }

    /// The tier chosen; what was not chosen is as `usual`, or as usual for streams.
    pub fn tier_or(self, usual: Tier) -> Tier {
        let usual_tolerance = match usual {
            Tier::Exact { tolerance } => tolerance,
            Tier::Paper => STREAM_TOLERANCE,
        };
        match self {
            Self::Usual => usual,
            Self::Paper => Tier::Paper,
            Self::Exact(tolerance) => Tier::Exact { tolerance: tolerance.unwrap_or(usual_tolerance) },
        }
    }
}

/// Whether a tolerance of the exact tier is possible.
pub fn is_tolerance(tolerance: f64) -> bool {
    tolerance > 0.0 && tolerance < 1.0
}

/// How scans are solved, as far as it was chosen.
#[derive(Clone, Copy, Debug, Default)]
pub struct Solving {
    /// Also estimates each pose from many scans, or does not.
    pub filter: Option<Filter>,
    /// Leaves out cells whose light falls on an end of the detector.
    pub without_clipped: bool,
    /// Takes emitters for as bright as scene or calibration says.
    pub known_light: bool,
    /// How exactly the optics are evaluated.
    pub tier: TierChoice,
}

/// Memory of the filter, seconds; `None`: no filter.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Filter(pub Option<f64>);

impl Solving {
    /// How scans are followed: as they were, unless asked otherwise.
    pub fn following_or(&self, recorded: Option<PipelineOptions>) -> PipelineOptions {
        let recorded = recorded.unwrap_or_default();
        PipelineOptions {
            source: recorded.source,
            filter_s: match self.filter {
                Some(Filter(filter_s)) => filter_s,
                None => recorded.filter_s,
            },
            without_clipped: self.without_clipped || recorded.without_clipped,
            known_light: self.known_light || recorded.known_light,
        }
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

/// The hashes of what `head` is made from.
pub fn hashes(head: &Head) -> Hashes {
    Hashes { scene: Some(head.file.hash), calibration: head.calibration().map(Calibration::hash) }
}

/// The bytes of `head` for a board that runs `schedule` with `scaling`.
pub fn compile(head: &Head, schedule: &Schedule, scaling: &AdcScaling) -> Result<Vec<u8>, BoardHeadError> {
    board_head::encode(&head.file, schedule, scaling, hashes(head))
}

/// Solves consecutive frames of `head`, `period_s` apart; cell k is exposed `exposures_s[k]` after the instant of a frame. `scene`:
/// that of the head, with the noise of what measures its currents.
pub fn tracker(
    head: &Head,
    scene: &Scene,
    tier: Tier,
    following: PipelineOptions,
    exposures_s: &[f64],
    period_s: f64,
) -> Result<Tracker<f64>, SceneError> {
    let is_calibrated = matches!(head.basis, Basis::Calibration(_));
    let solver = Solver::new(scene, tier)?.with_exposures(exposures_s);
    let solver = if following.without_clipped { solver.without_clipped() } else { solver };
    let solver = if following.known_light { solver.with_known_light_level() } else { solver };
    let tracker = Tracker::new(solver, period_s);
    let tracker = if !following.known_light && (is_calibrated || head.file.gives_emitter_drift) {
        tracker.following_levels(scene)
    } else {
        tracker
    };
    Ok(match following.filter_s {
        Some(memory_s) => tracker.with_filter(memory_s),
        None => tracker,
    })
}

/// The readings of one row, from the currents of each cell of `head`, dark current included; `None`: not measured.
pub fn readings(head: &Head, row: impl IntoIterator<Item = Option<Pair<f64>>>) -> Photocurrents {
    let reading = |(pair, cell): (Option<Pair<f64>>, &slitpose_model::Cell)| match pair {
        Some(Pair { i_x1_a, i_x2_a }) => {
            let half_dark_a = 0.5 * cell.detector.dark_current_a;
            Reading::Light(Pair { i_x1_a: i_x1_a - half_dark_a, i_x2_a: i_x2_a - half_dark_a })
        }
        None => Reading::Missing,
    };
    Photocurrents { cells: row.into_iter().zip(&head.file.scene.cells).map(reading).collect() }
}

/// Most numbers of averaged frames whose solvers are kept.
const MAX_SOLVERS: usize = 64;

/// Frames in a row without noise.
const NOISELESS: f64 = 1e12;

/// Poses over the workspace at which errors are computed.
const POSES: usize = 64;

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
    pub fn new(head: Head, tier: Tier, without_clipped: bool) -> Result<Self, SceneError> {
        let rows = Self { head, tier, without_clipped, solvers: Mutex::default() };
        rows.with_frames(1.0)?;
        Ok(rows)
    }

    /// How many cells the head has.
    pub fn cells(&self) -> usize {
        self.head.file.scene.cells.len()
    }

    /// The head whose readings it solves.
    pub fn head(&self) -> &Head {
        &self.head
    }

    /// Makes ready for readings that are the mean of `frames` frames.
    pub fn with_frames(&self, frames: f64) -> Result<RowsOf<'_>, SceneError> {
        let key = frames.to_bits();
        let known = lock(&self.solvers).get(&key).cloned();
        let solver = match known {
            Some(solver) => solver,
            None => {
                let scene = &self.head.file.scene;
                let noise = scene.noise.map(|noise| noise.averaged(frames));
                let mut scene = Scene { noise, ..scene.clone() };
                if self.head.calibration().is_none() && !self.head.file.gives_light_level {
                    // Rows of a table, not frames of a head that has warmed since it was calibrated.
                    scene.uncertainty.light_level_relative = 0.0;
                }
                let mut solver = Solver::new(&scene, self.tier)?;
                if self.without_clipped {
                    solver = solver.without_clipped();
                }
                let mut solvers = lock(&self.solvers);
                if solvers.len() >= MAX_SOLVERS {
                    solvers.clear();
                }
                Arc::clone(solvers.entry(key).or_insert(Arc::new(solver)))
            }
        };
        Ok(RowsOf { head: &self.head, solver })
    }

    /// Makes ready to solve the head's own light without noise: what is then uncertain of a pose is what the calibration left
    /// open, and what cells do beyond the model.
    pub fn without_noise(&self) -> Result<impl Fn(&Pose) -> Option<Estimate>, SceneError> {
        let plan = CompiledScene::<f64>::compile(&self.head.file.scene, self.tier)?;
        let rows = self.with_frames(NOISELESS)?;
        Ok(move |pose: &Pose| {
            let currents = (0..plan.cell_count()).map(|cell| Some(plan.respond(cell, pose).currents));
            rows.solve(&rows.readings(currents)).estimate
        })
    }

    /// How well poses of a calibrated head are known over its workspace, apart from where its frames lie, and from noise: root
    /// mean square of three axes together, metres and radians. `None`: it is not calibrated, or no pose is solved.
    pub fn known_to(&self) -> Option<[f64; 2]> {
        let (calibration, workspace) = (self.head.calibration()?, &self.head.file.workspace);
        let solve = self.without_noise().ok()?;
        let (mut squares, mut count) = ([0.0; 2], 0.0);
        for estimate in workspace.poses(POSES).filter_map(|pose| solve(&pose)) {
            let open = calibration.pose_covariance(&estimate.pose);
            for axis in 0..6 {
                squares[axis / 3] += estimate.covariance[axis][axis] - open[axis][axis];
            }
            count += 1.0;
        }
        let open = calibration.open_apart_from_frames(workspace);
        (count > 0.0).then(|| [0, 1].map(|k| (squares[k].max(0.0) / count + open[k] * open[k]).sqrt()))
    }
}

/// Solves readings that are means of as many frames.
#[derive(Clone)]
pub struct RowsOf<'a> {
    head: &'a Head,
    solver: Arc<Solver<f64>>,
}

impl RowsOf<'_> {
    /// One row: see [`readings`].
    pub fn readings(&self, row: impl IntoIterator<Item = Option<Pair<f64>>>) -> Photocurrents {
        readings(self.head, row)
    }

    /// The pose behind `readings`, found from a cold start.
    pub fn solve(&self, readings: &Photocurrents) -> Solution {
        let mut solution = self.solver.solve(readings, Start::Cold, &MotionPrior::AT_REST);
        self.head.complete(&mut solution);
        solution
    }
}
