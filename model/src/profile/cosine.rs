//! The profile cosⁿγ.

use crate::power::Power;
use crate::scalar::Number;

use super::{Emission, Falloff, MAX_TERMS, Series};

/// Fall of the profile over a panel that ten nodes resolve.
const RESOLVED_FALL: f64 = 1e-15;

/// Least ratio of cosines that counts in that fall: towards the horizon cⁿ has no scale of its own.
const MIN_RATIO: f64 = 1e-3;

/// I_rel = cⁿ.
#[derive(Clone, Debug)]
pub struct Cosine<S> {
    power: Power<S>,
    binomials: [S; MAX_TERMS + 1],
    /// `spreads[k]`: the greatest |δ| for which the series may end after k terms.
    spreads: [S; MAX_TERMS + 1],
}

impl<S: Number> Cosine<S> {
    /// Compiles the profile with exponent n. `tolerance`: relative error allowed to [`Emission::near`].
    pub fn compile(exponent: f64, tolerance: f64) -> Self {
        let mut binomial = 1.0;
        let mut binomials = [S::one(); MAX_TERMS + 1];
        let mut spreads = [S::zero(); MAX_TERMS + 1];
        for k in 0..=MAX_TERMS {
            binomials[k] = S::of(binomial);
            binomial *= (exponent - k as f64) / (k as f64 + 1.0);
            // The first neglected term takes an eighth of the tolerance; the rest of the tail is a
            // geometric series of ratio δ ≤ ½.
            let first_neglected = 0.125 * tolerance / binomial.abs().max(f64::MIN_POSITIVE);
            spreads[k] = S::of(libm::pow(first_neglected, 1.0 / (k as f64 + 1.0)).min(0.5));
        }
        Self { power: Power::compile(exponent), binomials, spreads }
    }

    pub fn power(&self) -> &Power<S> {
        &self.power
    }
}

impl<S: Number> Falloff<S> for Cosine<S> {
    #[inline(always)]
    fn relative(&self, c: S) -> S {
        self.power.of(c)
    }

    #[inline(always)]
    fn with_slope(&self, c: S) -> (S, S) {
        let value = self.power.of(c);
        (value, self.power.exponent() * value / c)
    }
}

impl<S: Number> Emission<S> for Cosine<S> {
    fn at_horizon(&self) -> S {
        if self.power.exponent() == S::zero() { S::one() } else { S::zero() }
    }

    /// cⁿ = c₀ⁿ·Σ binomial(n, k)·δᵏ.
    #[inline(always)]
    fn near(&self, centre: S, spread: S) -> Option<Series<S>> {
        let terms = self.spreads.iter().position(|&most| spread <= most)?;
        let inverse = centre.recip();
        let value = self.power.of(centre);
        let mut coefficients = [S::zero(); MAX_TERMS + 1];
        for (coefficient, binomial) in coefficients.iter_mut().zip(&self.binomials[..=terms]) {
            *coefficient = value * *binomial;
        }
        Some(Series { inverse, coefficients, terms, nodes: 1, more: 0 })
    }

    fn greatest(&self, _: S, upper: S) -> S {
        if upper > S::zero() { self.power.of(upper) } else { S::zero() }
    }

    fn is_resolved(&self, lower: S, upper: S) -> bool {
        (lower / upper).max(S::of(MIN_RATIO)).power(self.power.exponent()) >= S::of(RESOLVED_FALL)
    }

    fn is_smooth(&self, _: S, _: S) -> bool {
        true
    }

    fn rescaling(&self, brightest: impl FnOnce() -> S, corner: S) -> (S, S) {
        if corner > S::zero() && self.power.of(corner) > S::min_positive_value().root() {
            return (S::one(), S::one());
        }
        let brightest = brightest();
        (brightest, self.power.of(brightest))
    }
}
