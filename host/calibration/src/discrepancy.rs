//! What errors of the model do to the parameters if they do not change from reading to reading.
//!
//! The adjustment takes what the model leaves out for as independent as noise. In a real head it follows the pose: a burr on a
//! slit is there again whenever the light comes from the same side, and parameters adapt to it. Here it is a smooth function of
//! the pose whose coefficients are *considered*: not estimated, but known to be uncertain (Schmidt 1966, "Application of
//! state-space methods to navigation problems"; model discrepancy: Kennedy, O'Hagan 2001).

use nalgebra::DMatrix;
use slitpose_head::scene_file::Workspace;
use slitpose_model::Pose;

use crate::adjust::Adjustment;
use crate::data::{Row, half_extents, values_of};
use crate::normal::Normal;
use crate::reading::{whiten, whitener};
use crate::state::State;

/// Functions of the pose: linear and quadratic ones of six coordinates.
const FUNCTIONS: usize = 6 + 21;

/// Least spread of a coordinate over the poses of the data, by the half extent of the workspace: an error that bends within less is
/// not smooth, and it would be extrapolated to where nothing was measured.
const MIN_SPREAD: f64 = 0.25;

/// The functions, of mean zero over the poses of the data, and of mean square one if these spread over the workspace.
#[derive(Debug)]
struct Functions {
    middle: [f64; 6],
    /// Inverse of the spread; zero for a coordinate that is always the same.
    scale: [f64; 6],
    mean: [f64; FUNCTIONS],
    norm: [f64; FUNCTIONS],
}

impl Functions {
    fn over(poses: &[Pose], workspace: &Workspace) -> Self {
        let count = poses.len().max(1) as f64;
        let mut found = Self { middle: [0.0; 6], scale: [0.0; 6], mean: [0.0; FUNCTIONS], norm: [1.0; FUNCTIONS] };
        let moments = |of: &dyn Fn(&Pose) -> f64| {
            let mean = poses.iter().map(of).sum::<f64>() / count;
            let square = poses.iter().map(|pose| (of(pose) - mean).powi(2)).sum::<f64>() / count;
            (mean, square.sqrt())
        };
        for (axis, half_extent) in half_extents(workspace).into_iter().enumerate() {
            let (mean, spread) = moments(&|pose| values_of(pose)[axis]);
            let spread = spread.max(MIN_SPREAD * half_extent);
            found.middle[axis] = mean;
            found.scale[axis] = if spread > 0.0 { spread.recip() } else { 0.0 };
        }
        let of_functions: Vec<_> = (0..FUNCTIONS).map(|k| moments(&|pose| found.at(pose)[k])).collect();
        for (k, (mean, root)) in of_functions.into_iter().enumerate() {
            (found.mean[k], found.norm[k]) = (mean, root.max(1.0).recip());
        }
        found
    }

    fn at(&self, pose: &Pose) -> [f64; FUNCTIONS] {
        let values = values_of(pose);
        let u: [f64; 6] = std::array::from_fn(|axis| (values[axis] - self.middle[axis]) * self.scale[axis]);
        let mut found = [0.0; FUNCTIONS];
        found[..6].copy_from_slice(&u);
        let pairs = (0..6).flat_map(|i| (i..6).map(move |j| (i, j)));
        for (function, (i, j)) in found[6..].iter_mut().zip(pairs) {
            *function = u[i] * u[j];
        }
        std::array::from_fn(|k| (found[k] - self.mean[k]) * self.norm[k])
    }
}

/// Variance of the smooth part of a cell's model error, by that of what an adjustment leaves of the whole as if it were noise:
/// of such functions parameters leave 3 to 5 % in the residuals of free motion. Found with five heads of `slitpose bench --within
/// richer`, and judged by others (tests/FIGURES.md).
const SMOOTH: f64 = 4.0;

/// Smooth errors of the intensity and position of each cell, and what they do to the unknowns of an adjustment.
///
/// Coefficients are counted in units of their standard deviation.
#[derive(Debug)]
pub(crate) struct Discrepancy {
    functions: Functions,
    /// Of each cell the standard deviation of a coefficient of its intensity, relative, and of its position, metres.
    sizes: Vec<[f64; 2]>,
    /// By how much the unknowns follow each coefficient: all of the first cell's intensity, then of its position, and so on.
    pub(crate) reaction: DMatrix<f64>,
}

