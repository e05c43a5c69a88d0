//! The number of Gauss–Legendre nodes for a tolerance.
//!
//! The integrand of a spot, h·cosⁿγ/r³ = h·(u·d)ⁿ·r⁻⁽ⁿ⁺³⁾, is analytic except at the emitter itself
//! (r = 0 at complex positions) and at the horizon (u·d = 0). On the interval −1…1 across the
//! spot, N nodes err by K_N·ρ⁻²ᴺ, where ρ = s + √(s²−1) belongs to the Bernstein ellipse through
//! the nearest singularity and s is half the sum of that singularity's distances from the
//! interval's ends. For the emitter these distances are the lengths of the two rays to the ends of
//! the spot.
//!
//! K_N follows from the remainder of the rule (Abramowitz and Stegun 25.4.30) for a singularity
//! (1 − ξ/s)⁻ᵖ, with the emitter's two conjugate singularities taken as one real one of twice the power:
//! K_N = 4ᴺ·2²ᴺ(N!)⁴/((2N+1)((2N)!)²)·|binomial(−p, 2N)|. That is pessimistic; neglecting the first
//! moment's extra degree is optimistic. Together they leave a margin of a factor of two and more for each electrode.
//! The rule errs in the first moment about s times as much as in the power, and an electrode weighs the moment by the
//! spot's half width over the detector's length: that is no more than the emitter's distance over that length. Beyond
//! [`FAR_LENGTHS`] one more node is taken, which errs s² times less.
//!
//! Above an exponent of [`NARROW_LOBE`] this bound is far too pessimistic: cosⁿγ is then nearly a Gaussian
//! lobe, ln cosⁿγ ≈ λξ − κξ²/2 along the interval. On the ellipse ρ it grows by exp(λρ/2) and exp(κρ²/8);
//! at the best ρ, 4N/λ or √(8N/κ), N nodes err by (eλ/4N)²ᴺ or (eκ/8N)ᴺ, together at most by
//! ((λ² + 2Nκ/e)·(e/4N)²)ᴺ. Emitter and horizon must lie outside that ellipse.
//!
//! An interval that begins at the horizon, t = 0, has an integrand tⁿ·g(t), and derivatives tⁿ⁻¹·g(t), with g analytic
//! except at the emitter. The Gauss–Jacobi rule of weight tⁿ⁻¹ ([`Orders::horizon_rule`]) integrates both as Gauss–Legendre
//! does a spot far from the horizon.

use core::iter::{Copied, Zip};
use core::slice::Iter;

use crate::scalar::Number;
#[cfg(all(feature = "lanes", target_arch = "x86_64"))]
use crate::scalar::Real;

/// Nodes and weights of a rule, on −1…1.
pub type Nodes<'a, S> = Zip<Copied<Iter<'a, S>>, Copied<Iter<'a, S>>>;

/// Most nodes of a rule; spots that need more are divided.
pub const MAX_NODES: usize = 12;

/// Nodes of the rule for intervals that begin at the horizon.
pub const HORIZON_NODES: usize = 6;

/// Above this exponent the lobe, not emitter and horizon, decides the number of nodes.
const NARROW_LOBE: f64 = 4.0;

/// Distance of an emitter, in lengths of the detector, from which on the first moment takes one more node.
const FAR_LENGTHS: f64 = 3.0;

/// Share of the tolerance for the estimate of a lobe, which is taken at the spot's middle only.
const LOBE_SHARE: f64 = 0.1;

/// A narrow lobe is left out where it has fallen below this share of the tolerance, relative to its brightest ray in
/// the spot, if the total left out is small enough: see [`Orders::may_leave_out`].
const FADED_SHARE: f64 = 1e-4;

/// Share of the tolerance for the light left out.
const LEFT_OUT_SHARE: f64 = 0.1;

/// Equivalent exponent of a profile that is a [`Series`](crate::profile::Series) within a spot: its
/// addition to the emitter's own singularity. The series counts the nodes for itself.
pub const SERIES_EXPONENT: f64 = 1.5;

