//! What a head shows before it is calibrated.

use slitpose_calibration::uncalibrated;
use slitpose_head::scene_file::SceneFile;
use slitpose_model::{MotionPrior, Photocurrents, Plan, SceneError, Solver, Start, Tier};

use super::SOLVING_TOLERANCE;

/// Poses of the workspace that are tried.
const POSES: usize = 16;

/// Share of poses of the workspace whose currents, by `plan`, lead to a pose by the head's tolerances, which are the default
/// ones where the scene states none.
pub(super) fn told(file: &SceneFile, plan: &Plan<f64>) -> Result<f64, SceneError> {
    let solver = Solver::<f64>::new(&uncalibrated(file)?, Tier::Exact { tolerance: SOLVING_TOLERANCE })?;
    let is_told =
        |currents: &Photocurrents| solver.solve(currents, Start::Cold, &MotionPrior::AT_REST).estimate.is_some();
    let currents = file
        .workspace
        .poses(POSES)
        .map(|pose| Photocurrents::of_pairs((0..plan.cell_count()).map(|cell| plan.photocurrents(cell, &pose))));
    Ok(currents.filter(is_told).count() as f64 / POSES as f64)
}
