//! The adjustment: steps to the most probable parameters, outliers, and what the model leaves out.

use nalgebra::{DMatrix, DVector};
use slitpose_model::{ModelError, SceneError};

use crate::Statistics;
use crate::data::{self, Constraint, Row};
use crate::light;
use crate::normal::{Normal, equations, forward, moved};
use crate::parameter::FAMILIES;
use crate::reading::{directions, whiten, whitener};
use crate::start::solved;
use crate::state::{CellSensitivity, State, Weights, sensitivities_of_rows};

/// Squared normalised residual of a reading (two currents) beyond which it is an outlier: one in 3·10⁶ by chance.
const READING_LIMIT: f64 = 30.0;

/// The same of an instrument's pose (six coordinates): one in 10⁶ by chance.
const POSE_LIMIT: f64 = 40.0;

/// Model error of an uncalibrated cell, from which the adjustment starts.
pub(crate) const FIRST_ERROR: ModelError =
    ModelError { relative: 0.03, position_m: 50e-6, current_a: 0.0, reach: None };

/// The least model error: of the arithmetic.
const MIN_ERROR: ModelError = ModelError { relative: 1e-6, position_m: 1e-9, current_a: 0.0, reach: None };

/// What the model leaves out of a usual head, and how many readings this knowledge is worth.
pub(crate) const USUAL_ERROR: ModelError =
    ModelError { relative: 2e-4, position_m: 0.4e-6, current_a: 0.0, reach: None };
const USUAL_READINGS: f64 = 30.0;

/// Least share of a pose's redundancy in its instrument's errors that rounding leaves to be told.
const MIN_SHARE: f64 = 1e-6;

/// Rows that the redundancy is computed for.
const SAMPLE: usize = 300;

/// Decrease of χ² below which a minimum counts as reached.
const CONVERGED: f64 = 0.1;

pub(crate) struct Adjustment {
    /// Information of the prior, by parameters in units of their prior σ.
    pub(crate) prior: DMatrix<f64>,
    /// Whether the data may tell the size of families of parameters.
    pub(crate) learns_sizes: bool,
}

/// Squared residuals that grow like a logarithm beyond the limit: gross outliers count for next to nothing.
fn bounded(square: f64, limit: f64) -> f64 {
    if square <= limit { square } else { limit * (1.0 + libm::log(square / limit)) }
}

fn weight(square: f64, limit: f64) -> f64 {
    if square <= limit { 1.0 } else { limit / square }
}

/// Sum of squared residuals, bounded beyond the limits.
fn cost(state: &State<'_>, cells: &[CellSensitivity], prior: &DMatrix<f64>) -> f64 {
    let rows: f64 = (0..state.data.rows.len()).map(|row| row_cost(state, cells, row)).sum();
    let shift = shift(state);
    rows + shift.dot(&(prior * &shift)) + light_square(state)
}

fn row_cost(state: &State<'_>, cells: &[CellSensitivity], row: usize) -> f64 {
    let squares = (0..cells.len()).filter_map(|cell| reading_square(state, cells, row, cell));
    let readings: f64 = squares.map(|square| bounded(square, READING_LIMIT)).sum();
    readings + bounded(constraint_square(state, row), POSE_LIMIT)
}

fn shift(state: &State<'_>) -> DVector<f64> {
    let entries = &state.parameters.entries;
    DVector::from_iterator(entries.len(), entries.iter().map(|entry| entry.shift()))
}

fn light_square(state: &State<'_>) -> f64 {
    state.light.iter().map(|term| term.amplitude * term.amplitude).sum()
}

fn reading_square(state: &State<'_>, cells: &[CellSensitivity], row: usize, cell: usize) -> Option<f64> {
    let [a, b] = whitened(state, cells, row, cell)?;
    Some(a * a + b * b)
}

fn whitened(state: &State<'_>, cells: &[CellSensitivity], row: usize, cell: usize) -> Option<[f64; 2]> {
    let Row { readings, frames, .. } = &state.data.rows[row];
    let (reading, pair) = (readings[cell]?, cells[cell].pairs[row]?);
    let w = whitener(state.covariance(cell, reading, *frames));
    Some(whiten(w, [reading[0] - pair[0], reading[1] - pair[1]]))
}

fn constraint_square(state: &State<'_>, row: usize) -> f64 {
    let (number, group) = state.group_of(row);
    let (sigmas, measured) = (state.sigmas(number), &state.data.rows[row]);
    let residuals = data::residuals(group.constraint, sigmas, measured, &state.unknowns[number], &state.poses[row]);
    residuals.iter().map(|value| value * value).sum()
}

