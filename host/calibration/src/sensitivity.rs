//! Currents of every row, with their derivatives by the pose and by the parameters.

use slitpose_head::threads::on_all_cores;
use slitpose_model::{Plan, Pose, Scene, SceneError, Status, Tier};

use crate::parameters::Parameters;

/// The optics of calibration: finer than the noise of a thousand frames.
pub(crate) const TIER: Tier = Tier::Exact { tolerance: 1e-6 };

/// Step of a one-sided difference by a parameter, in standard deviations of its prior: parts deviate by a hundredth of
/// their size, so that curvature is below 1e-4 of the slope.
const STEP: f64 = 0.01;

/// A cell at every row's pose.
pub(crate) struct CellSensitivity {
    /// Which parameters act on it.
    pub(crate) acting: Vec<usize>,
    /// Currents above dark; `None`: no direct light reaches the detector.
    pub(crate) pairs: Vec<Option<[f64; 2]>>,
    /// Derivatives by the pose's perturbation.
    pub(crate) by_pose: Vec<[[f64; 6]; 2]>,
    /// Derivatives by the acting parameters in units of their prior σ: row after row, then parameter after parameter.
    /// Empty if not asked for.
    pub(crate) by_parameter: Vec<[f64; 2]>,
}

/// The part of the scene that cell `number` needs: all cells if light of other emitters reaches it.
fn scene_of(nominal: &Scene, parameters: &Parameters, number: usize, changed: Option<(usize, f64)>) -> (Scene, usize) {
    let cell = parameters.cell(&nominal.cells[number], number, changed);
    if cell.effects.lit_together == 0 {
        return (Scene { cells: [cell].into_iter().collect(), ..Scene::default() }, 0);
    }
    let mut scene = parameters.scene(nominal);
    scene.cells[number] = cell;
    if let Some(owner) = changed.and_then(|(place, _)| parameters.entries[place].cell) {
        scene.cells[owner] = parameters.cell(&nominal.cells[owner], owner, changed);
    }
    (scene, number)
}

fn of_cell(
    nominal: &Scene,
    parameters: &Parameters,
    number: usize,
    poses: &[Pose],
    derivatives: bool,
) -> Result<CellSensitivity, SceneError> {
    let cell = &nominal.cells[number];
    let acting = parameters.acting_on(cell, number, cell.effects.lit_together);
    let plan_of = |changed| {
        let (scene, index) = scene_of(nominal, parameters, number, changed);
        Ok((Plan::<f64>::compile(&scene, TIER)?, index))
    };
    let (plan, index) = plan_of(None)?;
    let mut pairs = Vec::with_capacity(poses.len());
    let mut by_pose = Vec::with_capacity(poses.len());
    for pose in poses {
        let (status, pair, jacobian) = plan.linearise(index, pose);
        pairs.push(matches!(status, Status::Lit | Status::Clipped).then_some([pair.i_x1_a, pair.i_x2_a]));
        by_pose.push(jacobian);
    }
    let mut by_parameter = Vec::new();
    if derivatives {
        by_parameter = vec![[0.0; 2]; poses.len() * acting.len()];
        for (place, &k) in acting.iter().enumerate() {
            let entry = &parameters.entries[k];
            let step = STEP * entry.prior_sigma;
            let (after, _) = plan_of(Some((k, entry.value + step)))?;
            for (row, pose) in poses.iter().enumerate() {
                let Some(before) = pairs[row] else { continue };
                let changed = after.photocurrents(index, pose);
                by_parameter[row * acting.len() + place] =
                    [(changed.i_x1_a - before[0]) / STEP, (changed.i_x2_a - before[1]) / STEP];
            }
        }
    }
    Ok(CellSensitivity { acting, pairs, by_pose, by_parameter })
}

/// All cells, each computed by one of the processor's cores.
pub(crate) fn sensitivities(
    nominal: &Scene,
    parameters: &Parameters,
    poses: &[Pose],
    derivatives: bool,
) -> Result<Vec<CellSensitivity>, SceneError> {
    let numbers: Vec<usize> = (0..nominal.cells.len()).collect();
    let of_cell = |&number: &usize| of_cell(nominal, parameters, number, poses, derivatives);
    on_all_cores(&numbers, of_cell).into_iter().collect()
}
