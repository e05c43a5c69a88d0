//! What a pose costs, and what it is worth: the board's solver in `f32` against the host's in
//! `f64` and against the truth.

use glam::DVec3;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use slitpose_head::scene_file::SceneFile;
use slitpose_model::{Estimate, MotionPrior, Outcome, Photocurrents, Plan, Pose, SceneError, Solver, Tier};
use slitpose_stopwatch::Solved;
use thiserror::Error;

use crate::stopwatch::{Stopwatch, StopwatchError};

/// A warm start's prior is this far off on every axis, one way or the other: some four standard
/// deviations of a pose, more than a tool that is followed at 4 kHz moves unforeseen.
const PRIOR_OFF_M: f64 = 3e-6;
const PRIOR_OFF_RAD: f64 = 0.3e-3;

/// Currents of the exact tier are made to this relative error, whatever the solver allows itself.
const TRUTH_TOLERANCE: f64 = 1e-9;

/// The board's pose is the host's to this share of its standard deviation.
const POSE_SIGMAS: f64 = 0.1;

/// The board's standard deviations are the host's to this relative error.
const SIGMA_RELATIVE: f64 = 0.02;

/// Poses tried for each one wanted before a scene is given up.
const TRIES: usize = 1_000;

/// Where a solve starts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Start {
    /// Nothing is known.
    Cold,
    /// From the pose before.
    Warm,
}

impl Start {
    /// The word used in tables.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Cold => "cold",
            Self::Warm => "warm",
        }
    }
}

