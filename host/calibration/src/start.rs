//! Where the adjustment starts: poses by the uncalibrated head, what follows from them for constraints, and where the frames of an
//! instrument lie: X·M = P·Y, with P the poses of the tool in the base, M those of the marker in the reference frame,
//! X = base_from_reference, Y = tool_from_marker (robot-world and hand-eye calibration).

use glam::{DMat3, DQuat, DVec3};
use nalgebra::{Matrix4, Matrix6, SymmetricEigen, Vector4, Vector6};
use slitpose_model::{MIN_CELLS, MotionPrior, Pose, Scene, SceneError, Solver, Start};

use crate::data::{Constraint, Data, Group, Knowledge, Row, compose, inverse, values_of};
use crate::reading::TIER;
use crate::{CalibrateError, Calibration};

/// Share of a group's rows that must lead to a pose for the others to follow from home.
const MIN_WITH_POSE: f64 = 0.25;

/// The pose of each row by `scene` alone.
pub(crate) fn solved(scene: &Scene, rows: &[Row]) -> Result<Vec<Option<Pose>>, SceneError> {
    let solver = Solver::<f64>::new(scene, TIER)?;
    let solve = |row: &Row| Some(solver.solve(&row.photocurrents(), Start::Cold, &MotionPrior::AT_REST).estimate?.pose);
    Ok(rows.iter().map(solve).collect())
}

/// The poses of `rows`, which are of the file `name`, by `scene`: the head as `start` has it, or by its tolerances.
fn first_poses(
    scene: &Scene,
    start: Option<&Calibration>,
    name: &str,
    rows: &[Row],
) -> Result<Vec<Option<Pose>>, CalibrateError> {
    let poses = solved(scene, rows)?;
    let found = poses.iter().flatten().count();
    if (found as f64) >= MIN_WITH_POSE * rows.len() as f64 {
        return Ok(poses);
    }
    let (basis, next_step) = match start {
        Some(_) => {
            ("the calibration to start with", "check that it is of this head, and that the currents are in amperes")
        }
        None if scene.cells.len() < MIN_CELLS => (
            "the scene, which has fewer than three cells",
            "such a head can only be calibrated by poses in the frames of the scene (--known)",
        ),
        None => (
            "the scene and its tolerances",
            "calibrate by poses in the frames of the scene first (--known), or begin with an earlier calibration (--start); \
             if neither helps, check the scene, and that the currents are in amperes",
        ),
    };
    Err(CalibrateError::NoPoses(name.to_owned(), found, rows.len(), basis, next_step))
}

/// Poses of all rows and unknowns of all groups, from the data and `scene`: the head as `start` has it, or by its tolerances.
/// Rows without a pose stay at home.
pub(crate) fn beginning(
    scene: &Scene,
    start: Option<&Calibration>,
    data: &Data,
) -> Result<(Vec<Pose>, Vec<Vec<f64>>), CalibrateError> {
    let (mut poses, mut unknowns) = (Vec::with_capacity(data.rows.len()), Vec::new());
    for group in &data.groups {
        let rows = &data.rows[group.rows.clone()];
        let found = match group.constraint {
            Constraint::Known => rows.iter().map(Row::reported).collect(),
            _ => first_poses(scene, start, &group.file, rows)?,
        };
        let mut places: Vec<Pose> = found.iter().map(|pose| pose.unwrap_or(Pose::HOME)).collect();
        unknowns.push(of_group(group, rows, &found, &mut places)?);
        poses.extend(places);
    }
    Ok((poses, unknowns))
}

