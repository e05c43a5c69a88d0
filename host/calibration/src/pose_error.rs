//! What the errors of the parameters do to poses, and what the tolerance of each kind of part costs in them, before calibration
//! and after it: the linear prediction.

use glam::DVec3;
use nalgebra::{DMatrix, DMatrixView, DVector, SMatrix};
use slitpose_head::scene_file::{SceneFile, Workspace};
use slitpose_model::{ModelError, Pose, SceneError};

use crate::adjust::USUAL_ERROR;
use crate::data::{Constraint, Data, Knowledge, Row};
use crate::discrepancy::Discrepancy;
use crate::head::uncalibrated;
use crate::normal::{Normal, backward, cholesky6, forward};
use crate::reading::{directions, whiten, whitener};
use crate::state::{CellSensitivity, State, Weights, sensitivities};
use crate::{CalibrateError, Quantity, prior};

/// Functions of the pose that its error is made of: 1, the translation, the rotation vector.
pub(crate) const FUNCTIONS: usize = 7;

/// Coefficients of the error of all six coordinates.
pub(crate) const COEFFICIENTS: usize = 6 * FUNCTIONS;

/// The covariance of a pose's error that the parameters cause: one error for all poses of a head, a slowly varying
/// function of the pose.
///
/// The error is Σₖ aₖ·φₖ(pose), aₖ a vector of six coordinates, φ = 1, t/s, θ, with normally distributed coefficients. What
/// varies faster is part of the model errors of the cells: a solver knows better what these do to a pose.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct PoseError {
    /// s, metres.
    pub(crate) length_scale_m: f64,
    /// Covariance of the coefficients, six for φ₀ first; row by row.
    pub(crate) coefficients: Vec<f64>,
}

pub(crate) fn functions(pose: &Pose, length_scale_m: f64) -> [f64; FUNCTIONS] {
    let (t, r) = (pose.translation_m / length_scale_m, pose.rotation_rad());
    [1.0, t.x, t.y, t.z, r.x, r.y, r.z]
}

/// Poses at which the error is computed.
pub(crate) const POSES: usize = 64;

struct Sample {
    functions: [f64; FUNCTIONS],
    /// Inverse of the mean variance of the pose by noise, in units of the length scale.
    weight: f64,
    /// −V⁻¹BᵀA: what the parameters do to the pose, lengths in units of the length scale; then the same of the coefficients
    /// of a discrepancy, what the parameters follow of them included.
    error: DMatrix<f64>,
}

impl PoseError {
    /// What the `covariance` of the parameters, in units of their prior σ, and a `discrepancy` do to poses of a `workspace`
    /// that are solved from single frames; and, as model errors of each cell, what the covariance does besides.
    pub(crate) fn of(
        state: &State<'_>,
        covariance: &DMatrix<f64>,
        discrepancy: Option<&Discrepancy>,
        workspace: &Workspace,
    ) -> Result<(Self, Vec<ModelError>), SceneError> {
        let count = state.parameters.entries.len();
        // With twice as many the model errors are known well enough for the weights of cells to cost no accuracy.
        let poses: Vec<Pose> = workspace.poses(2 * POSES).collect();
        let cells = sensitivities(state.nominal, &state.parameters, &poses, true)?;
        let covariance = covariance.view((0, 0), (count, count));
        let samples: Vec<Option<Sample>> =
            poses.iter().enumerate().map(|(row, pose)| Sample::of(state, &cells, discrepancy, row, pose)).collect();
        let mut gram = SMatrix::<f64, FUNCTIONS, FUNCTIONS>::zeros();
        for Sample { functions, weight, .. } in samples.iter().flatten() {
            for i in 0..FUNCTIONS {
                for j in 0..FUNCTIONS {
                    gram[(i, j)] += weight * functions[i] * functions[j];
                }
            }
        }
        // Least squares: the coefficients as functions of the parameters.
        let considered = discrepancy.map_or(0, |discrepancy| discrepancy.reaction.ncols());
        let mut coefficients = DMatrix::zeros(COEFFICIENTS, count + considered);
        if let Some(inverse) = gram.try_inverse().filter(|_| samples.iter().flatten().count() > 2 * FUNCTIONS) {
            for Sample { functions, weight, error } in samples.iter().flatten() {
                for k in 0..FUNCTIONS {
                    let share: f64 = (0..FUNCTIONS).map(|l| inverse[(k, l)] * functions[l] * weight).sum();
                    let mut rows = coefficients.rows_mut(6 * k, 6);
                    rows += error * share;
                }
            }
        }
        let by_parameters = coefficients.columns(0, count).into_owned();
        let rest = Self::model_errors(state, &cells, &samples, &by_parameters, &covariance);
        let scale = |i: usize| if i % 6 < 3 { state.length_scale_m } else { 1.0 };
        let by_discrepancy = coefficients.columns(count, considered);
        let spread =
            &by_parameters * covariance * by_parameters.transpose() + by_discrepancy * by_discrepancy.transpose();
        let places = (0..COEFFICIENTS).flat_map(|i| (0..COEFFICIENTS).map(move |j| (i, j)));
        let found = places.map(|(i, j)| spread[(i, j)] * scale(i) * scale(j)).collect();
        Ok((Self { length_scale_m: state.length_scale_m, coefficients: found }, rest))
    }

