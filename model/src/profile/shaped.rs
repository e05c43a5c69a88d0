//! A profile times a polynomial: I_rel·Σ aₖ·zᵏ, z = 1 − cos γ.

use heapless::Vec;

use crate::effects::RADIAL_TERMS;
use crate::scalar::Number;

use super::fit::MAX_DEGREE;
use super::window::rule_nodes;
use super::{Emission, Falloff, MAX_TERMS, Series};

/// Coefficients of z⁰, z¹, …: those of a fit times those of [`crate::ProfileShape::radial`].
pub type Shape<S> = Vec<S, { MAX_DEGREE + RADIAL_TERMS + 1 }>;

/// Shares of the tolerance for terms neglected within a spot, and for the rule that integrates the others.
const SHARES: [f64; 2] = [0.05, 0.25];

const FEW: usize = 5;

/// Bound of the terms of power `from` and beyond in the expansion of a polynomial around any z of 0…1, in units of
/// δ to the power `from`, for δ ≤ ½.
fn bound_beyond(shape: &[f64], from: usize) -> f64 {
    let of_power = |power: usize| {
        // |binomial(j, power)|·zʲ⁻ᵖᵒʷᵉʳ is greatest at z = 1.
        let binomial = |j: usize| (0..power).fold(1.0, |product, i| product * (j - i) as f64 / (i + 1) as f64);
        (power..shape.len()).map(|j| binomial(j) * shape[j].abs()).sum::<f64>()
    };
    (from..shape.len()).map(|power| of_power(power) * libm::pow(0.5, (power - from) as f64)).sum()
}

pub fn product(a: &[f64], b: &[f64]) -> Shape<f64> {
    let of = |k: usize| (0..=k).filter_map(|i| Some(a.get(i)? * b.get(k - i)?)).sum();
    (0..a.len() + b.len() - 1).map(of).collect()
}

#[derive(Clone, Debug)]
pub struct Shaped<S, E> {
    ideal: E,
    shape: Shape<S>,
    /// Relative errors allowed to neglected terms, and to a rule.
    allowed: [S; 2],
    /// Bounds of the factor's terms of power N and beyond, in units of spreadᴺ, for N of [`FEW`] and of all coefficients.
    beyond: [S; 2],
}

impl<S: Number, E> Shaped<S, E> {
    /// `tolerance`: relative error allowed to [`Emission::near`].
    pub fn new(ideal: E, shape: &Shape<f64>, tolerance: f64) -> Self {
        let used = shape.iter().rposition(|&coefficient| coefficient != 0.0).unwrap_or(0);
        Self {
            ideal,
            shape: shape[..=used].iter().map(|&coefficient| S::of(coefficient)).collect(),
            allowed: SHARES.map(|share| S::of(share * tolerance)),
            beyond: [FEW, MAX_TERMS + 1].map(|from| S::of(bound_beyond(&shape[..=used], from))),
        }
    }

    /// The factor, not below zero, and its derivative by c.
    #[inline(always)]
    fn factor(&self, c: S) -> (S, S) {
        let z = S::one() - c;
        let (mut value, mut slope) = (S::zero(), S::zero());
        for &coefficient in self.shape.iter().rev() {
            slope = slope * z + value;
            value = value * z + coefficient;
        }
        if value > S::zero() { (value, -slope) } else { (S::zero(), S::zero()) }
    }

