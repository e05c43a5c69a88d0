//! The integrand over any convex spot, and the frame in which it is integrated.
//!
//! The spot is cut along the emitter's horizon and sliced, at its corners' coordinates t, into slabs
//! with the shape of trapezoids. Near the horizon, t runs perpendicular to it: the integrand vanishes
//! there like tⁿ, which the slab that begins there has a rule for; other panels shrink geometrically towards
//! it. Derivatives follow Leibniz' rule: the
//! integral of ∂g/∂e, and for each moving side the light that its motion sweeps over ([`super::sides`]).

use heapless::Vec;

use crate::polygon::{EmitterGradient, MAX_CORNERS, Polygon};
use crate::profile::{CompiledProfile, Emission, Falloff, Series};
use crate::scalar::{Linear3, Number, Real};

use super::order::{MAX_NODES, Nodes, Orders, Rules};
use super::{Cosines, Integration, Method, panels, sides};

/// An end of a line is at the horizon if u·d there is within this share of the tolerance, or so many roundings, of what it is
/// at the other end.
const AT_HORIZON: (f64, f64) = (0.05, 64.0);

/// Contributions of panels and sides of the spot. Moments are about the spot's reference point.
#[derive(Default)]
pub struct Sums<S: Number> {
    pub power: EmitterGradient<S>,
    pub moment: EmitterGradient<S>,
    /// By a turn of the sides that ride with the emitter.
    pub turn: Turn<S>,
}

/// Derivatives of power and position by a turn about the emitter of all that rides with it, its axis excepted: cell
/// frame.
pub type Turn<S> = [<S as Real>::Vec3; 2];

impl<S: Number> Sums<S> {
    #[inline(always)]
    pub fn add(&mut self, x: S, value: S, by_position: S::Vec3, by_axis: S::Vec3) {
        for (sum, factor) in [(&mut self.power, S::one()), (&mut self.moment, x)] {
            sum.value += factor * value;
            sum.by_position += by_position * factor;
            sum.by_axis += by_axis * factor;
        }
    }

    /// Adds what a side sweeps over at `x` per motion of the emitter, its axis and what rides with it.
    #[inline(always)]
    pub fn sweep(&mut self, x: S, by_position: S::Vec3, by_axis: S::Vec3, by_turn: S::Vec3) {
        self.add(x, S::zero(), by_position, by_axis);
        self.turn[0] += by_turn;
        self.turn[1] += by_turn * x;
    }

    /// The light of sums about `reference` that count in units of 1/`factor`.
    #[inline(always)]
    pub fn light(self, reference: S, factor: S) -> LightAndTurn<S> {
        let Self { power, moment, turn: [power_turn, moment_turn] } = self;
        let inverse = power.value.recip();
        let x = moment.value * inverse;
        let of_ratio = |first: S::Vec3, zeroth: S::Vec3| (first - zeroth * x) * inverse;
        let centroid = EmitterGradient {
            value: reference + x,
            by_position: of_ratio(moment.by_position, power.by_position),
            by_axis: of_ratio(moment.by_axis, power.by_axis),
        };
        let power = EmitterGradient {
            value: power.value * factor,
            by_position: power.by_position * factor,
            by_axis: power.by_axis * factor,
        };
        ((power, centroid), [power_turn * factor, of_ratio(moment_turn, power_turn)])
    }
}

pub struct Integrand<'a, S: Number> {
    pub axis: S::Vec3,
    pub height: S,
    pub emission: &'a CompiledProfile<S>,
    pub orders: &'a Orders<S>,
    pub rules: &'a Rules<S>,
    /// Direction of t in the detector plane; s is at right angles.
    along_t: [S; 2],
    /// Whether t runs perpendicular to the horizon, so that u·d does not depend on s.
    pub across_horizon: bool,
    /// Factor of cos γ in the argument of the profile; see [`CompiledProfile::rescaling`].
    pub unit: S,
    /// The cone outside which a narrow lobe has faded, with s and t as its directions in the plane.
    pub cone: Option<Cone<S>>,
    pub reference: S,
    pub size: S,
    /// Nodes that a far emitter takes more; see [`Orders::far`].
    more: usize,
}

/// A slab between two values of t; its sides are s = start + slope·(t − t₀).
#[derive(Clone, Copy)]
pub struct Slab<S> {
    pub t: [S; 2],
    left: [S; 2],
    right: [S; 2],
}