    /// Standard deviations of the intensity and position of each cell that no smooth error of the pose explains.
    fn model_errors(
        state: &State<'_>,
        cells: &[CellSensitivity],
        samples: &[Option<Sample>],
        coefficients: &DMatrix<f64>,
        covariance: &DMatrixView<'_, f64>,
    ) -> Vec<ModelError> {
        let count = coefficients.ncols();
        let of_cell = |(number, cell): (usize, &CellSensitivity)| {
            let half_length_m = 0.5 * state.nominal.cells[number].detector.length_m;
            let (mut sums, mut weights) = ([0.0; 2], 0.0);
            for (row, sample) in samples.iter().enumerate() {
                let (Some(Sample { functions, weight, .. }), Some(pair)) = (sample, cell.pairs[row]) else { continue };
                let mut smooth = DMatrix::<f64>::zeros(6, count);
                for (k, function) in functions.iter().enumerate() {
                    smooth += coefficients.rows(6 * k, 6) * *function;
                }
                weights += weight;
                for (sum, direction) in sums.iter_mut().zip(directions(pair, half_length_m)) {
                    let of = |pair: [f64; 2]| direction[0] * pair[0] + direction[1] * pair[1];
                    let mut derivative = DVector::<f64>::zeros(count);
                    let width = cell.acting.len();
                    for (&place, by) in cell.acting.iter().zip(&cell.by_parameter[row * width..]) {
                        derivative[place] = of(*by);
                    }
                    let jacobian = cell.by_pose[row];
                    for axis in 0..6 {
                        let scale = if axis < 3 { state.length_scale_m } else { 1.0 };
                        let by = scale * of([jacobian[0][axis], jacobian[1][axis]]);
                        derivative.axpy(by, &smooth.row(axis).transpose(), 1.0);
                    }
                    *sum += weight * derivative.dot(&(covariance * &derivative));
                }
            }
            let [relative, position_m] = sums.map(|sum| if weights > 0.0 { (sum / weights).sqrt() } else { 0.0 });
            ModelError { relative, position_m, ..ModelError::default() }
        };
        cells.iter().enumerate().map(of_cell).collect()
    }

    /// The covariance at `pose`, m², m·rad, rad².
    pub(crate) fn covariance(&self, pose: &Pose) -> [[f64; 6]; 6] {
        let functions = functions(pose, self.length_scale_m);
        // The coefficients are symmetric: half of the blocks are the transposes of others.
        let mut half = [[0.0; 6]; 6];
        for (k, &of_row) in functions.iter().enumerate() {
            for (l, &of_column) in functions.iter().enumerate().take(k + 1) {
                let product = if l < k { of_row * of_column } else { 0.5 * of_row * of_column };
                for i in 0..6 {
                    let row = &self.coefficients[(6 * k + i) * COEFFICIENTS + 6 * l..][..6];
                    for j in 0..6 {
                        half[i][j] += product * row[j];
                    }
                }
            }
        }
        std::array::from_fn(|i| std::array::from_fn(|j| half[i][j] + half[j][i]))
    }

