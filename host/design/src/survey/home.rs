//! Each cell with the tool at home.

use serde::Serialize;
use slitpose_model::{Plan, Pose, Scene};

/// Geometry and light of a cell at home.
#[derive(Clone, Debug, Serialize)]
pub(crate) struct CellAtHome {
    /// Number of the cell.
    pub cell: usize,
    /// Geometry of the spot.
    pub status: &'static str,
    /// Flags, joined by `;`.
    pub flags: String,
    /// d_A: height of the emitter above the detector.
    pub emitter_distance_m: f64,
    /// d_B: height of the slit above the detector.
    pub slit_distance_m: f64,
    /// Position of the light; `None` without spot.
    pub x_a_m: Option<f64>,
    /// Angle between the emitter's axis and the beam; `None` without spot.
    pub gamma_rad: Option<f64>,
    /// Solid angle of the spot.
    pub solid_angle_sr: f64,
    /// Total current.
    pub i_o_a: f64,
}

pub(super) fn at_home(scene: &Scene, plan: &Plan<f64>) -> Vec<CellAtHome> {
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