impl<S: Number> Slab<S> {
    /// s of the left and the right side at `t`.
    pub fn sides(&self, t: S) -> [S; 2] {
        let dt = t - self.t[0];
        [self.left[0] + self.left[1] * dt, self.right[0] + self.right[1] * dt]
    }

    pub fn s(&self, share: S, t: S) -> S {
        let [left, right] = self.sides(t);
        left + share * (right - left)
    }
}

/// Power and centroid (relative to the emitter's foot) of the light on a polygon.
pub type PolygonLight<S> = (EmitterGradient<S>, EmitterGradient<S>);

/// The light on a polygon, and its derivatives by a turn.
pub type LightAndTurn<S> = (PolygonLight<S>, Turn<S>);

/// The light on `polygon` with derivatives with respect to the emitter and to a turn of the sides that ride with it,
/// `None` if none is found; and the cost and accuracy of the integrals.
pub fn polygon_light<S: Number, const GRADIENT: bool>(
    mut polygon: Polygon<S>,
    axis: S::Vec3,
    method: &Method<'_, S>,
) -> (Option<LightAndTurn<S>>, Integration<S>) {
    let nothing = (None, Integration { evaluations: 0, relative_error: method.orders.tolerance() });
    if !polygon.clip_horizon(axis) {
        return nothing;
    }
    let (divisor, factor) = method.emission.rescaling(|| polygon.greatest_cosine(axis), corner_cosine(&polygon, axis));
    if factor == S::zero() {
        // The light is below the smallest number.
        return nothing;
    }
    let integrand = Integrand::new(&polygon, axis, method, divisor.recip());
    let (mut sums, integration) = panels::add_all::<S, GRADIENT>(&integrand, &integrand.slabs(&polygon));
    let total = sums.power.value;
    if total.is_nan() || total <= S::zero() {
        return (None, integration);
    }
    if GRADIENT {
        for (line, a, b) in polygon.edges() {
            sides::add(&integrand, line, a, b, total, &mut sums);
        }
    }
    (Some(sums.light(integrand.reference, factor)), integration)
}

/// cos γ at the brightest corner.
fn corner_cosine<S: Number>(polygon: &Polygon<S>, axis: S::Vec3) -> S {
    let cosines = polygon.corners().iter().map(|&[x, y]| {
        let ray = S::Vec3::new(x, y, -polygon.height());
        axis.dot(ray) / ray.length()
    });
    cosines.fold(S::zero(), S::max)
}

impl<'a, S: Number> Integrand<'a, S> {
    fn new(polygon: &Polygon<S>, axis: S::Vec3, method: &Method<'a, S>, unit: S) -> Self {
        let height = polygon.height();
        let (mut least, mut brightest) = (S::infinity(), S::zero());
        for &[x, y] in polygon.corners() {
            let front = axis.dot(S::Vec3::new(x, y, -height));
            least = least.min(front);
            brightest = brightest.max(front);
        }
        let inclination = S::norm(axis.x(), axis.y());
        let horizon_near = least < S::of(0.25) * brightest;
        let across_horizon = horizon_near && inclination > S::zero();
        let along_t =
            if across_horizon { [axis.x() / inclination, axis.y() / inclination] } else { [S::zero(), S::one()] };
        let [x0, y0] = polygon.corners()[0];
        let size = polygon.corners().iter().fold(S::zero(), |size, &[x, y]| size.max(S::norm(x - x0, y - y0)));
        let [tx, ty] = along_t;
        let (ux, uy, uz) = (axis.x(), axis.y(), axis.z());
        let orders = method.orders;
        let cone = orders.is_narrow().then(|| Cone {
            axis: [ux * ty - uy * tx, ux * tx + uy * ty, uz],
            height,
            cosine: orders.faded(polygon.greatest_cosine(axis)),
        });
        let undivided = Self::undivided(S::Vec3::new(x0, y0, -height), axis, method);
        Self { along_t, across_horizon, unit, cone, size, ..undivided }
    }

    /// Of a spot that is not divided, with moments about a `place` in it, relative to the emitter.
    #[inline(always)]
    pub fn undivided(place: S::Vec3, axis: S::Vec3, method: &Method<'a, S>) -> Self {
        let Method { emission, orders, rules } = *method;
        let (height, reference, more) = (-place.z(), place.x(), usize::from(place.length() > orders.far()));
        let (along_t, across_horizon, unit, cone, size) = ([S::zero(), S::one()], false, S::one(), None, S::zero());
        Self { axis, height, emission, orders, rules, along_t, across_horizon, unit, cone, reference, size, more }
    }

