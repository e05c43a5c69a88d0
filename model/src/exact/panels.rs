//! The exact tier for any convex spot: divided into panels until each meets the tolerance.
//!
//! The spot is cut along the emitter's horizon, sliced into slabs at its corners' coordinates t,
//! and each slab, a trapezoid, is bisected until a tensor rule of at most
//! [`MAX_NODES`](super::order::MAX_NODES) suffices on each panel. Where the horizon is near, t runs
//! perpendicular to it: the integrand vanishes there like tⁿ, and panels shrink geometrically
//! towards it. Derivatives are those of the integral (Leibniz): ∂g/∂e inside, and for each moving
//! side the light that its motion sweeps over.

use heapless::Vec;

use crate::polygon::{EmitterGradient, Line, MAX_CORNERS, Polygon};
use crate::profile::Emission;
use crate::scalar::{Linear3, Scalar};

use super::order::{MAX_NODES, Orders, Rules};

/// Panels after which no more are divided: reached only by spots much wider than the emitter is
/// far away, or by coarse profile tables at tolerances below 1e-12.
const MAX_PANELS: usize = 1 << 16;

/// Panels waiting: bisection keeps at most one per level, and 2⁻⁹⁶ is beyond any scale here.
const MAX_WAITING: usize = 96;

/// What a panel or a side of the spot contributes.
struct Sums<S: Scalar> {
    power: EmitterGradient<S>,
    moment: EmitterGradient<S>,
}

/// The integrand, its frame and its accuracy.
struct Integrand<'a, S: Scalar, E> {
    axis: S::Vec3,
    height: S,
    emission: &'a E,
    orders: &'a Orders<S>,
    rules: &'a Rules<S>,
    /// Direction of t in the detector plane; s is at right angles.
    along_t: [S; 2],
    /// Whether t runs perpendicular to the horizon, so that u·d does not depend on s.
    across_horizon: bool,
    /// u·d on the brightest corner, and the share of it below which light is negligible.
    brightest: S,
    negligible: S,
    /// Angular width of the whole spot.
    width: S,
}

/// A slab between two values of t, with its sides s = start + slope·(t − t₀).
#[derive(Clone, Copy)]
struct Slab<S> {
    t: [S; 2],
    left: [S; 2],
    right: [S; 2],
}

impl<S: Scalar> Slab<S> {
    fn s(&self, share: S, t: S) -> S {
        let dt = t - self.t[0];
        let left = self.left[0] + self.left[1] * dt;
        left + share * (self.right[0] + self.right[1] * dt - left)
    }
}

/// Part of a slab: a range of shares from its left to its right side, and a range of t.
#[derive(Clone, Copy)]
struct Panel<S> {
    share: [S; 2],
    t: [S; 2],
}

/// Power and centroid (relative to the emitter's foot) of the light on `polygon`, with
/// derivatives by the emitter; `None` if the emitter faces away from all of it.
pub(crate) fn light<S: Scalar, E: Emission<S>, const GRADIENT: bool>(
    mut polygon: Polygon<S>,
    axis: S::Vec3,
    emission: &E,
    orders: &Orders<S>,
    rules: &Rules<S>,
) -> Option<(EmitterGradient<S>, EmitterGradient<S>)> {
    if !polygon.clip_horizon(axis) {
        return None;
    }
    let integrand = Integrand::new(&polygon, axis, emission, orders, rules);
    let mut sums = Sums { power: EmitterGradient::default(), moment: EmitterGradient::default() };
    for slab in integrand.slabs(&polygon) {
        integrand.add_slab::<GRADIENT>(&slab, &mut sums);
    }
    if GRADIENT {
        for (line, a, b) in polygon.edges() {
            integrand.add_side(line, a, b, &mut sums);
        }
    }
    let Sums { power, moment } = sums;
    if power.value <= S::zero() {
        return None;
    }
    let inverse = power.value.recip();
    let x = moment.value * inverse;
    let of_ratio = |first: S::Vec3, zeroth: S::Vec3| (first - zeroth * x) * inverse;
    let centroid = EmitterGradient {
        value: x,
        by_position: of_ratio(moment.by_position, power.by_position),
        by_axis: of_ratio(moment.by_axis, power.by_axis),
    };
    Some((power, centroid))
}

impl<'a, S: Scalar, E: Emission<S>> Integrand<'a, S, E> {
    fn new(polygon: &Polygon<S>, axis: S::Vec3, emission: &'a E, orders: &'a Orders<S>, rules: &'a Rules<S>) -> Self {
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
        let first = polygon.corners()[0];
        let (mut size, mut nearest) = (S::zero(), S::infinity());
        for &[x, y] in polygon.corners() {
            size = size.max(S::norm(x - first[0], y - first[1]));
            nearest = nearest.min(S::Vec3::new(x, y, height).length());
        }
        let power_of_distance = (S::one() + emission.steepness()).recip();
        Self {
            axis,
            height,
            emission,
            orders,
            rules,
            along_t,
            across_horizon,
            brightest,
            negligible: orders.tolerance().power(power_of_distance),
            width: size / nearest,
        }
    }

