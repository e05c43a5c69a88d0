//! Normal equations of a bundle adjustment, the poses eliminated.
//!
//! Unknowns x: the parameters in units of their prior σ, then the unknowns of the groups in units of their scale. Each
//! row has a pose of its own, which only its own residuals see. With A, B the whitened derivatives by x and by the pose,
//! V = BᵀB = LLᵀ and M = AᵀB·L⁻ᵀ, what is left for x is (AᵀA − MMᵀ)·δx = Aᵀr − M·L⁻¹Bᵀr (Schur complement; Brown 1958).

use nalgebra::{DMatrix, DVector};
use slitpose_model::Pose;

use crate::data::{self, RESIDUALS, VAGUE};
use crate::reading::{whiten, whitener};
use crate::state::{CellSensitivity, State, Weights};

/// Rows whose contributions are multiplied at once: bounds memory.
const CHUNK: usize = 256;

/// One row's own part, kept to get its pose back.
pub(crate) struct RowFactor {
    /// L, lower triangle.
    pub(crate) factor: [[f64; 6]; 6],
    /// L⁻¹Bᵀr.
    pub(crate) right: [f64; 6],
}

pub(crate) struct Normal {
    pub(crate) matrix: DMatrix<f64>,
    pub(crate) right: DVector<f64>,
    /// `None`: the readings do not fix the row's pose.
    pub(crate) rows: Vec<Option<RowFactor>>,
    /// M of all rows side by side: six columns a row.
    pub(crate) coupling: DMatrix<f64>,
    pub(crate) cells: Vec<CellSensitivity>,
    pub(crate) weights: Weights,
}

/// A whitened residual of a row and its derivatives, as they enter the sums.
pub(crate) struct Equation {
    pub(crate) residual: f64,
    pub(crate) by_pose: [f64; 6],
    /// Places among the unknowns, and the derivatives by them.
    pub(crate) by_unknown: Vec<(usize, f64)>,
}

pub(crate) fn equations(
    state: &State<'_>,
    sensitivities: &[CellSensitivity],
    weights: &Weights,
    row: usize,
) -> Vec<Equation> {
    let mut equations = Vec::new();
    let measured = &state.data.rows[row];
    let scale_m = state.length_scale_m;
    let scale = [scale_m, scale_m, scale_m, 1.0, 1.0, 1.0];
    for (cell, sensitivity) in sensitivities.iter().enumerate() {
        let weight = weights.readings[row][cell];
        let (Some(reading), Some(pair)) = (measured.readings[cell], sensitivity.pairs[row]) else { continue };
        if weight == 0.0 {
            continue;
        }
        let root = weight.sqrt();
        let w = whitener(state.covariance(cell, reading, measured.frames)).map(|value| value * root);
        let residual = whiten(w, [reading[0] - pair[0], reading[1] - pair[1]]);
        let jacobian = sensitivity.by_pose[row];
        let count = sensitivity.acting.len();
        let derivatives = &sensitivity.by_parameter[row * count..][..count];
        let mut unknown = [(); 2].map(|()| Vec::with_capacity(count + state.light.len()));
        for (&place, derivative) in sensitivity.acting.iter().zip(derivatives) {
            let [a, b] = whiten(w, *derivative);
            unknown[0].push((place, a));
            unknown[1].push((place, b));
        }
        for (k, term) in state.light.iter().enumerate() {
            let Some(slope) = term.slope(state.data, row) else { continue };
            let [a, b] = whiten(w, pair.map(|current_a| current_a * slope));
            unknown[0].push((state.first_light() + k, a));
            unknown[1].push((state.first_light() + k, b));
        }
        let mut by_pose = [[0.0; 6]; 2];
        for axis in 0..6 {
            let [a, b] = whiten(w, [jacobian[0][axis] * scale[axis], jacobian[1][axis] * scale[axis]]);
            (by_pose[0][axis], by_pose[1][axis]) = (a, b);
        }
        for ((residual, by_pose), by_unknown) in residual.into_iter().zip(by_pose).zip(unknown) {
            equations.push(Equation { residual, by_pose, by_unknown });
        }
    }
    let (number, group) = state.group_of(row);
    let unknowns = &state.unknowns[number];
    let root = weights.poses[row].sqrt();
    let sigmas = state.sigmas(number);
    let residuals = data::residuals(group.constraint, sigmas, measured, unknowns, &state.poses[row]);
    if !unknowns.is_empty() || state.is_known(row) {
        let (of_pose, of_unknowns) = data::derivatives(group.constraint, sigmas, measured, unknowns, &state.poses[row]);
        for k in 0..RESIDUALS {
            let by_pose: [f64; 6] = std::array::from_fn(|axis| of_pose[k][axis] * scale[axis] * root);
            let places = of_unknowns.iter().enumerate();
            let by_unknown: Vec<_> = places
                .map(|(u, of)| (state.first_unknown(number) + u, of[k] * root * data::scale(group.constraint, u)))
                .filter(|(_, value)| *value != 0.0)
                .collect();
            if by_pose != [0.0; 6] || !by_unknown.is_empty() {
                // r = measured − model; a constraint is met at zero.
                equations.push(Equation { residual: -residuals[k] * root, by_pose, by_unknown });
            }
        }
    }
    equations
}

