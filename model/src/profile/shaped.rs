//! A profile times a polynomial: I_rel·Σ aₖ·zᵏ, z = 1 − cos γ.

use heapless::Vec;

use crate::effects::RADIAL_TERMS;
use crate::scalar::Scalar;

use super::fit::MAX_DEGREE;
use super::window::rule_nodes;
use super::{Emission, Falloff, MAX_TERMS, Series};

/// Coefficients of z⁰, z¹, …: those of a fit times those of [`crate::ProfileShape::radial`].
pub(super) type Shape<S> = Vec<S, { MAX_DEGREE + RADIAL_TERMS + 1 }>;

/// Shares of the tolerance for terms neglected within a spot, and for the rule that integrates the others.
const SHARES: [f64; 2] = [0.05, 0.25];

/// The product of two polynomials.
pub(super) fn product(a: &[f64], b: &[f64]) -> Shape<f64> {
    let of = |k: usize| (0..=k).filter_map(|i| Some(a.get(i)? * b.get(k - i)?)).sum();
    (0..a.len() + b.len() - 1).map(of).collect()
}

#[derive(Clone, Debug)]
pub(crate) struct Shaped<S, E> {
    ideal: E,
    shape: Shape<S>,
    /// Relative errors allowed to neglected terms, and to a rule.
    allowed: [S; 2],
}

impl<S: Scalar, E> Shaped<S, E> {
    /// `tolerance`: relative error allowed to [`Emission::near`].
    pub(super) fn new(ideal: E, shape: &Shape<f64>, tolerance: f64) -> Self {
        let used = shape.iter().rposition(|&coefficient| coefficient != 0.0).unwrap_or(0);
        Self {
            ideal,
            shape: shape[..=used].iter().map(|&coefficient| S::of(coefficient)).collect(),
            allowed: SHARES.map(|share| S::of(share * tolerance)),
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

    /// A bound of the factor.
    fn most(&self) -> S {
        self.shape.iter().fold(S::zero(), |sum, coefficient| sum + coefficient.abs())
    }
}

impl<S: Scalar, E: Falloff<S>> Falloff<S> for Shaped<S, E> {
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

impl<S: Scalar, E: Emission<S>> Emission<S> for Shaped<S, E> {
    const NEEDS_SERIES: bool = E::NEEDS_SERIES;

    fn at_horizon(&self) -> S {
        self.ideal.at_horizon() * self.factor(S::zero()).0
    }

    /// The product of the ideal profile's series and of the factor's expansion in δ, z = z₀ − c₀·δ; `None` if it has too
    /// many terms.
    #[inline(always)]
    fn near(&self, centre: S, spread: S) -> Option<Series<S>> {
        let series = self.ideal.near(centre, spread)?;
        let z = S::one() - centre;
        // Around z₀ by Horner's synthetic divisions, then in powers of −c₀·δ.
        let last = self.shape.len() - 1;
        let mut factor = [S::zero(); MAX_DEGREE + RADIAL_TERMS + 1];
        factor[..=last].copy_from_slice(&self.shape);
        for i in 0..last {
            for j in (i..last).rev() {
                factor[j] += z * factor[j + 1];
            }
        }
        if factor[0] <= S::zero() {
            return None;
        }
        let mut scale = S::one();
        for coefficient in &mut factor[..=last] {
            *coefficient *= scale;
            scale = -(scale * centre);
        }
        let highest = (series.terms + last).min(MAX_TERMS);
        let mut coefficients = [S::zero(); MAX_TERMS + 1];
        for (i, &of_factor) in factor[..=last].iter().enumerate().take(MAX_TERMS + 1) {
            for (coefficient, &of_series) in coefficients[i..].iter_mut().zip(&series.coefficients[..=series.terms]) {
                *coefficient += of_factor * of_series;
            }
        }
        // The greatest size of each term within the spot.
        let (mut sizes, mut size) = ([S::zero(); MAX_TERMS + 1], S::one());
        for (of_term, coefficient) in sizes.iter_mut().zip(&coefficients[..=highest]) {
            *of_term = (*coefficient * size).abs();
            size *= spread;
        }
        let [left_out, by_rule] = self.allowed.map(|share| share * sizes[0]);
        if highest < series.terms + last && sizes[highest] > left_out {
            return None;
        }
        let (mut terms, mut tail) = (highest, S::zero());
        while terms > 1 && tail + sizes[terms] <= left_out {
            tail += sizes[terms];
            terms -= 1;
        }
        let nodes = series.nodes.max(rule_nodes(&sizes[..=terms], by_rule));
        Some(Series { coefficients, terms, nodes, ..series })
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
