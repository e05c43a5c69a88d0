//! Where the tool is before anything is known of it, and places around to start from.
//!
//! A scene has its tool about the origin of the base, or it has not: what the axes of a tool are called is the designer's
//! choice. So home is where emitters look at the slits: R turns their axes against the cells' normals, and their places
//! about their middle towards those of the slits about theirs (Wahba, A least squares estimate of satellite attitude,
//! 1965; solved by the eigenvector of Davenport's matrix, Markley and Mortari 2000); from there Gauss–Newton brings each
//! emitter to the line through its slit along the normal. Where that is near the origin, home is the origin.

use glam::{DMat3, DQuat, DVec3};

use crate::effects::Opening;
use crate::pose::{Pose, Transform};
use crate::scalar::{Number, Vector3};
use crate::scene::{Cell, Scene};

use super::algebra::{Factor, Matrix6};
use super::planes::{MAX_STEPS, settle};

/// Share of the way from slit to emitter by which an emitter may be elsewhere with the tool at the origin.
const NEAR: f64 = 0.5;

/// The home of the tool of `scene`. Slits that ride on it are described with the tool at the origin.
pub fn home(scene: &Scene) -> Pose {
    if scene.cells.iter().any(|cell| cell.opening() == Opening::RidingSlit) {
        return Pose::HOME;
    }
    let found = facing(scene).unwrap_or(Pose::HOME);
    let is_near = scene.cells.iter().all(|cell| {
        let emitter = cell.emitter.position_tool_m;
        let there = found.rotation * emitter + found.translation_m;
        there.distance(emitter) <= NEAR * there.distance(slit_base_m(cell))
    });
    if is_near { Pose::HOME } else { found }
}

/// The pose at which emitters look at their slits best; `None` where cells tell none.
fn facing(scene: &Scene) -> Option<Pose> {
    let cells = scene.cells.iter();
    let count = cells.len() as f64;
    let middle = |place: fn(&Cell) -> DVec3| cells.clone().map(place).sum::<DVec3>() / count;
    let (slits, emitters) = (middle(slit_base_m), middle(|cell| cell.emitter.position_tool_m));
    let mut profile = DMat3::ZERO;
    for cell in cells.clone() {
        let mut add =
            |base: DVec3, tool: DVec3| profile += DMat3::from_cols(base * tool.x, base * tool.y, base * tool.z);
        add(-cell.detector.normal_base, cell.emitter.axis_tool);
        add(
            (slit_base_m(cell) - slits).normalize_or_zero(),
            (cell.emitter.position_tool_m - emitters).normalize_or_zero(),
        );
    }
    let rotation = best_rotation(&profile, 2.0 * count)?;
    let ahead = cells.clone().map(|cell| cell.detector.normal_base * cell.slit.distance_m).sum::<DVec3>() / count;
    let start = Pose { translation_m: slits + ahead - rotation * emitters, rotation };
    let length_scale_m = scene.length_scale_m();
    let found = settle(Transform::of(&start), length_scale_m, MAX_STEPS, |pose| {
        scene.cells.iter().flat_map(move |cell| {
            let [x, z] = [cell.detector.x_axis_base, cell.detector.normal_base];
            let arm = pose.rotate(cell.emitter.position_tool_m);
            let off = arm + pose.translation() - slit_base_m(cell);
            [x, z.cross(x)].map(|across| {
                let turn = arm.cross(across) / length_scale_m;
                ([across.x, across.y, across.z, turn.x, turn.y, turn.z], across.dot(off), 1.0)
            })
        })
    });
    Some(found.to_pose()).filter(Pose::is_finite)
}

/// The rotation R with the greatest trace of `profile`ᵀ·R, for a sum of `count` products of unit vectors.
fn best_rotation(profile: &DMat3, count: f64) -> Option<DQuat> {
    let [x, y, z] = [profile.x_axis, profile.y_axis, profile.z_axis];
    let trace = x.x + y.y + z.z;
    let twist = [y.z - z.y, z.x - x.z, x.y - y.x];
    // Davenport's K of quaternions x, y, z, w, all of whose eigenvalues are ≤ `count` in size, raised to be positive; the
    // two unknowns more that a factor has stay below it.
    let mut raised: Matrix6<f64> = [[0.0; 6]; 6];
    let symmetric = [[x.x, y.x + x.y, z.x + x.z], [y.x + x.y, y.y, z.y + y.z], [z.x + x.z, z.y + y.z, z.z]];
    for i in 0..3 {
        for j in 0..3 {
            raised[i][j] = if i == j { 2.0 * symmetric[i][i] - trace } else { symmetric[i][j] };
        }
        (raised[i][3], raised[3][i]) = (twist[i], twist[i]);
    }
    raised[3][3] = trace;
    (0..6).for_each(|i| raised[i][i] += if i < 4 { 2.0 * count } else { 0.5 * count });
    let (_, [x, y, z, w, ..]) = Factor::of_matrix(&raised, 0.0, 0.0)?.singular()[5];
    let rotation = DQuat::from_xyzw(x, y, z, w);
    (rotation.length() > 0.0).then(|| rotation.normalize())
}

