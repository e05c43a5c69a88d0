//! Poses: spread over a box, and along its axes.

use glam::DVec3;
use slitpose_model::Pose;

use slitpose_head::scene_file::Workspace;

/// The six axes of motion from home, in the order (t, θ).
pub(crate) const AXES: [&str; 6] = ["tx", "ty", "tz", "rx", "ry", "rz"];

/// Bases of the Halton sequence: one prime for each axis.
const BASES: [usize; 6] = [2, 3, 5, 7, 11, 13];

/// Poses spread evenly over a workspace, the same ones every time.
///
/// A Halton sequence (Halton 1960): the error of a share found with n of its points falls almost
/// like 1/n, with random points like 1/√n.
pub(crate) fn workspace_poses(workspace: &Workspace, count: usize) -> impl Iterator<Item = Pose> + use<> {
    let (half_m, half_rad) = (workspace.half_extent_m, workspace.half_extent_rad);
    (1..=count).map(move |index| {
        let [tx, ty, tz, rx, ry, rz] = BASES.map(|base| 2.0 * radical_inverse(index, base) - 1.0);
        Pose::from_vectors(half_m * DVec3::new(tx, ty, tz), half_rad * DVec3::new(rx, ry, rz))
    })
}

/// The digits of `index` in `base`, mirrored at the point: in 0 … 1.
fn radical_inverse(mut index: usize, base: usize) -> f64 {
    let (mut inverse, mut place) = (0.0, 1.0);
    while index > 0 {
        place /= base as f64;
        inverse += place * (index % base) as f64;
        index /= base;
    }
    inverse
}

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
