//! How many Gauss–Legendre nodes a tolerance needs.
//!
//! The integrand of a spot, h·cosⁿγ/r³ = h·(u·d)ⁿ·r⁻⁽ⁿ⁺³⁾, is analytic but for the emitter itself
//! (r = 0 at complex positions) and for the horizon (u·d = 0). On the interval −1…1 across the
//! spot, N nodes err by K_N·ρ⁻²ᴺ, where ρ = s + √(s²−1) belongs to the Bernstein ellipse through
//! the nearest singularity and s is half the sum of that singularity's distances from the
//! interval's ends. For the emitter these distances are just the lengths of the two rays to the
//! ends of the spot.
//!
//! K_N follows from the remainder of the rule (Abramowitz and Stegun 25.4.30) for a singularity
//! (1 − ξ/s)⁻ᵖ, counting the emitter's two conjugate ones as one real one of twice the power:
//! K_N = 4ᴺ·2²ᴺ(N!)⁴/((2N+1)((2N)!)²)·|binomial(−p, 2N)|. The first is pessimistic, the neglect of
//! the first moment's extra degree is not; together they leave a factor of about three at 1e-3
//! and more at tighter tolerances.

use crate::scalar::Scalar;

/// Most nodes of a rule; spots that need more are divided.
pub(crate) const MAX_NODES: usize = 12;

/// Above this exponent horizon and emitter are always taken together: cosⁿ is then narrower than
/// either factor alone tells.
const NARROW_LOBE: f64 = 4.0;

/// For one emission profile and tolerance: the least s for which N nodes suffice.
#[derive(Clone, Debug)]
pub(crate) struct Orders<S> {
    emitter: [S; MAX_NODES],
    horizon: [S; MAX_NODES],
    /// For the nearer of the two, when the factors of emitter and horizon vary together.
    both: [S; MAX_NODES],
    tolerance: S,
}

impl<S: Scalar> Orders<S> {
    pub(crate) fn new(exponent: f64, tolerance: f64) -> Self {
        let least = |power: f64, nodes: usize| {
            let k = remainder(nodes) * binomial(power, 2 * nodes);
            let rho = libm::pow(k / tolerance, 0.5 / nodes as f64).max(1.0);
            S::of(0.5 * (rho + rho.recip()))
        };
        let narrow = exponent > NARROW_LOBE;
        let both = 2.0 * exponent + 3.0;
        Self {
            emitter: core::array::from_fn(|i| least(-if narrow { both } else { exponent + 3.0 }, i + 1)),
            horizon: core::array::from_fn(|i| least(if narrow { -both } else { exponent }, i + 1)),
            both: core::array::from_fn(|i| least(-both, i + 1)),
            tolerance: S::of(tolerance),
        }
    }

    /// Number of nodes for an interval with reach `emitter` to the emitter and `horizon` to the
    /// horizon; `None` if even the longest rule errs too much.
    ///
    /// A horizon much farther than the emitter adds nothing to the emitter's series; a nearer one
    /// multiplies its tail.
    #[inline(always)]
    pub(crate) fn nodes(&self, emitter: S, horizon: S) -> Option<usize> {
        let enough = |i: &usize| {
            if horizon >= S::two() * emitter {
                emitter >= self.emitter[*i] && horizon >= self.horizon[*i]
            } else {
                emitter.min(horizon) >= self.both[*i]
            }
        };
        (0..MAX_NODES).find(enough).map(|i| i + 1)
    }

    pub(crate) fn tolerance(&self) -> S {
        self.tolerance
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

/// Gauss–Legendre rules with 1 to [`MAX_NODES`] nodes on −1…1.
#[derive(Clone, Debug)]
pub(crate) struct Rules<S> {
    nodes: [[S; MAX_NODES]; MAX_NODES],
    weights: [[S; MAX_NODES]; MAX_NODES],
}

impl<S: Scalar> Rules<S> {
    pub(crate) fn new() -> Self {
        let mut rules =
            Self { nodes: [[S::zero(); MAX_NODES]; MAX_NODES], weights: [[S::zero(); MAX_NODES]; MAX_NODES] };
        for count in 1..=MAX_NODES {
            for i in 0..count {
                let (node, weight) = legendre_root(count, i);
                rules.nodes[count - 1][i] = S::of(node);
                rules.weights[count - 1][i] = S::of(weight);
            }
        }
        rules
    }

    /// (node, weight) pairs of the rule with `count` nodes, 1 ≤ `count` ≤ [`MAX_NODES`].
    #[inline(always)]
    pub(crate) fn get(&self, count: usize) -> impl Iterator<Item = (S, S)> + Clone {
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
    // Newton doubles the digits each time: the estimate has four, five steps are ample.
    for _ in 0..5 {
        let (mut before, mut value) = (1.0, x);
        for k in 2..=n {
            let k = k as f64;
            (before, value) = (value, ((2.0 * k - 1.0) * x * value - (k - 1.0) * before) / k);
        }
        derivative = n as f64 * (x * value - before) / (x * x - 1.0);
        x -= value / derivative;
    }
    (x, 2.0 / ((1.0 - x * x) * derivative * derivative))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rules_integrate_polynomials_exactly() {
        let rules = Rules::<f64>::new();
        for count in 1..=MAX_NODES {
            for degree in 0..2 * count {
                let sum: f64 = rules.get(count).map(|(x, w)| w * x.powi(degree as i32)).sum();
                let exact = if degree % 2 == 0 { 2.0 / (degree as f64 + 1.0) } else { 0.0 };
                assert!((sum - exact).abs() < 4e-15, "{count} nodes, degree {degree}: {sum}");
            }
        }
    }

    #[test]
    fn tighter_tolerances_never_take_fewer_nodes() {
        let (loose, tight) = (Orders::<f64>::new(1.247, 1e-6), Orders::<f64>::new(1.247, 1e-10));
        for i in 1..200 {
            let s = 1.0 + f64::from(i) * 0.2;
            let nodes = |orders: &Orders<f64>| orders.nodes(s, s).unwrap_or(MAX_NODES + 1);
            assert!(nodes(&loose) <= nodes(&tight));
        }
    }
}