/// The least s for which N nodes suffice, for one emission profile and tolerance.
#[derive(Clone, Debug)]
pub struct Orders<S> {
    emitter: [S; MAX_NODES],
    horizon: [S; MAX_NODES],
    /// For the nearer of emitter and horizon, when both factors vary together.
    both: [S; MAX_NODES],
    falloff: Shape<S>,
    /// Factor by which cos γ falls to where a narrow lobe has faded; one for other profiles.
    faded: S,
    exponent: S,
    tolerance: S,
    /// [`FAR_LENGTHS`], metres.
    far: S,
}

/// How light falls off from the emitter's axis to its horizon.
#[derive(Clone, Debug)]
enum Shape<S> {
    Constant,
    /// Like a low power of the distance from the horizon: nodes and weights of the rule for an interval that begins there.
    Broad([[S; HORIZON_NODES]; 2]),
    /// As a lobe that does not reach the horizon: the greatest λ² + 2Nκ/e of each number of nodes.
    Narrow([S; MAX_NODES]),
}

/// 2/e.
const BEND_SHARE: f64 = 2.0 / core::f64::consts::E;

impl<S: Number> Orders<S> {
    /// `length_m`: that of the detector.
    pub fn new(exponent: f64, tolerance: f64, length_m: f64) -> Self {
        let least = |power: f64, nodes: usize| {
            let k = remainder(nodes) * binomial(power, 2 * nodes);
            let rho = libm::pow(k / tolerance, 0.5 / nodes as f64).max(1.0);
            0.5 * (rho + rho.recip())
        };
        let narrow = exponent > NARROW_LOBE;
        // e·T^(−1/2N): the best ρ of a lobe that N nodes just resolve.
        let allowed = LOBE_SHARE * tolerance;
        let ellipse = |nodes: usize| core::f64::consts::E * libm::pow(allowed, -0.5 / nodes as f64);
        let table = |of: &dyn Fn(usize) -> f64| core::array::from_fn(|i| S::of(of(i + 1)));
        let four_per_e = 4.0 / core::f64::consts::E;
        let lobe = |nodes: usize| {
            let count = nodes as f64;
            four_per_e * four_per_e * count * count * libm::pow(allowed, count.recip())
        };
        Self {
            emitter: table(&|n| if narrow { least(-6.0, n).max(ellipse(n)) } else { least(-(exponent + 3.0), n) }),
            horizon: table(&|n| if narrow { ellipse(n) } else { least(exponent, n) }),
            both: table(&|n| if narrow { least(-6.0, n).max(ellipse(n)) } else { least(-(2.0 * exponent + 3.0), n) }),
            falloff: if narrow {
                Shape::Narrow(table(&lobe))
            } else if exponent > 0.0 {
                Shape::Broad(horizon_rule(exponent))
            } else {
                Shape::Constant
            },
            faded: S::of(if narrow { libm::pow(FADED_SHARE * tolerance, exponent.recip()) } else { 1.0 }),
            exponent: S::of(exponent),
            tolerance: S::of(tolerance),
            far: S::of(FAR_LENGTHS * length_m),
        }
    }

    /// The distance of an emitter beyond which the first moment takes one more node, metres.
    pub fn far(&self) -> S {
        self.far
    }