/// L of a positive definite matrix.
pub(crate) fn cholesky6(matrix: &[[f64; 6]; 6]) -> Option<[[f64; 6]; 6]> {
    let mut l = [[0.0; 6]; 6];
    for i in 0..6 {
        for j in 0..=i {
            let sum: f64 = matrix[i][j] - (0..j).map(|k| l[i][k] * l[j][k]).sum::<f64>();
            if i == j {
                if sum <= 1e-14 * matrix[i][i] || !sum.is_finite() {
                    return None;
                }
                l[i][i] = sum.sqrt();
            } else {
                l[i][j] = sum / l[j][j];
            }
        }
    }
    Some(l)
}

/// L⁻¹·b.
pub(crate) fn forward(l: &[[f64; 6]; 6], b: [f64; 6]) -> [f64; 6] {
    let mut x = b;
    for i in 0..6 {
        for j in 0..i {
            x[i] -= l[i][j] * x[j];
        }
        x[i] /= l[i][i];
    }
    x
}

/// L⁻ᵀ·b.
pub(crate) fn backward(l: &[[f64; 6]; 6], b: [f64; 6]) -> [f64; 6] {
    let mut x = b;
    for i in (0..6).rev() {
        for j in i + 1..6 {
            x[i] -= l[j][i] * x[j];
        }
        x[i] /= l[i][i];
    }
    x
}