    fn xy(&self, s: S, t: S) -> [S; 2] {
        let [tx, ty] = self.along_t;
        [s * ty + t * tx, t * ty - s * tx]
    }

    fn ray(&self, s: S, t: S) -> S::Vec3 {
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

    fn add_slab<const GRADIENT: bool>(&self, slab: &Slab<S>, sums: &mut Sums<S>) {
        let mut waiting: Vec<Panel<S>, MAX_WAITING> = Vec::new();
        let whole = Panel { share: [S::zero(), S::one()], t: slab.t };
        let _ = waiting.push(whole);
        let mut panels = 1;
        while let Some(panel) = waiting.pop() {
            let room = panels < MAX_PANELS && waiting.len() + 2 <= MAX_WAITING;
            match self.division(slab, &panel) {
                Division::Along(halves) if room => {
                    panels += 1;
                    let _ = waiting.push(halves[0]);
                    let _ = waiting.push(halves[1]);
                }
                Division::Along(_) => self.add_panel::<GRADIENT>(slab, &panel, (MAX_NODES, MAX_NODES), sums),
                Division::None(nodes) => self.add_panel::<GRADIENT>(slab, &panel, nodes, sums),
            }
        }
    }

    /// Whether and how to divide a panel.
    fn division(&self, slab: &Slab<S>, panel: &Panel<S>) -> Division<S> {
        let [t0, t1] = panel.t;
        let [c0, c1] = panel.share;
        let middle = |range: [S; 2]| S::half() * (range[0] + range[1]);
        let halves_of_share = || {
            let m = middle(panel.share);
            [[c0, m], [m, c1]].map(|share| Panel { share, ..*panel })
        };
        let halves_of_t = || {
            let m = middle(panel.t);
            [[t0, m], [m, t1]].map(|t| Panel { t, ..*panel })
        };
        let front = |share: S, t: S| self.axis.dot(self.ray(slab.s(share, t), t)).max(S::zero());
        let corners = [[c0, t0], [c1, t0], [c0, t1], [c1, t1]].map(|[share, t]| front(share, t));
        let brightest = corners.into_iter().fold(S::zero(), S::max);
        if brightest <= self.negligible * self.brightest {
            return Division::None((MAX_NODES, MAX_NODES));
        }
        let horizon = |a: S, b: S| if a == b { S::infinity() } else { (a + b) / (a - b).abs() };
        let reach = |[s0, t0]: [S; 2], [s1, t1]: [S; 2]| {
            let length = S::norm(s1 - s0, t1 - t0);
            let rays = self.ray(s0, t0).length() + self.ray(s1, t1).length();
            if length > S::zero() { rays / length } else { S::infinity() }
        };
        let clamp = |value: S, range: [S; 2]| range[0].max(range[1].min(value));

        // Lines along s and along t at the panel's ends and nearest to the emitter's foot.
        let t_near = clamp(S::zero(), panel.t);
        let reach_s = [t0, t1, t_near]
            .map(|t| reach([slab.s(c0, t), t], [slab.s(c1, t), t]))
            .into_iter()
            .fold(S::infinity(), S::min);
        let share_near = {
            let t = middle(panel.t);
            let (left, right) = (slab.s(S::zero(), t), slab.s(S::one(), t));
            clamp(-left / (right - left), panel.share)
        };
        let reach_t = [c0, c1, share_near]
            .map(|share| reach([slab.s(share, t0), t0], [slab.s(share, t1), t1]))
            .into_iter()
            .fold(S::infinity(), S::min);
        let horizon_s = if self.across_horizon {
            S::infinity()
        } else {
            horizon(corners[0], corners[1]).min(horizon(corners[2], corners[3]))
        };
        let horizon_t = horizon(corners[0], corners[2]).min(horizon(corners[1], corners[3]));

        let Some(along_s) = self.orders.nodes(reach_s, horizon_s) else {
            return Division::Along(halves_of_share());
        };
        let Some(along_t) = self.orders.nodes(reach_t, horizon_t) else {
            return Division::Along(halves_of_t());
        };
        if self.has_kink(slab, panel, reach_s.min(reach_t)) {
            return Division::Along(if reach_s < reach_t { halves_of_share() } else { halves_of_t() });
        }
        // A slab's width is linear in t: one degree more along t.
        Division::None((along_s, (along_t + 1).min(MAX_NODES)))
    }

    /// Whether a kink of a tabulated profile inside the panel matters. A jump J of d²I/dγ² in a
    /// panel of angular width δ changes its power by J·δ²/4 at most; of the spot's panels along
    /// the kink this is a share δ/width.
    fn has_kink(&self, slab: &Slab<S>, panel: &Panel<S>, reach: S) -> bool {
        let [c0, c1] = panel.share;
        let [t0, t1] = panel.t;
        let corners = [[c0, t0], [c1, t0], [c1, t1], [c0, t1]].map(|[share, t]| self.ray(slab.s(share, t), t));
        super::kink(corners, self.axis, self.emission).is_some_and(|jump| {
            let delta = S::two() / reach;
            jump * delta * delta * delta > S::of(4.0) * self.orders.tolerance() * self.width
        })
    }

    fn add_panel<const GRADIENT: bool>(
        &self,
        slab: &Slab<S>,
        panel: &Panel<S>,
        nodes: (usize, usize),
        sums: &mut Sums<S>,
    ) {
        let half = S::half();
        let [t0, t1] = panel.t;
        let half_t = half * (t1 - t0);
        let half_share = half * (panel.share[1] - panel.share[0]);
        let middle_share = half * (panel.share[0] + panel.share[1]);
        for (eta, weight_t) in self.rules.get(nodes.1) {
            let t = half * (t0 + t1) + half_t * eta;
            let (left, right) = (slab.s(S::zero(), t), slab.s(S::one(), t));
            let scale = weight_t * half_t * half_share * (right - left);
            for (xi, weight_s) in self.rules.get(nodes.0) {
                let s = left + (right - left) * (middle_share + half_share * xi);
                self.add_point::<GRADIENT>(self.ray(s, t), weight_s * scale, sums);
            }
        }
    }

    /// Adds g at a point, and ∇g there: see [`super::rectangle`] for k₁ (`kappa`) and k₂ (`lambda`).
    fn add_point<const GRADIENT: bool>(&self, ray: S::Vec3, weight: S, sums: &mut Sums<S>) {
        let inverse = ray.length().recip();
        let c = self.axis.dot(ray) * inverse;
        if c <= S::zero() {
            return;
        }
        let density = weight * self.height * inverse * inverse * inverse;
        let x = ray.x();
        if GRADIENT {
            let (relative, slope) = self.emission.with_slope(c);
            let g = density * relative;
            let kappa = density * slope * inverse;
            let lambda = (density * slope * c + S::of(3.0) * g) * inverse * inverse;
            // At a fixed point of the detector, d falls as e moves; height also scales g.
            let by_position = ray * lambda - self.axis * kappa + S::Vec3::new(S::zero(), S::zero(), g / self.height);
            let by_axis = ray * kappa;
            add(&mut sums.power, S::one(), g, by_position, by_axis);
            add(&mut sums.moment, x, g, by_position, by_axis);
        } else {
            let g = density * self.emission.relative(c);
            sums.power.value += g;
            sums.moment.value += x * g;
        }
    }

    /// Adds the light that the side from `a` to `b` sweeps over as it moves.
    fn add_side(&self, line: &Line<S>, a: [S; 2], b: [S; 2], sums: &mut Sums<S>) {
        let length = S::norm(b[0] - a[0], b[1] - a[1]);
        let at = |share: S| S::Vec3::new(a[0] + share * (b[0] - a[0]), a[1] + share * (b[1] - a[1]), -self.height);
        let front = |ray: S::Vec3| self.axis.dot(ray).max(S::zero());
        let mut waiting: Vec<[S; 2], MAX_WAITING> = Vec::new();
        let _ = waiting.push([S::zero(), S::one()]);
        while let Some([low, high]) = waiting.pop() {
            let (p, q) = (at(low), at(high));
            let (fp, fq) = (front(p), front(q));
            let reach = (p.length() + q.length()) / (length * (high - low));
            let horizon = if fp == fq { S::infinity() } else { (fp + fq) / (fp - fq).abs() };
            let needed = self.orders.nodes(reach, horizon);
            let faint = fp.max(fq) <= self.negligible * self.brightest;
            if needed.is_none() && !faint && waiting.len() + 2 <= MAX_WAITING {
                let middle = S::half() * (low + high);
                let _ = waiting.push([low, middle]);
                let _ = waiting.push([middle, high]);
                continue;
            }
            let half_length = S::half() * length * (high - low);
            for (xi, weight) in self.rules.get(needed.unwrap_or(MAX_NODES)) {
                let ray = at(S::half() * (low + high) + S::half() * (high - low) * xi);
                let inverse = ray.length().recip();
                let c = self.axis.dot(ray) * inverse;
                let relative = match line.motion {
                    crate::polygon::Motion::Horizon { .. } => self.emission.at_horizon(),
                    _ if c > S::zero() => self.emission.relative(c),
                    _ => S::zero(),
                };
                let g = weight * half_length * relative * self.height * inverse * inverse * inverse;
                let by_position = line.speed_by_position(ray) * g;
                let by_axis = line.speed_by_axis(ray) * g;
                add(&mut sums.power, S::one(), S::zero(), by_position, by_axis);
                add(&mut sums.moment, ray.x(), S::zero(), by_position, by_axis);
            }
        }
    }
}

/// A panel's fate.
enum Division<S> {
    Along([Panel<S>; 2]),
    None((usize, usize)),
}

fn add<S: Scalar>(sum: &mut EmitterGradient<S>, factor: S, value: S, by_position: S::Vec3, by_axis: S::Vec3) {
    sum.value += factor * value;
    sum.by_position += by_position * factor;
    sum.by_axis += by_axis * factor;
}