    /// The rule for an interval that begins at the horizon, at its end −1, with this reach to the emitter; `None` if it errs
    /// too much. Its integrand may grow like the interval's width: half a node is for that, and half for the power of t that
    /// the weight lacks.
    #[inline(always)]
    pub fn horizon_rule(&self, emitter: S) -> Option<Nodes<'_, S>> {
        let Shape::Broad([nodes, weights]) = &self.falloff else {
            return None;
        };
        (emitter >= self.emitter[HORIZON_NODES - 2]).then(|| nodes.iter().copied().zip(weights.iter().copied()))
    }

    /// Number of nodes for a narrow lobe along an interval that subtends 2/`reach` radians, at an angle γ to the axis
    /// with tan²γ = `tangent2`, where ln cos γ changes by `slope` per radian; `None` if even the longest rule errs too
    /// much.
    ///
    /// Along the interval ln cosⁿγ has the first derivative n·`slope` (n·tan γ towards the axis) and the second
    /// −n/cos²γ; the distance to the emitter adds three powers.
    #[inline(always)]
    pub fn lobe_nodes(&self, tangent2: S, slope: impl FnOnce() -> S, reach: S) -> Option<usize> {
        let Shape::Narrow(limits) = &self.falloff else {
            return Some(1);
        };
        let slope = slope();
        let delta2 = (reach * reach).recip();
        let n = self.exponent + S::of(3.0);
        let lambda2 = n * n * slope * slope * delta2;
        let kappa = n * (S::one() + tangent2) * delta2;
        (1..=MAX_NODES).find(|&count| lambda2 + S::of(BEND_SHARE * count as f64) * kappa <= limits[count - 1])
    }

    /// Number of nodes for an interval with reach `emitter` to the emitter and `horizon` to the
    /// horizon; `None` if even the longest rule errs too much.
    ///
    /// A horizon much farther than the emitter adds nothing to the emitter's series; a nearer one
    /// multiplies its tail.
    #[inline(always)]
    pub fn nodes(&self, emitter: S, horizon: S) -> Option<usize> {
        let enough = |i: &usize| {
            if horizon >= S::two() * emitter {
                emitter >= self.emitter[*i] && horizon >= self.horizon[*i]
            } else {
                emitter.min(horizon) >= self.both[*i]
            }
        };
        (0..MAX_NODES).find(enough).map(|i| i + 1)
    }

    /// cos γ at which a narrow lobe has faded whose brightest ray is at `cosine`.
    pub fn faded(&self, cosine: S) -> S {
        self.faded * cosine
    }

    /// Whether all light of the lobe beyond cos γ = `cosine`, where I_rel is `relative`, is negligible beside `power`:
    /// that light is 2π·∫cⁿ dc over 0…`cosine`.
    pub fn may_leave_out(&self, cosine: S, relative: S, power: S) -> bool {
        let beyond = S::two() * S::PI() * relative * cosine / (self.exponent + S::one());
        beyond <= S::of(LEFT_OUT_SHARE) * self.tolerance * power
    }

    pub fn tolerance(&self) -> S {
        self.tolerance
    }

    /// Relative rounding of the integrand: n times that of cos γ.
    pub fn rounding(&self) -> S {
        (S::of(16.0) + S::two() * self.exponent) * S::epsilon()
    }

    /// Whether the lobe decides the number of nodes.
    pub fn is_narrow(&self) -> bool {
        matches!(self.falloff, Shape::Narrow(_))
    }
}

/// 4ᴺ times the remainder's constant.
fn remainder(nodes: usize) -> f64 {
    // Factor by factor, to stay in range.
    let mut product = 1.0;
    for i in 1..=nodes {
        let i = i as f64;
        product *= 16.0 * (i * i * i * i) / ((2.0 * i - 1.0) * (2.0 * i - 1.0) * 4.0 * i * i);
    }
    product / (2.0 * nodes as f64 + 1.0)
}

/// |binomial(power, k)|, the size of the k-th Taylor coefficient of (1 + x)^power.
fn binomial(power: f64, k: usize) -> f64 {
    (0..k).fold(1.0, |product, j| product * ((power - j as f64) / (j as f64 + 1.0)).abs())
}

/// Number of nodes of the rule whose error is estimated from its values.
pub const ESTIMATED: usize = 10;

/// Nodes and weights of a rule per lane.
#[cfg(all(feature = "lanes", target_arch = "x86_64"))]
pub type LaneRule<R> = arrayvec::ArrayVec<(R, R), MAX_NODES>;

/// Gauss–Legendre rules with 1 to [`MAX_NODES`] nodes on −1…1.
#[derive(Clone, Debug)]
pub struct Rules<S> {
    nodes: [[S; MAX_NODES]; MAX_NODES],
    weights: [[S; MAX_NODES]; MAX_NODES],
    /// Weights that give the last four Legendre coefficients of values at [`ESTIMATED`] nodes.
    tails: [[S; ESTIMATED]; 4],
}

