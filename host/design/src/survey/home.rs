//! The head at home: each cell, how far the tool moves from there, and what it shows before it is calibrated.

use std::f64::consts::PI;

use serde::Serialize;
use slitpose_calibration::uncalibrated;
use slitpose_head::scene_file::SceneFile;
use slitpose_model::{CompiledScene, MotionPrior, Pose, Scene, SceneError, Solver, Start, Status, Tier};

use super::SOLVING_TOLERANCE;
use super::coverage::{AXES, axis_motion};
use crate::report::currents;

/// Geometry and light of a cell at home.
#[derive(Clone, Debug, Serialize)]
pub(crate) struct CellAtHome {
    pub cell: usize,
    /// Geometry of the spot.
    pub status: &'static str,
    pub flags: String,
    /// d_A: height of the emitter above the detector.
    pub emitter_distance_m: f64,
    /// d_B: height of the slit above the detector.
    pub slit_distance_m: f64,
    /// Position of the light; `None` without spot.
    pub x_a_m: Option<f64>,
    /// Angle between the emitter's axis and the beam; `None` without spot.
    pub gamma_rad: Option<f64>,
    pub solid_angle_sr: f64,
    pub i_o_a: f64,
}

pub(super) fn at_home(scene: &Scene, plan: &CompiledScene<f64>) -> Vec<CellAtHome> {
    let describe = |(number, cell): (usize, &slitpose_model::Cell)| {
        let response = plan.respond(number, &Pose::HOME);
        let above_detector = cell.emitter.position_tool_m - cell.detector.centre_base_m;
        CellAtHome {
            cell: number,
            status: response.status.as_str(),
            flags: response.flags.to_string(),
            emitter_distance_m: above_detector.dot(cell.detector.normal_base),
            slit_distance_m: cell.slit.distance_m,
            x_a_m: response.x_a_m,
            gamma_rad: response.gamma_rad,
            solid_angle_sr: response.solid_angle_sr,
            i_o_a: response.i_o_a,
        }
    };
    scene.cells.iter().enumerate().map(describe).collect()
}

/// Steps of the search outward from home: finer than any gap between two lit regions.
const STEP_M: f64 = 0.1e-3;
const STEP_RAD: f64 = 0.5 * PI / 180.0;

/// Where the search gives up: no head of this kind is as large.
const FARTHEST_M: f64 = 0.1;
const FARTHEST_RAD: f64 = PI;

/// Halvings of a step: to a millionth of it.
const BISECTIONS: usize = 20;

/// Pure motion from home along one axis.
#[derive(Clone, Debug, Serialize)]
pub(crate) struct Travel {
    /// `tx` … `rz`.
    pub axis: &'static str,
    pub negative: End,
    pub positive: End,
}

#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub(crate) struct End {
    /// Signed motion from home, metres or radians; zero if a cell is not usable even at home.
    pub at: f64,
    /// The first cell that is no longer usable; `None` if the search ended before.
    pub cell: Option<usize>,
    /// What that cell becomes: a status other than `lit`, or `faint`.
    pub becomes: Option<&'static str>,
}

pub(super) fn along_axes(plan: &CompiledScene<f64>) -> Vec<Travel> {
    let travel =
        |(number, axis)| Travel { axis, negative: farthest(plan, number, -1.0), positive: farthest(plan, number, 1.0) };
    AXES.into_iter().enumerate().map(travel).collect()
}

fn farthest(plan: &CompiledScene<f64>, axis: usize, sign: f64) -> End {
    let (step, limit) = if axis < 3 { (STEP_M, FARTHEST_M) } else { (STEP_RAD, FARTHEST_RAD) };
    let failure = |amount: f64| first_unusable(plan, &axis_motion(axis, sign * amount));
    let steps = (limit / step).round() as usize;
    let Some(first_bad) = (0..=steps).find(|index| failure(*index as f64 * step).is_some()) else {
        return End { at: sign * limit, cell: None, becomes: None };
    };
    let (mut good, mut bad) = ((first_bad as f64 - 1.0).max(0.0) * step, first_bad as f64 * step);
    for _ in 0..BISECTIONS {
        let middle = 0.5 * (good + bad);
        if failure(middle).is_some() { bad = middle } else { good = middle }
    }
    let (cell, becomes) = failure(bad).unzip();
    End { at: sign * good, cell, becomes }
}

fn first_unusable(plan: &CompiledScene<f64>, pose: &Pose) -> Option<(usize, &'static str)> {
    (0..plan.cell_count()).find_map(|cell| {
        let response = plan.respond(cell, pose);
        match response.status {
            Status::Lit if response.flags.faint => Some((cell, "faint")),
            Status::Lit => None,
            status => Some((cell, status.as_str())),
        }
    })
}

/// Poses of the workspace that are tried.
const POSES: usize = 16;

/// Share of poses of the workspace whose currents, by `plan`, lead to a pose by the head's tolerances, which are the default
/// ones where the scene states none.
pub(super) fn told(file: &SceneFile, plan: &CompiledScene<f64>) -> Result<f64, SceneError> {
    let solver = Solver::<f64>::new(&uncalibrated(file)?, Tier::Exact { tolerance: SOLVING_TOLERANCE })?;
    let is_told =
        |pose: &Pose| solver.solve(&currents(plan, pose), Start::Cold, &MotionPrior::AT_REST).estimate.is_some();
    Ok(file.workspace.poses(POSES).filter(is_told).count() as f64 / POSES as f64)
}