/// Why costs cannot be told.
#[derive(Debug, Error)]
pub enum CostError {
    /// Not a scene.
    #[error(transparent)]
    Scene(#[from] SceneError),
    /// Nowhere in the workspace do all cells see light.
    #[error("scene `{scene}`: no pose of its workspace in {tries} lights all cells and can be solved for")]
    NotLit {
        /// The scene.
        scene: String,
        /// Poses looked at.
        tries: usize,
    },
    /// The board does not answer.
    #[error(transparent)]
    Stopwatch(#[from] StopwatchError),
    /// The board finds no pose.
    #[error("the board has not converged on pose {index}, where the host has")]
    NoPose {
        /// Which pose of the trial.
        index: usize,
    },
    /// The board finds another pose.
    #[error("pose {index}: the board's pose is {sigmas:.2} σ from the host's, {POSE_SIGMAS} at most are rounding")]
    Pose {
        /// Which pose of the trial.
        index: usize,
        /// How far, on the worst axis.
        sigmas: f64,
    },
    /// The board trusts its pose more or less than the host.
    #[error("pose {index}: the board's σ is {ratio:.4} of the host's, within {SIGMA_RELATIVE} of 1 is rounding")]
    Covariance {
        /// Which pose of the trial.
        index: usize,
        /// By how much, on the worst axis.
        ratio: f64,
    },
}

/// Poses that light all cells of a scene.
#[derive(Clone, Debug)]
pub struct Trial {
    samples: Vec<Sample>,
}

#[derive(Clone, Debug)]
struct Sample {
    pose: Pose,
    prior: Pose,
    readings: Photocurrents,
    /// The host's.
    estimate: Estimate,
}

/// Numbers of a trial.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cost {
    /// Core cycles of a solve: the median.
    pub median_cycles: u32,
    /// The largest.
    pub max_cycles: u32,
    /// Steps of refinement: the mean.
    pub mean_iterations: f64,
    /// Distance from the true translation, root mean square, metres.
    pub rms_error_m: f64,
    /// Angle from the true rotation, root mean square, radians.
    pub rms_error_rad: f64,
}

impl Trial {
    /// Draws `count` poses of the scene's workspace, and what the scene's cells deliver there.
    ///
    /// # Errors
    /// If the scene does not light all its cells.
    pub fn new(file: &SceneFile, tier: Tier, count: usize, seed: u64) -> Result<Self, CostError> {
        let truth = Plan::<f64>::compile(&file.scene, truth_of(tier))?;
        let host = Solver::<f64>::new(&file.scene, tier)?;
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let (most, metres, radians) = (TRIES * count, file.workspace.half_extent_m, file.workspace.half_extent_rad);
        let mut samples = Vec::new();
        for _ in 0..most {
            if samples.len() == count {
                break;
            }
            let pose = Pose::from_vectors(within_one(&mut rng) * metres, within_one(&mut rng) * radians);
            let (shift, turn) = (within_one(&mut rng).signum(), within_one(&mut rng).signum());
            let prior = pose.perturbed(shift * PRIOR_OFF_M, turn * PRIOR_OFF_RAD);
            if !is_lit(&truth, &pose) {
                continue;
            }
            let readings = readings(&truth, &pose);
            let solution = host.solve(&readings, slitpose_model::Start::Near(&prior), &MotionPrior::AT_REST);
            if let (Outcome::Converged, Some(estimate)) = (solution.outcome, solution.estimate) {
                samples.push(Sample { pose, prior, readings, estimate });
            }
        }
        if samples.len() < count {
            return Err(CostError::NotLit { scene: file.name.clone(), tries: most });
        }
        Ok(Self { samples })
    }
}

fn truth_of(tier: Tier) -> Tier {
    match tier {
        Tier::Paper => Tier::Paper,
        Tier::Exact { .. } => Tier::Exact { tolerance: TRUTH_TOLERANCE },
    }
}

/// A vector whose components lie within ±1.
fn within_one(rng: &mut ChaCha8Rng) -> DVec3 {
    DVec3::from([0; 3].map(|_| rng.random_range(-1.0..1.0)))
}

fn is_lit(plan: &Plan<f64>, pose: &Pose) -> bool {
    (0..plan.cell_count()).all(|cell| {
        let flags = plan.respond(cell, pose).flags;
        !flags.faint && !flags.saturated
    })
}

fn readings(plan: &Plan<f64>, pose: &Pose) -> Photocurrents {
    Photocurrents::of_pairs((0..plan.cell_count()).map(|cell| plan.photocurrents(cell, pose)))
}

/// Has the board solve all of `trial`, for whose scene and tier it has a solver, and checks what it
/// finds.
///
/// # Errors
/// If it finds anything else than the host.
pub fn measure(stopwatch: &mut Stopwatch, trial: &Trial, start: Start) -> Result<Cost, CostError> {
    let mut cycles = Vec::new();
    let (mut iterations, mut square_m, mut square_rad) = (0.0, 0.0, 0.0);
    for (index, sample) in trial.samples.iter().enumerate() {
        let solved = stopwatch.solve(&sample.readings, (start == Start::Warm).then_some(&sample.prior))?;
        let pose = checked(index, &solved, &sample.estimate)?;
        let (dt, dr) = pose.displacement_from(&sample.pose);
        cycles.push(solved.cycles);
        iterations += f64::from(solved.iterations);
        square_m += dt.length_squared();
        square_rad += dr.length_squared();
    }
    cycles.sort_unstable();
    let count = cycles.len() as f64;
    Ok(Cost {
        median_cycles: cycles[cycles.len() / 2],
        max_cycles: cycles[cycles.len() - 1],
        mean_iterations: iterations / count,
        rms_error_m: (square_m / count).sqrt(),
        rms_error_rad: (square_rad / count).sqrt(),
    })
}

/// The board's pose, if it is the host's.
fn checked(index: usize, solved: &Solved, host: &Estimate) -> Result<Pose, CostError> {
    let Some((pose, covariance)) = solved.estimate.filter(|_| solved.converged) else {
        return Err(CostError::NoPose { index });
    };
    let (dt, dr) = pose.displacement_from(&host.pose);
    let off = [dt.x, dt.y, dt.z, dr.x, dr.y, dr.z];
    let sigma = host.sigma();
    let sigmas = (0..6).map(|axis| (off[axis] / sigma[axis]).abs()).fold(0.0, f64::max);
    // Written so that NaN fails, too.
    let is_close = sigmas <= POSE_SIGMAS;
    if !is_close {
        return Err(CostError::Pose { index, sigmas });
    }
    for axis in 0..6 {
        let ratio = covariance[axis][axis].sqrt() / sigma[axis];
        let is_close = (ratio - 1.0).abs() <= SIGMA_RELATIVE;
        if !is_close {
            return Err(CostError::Covariance { index, ratio });
        }
    }
    Ok(pose)
}