impl<S: Number> Rules<S> {
    pub fn new() -> Self {
        let mut rules = Self {
            nodes: [[S::zero(); MAX_NODES]; MAX_NODES],
            weights: [[S::zero(); MAX_NODES]; MAX_NODES],
            tails: [[S::zero(); ESTIMATED]; 4],
        };
        for count in 1..=MAX_NODES {
            for i in 0..count {
                let (node, weight) = legendre_root(count, i);
                rules.nodes[count - 1][i] = S::of(node);
                rules.weights[count - 1][i] = S::of(weight);
                if count == ESTIMATED {
                    for (tail, degree) in rules.tails.iter_mut().zip(ESTIMATED - 4..) {
                        tail[i] = S::of((degree as f64 + 0.5) * weight * legendre(degree, node)[1]);
                    }
                }
            }
        }
        rules
    }

    /// Estimated error of the rule of [`ESTIMATED`] nodes, for the integrand's `values` at its nodes with
    /// relative rounding `noise`.
    ///
    /// The coefficients a_k of the Legendre series fall geometrically for an analytic integrand
    /// (`is_smooth`); the rule's error is then about a_2N, extrapolated from the fall of the last four, with room for
    /// the slower fall next to the horizon, like that of a power of k.
    /// Where a third derivative jumps, they fall unevenly, like k^−4.5; the error is about a sixth of a_N,
    /// with a random sign in each panel. The estimate is a hundredth of the last four together, half that
    /// error, and more if they do not fall.
    pub fn estimate(&self, values: &[S; ESTIMATED], noise: S, is_smooth: bool) -> S {
        let size = values.iter().fold(S::zero(), |size, value| size.max(value.abs()));
        let [a, b, c, d] = self.tails.map(|tail| {
            let sum = tail.iter().zip(values).fold(S::zero(), |sum, (&weight, &value)| sum + weight * value);
            (sum.abs() - noise * size).max(S::zero())
        });
        let (before, last) = (a + b, c + d);
        if !is_smooth {
            let fall = (last / before).min(S::one());
            let unresolved = S::of(0.1) * fall * fall * fall * fall;
            return (S::of(0.01) + unresolved) * (before + last);
        }
        if last <= S::zero() {
            return S::zero();
        }
        let fall = (last / before).min(S::one());
        S::of(4.0) * last * fall * fall
    }

    /// Nodes and weights of the rule of each lane of `like`, with `counts` nodes each, 1 to [`MAX_NODES`] or zero for any
    /// number, the longest of which has `most`: those that it has more than others are at 0, with weight 0.
    #[cfg(all(feature = "lanes", target_arch = "x86_64"))]
    #[inline(always)]
    pub fn in_lanes<R: Real<Element = S>>(
        &self,
        like: R,
        counts: [usize; crate::lanes::MAX_LANES],
        most: usize,
    ) -> LaneRule<R> {
        let mut rule = LaneRule::new();
        if counts.iter().all(|&count| count == 0 || count == most) {
            rule.extend(self.get(most).map(|(node, weight)| (like.splat(node), like.splat(weight))));
            return rule;
        }
        for i in 0..most {
            let of = |lane: usize| counts[lane].max(1) - 1;
            let node = like.fill_with(|lane| self.nodes[of(lane)][i]);
            rule.push((node, like.fill_with(|lane| self.weights[of(lane)][i])));
        }
        rule
    }

    /// (node, weight) pairs of the rule with `count` nodes, 1 ≤ `count` ≤ [`MAX_NODES`].
    #[inline(always)]
    pub fn get(&self, count: usize) -> Nodes<'_, S> {
        let nodes = &self.nodes[count - 1][..count];
        let weights = &self.weights[count - 1][..count];
        nodes.iter().copied().zip(weights.iter().copied())
    }
}