    /// Errors over a `workspace` apart from where base and tool frame lie, root mean square of three axes together: metres
    /// and radians. What both frames shifted and turned explain is left out by least squares, to first order in the rotation.
    pub(crate) fn apart_from_frames(&self, workspace: &Workspace) -> [f64; 2] {
        let scale_m = self.length_scale_m;
        let poses: Vec<Pose> = workspace.poses(POSES).collect();
        let mut errors = DMatrix::<f64>::zeros(6 * poses.len(), COEFFICIENTS);
        for (row, pose) in poses.iter().enumerate() {
            for (k, function) in functions(pose, scale_m).into_iter().enumerate() {
                for axis in 0..6 {
                    // Rotations as lengths, so that both can be fitted together.
                    errors[(6 * row + axis, 6 * k + axis)] = if axis < 3 { function } else { function * scale_m };
                }
            }
        }
        // Base shifted by a or turned by w: a + w×t, and w; tool frame: R·a, and R·w, with R ≈ 1 + [θ]×.
        let mut frames = DMatrix::<f64>::zeros(COEFFICIENTS, 12);
        for i in 0..3 {
            (frames[(i, i)], frames[(3 + i, 3 + i)]) = (1.0, 1.0);
            (frames[(i, 6 + i)], frames[(3 + i, 9 + i)]) = (1.0, 1.0);
            for j in 0..3 {
                let across = DVec3::AXES[i].cross(DVec3::AXES[j]);
                for axis in 0..3 {
                    frames[(6 * (1 + j) + axis, 3 + i)] = scale_m * across[axis];
                    frames[(6 * (4 + j) + axis, 6 + i)] = -across[axis];
                    frames[(6 * (4 + j) + 3 + axis, 9 + i)] = -across[axis];
                }
            }
        }
        let fitted = (&errors * frames).qr().q();
        let left = &errors - &fitted * (fitted.transpose() * &errors);
        let spread = &left * DMatrix::from_row_slice(COEFFICIENTS, COEFFICIENTS, &self.coefficients);
        let mut squares = [0.0; 2];
        for row in 0..left.nrows() {
            squares[row % 6 / 3] += spread.row(row).dot(&left.row(row)) / poses.len() as f64;
        }
        [squares[0].max(0.0).sqrt(), squares[1].max(0.0).sqrt() / scale_m]
    }
}

/// Errors of `poses`, root mean square, for each of `covariances` of the parameters in units of their prior σ: metres and
/// radians, three axes together. `cells` are the sensitivities there.
pub(crate) fn spread(
    state: &State<'_>,
    cells: &[CellSensitivity],
    poses: &[Pose],
    covariances: &[DMatrix<f64>],
) -> Vec<[f64; 2]> {
    let samples: Vec<Sample> =
        poses.iter().enumerate().filter_map(|(row, pose)| Sample::of(state, cells, None, row, pose)).collect();
    let of = |covariance: &DMatrix<f64>| {
        let mut squares = [0.0; 2];
        for Sample { error, .. } in &samples {
            let reached = error * covariance;
            for axis in 0..6 {
                let square = reached.row(axis).dot(&error.row(axis)) / samples.len() as f64;
                squares[axis / 3] += square * if axis < 3 { state.length_scale_m.powi(2) } else { 1.0 };
            }
        }
        squares.map(f64::sqrt)
    };
    covariances.iter().map(of).collect()
}

