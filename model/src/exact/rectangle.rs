//! The exact tier for a rectangular spot wholly in front of the emitter: a tensor Gauss–Legendre
//! rule, and the derivatives of that rule.
//!
//! With d = (X, Y, −h) from the emitter to a point of the spot, r = |d| and c = u·d/r, the power
//! is ∫ g dX dY, g = I_rel(c)·h/r³. Nodes X = X_m + H_x·ξ, Y = Y_m + H_y·η follow the spot's sides.
//! Writing ∇g = k₁·u − k₂·d with k₁ = h·r⁻⁴·I'(c) and k₂ = h·r⁻⁵·(c·I' + 3·I), all derivatives
//! reduce to moments of g, k₁ and k₂ over the nodes.

use crate::profile::Falloff;
use crate::rectangle::{Extent, Rectangle, RectangleLight, SideGradient};
use crate::scalar::{Linear3, Number, Real, zero_half_one};

use super::order::{MAX_NODES, Orders};

/// How a spot lies to its emitter, and to the horizon of that.
#[derive(Clone, Copy, Debug)]
pub struct Reaches<R> {
    /// u·d at the middle of the spot, and its least value.
    middle: R,
    least: R,
    /// To the emitter and to the horizon, along x and along y: see [`Orders::nodes`].
    emitter: [R; 2],
    horizon: [R; 2],
    /// From the emitter to the middle of the spot.
    pub distance: R,
    /// cos γ of that ray, and the greatest relative change of cos γ over the spot.
    pub cosine: R,
    tangent2: R,
    pub spread: R,
}

impl<R: Real> Reaches<R> {
    #[inline(always)]
    pub fn of(spot: &Rectangle<R>, axis: R::Vec3) -> Self {
        let (x, y, h) = (&spot.x, &spot.y, spot.height);
        let [_, half, one] = zero_half_one(h);
        // u·d is linear over the spot; its least value measures the distance to the horizon.
        let (slope_x, slope_y) = ((axis.x() * x.half).magnitude(), (axis.y() * y.half).magnitude());
        let middle = axis.x() * x.middle + axis.y() * y.middle - axis.z() * h;
        let least = middle - slope_x - slope_y;
        let (reach_x, reach_y) = (reach(x, y, h), reach(y, x, h));
        // On the beam's middle ray c = middle/r; over the spot c changes by tan γ·δ + δ²/2 at most, with δ
        // half the angle that its diagonal subtends.
        let distance = R::Vec3::new(x.middle, y.middle, -h).length();
        let cosine = (middle / distance).at_most(one);
        let angle2 = (reach_x * reach_x).inverse() + (reach_y * reach_y).inverse();
        let tangent2 = (one - cosine * cosine) / (cosine * cosine);
        let spread = (tangent2 * angle2).root() + half * angle2;
        let (emitter, horizon) = ([reach_x, reach_y], [one + least / slope_x, one + least / slope_y]);
        Self { middle, least, emitter, horizon, distance, cosine, tangent2, spread }
    }
}

/// The sum of the distances of the emitter, `height` above the spot, from the ends of the spot along one side, over its
/// length.
#[inline(always)]
fn reach<R: Real>(along: &Extent<R>, across: &Extent<R>, height: R) -> R {
    // The line across the spot nearest to the emitter's foot.
    let nearest = across.low.position.at_least(across.high.position.at_most(height.constant(0.0)));
    let d2 = height * height + nearest * nearest;
    let (low, high) = (along.low.position, along.high.position);
    ((low * low + d2).root() + (high * high + d2).root()) / (height.constant(2.0) * along.half)
}

impl<R: Real> Reaches<R> {
    /// ∂ln c = u/(u·d) − d/r² per angle, along x (0) or along y (1).
    #[inline(always)]
    pub fn slope(&self, spot: &Rectangle<R>, axis: R::Vec3, along: usize) -> R {
        let (axis, at) = if along == 0 { (axis.x(), spot.x.middle) } else { (axis.y(), spot.y.middle) };
        axis * self.distance / self.middle - at / self.distance
    }

