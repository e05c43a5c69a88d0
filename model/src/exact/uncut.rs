//! Spots that take one rule: the light of a round hole that falls on the detector as a whole, and the strip between the
//! sides of a slit across the whole width of the detector.
//!
//! The nodes do not move with the emitter, so that derivatives are as in [`super::integrand`]: those of the light at the
//! nodes, and along a moving side the light that it sweeps over. A rule is chosen as for the rectangle around the spot;
//! where none is exact enough, the spot is divided.

use crate::profile::Falloff;
use crate::rectangle::Rectangle;
use crate::response::Integration;
use crate::scalar::{Linear3, Number};

use super::integrand::{Integrand, LightAndTurn, Sums};
use super::order::MAX_NODES;
use super::rectangle::Reaches;
use super::{Method, Rule, least_power, rule};

/// A polygon of this many sides stands for a circle of the same area. The second moment of its area, through which the
/// size of a hole moves the light, is 0.1 % more than the circle's.
const CIRCLE_CORNERS: usize = 10;

/// Gauss–Legendre nodes of a tensor rule that is as exact as that of a [`Disc`].
const DISC_NODES: usize = 3;

/// A round hole as a polygon, from its middle, with the rule for integrals over it: a node in the middle, and one on the
/// way to each corner. As that of Radon (1948) for the circle, it is exact to the fifth degree.
#[derive(Clone, Debug)]
pub struct Disc<S: Number> {
    pub corners: [S::Vec3; CIRCLE_CORNERS],
    /// Share of the way to a corner.
    share: S,
    /// Of the middle, and of each other node.
    weights: [S; 2],
}

impl<S: Number> Disc<S> {
    pub fn new(diameter_m: f64) -> Self {
        let step = core::f64::consts::TAU / CIRCLE_CORNERS as f64;
        let radius = 0.5 * diameter_m * libm::sqrt(step / libm::sin(step));
        // Corners opposite each other along x are so to the last bit, and their coordinates y alike: the fewer slabs
        // has the spot.
        let corner = |i: usize| {
            let half = CIRCLE_CORNERS / 2;
            let (up, i) = if i <= half { (1.0, i) } else { (-1.0, CIRCLE_CORNERS - i) };
            let (right, i) = if 2 * i <= half { (1.0, i) } else { (-1.0, half - i) };
            let angle = i as f64 * step;
            S::Vec3::new(S::of(right * libm::cos(angle) * radius), S::of(up * libm::sin(angle) * radius), S::zero())
        };
        // The means over the polygon of the square and the fourth power of the distance from the middle, in units of the
        // radius. In the triangle to a side, that square is at most cos²(π/n)·(1 + τ²), τ = tan of the angle from the
        // middle of the side, and as evenly distributed as in a circle.
        let (c, t) = (libm::cos(0.5 * step), libm::tan(0.5 * step));
        let (c2, t2) = (c * c, t * t);
        let (second, fourth) = (c2 * (1.0 + t2 / 3.0) / 2.0, c2 * c2 * (1.0 + t2 * (2.0 / 3.0 + t2 / 5.0)) / 3.0);
        let (area, ring) = (core::f64::consts::PI * 0.25 * diameter_m * diameter_m, second * second / fourth);
        Self {
            corners: core::array::from_fn(corner),
            share: S::of(libm::sqrt(fourth / second)),
            weights: [S::of(area * (1.0 - ring)), S::of(area * ring / CIRCLE_CORNERS as f64)],
        }
    }
}

/// The spot between two sides and two lines along x that do not move, relative to the emitter's foot.
pub struct Strip<S: Number> {
    /// Normals of the planes through the emitter that bound it towards −x and +x: they point inside, with |x| = 1.
    pub sides: [S::Vec3; 2],
    pub y: [S; 2],
    pub height: S,
}

impl<S: Number> Strip<S> {
    /// x of both sides at `y`.
    pub fn x(&self, y: S) -> [S; 2] {
        self.sides.map(|normal| (normal.z() * self.height - normal.y() * y) * normal.x())
    }
}