impl Sample {
    /// `None`: too few cells see light there.
    fn of(
        state: &State<'_>,
        cells: &[CellSensitivity],
        discrepancy: Option<&Discrepancy>,
        row: usize,
        pose: &Pose,
    ) -> Option<Self> {
        let scale = |axis: usize| if axis < 3 { state.length_scale_m } else { 1.0 };
        let count = state.parameters.entries.len();
        let considered = discrepancy.map_or(0, |discrepancy| discrepancy.reaction.ncols());
        let (mut v, mut error) = ([[0.0; 6]; 6], DMatrix::<f64>::zeros(6, count + considered));
        for (number, cell) in cells.iter().enumerate() {
            let Some(pair) = cell.pairs[row] else { continue };
            let w = whitener(state.covariance(number, pair, 1.0));
            let jacobian = cell.by_pose[row];
            let by_pose: [[f64; 2]; 6] = std::array::from_fn(|axis| {
                whiten(w, [jacobian[0][axis], jacobian[1][axis]].map(|value| value * scale(axis)))
            });
            for i in 0..6 {
                for j in 0..6 {
                    v[i][j] += by_pose[i][0] * by_pose[j][0] + by_pose[i][1] * by_pose[j][1];
                }
            }
            let width = cell.acting.len();
            for (&place, derivative) in cell.acting.iter().zip(&cell.by_parameter[row * width..]) {
                let of = whiten(w, *derivative);
                for (i, by) in by_pose.iter().enumerate() {
                    error[(i, place)] -= by[0] * of[0] + by[1] * of[1];
                }
            }
            let changes = |of: &Discrepancy| of.changes(number, state.noise[number].changes(pair), pose);
            for (place, change) in discrepancy.map(changes).into_iter().flatten() {
                let of = whiten(w, change);
                for (i, by) in by_pose.iter().enumerate() {
                    error[(i, count + place)] += by[0] * of[0] + by[1] * of[1];
                }
            }
        }
        let factor = cholesky6(&v)?;
        let solve = |right| backward(&factor, forward(&factor, right));
        for mut column in error.column_iter_mut() {
            let solved = solve(std::array::from_fn(|i| column[i]));
            column.copy_from_slice(&solved);
        }
        if let Some(discrepancy) = discrepancy {
            let (of_parameters, mut of_considered) = error.columns_range_pair_mut(0..count, count..);
            of_considered.gemm(1.0, &of_parameters, &discrepancy.reaction.rows(0, count), 1.0);
        }
        let variance: f64 = (0..6).map(|k| solve(std::array::from_fn(|i| f64::from(u8::from(i == k))))[k]).sum();
        Some(Self { functions: functions(pose, state.length_scale_m), weight: variance.recip(), error })
    }
}

/// The known poses of a calibration.
#[derive(Clone, Copy, Debug)]
pub struct KnownPoses {
    /// How many, spread over the workspace.
    pub count: usize,
    /// Standard deviations of the instrument: metres, radians.
    pub instrument: [f64; 2],
    /// Frames averaged at each.
    pub frames: f64,
}

/// Errors of poses, root mean square over the workspace: metres, radians.
pub type PoseRms = [f64; 2];

/// What one kind of part costs.
#[derive(Clone, Debug, PartialEq)]
pub struct PartCost {
    /// What deviates, in words.
    pub part: &'static str,
    /// Its key in `[tolerance]`.
    pub key: &'static str,
    /// Its share of the errors of poses by the uncalibrated head.
    pub before: PoseRms,
    /// By how much the calibrated head would err less if the part were known: the root of the difference of squares.
    pub after: PoseRms,
}

/// What tolerances cost.
#[derive(Clone, Debug, PartialEq)]
pub struct PartCosts {
    /// The kinds of parts, the dearest before calibration first.
    pub parts: Vec<PartCost>,
    /// All together, before calibration.
    pub before: PoseRms,
    /// And after it.
    pub after: PoseRms,
}

