//! cos γ to a real power, for the profile cosⁿγ, by table and series.
//!
//! c = m·2ᵉ with m in ½…1. Around the middle m₀ of one of [`SEGMENTS`] intervals,
//! mⁿ = m₀ⁿ·(1 + δ)ⁿ, δ = (m − m₀)/m₀, is a short binomial series. m − m₀ is exact and only the products
//! round: the error is at most three units in the last place.

use serde::{Deserialize, Serialize};

use crate::scalar::Number;

/// Intervals of m.
const SEGMENTS: usize = 32;

/// Tabulated powers of two; for c below 2⁻¹⁴ the library's power is called.
const OCTAVES: usize = 16;

const MAX_TERMS: usize = 8;

#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Power<S> {
    exponent: S,
    binomials: [S; MAX_TERMS],
    /// m₀ⁿ and 1/m₀.
    middles: [[S; 2]; SEGMENTS],
    /// 2ⁿᵉ for e = 1, 0, −1, …
    octaves: [S; OCTAVES],
    /// Whether the series is short enough; it is not for very narrow beams.
    has_series: bool,
}

/// The table's entry for one c, input of the series.
struct Anchor<S> {
    delta: S,
    factor: S,
}

impl<S: Number> Power<S> {
    pub fn compile(exponent: f64) -> Self {
        let mut binomials = [1.0; MAX_TERMS + 1];
        for k in 1..=MAX_TERMS {
            binomials[k] = binomials[k - 1] * (exponent - (k - 1) as f64) / k as f64;
        }
        let largest_delta = 0.5 / SEGMENTS as f64;
        let neglected = binomials[S::POWER_TERMS] * libm::pow(largest_delta, S::POWER_TERMS as f64);
        let middle = |i: usize| 0.5 + (i as f64 + 0.5) * 0.5 / SEGMENTS as f64;
        Self {
            exponent: S::of(exponent),
            binomials: core::array::from_fn(|k| S::of(binomials[k])),
            middles: core::array::from_fn(|i| [S::of(libm::pow(middle(i), exponent)), S::of(middle(i).recip())]),
            octaves: core::array::from_fn(|i| S::of(power_of_two(exponent, 1.0 - i as f64))),
            has_series: neglected.abs() < 0.25 * S::epsilon().as_f64(),
        }
    }

    pub fn exponent(&self) -> S {
        self.exponent
    }

    /// cⁿ, c > 0.
    #[inline(always)]
    pub fn of(&self, c: S) -> S {
        match self.anchor(c) {
            Some(anchor) => series(anchor.delta, anchor.factor, &self.binomials),
            None => c.power(self.exponent),
        }
    }

    /// cⁿ, c > 0, and its first two derivatives relative to it.
    #[inline(always)]
    pub fn bends(&self, c: S) -> [S; 3] {
        let inverse = c.recip();
        let slope = self.exponent * inverse;
        [self.of(c), slope, slope * (self.exponent - S::one()) * inverse]
    }

    #[inline(always)]
    fn anchor(&self, c: S) -> Option<Anchor<S>> {
        let (significand, exponent) = c.split();
        let octave = -exponent as usize;
        if octave >= OCTAVES || !self.has_series {
            return None;
        }
        // 1 ≤ 2m < 2: the leading bits of 2m number the segment.
        let significand = significand * S::half();
        let step = S::of(2.0 * SEGMENTS as f64);
        let segment = ((significand - S::half()) * step).to_usize()?.min(SEGMENTS - 1);
        let middle = S::half() + (S::of(segment as f64) + S::half()) / step;
        let [value, inverse] = self.middles[segment];
        Some(Anchor { delta: (significand - middle) * inverse, factor: value * self.octaves[octave] })
    }
}

/// 2ⁿᵉ, corrected for the rounding of n·e.
fn power_of_two(n: f64, e: f64) -> f64 {
    let product = n * e;
    libm::exp2(product) * (1.0 + libm::fma(n, e, -product) * core::f64::consts::LN_2)
}

/// factor·(1 + δ)ⁿ.
#[inline(always)]
fn series<S: Number>(delta: S, factor: S, binomials: &[S; MAX_TERMS]) -> S {
    let mut sum = binomials[S::POWER_TERMS - 1];
    for k in (0..S::POWER_TERMS - 1).rev() {
        sum = sum * delta + binomials[k];
    }
    sum * factor
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Three units in the last place, as stated above; the library's power errs by one of its own.
    fn check<S: Number>(exponent: f64) {
        let power = Power::<S>::compile(exponent);
        for i in 1..20_000 {
            let c = S::of(f64::from(i) / 19_999.0);
            let exact = libm::pow(c.as_f64(), exponent);
            if exact < 1e3 * S::min_positive_value().as_f64() {
                continue;
            }
            let error = (power.of(c).as_f64() - exact).abs() / exact;
            // The library's power takes a rounded exponent, whose error ln c multiplies.
            let library = !power.has_series || c.as_f64() < 1e-4;
            let rounding = if library { exponent * c.as_f64().ln().abs() } else { 0.0 };
            assert!(error < (4.0 + rounding) * S::epsilon().as_f64(), "{c:?}^{exponent}: {error}");
        }
    }

    #[test]
    fn powers_are_right_to_the_last_digits() {
        for exponent in [0.0, 0.5, 1.0, 1.24697, 2.0, 3.7, 17.0, 200.0] {
            check::<f64>(exponent);
            check::<f32>(exponent);
        }
    }

    #[test]
    fn next_to_the_horizon_the_library_helps_out() {
        let power = Power::<f64>::compile(1.24697);
        for c in [1e-5, 1e-9, 1e-100, 1e-300] {
            assert_eq!(power.of(c), libm::pow(c, 1.24697));
        }
    }
}