/// The light of a `strip`; `None` if it must be divided.
pub fn strip_light<S: Number, const GRADIENT: bool>(
    strip: &Strip<S>,
    axis: S::Vec3,
    method: &Method<'_, S>,
) -> Option<(LightAndTurn<S>, Integration<S>)> {
    let [[low0, high0], [low1, high1]] = strip.y.map(|y| strip.x(y));
    let around = Rectangle::between([low0.min(low1), high0.max(high1)], strip.y, strip.height);
    let reaches = Reaches::of(&around, axis);
    let slope = |along| reaches.slope(&around, axis, along);
    let Rule { nodes: [nodes_x, nodes_y], series } = rule(method.emission, method.orders, &reaches, slope)?;
    let integrand = Integrand::undivided(S::Vec3::new(around.x.middle, around.y.middle, -strip.height), axis, method);
    // The width, linear in y, adds one degree.
    let nodes = [nodes_x, (nodes_y + 1).min(MAX_NODES)];
    let sums = match &series {
        Some(series) => integrand.over_strip::<_, GRADIENT>(series, strip, nodes),
        None => integrand.over_strip::<_, GRADIENT>(method.emission, strip, nodes),
    };
    integrand.conclude(sums, nodes[0] * nodes[1])
}

/// The light through a `disc` whose middle is at `to_middle` from the emitter, `magnified` on the detector; `None` if it must
/// be divided.
pub fn disc_light<S: Number, const GRADIENT: bool>(
    disc: &Disc<S>,
    to_middle: S::Vec3,
    magnified: S,
    axis: S::Vec3,
    method: &Method<'_, S>,
) -> Option<(LightAndTurn<S>, Integration<S>)> {
    let (x, y, height, radius) = (to_middle.x(), to_middle.y(), -to_middle.z(), disc.corners[0].x());
    let around = Rectangle::between([x - radius, x + radius], [y - radius, y + radius], height);
    let straight = Reaches::of(&around, axis);
    // On the detector the first moment, which a greater distance makes less exact, is as small as the light is narrow.
    let mut reaches = straight;
    reaches.distance = straight.distance * magnified;
    let slope = |along| straight.slope(&around, axis, along);
    let Rule { nodes, series } = rule(method.emission, method.orders, &reaches, slope)?;
    if nodes[0].max(nodes[1]) > DISC_NODES {
        return None;
    }
    let integrand = Integrand::undivided(to_middle, axis, method);
    let sums = match &series {
        Some(series) => integrand.over_disc::<_, GRADIENT>(series, disc, to_middle),
        None => integrand.over_disc::<_, GRADIENT>(method.emission, disc, to_middle),
    };
    integrand.conclude(sums, CIRCLE_CORNERS + 1)
}

impl<S: Number> Integrand<'_, S> {
    fn over_strip<F: Falloff<S>, const GRADIENT: bool>(
        &self,
        falloff: &F,
        strip: &Strip<S>,
        [nodes_x, nodes_y]: [usize; 2],
    ) -> Sums<S> {
        let mut sums = Sums::default();
        let half = S::half();
        let [middle, half_y] = [half * (strip.y[0] + strip.y[1]), half * (strip.y[1] - strip.y[0])];
        for (eta, weight_y) in self.rules.get(nodes_y) {
            let y = middle + half_y * eta;
            let [low, high] = strip.x(y);
            let (centre, half_x, scale) = (half * (low + high), half * (high - low), weight_y * half_y);
            for (xi, weight_x) in self.rules.get(nodes_x) {
                let ray = S::Vec3::new(centre + half_x * xi, y, -self.height);
                self.add_point::<F, GRADIENT>(falloff, ray, weight_x * scale * half_x, &mut sums);
            }
            if GRADIENT {
                for (side, x) in strip.sides.into_iter().zip([low, high]) {
                    let ray = S::Vec3::new(x, y, -self.height);
                    // With F = ray·N, and dN = ω×N for a turn ω: ∂F/∂e = −N, ∂F/∂ω = N×ray.
                    let normal = side * (self.density(falloff, ray) * scale);
                    sums.sweep(x - self.reference, -normal, S::Vec3::default(), normal.cross(ray));
                }
            }
        }
        sums
    }

    fn over_disc<F: Falloff<S>, const GRADIENT: bool>(
        &self,
        falloff: &F,
        disc: &Disc<S>,
        to_middle: S::Vec3,
    ) -> Sums<S> {
        let mut sums = Sums::default();
        let [of_middle, of_ring] = disc.weights;
        self.add_point::<F, GRADIENT>(falloff, to_middle, of_middle, &mut sums);
        for &corner in &disc.corners {
            self.add_point::<F, GRADIENT>(falloff, to_middle + corner * disc.share, of_ring, &mut sums);
        }
        sums
    }

    fn conclude(&self, sums: Sums<S>, evaluations: usize) -> Option<(LightAndTurn<S>, Integration<S>)> {
        // NaN fails, too.
        let is_enough = sums.power.value >= least_power();
        let integration = Integration { evaluations, relative_error: self.orders.tolerance() };
        is_enough.then(|| (sums.light(self.reference, S::one()), integration))
    }
}