/// The i-th root of the Legendre polynomial P_n and its Gauss weight 2/((1−x²)P_n'(x)²), by
/// Newton's method from Tricomi's estimate cos(π(i + ¾)/(n + ½)).
fn legendre_root(n: usize, i: usize) -> (f64, f64) {
    let mut x = -libm::cos(core::f64::consts::PI * (i as f64 + 0.75) / (n as f64 + 0.5));
    let mut derivative = 0.0;
    // Each Newton step doubles the digits: the estimate has four, so five steps are ample.
    for _ in 0..5 {
        let [before, value] = legendre(n, x);
        derivative = n as f64 * (x * value - before) / (x * x - 1.0);
        x -= value / derivative;
    }
    (x, 2.0 / ((1.0 - x * x) * derivative * derivative))
}

/// P_{n−1} and P_n at x, n ≥ 1, by Bonnet's recursion.
fn legendre(n: usize, x: f64) -> [f64; 2] {
    let (mut before, mut value) = (1.0, x);
    for k in 2..=n {
        let k = k as f64;
        (before, value) = (value, ((2.0 * k - 1.0) * x * value - (k - 1.0) * before) / k);
    }
    [before, value]
}

/// The Gauss–Jacobi rule of weight (1+x)^β, β = `exponent` − 1, for integrands with that factor: its weights are divided by
/// it, 2^(β+1)/((1−x²)·P'(x)²·(1+x)^β) (Abramowitz and Stegun 25.4.33). The roots are found like those of [`legendre_root`].
fn horizon_rule<S: Number>(exponent: f64) -> [[S; HORIZON_NODES]; 2] {
    let beta = exponent - 1.0;
    let count = HORIZON_NODES as f64;
    let mut rule = [[S::zero(); HORIZON_NODES]; 2];
    for i in 0..HORIZON_NODES {
        let estimate = (i as f64 + 0.75 + 0.5 * beta) / (count + 0.5 * (beta + 1.0));
        let mut x = -libm::cos(core::f64::consts::PI * estimate);
        let mut slope = 0.0;
        // The estimate is worst for exponents near zero, where nine steps are ample.
        for _ in 0..9 {
            let [value, derivative] = jacobi(HORIZON_NODES, beta, x);
            slope = derivative;
            x -= value / derivative;
        }
        rule[0][i] = S::of(x);
        rule[1][i] = S::of(2.0 / ((1.0 - x * x) * slope * slope) * libm::pow(2.0 / (1.0 + x), beta));
    }
    rule
}

/// P_n^(0,β) and its derivative at x, n ≥ 2, by the recursion of Abramowitz and Stegun 22.7.1 and 22.8.1.
fn jacobi(n: usize, beta: f64, x: f64) -> [f64; 2] {
    let (mut before, mut value) = (1.0, 1.0 + 0.5 * (beta + 2.0) * (x - 1.0));
    for k in 2..=n {
        let k = k as f64;
        let a = 2.0 * k + beta;
        let next =
            (a - 1.0) * (a * (a - 2.0) * x - beta * beta) * value - 2.0 * (k - 1.0) * (k + beta - 1.0) * a * before;
        (before, value) = (value, next / (2.0 * k * (k + beta) * (a - 2.0)));
    }
    let n = n as f64;
    let a = 2.0 * n + beta;
    let slope = n * (2.0 * (n + beta) * before - (beta + a * x) * value) / (a * (1.0 - x * x));
    [value, slope]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_rule_from_the_horizon_integrates_powers_times_polynomials_exactly() {
        for exponent in [0.05, 0.5, 1.0, 1.247, 2.5, 4.0] {
            let [nodes, weights] = horizon_rule::<f64>(exponent);
            assert!(nodes.is_sorted_by(|a, b| a < b) && nodes[0] > -1.0 && nodes[HORIZON_NODES - 1] < 1.0);
            for degree in 0..2 * HORIZON_NODES {
                let power = exponent - 1.0 + degree as f64;
                let sum: f64 = nodes.iter().zip(weights).map(|(x, w)| w * (1.0 + x).powf(power)).sum();
                let exact = 2.0_f64.powf(power + 1.0) / (power + 1.0);
                assert!((sum / exact - 1.0).abs() < 2e-13, "{exponent}, degree {degree}: {sum} for {exact}");
            }
        }
    }
}