    /// The product of `series` and of the factor's expansion in δ, z = z₀ − c₀·δ, with N coefficients; `None` if terms
    /// beyond them matter. `beyond`: which of [`Self::beyond`] is of N coefficients.
    #[inline(always)]
    fn product<const N: usize>(&self, series: &Series<S>, centre: S, spread: S, beyond: usize) -> Option<Series<S>> {
        if series.terms >= N {
            return None;
        }
        // Around z₀ by Horner's synthetic divisions, all in one pass, then in powers of −c₀·δ.
        let z = S::one() - centre;
        let mut factor = [S::zero(); N];
        for &coefficient in self.shape.iter().rev() {
            for k in (1..N).rev() {
                factor[k] = factor[k] * z + factor[k - 1];
            }
            factor[0] = factor[0] * z + coefficient;
        }
        if factor[0] <= S::zero() {
            return None;
        }
        let mut coefficients = [S::zero(); MAX_TERMS + 1];
        // The greatest sizes of each term of factor, series and product within the spot.
        let (mut of_factor, mut of_series, mut sizes) = ([S::zero(); N], [S::zero(); N], [S::zero(); N]);
        let (mut scale, mut size) = (S::one(), S::one());
        for k in 0..N {
            factor[k] *= scale;
            scale = -(scale * centre);
            for i in 0..N - k {
                coefficients[k + i] += factor[k] * series.coefficients[i];
            }
        }
        for k in 0..N {
            of_factor[k] = factor[k].abs() * size;
            of_series[k] = series.coefficients[k].abs() * size;
            sizes[k] = coefficients[k].abs() * size;
            size *= spread;
        }
        let [left_out, by_rule] = self.allowed.map(|share| share * sizes[0]);
        // Terms of the N-th power and beyond.
        let (mut tail, mut highest) = (S::zero(), S::zero());
        for k in (1..N).rev() {
            highest += of_series[k];
            tail += of_factor[N - k] * highest;
        }
        tail += self.beyond[beyond] * size * (highest + of_series[0]);
        if tail > left_out {
            return None;
        }
        let mut terms = N - 1;
        while terms > 1 && tail + sizes[terms] <= left_out {
            tail += sizes[terms];
            terms -= 1;
        }
        let nodes = series.nodes.max(rule_nodes(&sizes, by_rule));
        Some(Series { coefficients, terms, nodes, ..*series })
    }

    /// [`Self::product`] for spots so wide that few have them.
    #[cold]
    #[inline(never)]
    fn product_of_many(&self, series: &Series<S>, centre: S, spread: S) -> Option<Series<S>> {
        self.product::<{ MAX_TERMS + 1 }>(series, centre, spread, 1)
    }

    fn most(&self) -> S {
        self.shape.iter().fold(S::zero(), |sum, coefficient| sum + coefficient.abs())
    }
}

impl<S: Number, E: Falloff<S>> Falloff<S> for Shaped<S, E> {
    #[inline(always)]
    fn relative(&self, c: S) -> S {
        self.ideal.relative(c) * self.factor(c).0
    }

    #[inline(always)]
    fn with_slope(&self, c: S) -> (S, S) {
        let (value, slope) = self.ideal.with_slope(c);
        let (factor, by_c) = self.factor(c);
        (value * factor, slope * factor + value * by_c)
    }
}

impl<S: Number, E: Emission<S>> Emission<S> for Shaped<S, E> {
    fn at_horizon(&self) -> S {
        self.ideal.at_horizon() * self.factor(S::zero()).0
    }

    /// The product of the ideal profile's series and of the factor's expansion in δ; `None` if it has too many terms.
    #[inline(always)]
    fn near(&self, centre: S, spread: S) -> Option<Series<S>> {
        let series = self.ideal.near(centre, spread)?;
        self.product::<FEW>(&series, centre, spread, 0).or_else(|| self.product_of_many(&series, centre, spread))
    }

    fn greatest(&self, lower: S, upper: S) -> S {
        self.ideal.greatest(lower, upper) * self.most()
    }

    fn is_resolved(&self, lower: S, upper: S) -> bool {
        self.ideal.is_resolved(lower, upper)
    }

    fn is_smooth(&self, lower: S, upper: S) -> bool {
        self.ideal.is_smooth(lower, upper)
    }

    fn rescaling(&self, _: impl FnOnce() -> S, _: S) -> (S, S) {
        (S::one(), S::one())
    }
}
