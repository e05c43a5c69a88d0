//! What is left between readings and model, for people to look at.

use slitpose_model::{Plan, Scene, SceneError};

use crate::data::Data;
use crate::parameters::Parameters;
use crate::reading_noise::{directions, whiten, whitener};
use crate::sensitivity::TIER;
use crate::state::State;

/// One reading, against the head before and after calibration.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Residual {
    /// The cell.
    pub cell: usize,
    /// Position of the light on the detector, metres.
    pub position_m: f64,
    /// Angle γ of the beam to the emitter's axis, radians.
    pub angle_rad: f64,
    /// Deviation of the photocurrent, relative, and of the position, metres, from the most probable head of the tolerances.
    pub before: [f64; 2],
    /// The same from the calibrated head.
    pub after: [f64; 2],
    /// Both in units of their σ, uncorrelated.
    pub normalised: [f64; 2],
}

/// Of all readings that have light in both models.
pub(crate) fn of(nominal: &Scene, data: &Data, state: &State) -> Result<Vec<Residual>, SceneError> {
    let at_prior = Parameters {
        entries: state
            .parameters
            .entries
            .iter()
            .map(|entry| crate::Parameter { value: entry.prior, ..*entry })
            .collect(),
        ..state.parameters
    };
    let [before, after] = [&at_prior, &state.parameters].map(|of| Plan::<f64>::compile(&of.scene(nominal), TIER));
    let (before, after) = (before?, after?);
    let mut found = Vec::new();
    for (row, pose) in data.rows.iter().zip(&state.poses) {
        for (cell, reading) in row.readings.iter().enumerate() {
            let (Some(reading), response) = (*reading, after.respond(cell, pose)) else { continue };
            let (Some(position_m), Some(angle_rad)) = (response.x_a_m, response.gamma_rad) else { continue };
            let half_length_m = 0.5 * nominal.cells[cell].detector.length_m;
            let deviation = |plan: &Plan<f64>| {
                let pair = plan.photocurrents(cell, pose);
                let expected = [pair.i_x1_a, pair.i_x2_a];
                let change = [reading[0] - expected[0], reading[1] - expected[1]];
                (directions(expected, half_length_m).map(|by| by[0] * change[0] + by[1] * change[1]), change)
            };
            let ((before, _), (after, change)) = (deviation(&before), deviation(&after));
            let normalised = whiten(whitener(state.covariance(cell, reading, row.frames)), change);
            if before.iter().chain(&after).all(|value| value.is_finite()) {
                found.push(Residual { cell, position_m, angle_rad, before, after, normalised });
            }
        }
    }
    Ok(found)
}
