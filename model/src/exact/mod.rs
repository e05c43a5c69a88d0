//! The exact tier: I_rel integrated over the solid angle of the spot, and the power-weighted
//! centroid of the light.
//!
//! A rectangle wholly in front of the emitter takes one tensor rule ([`rectangle`]); any other spot is
//! divided ([`integrand`], [`panels`], [`sides`]). For a narrow lobe the division starts from the part
//! of the spot that it lights ([`integrand::Cone`]). The work is bounded: see [`MAX_EVALUATIONS`].

mod integrand;
mod order;
mod panels;
mod rectangle;
mod sides;

pub use integrand::{PolygonLight, Turn, light as polygon_light, light_and_turn};
pub use order::{Orders, Rules, SERIES_EXPONENT};
pub use panels::MAX_EVALUATIONS;
pub use rectangle::narrow_light;

#[cfg(feature = "batch")]
use order::LaneRule;
use order::MAX_NODES;

#[cfg(feature = "batch")]
use crate::profile::Cosine;
use crate::profile::Emission;
use crate::rectangle::{Rectangle, RectangleLight};
use crate::response::Integration;
#[cfg(feature = "batch")]
use crate::scalar::Real;
use crate::scalar::{Linear3, Number};

/// u·d at the middle of the spot, and by how much it is more or less at a corner: it is linear over the spot.
#[inline(always)]
fn along_axis<S: Number>(spot: &Rectangle<S>, axis: S::Vec3) -> (S, S) {
    let slopes = (axis.x() * spot.x.half).abs() + (axis.y() * spot.y.half).abs();
    (axis.x() * spot.x.middle + axis.y() * spot.y.middle - axis.z() * spot.height, slopes)
}

/// Whether the whole spot lies behind the emitter's horizon: u·d is nowhere positive.
#[inline(always)]
pub fn faces_away<S: Number>(spot: &Rectangle<S>, axis: S::Vec3) -> bool {
    let (middle, slopes) = along_axis(spot, axis);
    middle + slopes <= S::zero()
}

/// Whether no part of the spot lies behind the emitter's horizon.
#[inline(always)]
pub fn is_wholly_in_front<S: Number>(spot: &Rectangle<S>, axis: S::Vec3) -> bool {
    let (middle, slopes) = along_axis(spot, axis);
    middle > slopes
}

/// Power and centroid of a rectangular spot by one tensor rule, and the rule's number of nodes; `None`
/// if the spot must be divided.
#[inline(always)]
pub fn rectangle_light<S: Number, E: Emission<S>, const GRADIENT: bool>(
    spot: &Rectangle<S>,
    axis: S::Vec3,
    emission: &E,
    orders: &Orders<S>,
    rules: &Rules<S>,
) -> Option<(RectangleLight<S>, usize)> {
    let needs = rectangle::needs(spot, axis, orders)?;
    let (mut along_x, mut along_y) = needs.nodes;
    let light = match emission.near(needs.cosine, needs.spread) {
        Some(series) => {
            (along_x, along_y) = (series.nodes_with(along_x), series.nodes_with(along_y));
            if along_x.max(along_y) > MAX_NODES {
                return None;
            }
            rectangle::light::<S, _, GRADIENT>(spot, axis, &series, &rules.get(along_x), rules.get(along_y))
        }
        None if E::NEEDS_SERIES => return None,
        None => rectangle::light::<S, _, GRADIENT>(spot, axis, emission, &rules.get(along_x), rules.get(along_y)),
    };
    // NaN fails, too.
    (light.power.value >= least_power()).then_some((light, along_x * along_y))
}

/// Below this power, near the end of the number range, ratios lose all digits.
#[inline(always)]
fn least_power<S: Number>() -> S {
    S::min_positive_value() / (S::epsilon() * S::epsilon())
}

/// [`rectangle_light`] of the spot of each lane, from an emitter whose lobe is not narrow; the power is NaN where the spot
/// must be divided.
#[cfg(feature = "batch")]
#[inline(always)]
pub fn rectangle_light_lanes<R: Real, const GRADIENT: bool>(
    spot: &Rectangle<R>,
    axis: R::Vec3,
    emission: &Cosine<R::Element>,
    orders: &Orders<R::Element>,
    rules: &Rules<R::Element>,
) -> RectangleLight<R> {
    let reaches = rectangle::Reaches::of(spot, axis);
    let zero = spot.height.constant(0.0);
    let count_x = orders.nodes_lanes(reaches.emitter[0], reaches.horizon[0]);
    let count_y = orders.nodes_lanes(reaches.emitter[1], reaches.horizon[1]);
    let (mut along_x, mut along_y) = (LaneRule::new(), LaneRule::new());
    let one = zero.constant(1.0);
    rules.in_lanes(count_x + R::select_gt(reaches.distance, zero.splat(orders.far()), one, zero), &mut along_x);
    rules.in_lanes(count_y, &mut along_y);
    let series = emission.near_lanes(reaches.cosine, reaches.spread);
    let nodes = (along_x.iter().copied(), along_y.iter().copied());
    let mut light = rectangle::light::<R, _, GRADIENT>(spot, axis, &series, &nodes.0, nodes.1);
    let power = light.power.value;
    let nan = zero.constant(f64::NAN);
    for above in [reaches.least, count_x, count_y] {
        light.power.value = R::select_gt(above, zero, light.power.value, nan);
    }
    light.power.value = R::select_ge(power, zero.splat(least_power()), light.power.value, nan);
    light
}

/// cos γ over a convex patch of the spot.
#[derive(Clone, Copy, Debug)]
struct Cosines<S> {
    lower: S,
    middle: S,
    upper: S,
}

impl<S: Number> Cosines<S> {
    /// From the rays to the patch's corners, the tighter of two pairs of bounds: those of the cone around the middle
    /// ray; and those of u·d, which is linear over the patch, over the least and greatest distance. The cone around a
    /// patch along the horizon reaches far behind the horizon.
    fn of<const N: usize>(corners: [S::Vec3; N], axis: S::Vec3) -> Self {
        let units = corners.map(|corner| corner * corner.length().recip());
        let sum = units.into_iter().fold(S::Vec3::default(), |sum, unit| sum + unit);
        let middle = sum * sum.length().recip();
        let angle = |a: S::Vec3, b: S::Vec3| a.cross(b).length().angle_from(a.dot(b));
        let radius = units.into_iter().fold(S::zero(), |radius, unit| radius.max(angle(unit, middle)));
        let gamma = angle(axis, middle);
        let least = |of: &dyn Fn(S::Vec3) -> S| corners.into_iter().map(of).fold(S::infinity(), S::min);
        let (behind, front) = (least(&|ray| axis.dot(ray)), -least(&|ray| -axis.dot(ray)));
        let (nearest, farthest) = (least(&|ray| middle.dot(ray)), -least(&|ray| -ray.length()));
        let lower = (gamma + radius).min(S::PI()).cosine();
        let upper = (gamma - radius).max(S::zero()).cosine();
        Self {
            lower: if behind > S::zero() { lower.max(behind / farthest) } else { lower },
            middle: axis.dot(middle),
            upper: if nearest > S::zero() { upper.min(front / nearest) } else { upper },
        }
    }

    /// Greatest relative difference from the value at the middle, which must be positive.
    fn spread(&self) -> S {
        (self.upper - self.middle).max(self.middle - self.lower) / self.middle
    }

    /// tan²γ at the middle.
    fn tangent2(&self) -> S {
        let square = self.middle * self.middle;
        (S::one() - square).max(S::zero()) / square
    }
}