    #[cfg(all(feature = "lanes", target_arch = "x86_64"))]
    #[inline(always)]
    pub fn lane(&self, lane: usize) -> Reaches<R::Element> {
        Reaches {
            middle: self.middle.lane(lane),
            least: self.least.lane(lane),
            emitter: [self.emitter[0].lane(lane), self.emitter[1].lane(lane)],
            horizon: [self.horizon[0].lane(lane), self.horizon[1].lane(lane)],
            distance: self.distance.lane(lane),
            cosine: self.cosine.lane(lane),
            tangent2: self.tangent2.lane(lane),
            spread: self.spread.lane(lane),
        }
    }
}

impl<S: Number> Reaches<S> {
    /// Nodes along x and along y; `None` if the spot must be divided because it touches the horizon or is very wide.
    /// `slope`: see [`Self::slope`].
    #[inline(always)]
    pub fn nodes(&self, orders: &Orders<S>, slope: impl Fn(usize) -> S) -> Option<[usize; 2]> {
        let Self { least, emitter, horizon, distance, tangent2, .. } = *self;
        if least <= S::zero() {
            return None;
        }
        let nodes = [orders.nodes(emitter[0], horizon[0])?, orders.nodes(emitter[1], horizon[1])?];
        let lobe = |along: usize| orders.lobe_nodes(tangent2, || slope(along), emitter[along]);
        let more = usize::from(distance > orders.far());
        Some([(nodes[0].max(lobe(0)?) + more).min(MAX_NODES), nodes[1].max(lobe(1)?)])
    }
}

/// Least share of its middle's light that a spot is taken to have: below, it is so wide that the expansion fails.
const MIN_SHARE: f64 = 0.25;

/// The light of a narrow spot by the expansion of g about its middle, in the half angles δ that the spot subtends: along
/// x to the fourth order, along y, where a detector is narrow, to the second. Power and centroid of the shipped scenes'
/// light are right to 10⁻⁵, better than by two nodes along either side; derivatives to some δ². `bends` gives I_rel at a
/// cos γ, and its first two derivatives relative to it.
///
/// X, Y and lengths count in units of r, k = I'/I, m = I″/I and e = u_x − c·X. With L = ln g,
///
/// * L' = k·e − 3X, g″/g = m·e² − k·(8X·e + c·(1 − X²)) + 15X² − 3, L″ = g″/g − L'²,
/// * L‴ = n·X·(6 − 8X²), L⁗ = 6n·(1 − 8X²·(1 − X²)), those of r⁻ⁿ with n = k·c + 3: what the profile adds to them is of
///   the third order in u_x,
/// * g‴/g = L‴ + 3L'·L″ + L'³, g⁗/g = L⁗ + 4L'·L‴ + 3L″² + 6L'²·L″ + L'⁴,
///
/// along x the mean of g/g₀ is 1 + H²·g″/6g + H⁴·g⁗/120g, and the centroid H²/3·(L' + H²·g‴/10g) over that mean.
/// Derivatives of the centroid are left out; what comes second is how far it moves per motion of the middle, H²·L″/3.
#[inline(always)]
pub fn narrow_light<S: Number, const GRADIENT: bool>(
    spot: &Rectangle<S>,
    axis: S::Vec3,
    bends: impl FnOnce(S) -> [S; 3],
) -> (RectangleLight<S>, S) {
    let (half, one, three, six, eight) = (S::half(), S::one(), S::of(3.0), S::of(6.0), S::of(8.0));
    let (xm, ym, h) = (spot.x.middle, spot.y.middle, spot.height);
    let inverse = (xm * xm + (ym * ym + h * h)).inverse_root();
    let (x, y, z) = (xm * inverse, ym * inverse, h * inverse);
    let c = axis.x() * x + axis.y() * y - axis.z() * z;
    let [relative, k, m] = bends(c);
    let n = k * c + three;
    // L' and g″/g.
    let along = |u: S, x: S| {
        let (e, x2) = (u - c * x, x * x);
        (k * e - three * x, m * e * e - k * (eight * x * e + c * (one - x2)) + S::of(15.0) * x2 - three)
    };
    let ((first, second), (first_y, second_y)) = (along(axis.x(), x), along(axis.y(), y));
    let (square, x2) = (first * first, x * x);
    let bend = second - square;
    let third = n * x * (six - eight * x2);
    let fourth = six * n * (one - eight * x2 * (one - x2));
    let of_third = third + first * (three * bend + square);
    let of_fourth = fourth + S::of(4.0) * first * third + bend * (three * bend + six * square) + square * square;
    let (hx, hy) = (spot.x.half * inverse, spot.y.half * inverse);
    let (hx2, hy2) = (hx * hx, hy * hy);
    let lower = S::of(1.0 / 6.0) * hx2 * second;
    let mean = (one + lower + S::of(1.0 / 120.0) * hx2 * hx2 * of_fourth) * (one + S::of(1.0 / 6.0) * hy2 * second_y);
    let power = S::of(4.0) * hx * hy * z * relative * mean.max(S::of(MIN_SHARE));
    let by_middle = S::of(1.0 / 3.0) * spot.x.half * hx;
    let offset = by_middle * (first + S::of(0.1) * hx2 * of_third) * (one - lower);
    let mut light = RectangleLight { power: SideGradient::of_value(power), centroid: SideGradient::of_value(offset) };
    if !GRADIENT {
        return (light, S::zero());
    }
    // Each side moves the middle by half of its way, and the extent by the other half.
    let scale = half * power * inverse;
    let (along_x, along_y) = (scale * first, scale * first_y);
    let (across_x, across_y) = (half * power / spot.x.half, half * power / spot.y.half);
    light.power.by_side = [along_x - across_x, along_x + across_x, along_y - across_y, along_y + across_y];
    light.power.by_height = power * (h.recip() - inverse * (k * axis.z() + n * z));
    light.power.by_axis = S::Vec3::new(x, y, -z) * (power * k);
    (light, by_middle * inverse * bend)
}