impl Normal {
    /// The sums over all rows, and the prior.
    pub(crate) fn assemble(
        state: &State<'_>,
        cells: Vec<CellSensitivity>,
        weights: Weights,
        prior: &DMatrix<f64>,
    ) -> Self {
        let (count, count_of_rows) = (state.unknown_count(), state.data.rows.len());
        let parameters = state.parameters.entries.len();
        let mut matrix = DMatrix::zeros(count, count);
        let mut right = DVector::zeros(count);
        let mut coupling = DMatrix::zeros(count, 6 * count_of_rows);
        let mut rows = Vec::with_capacity(count_of_rows);
        let mut own = DMatrix::<f64>::zeros(count, 0);
        let mut filled = 0;
        for row in 0..count_of_rows {
            let equations = equations(state, &cells, &weights, row);
            let mut v = [[0.0; 6]; 6];
            let mut b = [0.0; 6];
            for Equation { residual, by_pose, .. } in &equations {
                for i in 0..6 {
                    b[i] += by_pose[i] * residual;
                    for j in 0..6 {
                        v[i][j] += by_pose[i] * by_pose[j];
                    }
                }
            }
            let Some(factor) = cholesky6(&v) else {
                rows.push(None);
                continue;
            };
            let columns = equations.len();
            if own.ncols() < filled + columns {
                own = own.resize_horizontally(filled + columns.max(24 * CHUNK), 0.0);
            }
            for (k, Equation { residual, by_pose, by_unknown }) in equations.iter().enumerate() {
                for &(place, value) in by_unknown {
                    own[(place, filled + k)] = value;
                    right[place] += value * residual;
                    for j in 0..6 {
                        coupling[(place, 6 * row + j)] += value * by_pose[j];
                    }
                }
            }
            filled += columns;
            for j in 0..6 {
                for l in 0..j {
                    let (before, mut column) = coupling.columns_range_pair_mut(6 * row + l, 6 * row + j);
                    column.axpy(-factor[j][l], &before, 1.0);
                }
                coupling.column_mut(6 * row + j).scale_mut(factor[j][j].recip());
            }
            let reduced = forward(&factor, b);
            for j in 0..6 {
                right.axpy(-reduced[j], &coupling.column(6 * row + j), 1.0);
            }
            rows.push(Some(RowFactor { factor, right: reduced }));
            if filled > 20 * CHUNK || row + 1 == count_of_rows {
                let part = own.columns(0, filled);
                matrix.gemm(1.0, &part, &part.transpose(), 1.0);
                own.fill(0.0);
                filled = 0;
            }
        }
        if filled > 0 {
            let part = own.columns(0, filled);
            matrix.gemm(1.0, &part, &part.transpose(), 1.0);
        }
        for first in (0..coupling.ncols()).step_by(6 * CHUNK) {
            let part = coupling.columns(first, (6 * CHUNK).min(coupling.ncols() - first));
            matrix.gemm(-1.0, &part, &part.transpose(), 1.0);
        }
        let shift = DVector::from_iterator(parameters, state.parameters.entries.iter().map(|entry| -entry.shift()));
        let pull = prior * &shift;
        for i in 0..parameters {
            right[i] += pull[i];
            for j in 0..parameters {
                matrix[(i, j)] += prior[(i, j)];
            }
        }
        for k in parameters..state.first_light() {
            matrix[(k, k)] += VAGUE.powi(-2);
        }
        for (k, term) in (state.first_light()..).zip(&state.light) {
            matrix[(k, k)] += 1.0;
            right[k] -= term.amplitude;
        }
        Self { matrix, right, rows, coupling, cells, weights }
    }

    /// The step of the unknowns, damped by `damping` times the diagonal.
    pub(crate) fn step(&self, damping: f64) -> Option<DVector<f64>> {
        let mut matrix = self.matrix.clone();
        for k in 0..matrix.nrows() {
            matrix[(k, k)] *= 1.0 + damping;
        }
        Some(matrix.cholesky()?.solve(&self.right))
    }

    /// The step of the pose of row `row` that goes with `step`: V⁻¹(Bᵀr − BᵀA·δx), with lengths in units of the length
    /// scale.
    pub(crate) fn pose_step(&self, row: usize, step: &DVector<f64>) -> Option<[f64; 6]> {
        let RowFactor { factor, right } = self.rows[row].as_ref()?;
        let moved = std::array::from_fn(|j| right[j] - self.coupling.column(6 * row + j).dot(step));
        Some(backward(factor, moved))
    }

    pub(crate) fn covariance(&self) -> Option<DMatrix<f64>> {
        Some(self.matrix.clone().cholesky()?.inverse())
    }
}

/// The pose after a step with lengths in units of the length scale.
pub(crate) fn moved(pose: &Pose, step: [f64; 6], scale_m: f64) -> Pose {
    let [x, y, z, rx, ry, rz] = step;
    pose.perturbed(glam::DVec3::new(x, y, z) * scale_m, glam::DVec3::new(rx, ry, rz))
}