/// What the tolerances of `file` cost, whose `noise` of a single frame is that of its scene; calibrated at `known` poses.
///
/// To first order around the scene.
pub fn part_costs(file: &SceneFile, known: KnownPoses) -> Result<PartCosts, CalibrateError> {
    let nominal = &file.scene;
    let parameters = prior::parameters(file)?;
    if parameters.entries.is_empty() {
        return Err(CalibrateError::NothingOpen);
    }
    let count = parameters.entries.len();
    let rough = uncalibrated(file)?;
    let errors = rough.cells.iter().map(|cell| cell.effects.model_error).collect();
    let no_data = Data::default();
    let before = State::new(nominal, parameters.clone(), &no_data, Vec::new(), errors);
    let diagonal = |counts: &dyn Fn(Quantity) -> bool| {
        let value = |k: usize| if counts(parameters.entries[k].quantity) { 1.0 } else { 0.0 };
        DMatrix::from_diagonal(&DVector::from_iterator(count, (0..count).map(value)))
    };

    let mut data = Data::default();
    let at: Vec<Pose> = file.workspace.poses(known.count).collect();
    let cells = sensitivities(nominal, &parameters, &at, true)?;
    let row = |(number, pose)| Row {
        readings: cells.iter().map(|cell| cell.pairs[number]).collect(),
        frames: known.frames,
        knowledge: Knowledge::Reported(pose),
        ..Row::default()
    };
    data.add("", Constraint::Known, known.instrument, at.iter().copied().enumerate().map(row).collect());
    let errors = vec![USUAL_ERROR; nominal.cells.len()];
    let after = State::new(nominal, parameters.clone(), &data, at, errors);
    let information = DMatrix::identity(count, count);
    let normal = Normal::assemble(&after, cells, Weights::equal(&data), &information);
    // Covariance of all others if those of one kind are known.
    let without = |known: &dyn Fn(Quantity) -> bool| -> Result<DMatrix<f64>, CalibrateError> {
        let mut matrix = normal.matrix.clone();
        for k in (0..count).filter(|&k| known(parameters.entries[k].quantity)) {
            matrix.row_mut(k).fill(0.0);
            matrix.column_mut(k).fill(0.0);
            matrix[(k, k)] = f64::MAX.sqrt();
        }
        Ok(matrix.cholesky().ok_or(CalibrateError::Singular)?.inverse())
    };

    let mut kinds: Vec<(&str, &str)> = Vec::new();
    for entry in &parameters.entries {
        if !kinds.contains(&entry.quantity.kind().0.part) {
            kinds.push(entry.quantity.kind().0.part);
        }
    }
    let mut spreads = [vec![diagonal(&|_| true)], vec![without(&|_| false)?]];
    for kind in &kinds {
        spreads[0].push(diagonal(&|quantity| quantity.kind().0.part == *kind));
        spreads[1].push(without(&|quantity| quantity.kind().0.part == *kind)?);
    }
    let poses: Vec<Pose> = file.workspace.poses(POSES).collect();
    let cells = sensitivities(nominal, &parameters, &poses, true)?;
    let [of_before, of_after] =
        [(&before, &spreads[0]), (&after, &spreads[1])].map(|(state, spreads)| spread(state, &cells, &poses, spreads));
    let difference =
        |all: PoseRms, rest: PoseRms| [0, 1].map(|k| (all[k] * all[k] - rest[k] * rest[k]).max(0.0).sqrt());
    let mut parts: Vec<PartCost> = kinds
        .into_iter()
        .zip(of_before[1..].iter().zip(&of_after[1..]))
        .map(|((part, key), (before, rest))| PartCost {
            part,
            key,
            before: *before,
            after: difference(of_after[0], *rest),
        })
        .collect();
    parts.sort_by(|a, b| b.before[0].total_cmp(&a.before[0]));
    Ok(PartCosts { parts, before: of_before[0], after: of_after[0] })
}

#[cfg(test)]
mod tests {
    use glam::DVec3;
    use slitpose_head::scene_file::{Tolerance, WIDE};

    use super::*;
    use crate::{Quantity, prior};

    /// All emitters off by the same way on the tool: every pose errs by that way, turned with the tool.
    #[test]
    fn a_tool_whose_emitters_are_all_off_by_the_same_is_elsewhere() {
        let file = WIDE.read().expect("the scene");
        let parameters = prior::parameters(&file).expect("a prior");
        let is_moved = |place: usize| parameters.entries[place].quantity == Quantity::EmitterShift(0);
        let count = parameters.entries.len();
        let covariance = DMatrix::from_fn(count, count, |i, j| f64::from(u8::from(is_moved(i) && is_moved(j))));
        let sigma_m = file.tolerance.unwrap_or_default().position_m;
        let errors = vec![ModelError::default(); file.scene.cells.len()];
        let data = Data::default();
        let state = State::new(&file.scene, parameters.clone(), &data, Vec::new(), errors);
        let (found, rest) = PoseError::of(&state, &covariance, None, &file.workspace).expect("poses");
        for turn in [DVec3::ZERO, DVec3::new(0.0, 0.0, 0.2)] {
            let pose = Pose::from_vectors(DVec3::new(1e-3, -2e-3, 1e-3), turn);
            let way = pose.rotation * DVec3::X * sigma_m;
            let covariance = found.covariance(&pose);
            for i in 0..3 {
                for j in 0..3 {
                    // The error is linear in the rotation vector: 0.2²/2 of it is left, twice in a square.
                    let missed = (covariance[i][j] - way[i] * way[j]).abs();
                    assert!(missed < 0.05 * sigma_m * sigma_m, "{i} {j}: {covariance:?}");
                }
            }
        }
        // The poses explain it: what is left for single cells is of second order.
        for error in rest {
            assert!(error.position_m < 0.05 * sigma_m && error.relative < 1e-3, "{error:?}");
        }
    }

