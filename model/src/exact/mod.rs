//! The exact tier: I_rel integrated over the solid angle of the spot, and the power-weighted
//! centroid of the light.
//!
//! A rectangle wholly in front of the emitter takes one tensor rule ([`rectangle`]), and so do common spots of other
//! openings ([`uncut`]); any other spot is divided ([`integrand`], [`panels`], [`sides`]). For a narrow lobe the division starts from the part
//! of the spot that it lights ([`integrand::Cone`]). The work is bounded: see [`MAX_EVALUATIONS`].

mod integrand;
mod order;
mod panels;
mod rectangle;
mod sides;
mod uncut;

pub use integrand::{LightAndTurn, PolygonLight, Turn, polygon_light};
pub use order::{Orders, Rules, SERIES_EXPONENT};
pub use panels::MAX_EVALUATIONS;
pub use rectangle::narrow_light;
pub use uncut::{Disc, Strip, disc_light, strip_light};

use order::MAX_NODES;
use rectangle::Reaches;

use crate::polygon::Polygon;
#[cfg(all(feature = "lanes", target_arch = "x86_64"))]
use crate::profile::MAX_TERMS;
use crate::profile::{CompiledProfile, Emission, Series};
use crate::rectangle::{Rectangle, RectangleLight};
use crate::response::Integration;
#[cfg(all(feature = "lanes", target_arch = "x86_64"))]
use crate::scalar::Real;
use crate::scalar::{Linear3, Number};

/// What a light is integrated with: the profile, the numbers of nodes that it takes, and the rules of so many.
pub struct Method<'a, S> {
    pub emission: &'a CompiledProfile<S>,
    pub orders: &'a Orders<S>,
    pub rules: &'a Rules<S>,
}

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
pub fn rectangle_light<S: Number, const GRADIENT: bool>(
    spot: &Rectangle<S>,
    axis: S::Vec3,
    method: &Method<'_, S>,
) -> Option<(RectangleLight<S>, usize)> {
    let reaches = Reaches::of(spot, axis);
    let rule = rule(method.emission, method.orders, &reaches, |along| reaches.slope(spot, axis, along))?;
    let [nodes_x, nodes_y] = rule.nodes;
    let (along_x, along_y) = (method.rules.get(nodes_x), method.rules.get(nodes_y));
    let light = match rule.series {
        Some(series) => rectangle::light::<S, _, GRADIENT>(spot, axis, &series, &along_x, along_y),
        None => rectangle::light::<S, _, GRADIENT>(spot, axis, method.emission, &along_x, along_y),
    };
    // NaN fails, too.
    (light.power.value >= least_power()).then_some((light, nodes_x * nodes_y))
}

/// The light of a rectangular spot that one tensor rule cannot integrate: see [`Polygon::of_rectangle`].
#[cold]
#[inline(never)]
pub fn divided_light<S: Number, const GRADIENT: bool>(
    spot: &Rectangle<S>,
    motions: impl FnOnce() -> [S::Vec3; 4],
    axis: S::Vec3,
    method: &Method<'_, S>,
) -> (Option<LightAndTurn<S>>, Integration<S>) {
    polygon_light::<S, GRADIENT>(Polygon::of_rectangle(spot, motions()), axis, method)
}

/// The tensor rule for a spot that lies as `reaches` tells; `None` if the spot must be divided. `slope`: see
/// [`Reaches::slope`].
#[inline(always)]
fn rule<S: Number>(
    emission: &CompiledProfile<S>,
    orders: &Orders<S>,
    reaches: &Reaches<S>,
    slope: impl Fn(usize) -> S,
) -> Option<Rule<S>> {
    let nodes = reaches.nodes(orders, slope)?;
    match emission.near(reaches.cosine, reaches.spread) {
        Some(series) => {
            let nodes = nodes.map(|count| series.nodes_with(count));
            (nodes[0].max(nodes[1]) <= MAX_NODES).then_some(Rule { nodes, series: Some(series) })
        }
        None if emission.needs_series() => None,
        None => Some(Rule { nodes, series: None }),
    }
}

/// Nodes along x and along y, and what stands for the profile; `None`: itself.
pub struct Rule<S> {
    nodes: [usize; 2],
    series: Option<Series<S>>,
}

/// Below this power, near the end of the number range, ratios lose all digits.
#[inline(always)]
fn least_power<S: Number>() -> S {
    S::min_positive_value() / (S::epsilon() * S::epsilon())
}

/// [`rectangle_light`] of the spot of each lane by the rule of that lane's `profile`; the power is NaN where there is none,
/// or none with a series.
#[cfg(all(feature = "lanes", target_arch = "x86_64"))]
#[inline(always)]
pub fn rectangle_light_lanes<'a, R: Real<Element = f64>, const GRADIENT: bool>(
    spot: &Rectangle<R>,
    axis: R::Vec3,
    rules: &Rules<f64>,
    profile: impl Fn(usize) -> Option<(&'a CompiledProfile<f64>, &'a Orders<f64>)>,
) -> RectangleLight<R> {
    let reaches = Reaches::of(spot, axis);
    // Zero: any number.
    let (mut nodes, mut most, mut terms) = ([[0; crate::lanes::MAX_LANES]; 2], [1; 2], 0);
    let mut inverses = [f64::NAN; crate::lanes::MAX_LANES];
    let mut coefficients = [[0.0; crate::lanes::MAX_LANES]; MAX_TERMS + 1];
    for lane in 0..R::LANES {
        let Some((profile, orders)) = profile(lane) else { continue };
        let slope = |along: usize| reaches.slope(spot, axis, along).lane(lane);
        let rule = rule(profile, orders, &reaches.lane(lane), slope);
        let Some(Rule { nodes: counts, series: Some(series) }) = rule else { continue };
        for (along, count) in counts.into_iter().enumerate() {
            nodes[along][lane] = count;
            most[along] = most[along].max(count);
        }
        terms = terms.max(series.terms);
        inverses[lane] = series.inverse;
        for k in 0..=series.terms {
            coefficients[k][lane] = series.coefficients[k];
        }
    }
    let zero = spot.height.constant(0.0);
    let inverse = zero.fill_with(|lane| inverses[lane]);
    let mut series = Series { inverse, coefficients: [zero; MAX_TERMS + 1], terms, nodes: 1, more: 0 };
    for k in 0..=terms {
        series.coefficients[k] = zero.fill_with(|lane| coefficients[k][lane]);
    }
    let along_x = rules.in_lanes(zero, nodes[0], most[0]);
    let along_y = rules.in_lanes(zero, nodes[1], most[1]);
    let along_x = along_x.iter().copied();
    let mut light = rectangle::light::<R, _, GRADIENT>(spot, axis, &series, &along_x, along_y.iter().copied());
    let power = light.power.value;
    light.power.value = R::select_ge(power, zero.splat(least_power()), power, zero.constant(f64::NAN));
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