    fn xy(&self, s: S, t: S) -> [S; 2] {
        let [tx, ty] = self.along_t;
        [s * ty + t * tx, t * ty - s * tx]
    }

    pub fn ray(&self, s: S, t: S) -> S::Vec3 {
        let [x, y] = self.xy(s, t);
        S::Vec3::new(x, y, -self.height)
    }

    fn slabs(&self, polygon: &Polygon<S>) -> Vec<Slab<S>, MAX_CORNERS> {
        let [tx, ty] = self.along_t;
        let turned = |[x, y]: [S; 2]| [x * ty - y * tx, x * tx + y * ty];
        let mut levels: Vec<S, MAX_CORNERS> = polygon.corners().iter().map(|&corner| turned(corner)[1]).collect();
        levels.sort_unstable_by(|a, b| a.partial_cmp(b).unwrap_or(core::cmp::Ordering::Equal));
        let mut slabs = Vec::new();
        for pair in levels.windows(2) {
            let (t0, t1) = (pair[0], pair[1]);
            if t1 <= t0 {
                continue;
            }
            let middle = S::half() * (t0 + t1);
            let (mut left, mut right) = ([S::infinity(); 3], [S::neg_infinity(); 3]);
            for (_, a, b) in polygon.edges() {
                let (a, b) = (turned(a), turned(b));
                if middle < a[1].min(b[1]) || middle > a[1].max(b[1]) || a[1] == b[1] {
                    continue;
                }
                let slope = (b[0] - a[0]) / (b[1] - a[1]);
                let at = |t: S| a[0] + slope * (t - a[1]);
                let side = [at(middle), at(t0), slope];
                if side[0] < left[0] {
                    left = side;
                }
                if side[0] > right[0] {
                    right = side;
                }
            }
            if right[0] > left[0] {
                let _ = slabs.push(Slab { t: [t0, t1], left: [left[1], left[2]], right: [right[1], right[2]] });
            }
        }
        slabs
    }

    /// cos γ over a patch, as arguments of the profile.
    pub fn cosines<const N: usize>(&self, corners: [S::Vec3; N]) -> Cosines<S> {
        let Cosines { lower, middle, upper } = Cosines::<S>::of(corners, self.axis);
        Cosines { lower: lower * self.unit, middle: middle * self.unit, upper: upper * self.unit }
    }

    /// The numbers of nodes that suffice along lines, each given by its reaches to emitter and horizon (see [`Orders`])
    /// and the difference of cos γ between its ends, and the profile's series; `None` if they cannot be foreseen.
    pub fn foreseen<const N: usize>(
        &self,
        corners: [S::Vec3; N],
        along: impl Iterator<Item = (S, S, S)>,
    ) -> Option<(Vec<usize, 2>, Option<Series<S>>)> {
        let mut nodes: Vec<usize, 2> = Vec::new();
        let mut lines: Vec<[S; 2], 2> = Vec::new();
        for (reach, horizon, difference) in along {
            let count = (self.orders.nodes(reach, horizon)? + self.more).min(MAX_NODES);
            let _ = (nodes.push(count), lines.push([reach, difference]));
        }
        if !self.emission.needs_series() && !self.orders.is_narrow() {
            return Some((nodes, None));
        }
        let cosines = Cosines::<S>::of(corners, self.axis);
        if cosines.middle <= S::zero() {
            return None;
        }
        let needs_series = self.emission.needs_series();
        let series = if needs_series { Some(self.emission.near(cosines.middle, cosines.spread())?) } else { None };
        for (count, &[reach, difference]) in nodes.iter_mut().zip(&lines) {
            // The line subtends 2/reach radians.
            let slope = S::half() * difference * reach / cosines.middle;
            let lobe = self.orders.lobe_nodes(cosines.tangent2(), || slope, reach)? + self.more;
            *count = (*count).max(lobe);
            *count = series.map_or(*count, |series| series.nodes_with(*count));
            if *count > MAX_NODES {
                return None;
            }
        }
        Some((nodes, series))
    }