fn of_group(
    group: &Group,
    rows: &[Row],
    found: &[Option<Pose>],
    places: &mut [Pose],
) -> Result<Vec<f64>, CalibrateError> {
    if group.constraint == Constraint::Known {
        return Ok(Vec::new());
    }
    let weak = || CalibrateError::LittleMotion(group.file.clone());
    let solved: Vec<Pose> = found.iter().flatten().copied().collect();
    let first = *solved.first().ok_or_else(weak)?;
    Ok(match group.constraint {
        Constraint::Known | Constraint::Free => Vec::new(),
        Constraint::KnownInOwnFrames => {
            let pairs: Vec<_> =
                found.iter().zip(rows).filter_map(|(pose, row)| Some(((*pose)?, row.reported()?))).collect();
            let [x, y] = align(&pairs).ok_or_else(weak)?;
            for (place, row) in places.iter_mut().zip(rows) {
                if let Some(report) = row.reported() {
                    *place = compose(&compose(&x, &report), &inverse(&y));
                }
            }
            [values_of(&x), values_of(&y)].concat()
        }
        Constraint::Pivot => {
            let [in_tool, in_base] = pivot(&solved).ok_or_else(weak)?;
            [in_tool.to_array(), in_base.to_array()].concat()
        }
        Constraint::Rest => values_of(&first).to_vec(),
        Constraint::Stage => {
            let moved = found.iter().zip(rows).filter_map(|(pose, row)| match row.knowledge {
                Knowledge::Step(step_m) => Some((pose.as_ref()?.translation_m, step_m)),
                _ => None,
            });
            let moved: Vec<(DVec3, f64)> = moved.collect();
            let count = moved.len() as f64;
            let mean = moved.iter().map(|(at, _)| at).sum::<DVec3>() / count;
            let step = moved.iter().map(|(_, step_m)| step_m).sum::<f64>() / count;
            let direction: DVec3 = moved.iter().map(|(at, step_m)| (at - mean) * (step_m - step)).sum();
            let direction = direction.try_normalize().ok_or_else(weak)?;
            let start = Pose { translation_m: mean - direction * step, ..first };
            [values_of(&start).as_slice(), &direction.to_array()].concat()
        }
    })
}

/// Rounds of the alternation; each is a maximum, so the sum only grows.
const ROUNDS: usize = 60;

const STEPS: usize = 20;

/// Ratio of the largest to the smallest eigenvalue beyond which the motion does not fix the transforms.
const SINGULAR: f64 = 1e8;

/// Weight of a radian against a metre.
const METRES_PER_RADIAN: f64 = 0.01;

/// X and Y that fit the pairs (P, M) best; `None`: the tool does not turn about two axes.
pub fn align(pairs: &[(Pose, Pose)]) -> Option<[Pose; 2]> {
    let [x, y] = rotations(pairs)?;
    let [t_x, t_y] = translations(pairs, x)?;
    let mut found = [Pose { rotation: x, translation_m: t_x }, Pose { rotation: y, translation_m: t_y }];
    for _ in 0..STEPS {
        let step = refinement(pairs, &found)?;
        let part = |k: usize| DVec3::new(step[k], step[k + 1], step[k + 2]);
        found = [found[0].perturbed(part(0), part(3)), found[1].perturbed(part(6), part(9))];
        if step.iter().all(|value| value.abs() < 1e-12) {
            break;
        }
    }
    Some(found)
}

/// A with qᵀ·A·r = ⟨q·m, p·r⟩ for quaternions, so that its square is greatest where X·M and P·Y turn alike.
fn product(p: DQuat, m: DQuat) -> Matrix4<f64> {
    let unit = |k: usize| DQuat::from_array(std::array::from_fn(|i| f64::from(u8::from(i == k))));
    Matrix4::from_fn(|i, j| {
        let (left, right) = (unit(i) * m, p * unit(j));
        left.dot(right)
    })
}

fn rotations(pairs: &[(Pose, Pose)]) -> Option<[DQuat; 2]> {
    let products: Vec<_> = pairs.iter().map(|(p, m)| product(p.rotation, m.rotation)).collect();
    let best_for = |of: &dyn Fn(&Matrix4<f64>) -> Vector4<f64>| {
        let sum: Matrix4<f64> = products.iter().map(of).map(|v| v * v.transpose()).sum();
        let eigen = SymmetricEigen::new(sum);
        let place = eigen.eigenvalues.imax();
        (eigen.eigenvectors.column(place).into_owned(), eigen.eigenvalues[place])
    };
    let mut best: Option<(f64, [Vector4<f64>; 2])> = None;
    // Any start with a part of the maximum leads there; these span all rotations.
    for start in 0..8 {
        let mut y = Vector4::from_fn(|i, _| if start < 4 { f64::from(u8::from(i == start)) } else { 0.5 });
        if start >= 4 {
            y[start - 4] = -0.5;
        }
        let (mut x, mut value) = (y, 0.0);
        for _ in 0..ROUNDS {
            x = best_for(&|a| a * y).0;
            (y, value) = best_for(&|a| a.transpose() * x);
        }
        if best.as_ref().is_none_or(|(most, _)| value > *most) {
            best = Some((value, [x, y]));
        }
    }
    let (_, [x, y]) = best?;
    let quaternion = |q: Vector4<f64>| DQuat::from_xyzw(q[0], q[1], q[2], q[3]).normalize();
    Some([quaternion(x), quaternion(y)])
}