impl Adjustment {
    /// The normal equations at `state`, derivatives included.
    fn normal(&self, state: &State<'_>) -> Result<Normal, SceneError> {
        let cells = sensitivities_of_rows(state, true)?;
        let weights = self.weigh(state, &cells);
        Ok(Normal::assemble(state, cells, weights, &self.prior))
    }

    fn weigh(&self, state: &State<'_>, cells: &[CellSensitivity]) -> Weights {
        let mut weights = Weights::equal(state.data);
        for row in 0..state.data.rows.len() {
            for cell in 0..cells.len() {
                let square = reading_square(state, cells, row, cell).unwrap_or(0.0);
                weights.readings[row][cell] = weight(square, READING_LIMIT);
            }
            weights.poses[row] = weight(constraint_square(state, row), POSE_LIMIT);
        }
        weights
    }

    /// At most `steps` steps towards the minimum of χ².
    pub(crate) fn minimise(&self, state: &mut State<'_>, steps: usize) -> Result<Normal, SceneError> {
        let mut damping = 1e-6;
        let mut normal = self.normal(state)?;
        let mut before = cost(state, &normal.cells, &self.prior);
        for _ in 0..steps {
            let mut accepted = None;
            while damping < 1e8 {
                let Some(step) = normal.step(damping) else {
                    damping *= 100.0;
                    continue;
                };
                let mut candidate = state.clone();
                candidate.advance(step.as_slice());
                for (row, pose) in candidate.poses.iter_mut().enumerate() {
                    if let Some(of_pose) = normal.pose_step(row, &step) {
                        *pose = moved(pose, of_pose, state.length_scale_m);
                    }
                }
                // A step far beyond the model compiles to no head.
                if let Ok(found) = sensitivities_of_rows(&candidate, false) {
                    let after = cost(&candidate, &found, &self.prior);
                    if after <= before {
                        accepted = Some((candidate, after));
                        break;
                    }
                }
                damping = (damping * 20.0).max(1e-4);
            }
            let Some((candidate, after)) = accepted else { break };
            *state = candidate;
            damping = (damping * 0.05).max(1e-9);
            let decrease = before - after;
            normal = self.normal(state)?;
            before = after;
            if decrease < CONVERGED {
                break;
            }
        }
        Ok(normal)
    }

    /// Renews the model errors so that residuals are as large as expected; the largest relative change of a variance.
    fn estimate_model_errors(&self, state: &mut State<'_>, normal: &Normal) -> f64 {
        let Some(covariance) = normal.covariance() else { return 0.0 };
        let Normal { cells, weights, .. } = normal;
        let count = cells.len();
        // Of each cell: squares found, squares expected, variance by noise, for intensity and position; readings.
        let mut sums = vec![[[0.0; 3]; 2]; count];
        let mut readings = vec![0.0; count];
        let every = state.data.rows.len().div_ceil(SAMPLE);
        for row in (0..state.data.rows.len()).step_by(every) {
            let Some(reduced) = self.reduced(state, normal, row) else { continue };
            let spread = &covariance * &reduced.derivatives;
            let mut place = 0;
            for cell in 0..count {
                if weights.readings[row][cell] == 0.0 {
                    continue;
                }
                let measured = &state.data.rows[row];
                let Some(found) = whitened(state, cells, row, cell) else { continue };
                let here = place;
                place += 2;
                if weights.readings[row][cell] < 1.0 {
                    continue;
                }
                let Some(reading) = measured.readings[cell] else { continue };
                let hat = |i: usize, j: usize| reduced.hat(&spread, here + i, here + j);
                let w = whitener(state.covariance(cell, reading, measured.frames));
                let noise = state.noise[cell].covariance(reading, measured.frames, &MIN_ERROR);
                readings[cell] += 1.0;
                for (sum, direction) in
                    sums[cell].iter_mut().zip(directions(reading, 0.5 * state.nominal.cells[cell].detector.length_m))
                {
                    // e = c·W⁻¹·(whitened residual).
                    let second = direction[1] / w[2];
                    let d = [(direction[0] - second * w[1]) / w[0], second];
                    let e = d[0] * found[0] + d[1] * found[1];
                    let expected = d[0] * d[0] * (1.0 - hat(0, 0)) + d[1] * d[1] * (1.0 - hat(1, 1))
                        - 2.0 * d[0] * d[1] * hat(0, 1);
                    let [c0, c1] = direction;
                    sum[0] += e * e;
                    sum[1] += expected;
                    sum[2] += c0 * c0 * noise[0] + 2.0 * c0 * c1 * noise[1] + c1 * c1 * noise[2];
                }
            }
        }
        let mut change = 0.0_f64;
        for (cell, error) in state.model_errors.iter_mut().enumerate() {
            if readings[cell] < 3.0 {
                continue;
            }
            let before = [error.relative, error.position_m];
            let least = [MIN_ERROR.relative, MIN_ERROR.position_m];
            let usual = [USUAL_ERROR.relative, USUAL_ERROR.position_m];
            let after: [f64; 2] = std::array::from_fn(|k| {
                let [found, expected, noise] = sums[cell][k];
                let noise = noise / readings[cell];
                let variance = before[k] * before[k] + noise;
                state.residual_errors[cell][k] =
                    (found / expected.max(f64::MIN_POSITIVE) * variance - noise).max(0.0).sqrt();
                let found = found + USUAL_READINGS * (usual[k] * usual[k] + noise);
                let expected = expected.max(0.0) + USUAL_READINGS * variance;
                let ratio = found / expected;
                change = change.max((ratio * variance - variance).abs() / variance);
                (ratio * variance - noise).max(least[k] * least[k]).sqrt()
            });
            *error = ModelError { relative: after[0], position_m: after[1], current_a: 0.0, reach: None };
        }
        change
    }