    /// The rule along a line on which u·d rises from `low` to `high`, if `low` is at the horizon; see
    /// [`Orders::horizon_rule`].
    pub fn horizon_rule(&self, [low, high]: [S; 2], reach: S) -> Option<Nodes<'_, S>> {
        let (share, roundings) = AT_HORIZON;
        let zero = (S::of(share) * self.orders.tolerance()).max(S::of(roundings) * S::epsilon());
        if self.emission.needs_series() || low > zero * high {
            return None;
        }
        self.orders.horizon_rule(reach)
    }

    /// I_rel·h/r³ at a point of the detector, per area; zero behind the horizon.
    #[inline(always)]
    pub fn density<F: Falloff<S>>(&self, falloff: &F, ray: S::Vec3) -> S {
        let inverse = ray.length().recip();
        let c = self.axis.dot(ray) * inverse * self.unit;
        let relative = if c > S::zero() { falloff.relative(c) } else { S::zero() };
        relative * self.height * inverse * inverse * inverse
    }

    /// Adds g at a point, and ∇g there: see [`super::rectangle`] for k₁ (`kappa`) and k₂ (`lambda`).
    #[inline(always)]
    pub fn add_point<F: Falloff<S>, const GRADIENT: bool>(
        &self,
        falloff: &F,
        ray: S::Vec3,
        weight: S,
        sums: &mut Sums<S>,
    ) {
        let inverse = ray.length().recip();
        let c = self.axis.dot(ray) * inverse;
        if c <= S::zero() {
            return;
        }
        let density = weight * self.height * inverse * inverse * inverse;
        let x = ray.x() - self.reference;
        if GRADIENT {
            let (relative, slope) = falloff.with_slope(c * self.unit);
            let (g, turn) = (density * relative, density * slope * self.unit);
            let kappa = turn * inverse;
            let lambda = (turn * c + S::of(3.0) * g) * inverse * inverse;
            // At a fixed point of the detector ∂d/∂e = −1, and g is also proportional to the height.
            let by_position = ray * lambda - self.axis * kappa + S::Vec3::new(S::zero(), S::zero(), g / self.height);
            sums.add(x, g, by_position, ray * kappa);
        } else {
            let g = density * falloff.relative(c * self.unit);
            sums.power.value += g;
            sums.moment.value += x * g;
        }
    }
}

/// Nodes along s and t: the slab's width, linear in t, adds one degree along t.
pub fn of_slab(nodes: &[usize]) -> (usize, usize) {
    (nodes[0], (nodes[1] + 1).min(MAX_NODES))
}

/// The cone cos γ ≥ `cosine` around an axis, above the plane at `height` below the emitter.
pub struct Cone<S> {
    /// Components of the axis along the two directions of the plane, and along its normal.
    pub axis: [S; 3],
    pub height: S,
    pub cosine: S,
}

impl<S: Number> Cone<S> {
    /// The part of the box `ranges` that contains the cone within it; the box itself without a known bound.
    pub fn within(&self, ranges: [[S; 2]; 2]) -> [[S; 2]; 2] {
        let [x, y] = ranges;
        let [ux, uy, uz] = self.axis;
        let across = Self { axis: [uy, ux, uz], ..*self };
        let y = across.narrowed(y, x);
        let x = self.narrowed(x, y);
        [x, across.narrowed(y, x)]
    }

    /// The part of `range` along the first direction that contains the cone over `strip` along the second.
    fn narrowed(&self, range: [S; 2], strip: [S; 2]) -> [S; 2] {
        let lit = [S::one(), -S::one()].map(|side| self.end(side, strip));
        let [Some(high), Some(low)] = lit else { return range };
        let narrowed = [range[0].max(low), range[1].min(high)];
        if narrowed[0] < narrowed[1] { narrowed } else { range }
    }

    /// The farthest lit point over `strip` in the direction `side`, +1 or −1; `None` without a known bound.
    fn end(&self, side: S, strip: [S; 2]) -> Option<S> {
        let ([ux, uy, uz], h, c) = (self.axis, self.height, self.cosine);
        let sine2 = (S::one() - c * c).max(S::zero());
        let q2 = ux * ux + uz * uz - sine2;
        let a = c * c - ux * ux;
        let b = c * c - uy * uy;
        if !(q2 > S::zero() && a > S::zero() && b > S::zero()) {
            return None;
        }
        let (q, sine) = (q2.root(), sine2.root() * side);
        let down = -uz * q - ux * sine;
        if down <= S::zero() {
            return None;
        }
        let farthest = h * (ux * q - uz * sine) / down;
        let touches = uy * (ux * farthest - uz * h) / b;
        if strip[0] <= touches && touches <= strip[1] {
            return Some(farthest);
        }
        let at = |y: S| {
            let w = uy * y - uz * h;
            let root2 = w * w - (y * y + h * h) * a;
            (root2 >= S::zero()).then(|| (ux * w + side * c * root2.root()) / a)
        };
        // Lines that miss the cone are skipped.
        strip.into_iter().filter_map(at).reduce(|one, other| if (one - other) * side > S::zero() { one } else { other })
    }
}
