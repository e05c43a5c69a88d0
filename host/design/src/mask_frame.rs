//! Where the mask of a cell is: on the base, or where the tool has taken it.

use glam::{DVec2, DVec3, dvec2};
use slitpose_model::{Cell, Opening, Pose, rotation_exp};

/// How far a drawn mask reaches beyond detector and opening, metres. Scenes do not say how large their masks are.
const MARGIN_M: f64 = 1e-3;

/// Where a mask is, base frame, metres.
#[derive(Clone, Copy, Debug)]
pub struct MaskFrame {
    /// Centre of the opening, in the mask's mid-plane.
    pub centre: DVec3,
    /// Directions across and along the opening, unit length.
    pub axes: [DVec3; 2],
}

impl MaskFrame {
    /// That of `cell` with the tool at `pose`.
    pub(crate) fn of(cell: &Cell, pose: &Pose) -> Self {
        Self::at_home(cell).carried(cell, pose)
    }

    /// That of `cell` with the tool at home, where frames base and tool agree.
    pub fn at_home(cell: &Cell) -> Self {
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

/// Half extents of a mask as it is drawn, metres: a mask that rides is as large as its slit asks for, others cover their
/// detectors.
pub fn mask_half_extents_m(cell: &Cell) -> DVec2 {
    let covered = match cell.opening() {
        Opening::RidingSlit => DVec2::ZERO,
        _ => dvec2(cell.detector.length_m, cell.detector.width_m),
    };
    0.5 * dvec2(cell.slit.width_m, cell.slit.length_m).max(covered) + MARGIN_M
}