    /// Renews the size of the families of parameters of which tolerances say little: the mean square that the data give,
    /// what they leave open included (expectation maximisation; Dempster, Laird, Rubin 1977).
    fn estimate_sizes(&mut self, state: &State<'_>, normal: &Normal) {
        let Some(covariance) = normal.covariance() else { return };
        let mut sums = [[1.0, 1.0]; FAMILIES];
        let families = state.parameters.entries.iter().map(|entry| entry.quantity.kind().0.family);
        for (k, family) in families.clone().enumerate() {
            if let Some(family) = family {
                let shift = state.parameters.entries[k].shift();
                sums[family][0] += shift * shift + covariance[(k, k)];
                sums[family][1] += 1.0;
            }
        }
        for (k, family) in families.enumerate() {
            if let Some(family) = family {
                self.prior[(k, k)] = sums[family][1] / sums[family][0];
            }
        }
    }

    /// Renews model errors and sizes, and adjusts with them; the largest relative change of a variance.
    pub(crate) fn round(&mut self, state: &mut State<'_>, normal: &mut Normal) -> Result<f64, SceneError> {
        let scales = self.constraint_scales(state, normal);
        let mut change = self.estimate_model_errors(state, normal);
        for (scale, ratio) in state.scales.as_flattened_mut().iter_mut().zip(scales.as_flattened()) {
            // Nobody is asked to believe that an instrument is better than its maker says.
            let renewed = (*scale * ratio).max(1.0);
            change = change.max((renewed / *scale).powi(2) - 1.0);
            *scale = renewed;
        }
        if self.learns_sizes {
            self.estimate_sizes(state, normal);
        }
        self.release(state, &normal.weights)?;
        *normal = self.minimise(state, 3)?;
        Ok(change)
    }

    /// Lets poses go that most cells contradict: those that the readings alone lead to replace them, if that makes fewer
    /// outliers. Steps alone would hold on to them.
    fn release(&self, state: &mut State<'_>, weights: &Weights) -> Result<(), SceneError> {
        let is_contradicted = |row: &usize| {
            let of_row = &weights.readings[*row];
            2 * of_row.iter().filter(|weight| **weight < 1.0).count() > of_row.len()
        };
        let rows: Vec<usize> = (0..state.data.rows.len()).filter(is_contradicted).collect();
        if rows.is_empty() {
            return Ok(());
        }
        let scene = state.scene();
        let readings: Vec<_> = rows.iter().map(|&row| state.data.rows[row].clone()).collect();
        let mut candidate = state.clone();
        for (&row, pose) in rows.iter().zip(solved(&scene, &readings)?) {
            candidate.poses[row] = pose.unwrap_or(state.poses[row]);
        }
        let [before, after] = [&*state, &candidate].map(|state| sensitivities_of_rows(state, false));
        let (before, after) = (before?, after?);
        for &row in &rows {
            let costs = [(&*state, &before), (&candidate, &after)].map(|(state, cells)| row_cost(state, cells, row));
            if costs[1] < costs[0] {
                state.poses[row] = candidate.poses[row];
            }
        }
        Ok(())
    }

    /// Adds the term of the light that the data demand most, and adjusts with it; `false`: they demand none.
    pub(crate) fn adds_light(&self, state: &mut State<'_>, normal: &mut Normal) -> Result<bool, SceneError> {
        let Some(term) = light::missing(state, normal, &self.prior) else { return Ok(false) };
        state.light.push(term);
        *normal = self.minimise(state, 3)?;
        Ok(true)
    }