fn slit_base_m(cell: &Cell) -> DVec3 {
    let detector = &cell.detector;
    let [x, z] = [detector.x_axis_base, detector.normal_base];
    let slit = &cell.slit;
    detector.centre_base_m + x * slit.offset_m.x + z.cross(x) * slit.offset_m.y + z * slit.distance_m
}

/// How far the starts lie apart: half the reach of a head.
const ROTATION_RAD: f64 = 0.3;
const TRANSLATION_M: f64 = 3e-3;

/// Starts around home and around the pose on the planes, twelve each.
pub const STARTS_AROUND: usize = 24;

pub const STARTS_SPREAD: usize = 48;

/// Start `index` of [`STARTS_AROUND`]: a turn about one axis and a shift along the next, both ways, first from
/// home, then from `centre`.
pub fn around<S: Number>(home: &Transform<S>, centre: &Transform<S>, index: usize) -> Transform<S> {
    let i = index % 12;
    let mut turn = [0.0; 3];
    let mut shift = [0.0; 3];
    let sign = if i.is_multiple_of(2) { 1.0 } else { -1.0 };
    turn[i / 2 % 3] = sign * ROTATION_RAD;
    shift[(i / 2 + 1) % 3] = sign * TRANSLATION_M * if i < 6 { 1.0 } else { -1.0 };
    let centre = if index < 12 { home } else { centre };
    centre.moved(S::Vec3::of(shift.into()), S::Vec3::of(turn.into()))
}

/// Start `index` of [`STARTS_SPREAD`] about `home`, or of any number: the generalised golden ratio in six dimensions fills
/// a box evenly (Roberts 2018), with powers of the inverse of the root of x⁷ = x + 1.
pub fn spread<S: Number>(home: &Transform<S>, index: usize) -> Transform<S> {
    let mut share = 1.0;
    let coordinates: [f64; 6] = core::array::from_fn(|_| {
        share *= 0.898_653_712_628_699;
        let position = (index + 1) as f64 * share;
        2.0 * (position - libm::floor(position)) - 1.0
    });
    let [tx, ty, tz, rx, ry, rz] = coordinates;
    let (shift, turn) = (DVec3::new(tx, ty, tz), DVec3::new(rx, ry, rz));
    home.moved(S::Vec3::of(shift * 4.0 / 3.0 * TRANSLATION_M), S::Vec3::of(turn * ROTATION_RAD))
}

#[cfg(test)]
mod tests {
    use super::super::fixture::head;
    use super::*;

    /// The head with its tool's frame turned and moved: `to` is the new frame's pose in the old one.
    fn reframed(to: &Pose) -> Scene {
        let mut scene = head();
        let back = to.rotation.inverse();
        for cell in &mut scene.cells {
            cell.emitter.position_tool_m = back * (cell.emitter.position_tool_m - to.translation_m);
            cell.emitter.axis_tool = back * cell.emitter.axis_tool;
        }
        scene
    }

    #[test]
    fn home_is_where_emitters_look_at_slits_whatever_the_axes_of_the_tool_are_called() {
        assert_eq!(home(&head()), Pose::HOME);
        for (shift, turn) in [
            (DVec3::ZERO, DVec3::new(3.1, 0.0, 0.0)),
            (DVec3::ZERO, DVec3::new(0.0, -2.2, 2.2)),
            (DVec3::new(0.0, 0.02, -0.1), DVec3::new(1.0, -0.5, 0.3)),
            (DVec3::new(0.03, 0.0, 0.0), DVec3::ZERO),
        ] {
            let to = Pose::from_vectors(shift, turn);
            let (shift, turn) = home(&reframed(&to)).displacement_from(&to);
            assert!(shift.length() < 1e-3 && turn.length() < 0.05, "{to:?}: {shift} {turn}");
        }
    }
}
