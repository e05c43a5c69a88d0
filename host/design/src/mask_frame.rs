//! Where the opening of a cell is: on the base, or where the tool has taken it.

use glam::{DVec2, DVec3};
use slitpose_model::{Cell, Opening, Pose, rotation_exp};

/// Where a mask is, base frame, metres.
#[derive(Clone, Copy, Debug)]
pub(crate) struct MaskFrame {
    centre: DVec3,
    axes: [DVec3; 2],
}

impl MaskFrame {
    /// That of `cell` with the tool at `pose`.
    pub(crate) fn of(cell: &Cell, pose: &Pose) -> Self {
        Self::at_home(cell).carried(cell, pose)
    }

    /// That of `cell` with the tool at home.
    pub(crate) fn at_home(cell: &Cell) -> Self {
        let (detector, slit) = (&cell.detector, &cell.slit);
        let (x, z) = (detector.x_axis_base, detector.normal_base);
        let to_base = |v: DVec3| x * v.x + z.cross(x) * v.y + z * v.z;
        let tilt = rotation_exp(slit.tilt_rad);
        let centre = detector.centre_base_m + to_base(slit.offset_m.extend(slit.distance_m));
        Self { centre, axes: [DVec3::X, DVec3::Y].map(|axis| to_base(tilt * axis)) }
    }

    /// Where the tool at `pose` has taken that of `cell` at home, if it rides.
    pub(crate) fn carried(self, cell: &Cell, pose: &Pose) -> Self {
        if cell.opening() != Opening::RidingSlit {
            return self;
        }
        let axes = self.axes.map(|axis| pose.rotation * axis);
        Self { centre: pose.rotation * self.centre + pose.translation_m, axes }
    }

    /// A point of the mask's mid-plane.
    pub(crate) fn at(&self, point_m: DVec2) -> DVec3 {
        self.centre + self.axes[0] * point_m.x + self.axes[1] * point_m.y
    }
}