impl Discrepancy {
    /// At the result of an adjustment.
    pub(crate) fn of(
        adjustment: &Adjustment,
        state: &State<'_>,
        normal: &Normal,
        workspace: &Workspace,
    ) -> Option<Self> {
        let size = |of_kind: f64| of_kind * (SMOOTH / FUNCTIONS as f64).sqrt();
        let sizes = state.residual_errors.iter().map(|of_cell| of_cell.map(size)).collect();
        let (count, functions) = (normal.matrix.nrows(), Functions::over(&state.poses, workspace));
        let mut found = Self { functions, sizes, reaction: DMatrix::zeros(count, 2 * normal.cells.len() * FUNCTIONS) };
        for (row, pose) in state.poses.iter().enumerate() {
            let Some(reduced) = adjustment.reduced(state, normal, row) else { continue };
            let Row { readings, frames, .. } = &state.data.rows[row];
            let mut residual = 0;
            for (cell, sensitivity) in normal.cells.iter().enumerate() {
                let weight = normal.weights.readings[row][cell];
                let (Some(reading), Some(pair)) = (readings[cell], sensitivity.pairs[row]) else { continue };
                if weight == 0.0 {
                    continue;
                }
                let w = whitener(state.covariance(cell, reading, *frames));
                let [first, second] = [0, 1].map(|k| reduced.derivatives.column(residual + k) * weight.sqrt());
                for (coefficient, change) in found.changes(cell, state.noise[cell].changes(pair), pose) {
                    let [a, b] = whiten(w, change);
                    let mut right = found.reaction.column_mut(coefficient);
                    right.axpy(a, &first, 1.0);
                    right.axpy(b, &second, 1.0);
                }
                residual += 2;
            }
        }
        found.reaction = normal.matrix.clone().cholesky()?.solve(&found.reaction);
        Some(found)
    }

    /// Derivatives of the currents of a cell at `pose` by its coefficients, each with its place; `by`: by relative intensity
    /// and position.
    pub(crate) fn changes(&self, cell: usize, by: [[f64; 2]; 2], pose: &Pose) -> Vec<(usize, [f64; 2])> {
        let functions = self.functions.at(pose);
        let of_kind = |kind: usize| {
            let (size, first) = (self.sizes[cell][kind], (2 * cell + kind) * FUNCTIONS);
            (first..).zip(functions).map(move |(place, function)| (place, by[kind].map(|of| of * size * function)))
        };
        of_kind(0).chain(of_kind(1)).collect()
    }

    /// Covariance of the unknowns by such errors.
    pub(crate) fn covariance(&self) -> DMatrix<f64> {
        &self.reaction * self.reaction.transpose()
    }
}

#[cfg(test)]
mod tests {
    use slitpose_head::scene_file::WIDE;

    use super::*;
    use crate::adjust::USUAL_ERROR;
    use crate::data::{Constraint, Data, Knowledge};
    use crate::prior;
    use crate::state::sensitivities;

    #[test]
    fn an_adjustment_follows_a_smooth_error_as_predicted() {
        let file = WIDE.read().expect("the scene");
        let parameters = prior::parameters(&file).expect("a prior");
        let count = parameters.entries.len();
        let poses: Vec<Pose> = file.workspace.poses(60).collect();
        let cells = sensitivities(&file.scene, &parameters, &poses, false).expect("currents");
        let row = |(number, pose): (usize, &Pose)| Row {
            readings: cells.iter().map(|cell| cell.pairs[number]).collect(),
            frames: 16.0,
            knowledge: Knowledge::Reported(*pose),
            ..Row::default()
        };
        let mut data = Data::default();
        data.add("", Constraint::Known, [2e-6, 20e-6], poses.iter().enumerate().map(row).collect());
        let mut state = State::new(&file.scene, parameters, &data, poses, vec![USUAL_ERROR; cells.len()]);
        state.residual_errors.fill([USUAL_ERROR.relative, USUAL_ERROR.position_m]);
        let adjust = |state: &mut State<'_>| {
            let prior = DMatrix::identity(count, count);
            let adjustment = Adjustment { prior, learns_sizes: false };
            let normal = adjustment.minimise(state, 5).expect("a head");
            Discrepancy::of(&adjustment, state, &normal, &file.workspace).expect("a minimum")
        };
        let discrepancy = adjust(&mut state);
        // Of intensity and of position: linear and quadratic.
        for wanted in [(1, 2), (1, FUNCTIONS + 7), (4, 12), (4, FUNCTIONS)] {
            let (cell, place) = (wanted.0, 2 * wanted.0 * FUNCTIONS + wanted.1);
            let mut bent = data.clone();
            for (row, pose) in bent.rows.iter_mut().zip(&state.poses) {
                let Some(reading) = &mut row.readings[cell] else { continue };
                let changes = discrepancy.changes(cell, state.noise[cell].changes(*reading), pose);
                let change = changes.into_iter().find(|(of, _)| *of == place).expect("a coefficient").1;
                *reading = [reading[0] + change[0], reading[1] + change[1]];
            }
            let mut found = state.clone();
            found.data = &bent;
            adjust(&mut found);
            let shifts = found.parameters.entries.iter().map(|entry| entry.shift());
            let (mut missed, mut all) = (0.0, 0.0);
            for (shift, predicted) in shifts.zip(discrepancy.reaction.column(place).iter()) {
                missed += (shift - predicted).powi(2);
                all += predicted * predicted;
            }
            // Derivatives are differences over a hundredth of a tolerance, good to 1e-2; the steps end at 0.1 of χ².
            assert!(missed < 0.03_f64.powi(2) * all && all > 1e-4, "{wanted:?}: missed {missed:e} of {all:e}");
        }
    }
}