/// Power and centroid (relative to the emitter's foot) with nodes and weights `along_x` and `along_y`, on −1…1.
#[inline(always)]
pub fn light<R: Real, E: Falloff<R>, const GRADIENT: bool>(
    spot: &Rectangle<R>,
    axis: R::Vec3,
    emission: &E,
    along_x: &(impl Iterator<Item = (R, R)> + Clone),
    along_y: impl Iterator<Item = (R, R)>,
) -> RectangleLight<R> {
    let [zero, half, one] = zero_half_one(spot.height);
    let three = zero.constant(3.0);
    let (xm, hx, ym, hy, h) = (spot.x.middle, spot.x.half, spot.y.middle, spot.y.half, spot.height);
    let (ux, uy, uz) = (axis.x(), axis.y(), axis.z());

    // Moments over the nodes: g with 1, ξ; k₁ with 1, ξ, ξ², η, ξη; k₂ with 1, ξ, ξ², ξ³, η, ξη, ξ²η, η², ξη².
    let (mut g0, mut g1) = (zero, zero);
    let (mut k0, mut k1, mut k2, mut k01, mut k11) = (zero, zero, zero, zero, zero);
    let (mut l0, mut l1, mut l2, mut l3) = (zero, zero, zero, zero);
    let (mut l01, mut l11, mut l02, mut l12) = (zero, zero, zero, zero);
    for (eta, weight_y) in along_y {
        let y = ym + hy * eta;
        let across2 = y * y + h * h;
        let across_u = uy * y - uz * h;
        let (mut rg0, mut rg1) = (zero, zero);
        let (mut rk0, mut rk1, mut rk2) = (zero, zero, zero);
        let (mut rl0, mut rl1, mut rl2, mut rl3) = (zero, zero, zero, zero);
        for (xi, weight_x) in along_x.clone() {
            let x = xm + hx * xi;
            let inverse = (x * x + across2).root().inverse();
            let inverse2 = inverse * inverse;
            let c = (ux * x + across_u) * inverse;
            let density = weight_x * h * inverse2 * inverse;
            if GRADIENT {
                let (relative, slope) = emission.with_slope(c);
                let g = density * relative;
                let turn = density * slope;
                let kappa = turn * inverse;
                let lambda = (turn * c + three * g) * inverse2;
                let (kappa_xi, lambda_xi) = (kappa * xi, lambda * xi);
                let lambda_xi2 = lambda_xi * xi;
                rg0 += g;
                rg1 += g * xi;
                rk0 += kappa;
                rk1 += kappa_xi;
                rk2 += kappa_xi * xi;
                rl0 += lambda;
                rl1 += lambda_xi;
                rl2 += lambda_xi2;
                rl3 += lambda_xi2 * xi;
            } else {
                let g = density * emission.relative(c);
                rg0 += g;
                rg1 += g * xi;
            }
        }
        g0 += weight_y * rg0;
        g1 += weight_y * rg1;
        if GRADIENT {
            let weight_eta = weight_y * eta;
            let weight_eta2 = weight_eta * eta;
            k0 += weight_y * rk0;
            k1 += weight_y * rk1;
            k2 += weight_y * rk2;
            k01 += weight_eta * rk0;
            k11 += weight_eta * rk1;
            l0 += weight_y * rl0;
            l1 += weight_y * rl1;
            l2 += weight_y * rl2;
            l3 += weight_y * rl3;
            l01 += weight_eta * rl0;
            l11 += weight_eta * rl1;
            l02 += weight_eta2 * rl0;
            l12 += weight_eta2 * rl1;
        }
    }
    let area = hx * hy;
    let power = area * g0;
    let ratio = g1 / g0;
    let centroid = hx * ratio;
    if !GRADIENT {
        let plain = SideGradient::of_value;
        return RectangleLight { power: plain(power), centroid: plain(centroid) };
    }

    // Moments of ∂g/∂X with 1, ξ, ξ² and of ∂g/∂Y with 1, η, ξ, ξη.
    let gx0 = ux * k0 - (xm * l0 + hx * l1);
    let gx1 = ux * k1 - (xm * l1 + hx * l2);
    let gx2 = ux * k2 - (xm * l2 + hx * l3);
    let gy0 = uy * k0 - (ym * l0 + hy * l01);
    let gy1 = uy * k01 - (ym * l01 + hy * l02);
    let gy10 = uy * k1 - (ym * l1 + hy * l11);
    let gy11 = uy * k11 - (ym * l11 + hy * l12);
    let gh0 = g0 / h - uz * k0 - h * l0;
    let gh1 = g1 / h - uz * k1 - h * l1;
    // ∂g/∂u = k₁·d.
    let axis0 = R::Vec3::new(xm * k0 + hx * k1, ym * k0 + hy * k01, -h * k0);
    let axis1 = R::Vec3::new(xm * k1 + hx * k2, ym * k1 + hy * k11, -h * k1);

    let per_g0 = g0.inverse();
    let by = [ratio, per_g0];
    RectangleLight {
        power: SideGradient {
            value: power,
            by_side: [
                half * (area * (gx0 - gx1) - hy * g0),
                half * (area * (gx0 + gx1) + hy * g0),
                half * (area * (gy0 - gy1) - hx * g0),
                half * (area * (gy0 + gy1) + hx * g0),
            ],
            by_height: area * gh0,
            by_axis: axis0 * area,
        },
        centroid: SideGradient {
            value: centroid,
            by_side: [
                half * (one - ratio + hx * of_ratio(gx1 - gx2, gx0 - gx1, by)),
                half * (one + ratio + hx * of_ratio(gx1 + gx2, gx0 + gx1, by)),
                half * hx * of_ratio(gy10 - gy11, gy0 - gy1, by),
                half * hx * of_ratio(gy10 + gy11, gy0 + gy1, by),
            ],
            by_height: hx * of_ratio(gh1, gh0, by),
            by_axis: (axis1 - axis0 * ratio) * (hx * per_g0),
        },
    }
}

/// Derivative of the ratio of two moments, from theirs: ∂(g1/g0) = (∂g1 − ratio·∂g0)/g0.
#[inline(always)]
fn of_ratio<R: Real>(first: R, zeroth: R, [ratio, per_zeroth]: [R; 2]) -> R {
    (first - ratio * zeroth) * per_zeroth
}
