//! A sensor head in space, and the three ways to look at it.

use glam::{DVec2, DVec3, dvec2, dvec3};
use slitpose_model::{Cell, CompiledScene, Opening, Pose, Scene, rotation_exp};

/// Outlines of one cell in the base frame, millimetres.
pub(super) struct CellShape {
    pub(super) number: usize,
    pub(super) detector: Vec<DVec3>,
    pub(super) mask: Vec<DVec3>,
    pub(super) slit: Vec<DVec3>,
    /// Whether light is bent in the slit, a lens.
    pub(super) bends: bool,
    /// Whether all of it but the number is drawn with an earlier cell: the second axis of a detector.
    pub(super) repeats: bool,
    pub(super) emitter: DVec3,
    pub(super) emitter_axis: DVec3,
    /// Corners of the light spot; empty without spot.
    pub(super) spot: Vec<DVec3>,
    /// Where the light's position X_A is on the detector.
    pub(super) x_a: Option<DVec3>,
}

impl CellShape {
    pub(super) fn of(number: usize, cell: &Cell, plan: &CompiledScene<f64>, pose: &Pose) -> Self {
        let (detector, emitter) = (&cell.detector, &cell.emitter);
        let (x, z) = (detector.x_axis_base, detector.normal_base);
        let y = z.cross(x);
        let base_from_cell = |p: DVec3| (detector.centre_base_m + x * p.x + y * p.y + z * p.z) * 1e3;
        let mask = MaskFrame::of(cell, pose);
        let in_mask = |corner: DVec2| mask.at(corner) * 1e3;
        let opening = cell.opening();
        let position = |number: usize| plan.respond(number, pose).x_a_m;
        // On the centre line, or where the second axis has it.
        let across_m = cell.other_axis().and_then(position).unwrap_or_default();
        let x_a_m = position(number);
        let outline = plan.spot_outline_m(number, pose);
        Self {
            number,
            detector: rectangle(0.5 * dvec2(detector.length_m, detector.width_m))
                .map(|corner| base_from_cell(corner.extend(0.0)))
                .collect(),
            mask: rectangle(mask_half_extents_m(cell)).map(in_mask).collect(),
            slit: opening_outline(cell).into_iter().map(in_mask).collect(),
            bends: matches!(opening, Opening::Lens { .. }),
            repeats: cell.is_second_axis(number),
            emitter: (pose.rotation * emitter.position_tool_m + pose.translation_m) * 1e3,
            emitter_axis: pose.rotation * emitter.axis_tool,
            spot: outline.iter().map(|[x, y]| base_from_cell(dvec3(*x, *y, 0.0))).collect(),
            x_a: x_a_m.map(|x_a| base_from_cell(dvec3(x_a, across_m, 0.0))),
        }
    }

    pub(super) fn all(scene: &Scene, plan: &CompiledScene<f64>, pose: &Pose) -> Vec<Self> {
        scene.cells.iter().enumerate().map(|(number, cell)| Self::of(number, cell, plan, pose)).collect()
    }

    pub(super) fn centre(&self) -> DVec3 {
        self.detector.iter().sum::<DVec3>() / self.detector.len() as f64
    }

    pub(super) fn slit_centre(&self) -> DVec3 {
        self.slit.iter().sum::<DVec3>() / self.slit.len() as f64
    }

    fn points(&self) -> impl Iterator<Item = DVec3> {
        self.detector.iter().chain(&self.mask).copied().chain([self.emitter])
    }
}

const CIRCLE: usize = 32;

/// The outline of the opening in its mask, metres.
fn opening_outline(cell: &Cell) -> Vec<DVec2> {
    let half = 0.5 * dvec2(cell.slit.width_m, cell.slit.length_m);
    if !cell.opening().is_hole() {
        return rectangle(half).collect();
    }
    let angles = (0..CIRCLE).map(|i| i as f64 * std::f64::consts::TAU / CIRCLE as f64);
    angles.map(|angle| half.x * DVec2::from_angle(angle)).collect()
}

fn rectangle(half: DVec2) -> impl Iterator<Item = DVec2> {
    [[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]].into_iter().map(move |[x, y]| half * dvec2(x, y))
}

/// The box around all cells: least and greatest corner, millimetres.
pub(super) fn bounds(shapes: &[CellShape]) -> [DVec3; 2] {
    let start = [DVec3::INFINITY, DVec3::NEG_INFINITY];
    let points = shapes.iter().flat_map(CellShape::points);
    points.fold(start, |[least, most], point| [least.min(point), most.max(point)])
}

/// A direction to look in, parallel to an axis of the base frame.
#[derive(Clone, Copy)]
pub(super) struct View {
    pub(super) name: &'static str,
    /// Base axis that points to the right, and its name.
    pub(super) right: (DVec3, &'static str),
    /// Base axis that points up, and its name.
    pub(super) up: (DVec3, &'static str),
}

pub(super) const TOP: View = View { name: "top view", right: (DVec3::X, "x"), up: (DVec3::Y, "y") };
/// From the front: along +y.
pub(super) const FRONT: View = View { name: "front view", right: (DVec3::X, "x"), up: (DVec3::Z, "z") };
/// From the right: along −x.
pub(super) const SIDE: View = View { name: "side view", right: (DVec3::Y, "y"), up: (DVec3::Z, "z") };

impl View {
    pub(super) fn project(&self, point: DVec3) -> DVec2 {
        dvec2(point.dot(self.right.0), point.dot(self.up.0))
    }

    pub(super) fn nearness(&self, point: DVec3) -> f64 {
        point.dot(self.right.0.cross(self.up.0))
    }
}

/// The convex hull of points in a plane, in order around it (Andrew's monotone chain).
pub(super) fn hull(points: &[DVec2]) -> Vec<DVec2> {
    let mut sorted = points.to_vec();
    sorted.sort_by(|a, b| a.x.total_cmp(&b.x).then(a.y.total_cmp(&b.y)));
    let half = |points: &mut dyn Iterator<Item = DVec2>| {
        let mut chain: Vec<DVec2> = Vec::new();
        for point in points {
            while let [.., before, last] = chain[..] {
                if (last - before).perp_dot(point - last) > 0.0 {
                    break;
                }
                chain.pop();
            }
            chain.push(point);
        }
        chain.pop();
        chain
    };
    let mut around = half(&mut sorted.iter().copied());
    around.extend(half(&mut sorted.iter().rev().copied()));
    around
}

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