    pub(crate) fn statistics(&self, state: &State<'_>, normal: &Normal) -> Statistics {
        let Normal { cells, weights, .. } = normal;
        let mut found = Statistics { rows: state.data.rows.len(), ..Statistics::default() };
        let (mut residuals, mut unknowns) = (0, state.first_light() - state.parameters.entries.len());
        for row in 0..state.data.rows.len() {
            for cell in 0..cells.len() {
                let Some(square) = reading_square(state, cells, row, cell) else { continue };
                if weights.readings[row][cell] < 1.0 {
                    found.readings_rejected += 1;
                } else {
                    (found.readings, residuals, found.chi2) = (found.readings + 1, residuals + 2, found.chi2 + square);
                }
            }
            if weights.poses[row] < 1.0 {
                found.poses_rejected += 1;
            } else {
                found.chi2 += constraint_square(state, row);
                residuals += match state.group_of(row).1.constraint {
                    Constraint::Free => 0,
                    Constraint::Pivot => 3,
                    _ => 6,
                };
            }
            unknowns += 6;
        }
        let shift = shift(state);
        found.chi2 += shift.dot(&(&self.prior * &shift)) + light_square(state);
        found.redundancy = (residuals as f64 - unknowns as f64).max(1.0);
        found
    }

    /// Of each group, the ratio of the errors of lengths and of angles to what they are taken for.
    fn constraint_scales(&self, state: &State<'_>, normal: &Normal) -> Vec<[f64; 2]> {
        let mut sums = vec![[[0.0; 3]; 2]; state.data.groups.len()];
        let Some(covariance) = normal.covariance() else { return vec![[0.0; 2]; sums.len()] };
        let every = state.data.rows.len().div_ceil(SAMPLE);
        for row in (0..state.data.rows.len()).step_by(every) {
            let (number, _) = state.group_of(row);
            if normal.weights.poses[row] < 1.0 || !state.is_known(row) {
                continue;
            }
            let Some(reduced) = self.reduced(state, normal, row) else { continue };
            let spread = &covariance * &reduced.derivatives;
            // The last six are those of the instrument.
            let first = reduced.residuals.len() - 6;
            for k in 0..6 {
                let sum = &mut sums[number][k / 3];
                sum[0] += reduced.residuals[first + k].powi(2);
                sum[1] += 1.0 - reduced.hat(&spread, first + k, first + k);
                sum[2] += 1.0;
            }
        }
        // What is known beforehand counts as so many poses that say as little of the instrument as these do.
        let ratio = |[found, expected, count]: [f64; 3]| {
            let usual = USUAL_READINGS * f64::max(expected / f64::max(count, 1.0), MIN_SHARE);
            ((found + usual) / (expected.max(0.0) + usual)).sqrt()
        };
        sums.into_iter().map(|of_group| of_group.map(ratio)).collect()
    }

    /// Row `row` without what its own pose explains; `None`: nothing tells that pose.
    pub(crate) fn reduced(&self, state: &State<'_>, normal: &Normal, row: usize) -> Option<Reduced> {
        let factor = &normal.rows[row].as_ref()?.factor;
        let equations = equations(state, &normal.cells, &normal.weights, row);
        let mut derivatives = DMatrix::zeros(normal.matrix.nrows(), equations.len());
        let by_pose: Vec<_> = equations.iter().map(|equation| forward(factor, equation.by_pose)).collect();
        for (k, (of_pose, equation)) in by_pose.iter().zip(&equations).enumerate() {
            let mut column = derivatives.column_mut(k);
            for &(place, value) in &equation.by_unknown {
                column[place] = value;
            }
            for (j, &by) in of_pose.iter().enumerate() {
                column.axpy(-by, &normal.coupling.column(6 * row + j), 1.0);
            }
        }
        let residuals = equations.iter().map(|equation| equation.residual).collect();
        Some(Reduced { residuals, derivatives, by_pose })
    }
}

pub(crate) struct Reduced {
    residuals: Vec<f64>,
    /// By the unknowns, of what the row's own pose cannot explain.
    pub(crate) derivatives: DMatrix<f64>,
    /// L⁻¹ of the derivatives by the pose.
    pub(crate) by_pose: Vec<[f64; 6]>,
}

impl Reduced {
    /// How far residual `i` follows an error of residual `j`; `spread`: covariance by derivatives.
    fn hat(&self, spread: &DMatrix<f64>, i: usize, j: usize) -> f64 {
        let by_pose = self.by_pose[i].iter().zip(self.by_pose[j]).map(|(a, b)| a * b).sum::<f64>();
        self.derivatives.column(i).dot(&spread.column(j)) + by_pose
    }
}