    #[test]
    fn where_frames_lie_is_no_error_of_poses() {
        let workspace = WIDE.read().expect("the scene").workspace;
        let length_scale_m = 1e-2;
        let of = |error: &[(usize, f64)]| {
            let mut coefficients = vec![0.0; COEFFICIENTS * COEFFICIENTS];
            for &(i, a) in error {
                error.iter().for_each(|&(j, b)| coefficients[COEFFICIENTS * i + j] = a * b);
            }
            PoseError { length_scale_m, coefficients }.apart_from_frames(&workspace)
        };
        // A base shifted along x; one turned about z, by which (x, y) errs by (−y, x).
        for frame in [&[(0, 1e-3)][..], &[(5, 1e-3), (6 * 2, -1e-3 * length_scale_m), (6 + 1, 1e-3 * length_scale_m)]] {
            let [metres, radians] = of(frame);
            assert!(metres < 1e-9 && radians < 1e-7, "{frame:?}: {metres} {radians}");
        }
        // A scale error along x has a mean of nothing, so no shift hides it: rms of x over the poses.
        let xs: Vec<f64> = workspace.poses(POSES).map(|pose| pose.translation_m.x).collect();
        let mean = xs.iter().sum::<f64>() / xs.len() as f64;
        let rms = (xs.iter().map(|x| (x - mean).powi(2)).sum::<f64>() / xs.len() as f64).sqrt();
        let [metres, radians] = of(&[(6, 1e-3 * length_scale_m)]);
        // Frames that turn explain some of what 64 poses happen to have in common.
        assert!((metres / (1e-3 * rms) - 1.0).abs() < 0.05, "{metres} {rms}");
        println!("{metres} of {}, {radians}", 1e-3 * rms);
    }

    const KNOWN: KnownPoses = KnownPoses { count: 60, instrument: [2e-6, 20e-6], frames: 16.0 };

    #[test]
    fn a_tolerance_costs_in_proportion_and_nothing_if_it_is_zero() {
        let file = WIDE.read().expect("a scene");
        let with = |tolerance: Tolerance| {
            part_costs(&SceneFile { tolerance: Some(tolerance), ..file.clone() }, KNOWN).expect("costs")
        };
        let costs = with(Tolerance::default());
        // Parts are independent: squares add up.
        for axis in 0..2 {
            let sum: f64 = costs.parts.iter().map(|part| part.before[axis].powi(2)).sum();
            assert!((sum / costs.before[axis].powi(2) - 1.0).abs() < 1e-9);
        }
        // Calibration is worth its while, for each kind of part.
        assert!(costs.after[0] < 0.02 * costs.before[0], "{costs:?}");
        assert!(costs.parts.iter().all(|part| part.after[0] < costs.after[0]), "{costs:?}");
        let stiff = with(Tolerance { angle_rad: 0.0, ..Tolerance::default() });
        assert!(costs.parts.iter().any(|part| part.key == "angle_deg"));
        assert!(stiff.parts.iter().all(|part| part.key != "angle_deg"));
        assert!(stiff.before[0] < costs.before[0] && stiff.after[0] < costs.after[0]);
        let known = Tolerance {
            position_m: 0.0,
            angle_rad: 0.0,
            slit_width_m: 0.0,
            emitter_angle_rad: 0.0,
            emitter_gain_relative: 0.0,
            electrode_gain_relative: 0.0,
            profile_relative: 0.0,
            nonlinearity_m: 0.0,
            window_m: 0.0,
            stray_relative: 0.0,
        };
        let all_known = SceneFile { tolerance: Some(known), ..file.clone() };
        assert!(matches!(part_costs(&all_known, KNOWN), Err(CalibrateError::NothingOpen)));
    }
}
