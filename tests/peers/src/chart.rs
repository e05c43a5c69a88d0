//! Six numbers for a pose: what general solvers can vary freely.
//!
//! x = (translation in units of the arm, rotation vector), both in the base frame. The rotation is
//! Cayley's, R(x) = I + 2/(1+a²)·(\[a\]ₓ + \[a\]ₓ²) with a half the vector: the exponential to third
//! order, without trigonometry. The chart of `cpp/head.h` is the same around its start.

use glam::{DMat3, DQuat, DVec3};
use slitpose_model::Pose;

/// Unit of translation: the emitters' distance from the tool's origin.
pub const ARM_M: f64 = 0.01;

pub fn pose(x: &[f64; 6]) -> Pose {
    let a = half_turn(x);
    Pose {
        rotation: DQuat::from_xyzw(a.x, a.y, a.z, 1.0).normalize(),
        translation_m: DVec3::new(x[0], x[1], x[2]) * ARM_M,
    }
}

pub fn coordinates(pose: &Pose) -> [f64; 6] {
    let [tx, ty, tz] = (pose.translation_m / ARM_M).to_array();
    let [rx, ry, rz] = (pose.rotation.xyz() * (2.0 / pose.rotation.w)).to_array();
    [tx, ty, tz, rx, ry, rz]
}

/// From a derivative by the perturbation (δt, δθ) of the pose at `x` to the derivative by x:
/// δθ = (I + \[a\]ₓ)·dx/(1 + a²), transposed.
pub fn by_coordinates(x: &[f64; 6], by_pose: &[f64; 6]) -> [f64; 6] {
    let a = half_turn(x);
    let turn = DVec3::new(by_pose[3], by_pose[4], by_pose[5]);
    let turn = (turn - a.cross(turn)) * (1.0 + a.length_squared()).recip();
    let [tx, ty, tz, ..] = by_pose.map(|value| value * ARM_M);
    [tx, ty, tz, turn.x, turn.y, turn.z]
}

/// The matrix that leads from dx to δθ at `x`.
pub fn turn_by_coordinates(x: &[f64; 6]) -> DMat3 {
    let a = half_turn(x);
    let column = |axis: DVec3| axis + a.cross(axis);
    DMat3::from_cols(column(DVec3::X), column(DVec3::Y), column(DVec3::Z)) * (1.0 + a.length_squared()).recip()
}

fn half_turn(x: &[f64; 6]) -> DVec3 {
    DVec3::new(x[3], x[4], x[5]) * 0.5
}

#[cfg(test)]
mod tests {
    use super::*;

    const X: [f64; 6] = [0.3, -0.2, 0.1, 0.4, -0.5, 0.2];

    #[test]
    fn coordinates_lead_back() {
        for (a, b) in coordinates(&pose(&X)).into_iter().zip(X) {
            assert!((a - b).abs() < 1e-15, "{a} {b}");
        }
    }

    #[test]
    fn derivatives_are_those_of_the_pose() {
        const STEP: f64 = 1e-6;
        for axis in 0..6 {
            let [mut before, mut after] = [X; 2];
            before[axis] -= STEP;
            after[axis] += STEP;
            let (shift, turn) = pose(&after).displacement_from(&pose(&before));
            let moved: [f64; 6] = [shift.x, shift.y, shift.z, turn.x, turn.y, turn.z];
            let column = turn_by_coordinates(&X);
            for coordinate in 0..6 {
                let mut unit = [0.0; 6];
                unit[coordinate] = 1.0;
                let expected = by_coordinates(&X, &unit)[axis];
                assert!((moved[coordinate] / (2.0 * STEP) - expected).abs() < 1e-9);
                if axis >= 3 && coordinate >= 3 {
                    assert!((column.col(axis - 3)[coordinate - 3] - expected).abs() < 1e-15);
                }
            }
        }
    }
}
