//! Planes through home, and the worst that lies behind each of their points.

use glam::DVec3;
use slitpose_head::scene_file::Workspace;
use slitpose_head::threads::on_all_cores;
use slitpose_model::Pose;

use super::{Fineness, View};

/// The planes: pairs of (tx, ty, tz, rx, ry, rz).
pub(super) const AXES: [[usize; 2]; 6] = [[0, 1], [0, 2], [1, 2], [3, 4], [3, 5], [4, 5]];

/// Poses of which two coordinates vary, the others zero.
#[derive(Clone, Debug)]
pub struct Plane {
    /// The two coordinates, in the order (t, θ).
    pub axes: [usize; 2],
    /// Half extents along both, metres or radians.
    pub extents: [f64; 2],
    /// Points along each side.
    pub side: usize,
    /// Row by row; the first coordinate varies fastest.
    pub points: Vec<PlanePoint>,
}

/// One point of a plane.
#[derive(Clone, Copy, Debug)]
pub struct PlanePoint {
    /// Both coordinates, metres or radians.
    pub at: [f64; 2],
    /// In the plane.
    pub view: View,
    /// The greatest standard deviation of the position over poses with these two coordinates, metres; infinite if there
    /// is one at which a frame gives no pose.
    pub worst_m: f64,
    /// The same of the rotation, radians.
    pub worst_rad: f64,
    /// The fewest cells whose whole spot is on the detector.
    pub least_lit: usize,
}

impl Plane {
    pub(super) fn of(
        axes: [usize; 2],
        workspace: &Workspace,
        fineness: Fineness,
        view: impl Fn(&Pose) -> View + Sync,
    ) -> Self {
        let all = [workspace.half_extent_m.to_array(), workspace.half_extent_rad.to_array()].concat();
        let extents = axes.map(|axis| all[axis]);
        let behind: Vec<Pose> = workspace.poses(fineness.behind).collect();
        let last = fineness.side.saturating_sub(1).max(1) as f64;
        let along = |k: usize, extent: f64| extent * (2.0 * k as f64 / last - 1.0);
        let places = (0..fineness.side).flat_map(|row| (0..fineness.side).map(move |column| [column, row]));
        let places: Vec<[usize; 2]> = places.collect();
        let points = on_all_cores(&places, |&[column, row]| {
            let at = [along(column, extents[0]), along(row, extents[1])];
            let here = |pose: &Pose| {
                let (t, r) = (pose.translation_m.to_array(), pose.rotation_rad().to_array());
                let mut coordinates = [t, r].concat();
                for (axis, value) in axes.into_iter().zip(at) {
                    coordinates[axis] = value;
                }
                let [t, r] = [0, 3].map(|from| DVec3::from_slice(&coordinates[from..from + 3]));
                view(&Pose::from_vectors(t, r))
            };
            let view = here(&Pose::HOME);
            let mut point = PlanePoint {
                at,
                view,
                worst_m: view.sigma_m().unwrap_or(f64::INFINITY),
                worst_rad: view.sigma_rad().unwrap_or(f64::INFINITY),
                least_lit: view.lit,
            };
            for pose in &behind {
                let view = here(pose);
                point.worst_m = point.worst_m.max(view.sigma_m().unwrap_or(f64::INFINITY));
                point.worst_rad = point.worst_rad.max(view.sigma_rad().unwrap_or(f64::INFINITY));
                point.least_lit = point.least_lit.min(view.lit);
            }
            point
        });
        Self { axes, extents, side: fineness.side, points }
    }
}