/// t_X − R_P·t_Y = t_P − R_X·t_M, by least squares.
fn translations(pairs: &[(Pose, Pose)], x: DQuat) -> Option<[DVec3; 2]> {
    let (mut matrix, mut right) = (Matrix6::<f64>::zeros(), Vector6::<f64>::zeros());
    for (p, m) in pairs {
        let rotation = DMat3::from_quat(p.rotation);
        let target = p.translation_m - x * m.translation_m;
        for i in 0..3 {
            let mut row = Vector6::zeros();
            row[i] = 1.0;
            for j in 0..3 {
                row[3 + j] = -rotation.col(j)[i];
            }
            matrix += row * row.transpose();
            right += row * target[i];
        }
    }
    let eigen = SymmetricEigen::new(matrix);
    if eigen.eigenvalues.min() * SINGULAR <= eigen.eigenvalues.max() {
        return None;
    }
    let found = matrix.cholesky()?.solve(&right);
    Some([DVec3::new(found[0], found[1], found[2]), DVec3::new(found[3], found[4], found[5])])
}

fn refinement(pairs: &[(Pose, Pose)], [x, y]: &[Pose; 2]) -> Option<[f64; 12]> {
    const STEP: f64 = 1e-6;
    let residual = |x: &Pose, y: &Pose, (p, m): &(Pose, Pose)| {
        let expected = compose(&compose(x, m), &inverse(y));
        let (t, r) = expected.displacement_from(p);
        let r = r * METRES_PER_RADIAN;
        [t.x, t.y, t.z, r.x, r.y, r.z]
    };
    let (mut matrix, mut right) = (nalgebra::DMatrix::<f64>::zeros(12, 12), nalgebra::DVector::<f64>::zeros(12));
    for pair in pairs {
        let here = residual(x, y, pair);
        let by: Vec<[f64; 6]> = (0..12)
            .map(|k| {
                let mut delta = [DVec3::ZERO; 4];
                delta[k / 3][k % 3] = STEP;
                let moved = residual(&x.perturbed(delta[0], delta[1]), &y.perturbed(delta[2], delta[3]), pair);
                std::array::from_fn(|i| (moved[i] - here[i]) / STEP)
            })
            .collect();
        for k in 0..12 {
            for l in 0..12 {
                matrix[(k, l)] += (0..6).map(|i| by[k][i] * by[l][i]).sum::<f64>();
            }
            right[k] -= (0..6).map(|i| by[k][i] * here[i]).sum::<f64>();
        }
    }
    let solved = matrix.cholesky()?.solve(&right);
    Some(std::array::from_fn(|k| solved[k]))
}

/// The point of the tool that stays in place, and its place: R_P·q + t_P = c. `None`: the tool does not turn about two
/// axes.
pub(crate) fn pivot(poses: &[Pose]) -> Option<[DVec3; 2]> {
    let pairs: Vec<_> = poses.iter().map(|pose| (*pose, Pose::HOME)).collect();
    let [in_base, in_tool] = translations(&pairs, DQuat::IDENTITY)?;
    Some([in_tool, in_base])
}

#[cfg(test)]
mod tests {
    use super::*;

    fn pose(values: [f64; 6]) -> Pose {
        crate::data::pose_of(&values)
    }

    fn motion() -> Vec<Pose> {
        let at = |k: usize| {
            let phase = |rate: f64| (rate * k as f64).sin();
            pose([
                4e-3 * phase(1.1),
                3e-3 * phase(2.3),
                4e-3 * phase(0.7),
                0.3 * phase(1.7),
                0.2 * phase(0.4),
                0.3 * phase(2.9),
            ])
        };
        (0..12).map(at).collect()
    }

    #[test]
    fn frames_are_found_however_the_marker_is_turned() {
        for turn in [[0.1, -0.2, 0.1], [3.0, 0.1, -0.2], [0.0, -2.2, 2.0], [1.5, 1.5, -1.0]] {
            let x = pose([0.2, -0.1, 0.5, turn[0], turn[1], turn[2]]);
            let y = pose([0.02, 0.01, -0.03, -turn[2], turn[0], turn[1]]);
            let pairs: Vec<_> = motion().into_iter().map(|p| (p, compose(&compose(&inverse(&x), &p), &y))).collect();
            for (found, expected) in align(&pairs).unwrap().iter().zip([x, y]) {
                let (t, r) = found.displacement_from(&expected);
                assert!(t.length() < 1e-9 && r.length() < 1e-9, "{turn:?}: {t} {r}");
            }
        }
    }

    #[test]
    fn a_tool_that_does_not_turn_fixes_no_frames() {
        let still: Vec<_> = motion().iter().map(|p| Pose { rotation: DQuat::IDENTITY, ..*p }).map(|p| (p, p)).collect();
        assert!(align(&still).is_none());
    }
}
