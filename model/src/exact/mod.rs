//! The exact tier: I_rel integrated over the solid angle of the spot, and the power-weighted
//! centroid of the light.
//!
//! A rectangle wholly in front of the emitter takes one tensor rule ([`rectangle`]); whatever else
//! is divided into panels ([`panels`]).

mod order;
mod panels;
mod rectangle;

pub(crate) use order::{Orders, Rules};
pub(crate) use panels::light as polygon_light;

use crate::profile::Emission;
use crate::rectangle::{Rectangle, RectangleLight};
use crate::scalar::{Linear3, Scalar};

/// Whether the whole spot lies behind the emitter's horizon: u·d, linear over the spot, is nowhere
/// positive.
#[inline(always)]
pub(crate) fn faces_away<S: Scalar>(spot: &Rectangle<S>, axis: S::Vec3) -> bool {
    let slopes = (axis.x() * spot.x.half).abs() + (axis.y() * spot.y.half).abs();
    axis.x() * spot.x.middle + axis.y() * spot.y.middle - axis.z() * spot.height + slopes <= S::zero()
}

/// Power and centroid of a rectangular spot by one tensor rule; `None` if it needs dividing.
#[inline(always)]
pub(crate) fn rectangle_light<S: Scalar, E: Emission<S>, const GRADIENT: bool>(
    spot: &Rectangle<S>,
    axis: S::Vec3,
    emission: &E,
    orders: &Orders<S>,
    rules: &Rules<S>,
) -> Option<RectangleLight<S>> {
    let needs = rectangle::needs(spot, axis, emission, orders)?;
    Some(match emission.near(needs.cosine, needs.spread) {
        Some(series) => rectangle::light::<S, _, GRADIENT>(spot, axis, &series, rules, needs.nodes),
        None => rectangle::light::<S, _, GRADIENT>(spot, axis, emission, rules, needs.nodes),
    })
}

/// The largest kink of a profile inside a convex patch of the spot, given by the rays to its
/// corners. cos γ is least at a corner; its greatest value is bounded by the angle between the
/// middle ray and the corners.
#[inline(always)]
fn kink<S: Scalar, E: Emission<S>>(corners: [S::Vec3; 4], axis: S::Vec3, emission: &E) -> Option<S> {
    if !E::HAS_KINKS {
        return None;
    }
    let middle = corners[0] + corners[1] + corners[2] + corners[3];
    let middle = middle * middle.length().recip();
    let (mut lower, mut radius) = (S::infinity(), S::zero());
    for corner in corners {
        let unit = corner * corner.length().recip();
        lower = lower.min(axis.dot(unit));
        radius = radius.max(unit.cross(middle).length().angle_from(unit.dot(middle)));
    }
    let gamma = axis.dot(middle).max(-S::one()).min(S::one()).arc_cosine();
    let upper = (gamma - radius).max(S::zero()).cosine();
    emission.kink(lower, upper)
}
