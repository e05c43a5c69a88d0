//! Where a search begins.

use crate::pose::{Pose, Transform};
use crate::scalar::{Number, Vector3};

/// How far the starts lie apart: half the reach of a head.
const ROTATION_RAD: f64 = 0.3;
const TRANSLATION_M: f64 = 3e-3;

/// Starts around home and around the pose on the planes, twelve each.
pub(super) const AROUND: usize = 24;

/// Starts spread over the reach of a head.
pub(super) const SPREAD: usize = 48;

/// Start `index` of [`AROUND`]: a turn about one axis and a shift along the next, both ways, first from
/// home, then from `centre`.
pub(super) fn around<S: Number>(centre: &Transform<S>, index: usize) -> Transform<S> {
    let i = index % 12;
    let mut turn = [0.0; 3];
    let mut shift = [0.0; 3];
    let sign = if i.is_multiple_of(2) { 1.0 } else { -1.0 };
    turn[i / 2 % 3] = sign * ROTATION_RAD;
    shift[(i / 2 + 1) % 3] = sign * TRANSLATION_M * if i < 6 { 1.0 } else { -1.0 };
    let centre = if index < 12 { Transform::of(&Pose::HOME) } else { *centre };
    centre.moved(vector::<S>(shift.into()), vector::<S>(turn.into()))
}

/// Start `index` of [`SPREAD`], or of any number: the generalised golden ratio in six dimensions fills
/// a box evenly (Roberts 2018), with powers of the inverse of the root of x⁷ = x + 1.
pub(super) fn spread<S: Number>(index: usize) -> Transform<S> {
    let mut share = 1.0;
    let coordinates: [f64; 6] = core::array::from_fn(|_| {
        share *= 0.898_653_712_628_699;
        let position = (index + 1) as f64 * share;
        2.0 * (position - libm::floor(position)) - 1.0
    });
    let [tx, ty, tz, rx, ry, rz] = coordinates;
    let (shift, turn) = (glam::DVec3::new(tx, ty, tz), glam::DVec3::new(rx, ry, rz));
    Transform::of(&Pose::HOME).moved(vector::<S>(shift * 4.0 / 3.0 * TRANSLATION_M), vector::<S>(turn * ROTATION_RAD))
}

fn vector<S: Number>(v: glam::DVec3) -> S::Vec3 {
    S::Vec3::of(v)
}
