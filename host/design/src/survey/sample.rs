//! Poses along the axes of a workspace.

use glam::DVec3;
use slitpose_model::Pose;

/// The six axes of motion from home, in the order (t, θ).
pub(crate) const AXES: [&str; 6] = ["tx", "ty", "tz", "rx", "ry", "rz"];

/// The pose after a pure motion from home along one of [`AXES`], in metres or radians.
///
/// # Panics
/// If `axis` is not below 6.
pub(crate) fn axis_motion(axis: usize, amount: f64) -> Pose {
    let mut motion = [0.0; 6];
    motion[axis] = amount;
    let [tx, ty, tz, rx, ry, rz] = motion;
    Pose::from_vectors(DVec3::new(tx, ty, tz), DVec3::new(rx, ry, rz))
}
