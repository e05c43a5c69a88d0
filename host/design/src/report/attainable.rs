//! How exact a pose can be when every number is rounded once.
//!
//! A relative error ρ of each current, and of each coordinate of detectors and emitters, moves the
//! pose by ρ times a factor that belongs to the head and the pose: the condition. No arithmetic can
//! do better with rounded data, and a stable one does little worse, so that error over this is what
//! an algorithm is to be judged by.

use nalgebra::DMatrix;
use slitpose_model::{Plan, Pose, Scene};

use super::method::Precision;

/// The amplification of relative errors into errors of a pose.
#[derive(Clone, Copy, Debug)]
pub(super) struct Attainable {
    /// Ratio of the extreme singular values of the Jacobian, each current in units of its own
    /// rounding, translations in units of the emitters' distance from the tool's origin.
    pub(super) condition: f64,
    /// Translation per relative error, metres.
    translation_m: f64,
    /// Rotation per relative error, radians.
    rotation_rad: f64,
}

impl Attainable {
    /// With the tool of `scene` at `pose`, from the cells that `used` lets pass.
    pub(super) fn at(scene: &Scene, plan: &Plan<f64>, pose: &Pose, used: impl Fn(usize) -> bool) -> Self {
        let arm_m = scene.length_scale_m();
        let mut rows = Vec::new();
        for (number, cell) in scene.cells.iter().enumerate().filter(|(number, _)| used(*number)) {
            let (_, pair, jacobian) = plan.linearise(number, pose);
            let coordinates =
                cell.detector.centre_base_m.length_squared() + cell.emitter.position_tool_m.length_squared();
            for (current, row) in [pair.i_x1_a, pair.i_x2_a].into_iter().zip(jacobian) {
                let slope = row[0] * row[0] + row[1] * row[1] + row[2] * row[2];
                let rounding_a = ((current * current + slope * coordinates) / 3.0).sqrt();
                if rounding_a > 0.0 {
                    rows.extend((0..6).map(|axis| row[axis] * if axis < 3 { arm_m } else { 1.0 } / rounding_a));
                }
            }
        }
        // Rows of zeros change no singular value; without them two cells would have four.
        rows.resize(rows.len().max(36), 0.0);
        // The right singular vectors of A are the left ones of its transpose.
        let svd = DMatrix::from_column_slice(6, rows.len() / 6, &rows).svd(true, false);
        let values = &svd.singular_values;
        let variance = |axes: std::ops::Range<usize>| -> f64 {
            let of = |vectors: &DMatrix<f64>| {
                let weighted = |k: usize| vectors.column(k).rows_range(axes.clone()).norm_squared() / values[k].powi(2);
                (0..6).map(weighted).sum()
            };
            svd.u.as_ref().map_or(f64::NAN, of)
        };
        Self {
            condition: values[0] / values[5],
            translation_m: arm_m * variance(0..3).sqrt(),
            rotation_rad: variance(3..6).sqrt(),
        }
    }

    /// How far rounding in `precision` moves the emitters of a tool with the given arm: root mean
    /// square, metres.
    pub(super) fn at_emitters_m(&self, precision: Precision, arm_m: f64) -> f64 {
        precision.unit_roundoff() * self.translation_m.hypot(arm_m * self.rotation_rad)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use slitpose_head::scene_file::WIDE;
    use slitpose_model::Tier;

    #[test]
    fn rounding_moves_a_pose_by_a_few_roundings_of_the_heads_size() {
        let scene = WIDE.read().unwrap().scene;
        let plan = Plan::compile(&scene, Tier::Paper).unwrap();
        let all = Attainable::at(&scene, &plan, &Pose::HOME, |_| true);
        assert!((1.0..10.0).contains(&all.condition), "{}", all.condition);
        for precision in Precision::BOTH {
            // Detectors lie 25 mm from the middle.
            let roundings = all.at_emitters_m(precision, scene.length_scale_m()) / (precision.unit_roundoff() * 25e-3);
            assert!((0.3..10.0).contains(&roundings), "{roundings}");
        }
        let half = Attainable::at(&scene, &plan, &Pose::HOME, |cell| cell > 1);
        assert!(half.condition > all.condition, "fewer cells tell no more");
    }
}
