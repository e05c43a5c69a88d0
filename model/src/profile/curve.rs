//! A profile as one polynomial, for a processor that evaluates it once a spot.

use serde::{Deserialize, Serialize};

use crate::scalar::Number;

use super::window::{DEGREE, interpolate};
use super::{CompiledProfile, Falloff};

/// Cosines down to which the polynomial may reach, the lowest that fits counts: 78°, and up to 37°.
const LOWEST: [f64; 7] = [0.2, 0.25, 0.3, 0.4, 0.5, 0.65, 0.8];

/// Greatest relative error of the polynomial: a few roundings of `f32`.
const MOST_ERROR: f64 = 1e-6;

/// Places at which it is compared.
const CHECKS: usize = 200;

/// I_rel = Σ coefficient·(c − c₀)ᵏ from [`Self::lowest`] to 1, c₀ their mean; below, the power of c that goes on as steep.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(crate) struct Curve<S> {
    lowest: S,
    coefficients: [S; DEGREE + 1],
}

impl<S: Number> Curve<S> {
    /// `None`: no polynomial is near enough to `profile` over an angle worth it.
    pub(crate) fn fit(profile: &CompiledProfile<f64>) -> Option<Self> {
        LOWEST.into_iter().find_map(|lowest| {
            let (centre, half) = (0.5 * (1.0 + lowest), 0.5 * (1.0 - lowest));
            let curve = Curve { lowest, coefficients: interpolate(centre, (centre, half), |c| profile.relative(c)) };
            let fits = (0..=CHECKS).all(|i| {
                let c = lowest + (1.0 - lowest) * i as f64 / CHECKS as f64;
                let exact = profile.relative(c);
                // Written so that NaN does not fit.
                exact > 0.0 && (curve.bends(c)[0] - exact).abs() <= MOST_ERROR * exact
            });
            fits.then(|| Self { lowest: S::of(lowest), coefficients: curve.coefficients.map(S::of) })
        })
    }

    /// I_rel at cos γ = `c` > 0, and its first two derivatives relative to it.
    #[inline(always)]
    pub(crate) fn bends(&self, c: S) -> [S; 3] {
        if c < self.lowest {
            return self.faded(c);
        }
        let offset = c - S::half() * (S::one() + self.lowest);
        let (mut value, mut slope, mut bend) = (S::zero(), S::zero(), S::zero());
        for &coefficient in self.coefficients.iter().rev() {
            bend = bend * offset + slope;
            slope = slope * offset + value;
            value = value * offset + coefficient;
        }
        let inverse = value.recip();
        [value, slope * inverse, S::two() * bend * inverse]
    }

    /// [`Self::bends`] below the lowest cosine.
    #[cold]
    #[inline(never)]
    fn faded(&self, c: S) -> [S; 3] {
        let [value, slope, _] = self.bends(self.lowest);
        let (exponent, inverse) = (slope * self.lowest, c.recip());
        let slope = exponent * inverse;
        [value * (c / self.lowest).power(exponent), slope, slope * (exponent - S::one()) * inverse]
    }
}

impl<S: Number> CompiledProfile<S> {
    /// I_rel at cos γ = `c` > 0.
    fn relative(&self, c: S) -> S {
        match self {
            Self::Cosine(profile) => profile.relative(c),
            Self::Table(profile) => profile.relative(c),
            Self::ShapedCosine(profile) => profile.relative(c),
            Self::ShapedTable(profile) => profile.relative(c),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::Profile;

    fn profile(exponent: f64, radial: [f64; 4]) -> CompiledProfile<f64> {
        CompiledProfile::compile(&Profile::Cosine { exponent }, radial, 1e-9).0
    }

    /// Against the profile and differences of it; a power of the cosine down to the horizon.
    #[test]
    fn a_curve_is_the_profile_with_its_derivatives() {
        for (exponent, radial, from) in [
            (1.247, [0.0; 4], 0.01),
            (1.2, [-0.06, 0.17, -0.03, 0.23], 0.2),
            (1.4, [0.2, -0.3, 0.1, 0.1], 0.2),
            (20.0, [0.0; 4], 0.81),
        ] {
            let profile = profile(exponent, radial);
            let curve = Curve::<f64>::fit(&profile).expect("smooth");
            for i in 0..50 {
                let c = from + (0.999 - from) * f64::from(i) / 49.0;
                let [value, slope, bend] = curve.bends(c);
                let step = 1e-4 * c;
                let [before, here, after] = [c - step, c, c + step].map(|c| profile.relative(c));
                let (first, second) = ((after - before) / (2.0 * step), (after - 2.0 * here + before) / (step * step));
                // Beyond its end it goes on by the slope there, which is right to 10⁻⁵.
                let most = if c < curve.lowest { 1e-4 } else { 2e-6 };
                assert!((value / here - 1.0).abs() < most, "{exponent} {c}: {value} {here}");
                assert!((slope * value - first).abs() < 1e-4 * (1.0 + first.abs()), "{exponent} {c}: {slope} {first}");
                assert!((bend * value - second).abs() < 5e-3 * (1.0 + second.abs()), "{exponent} {c}: {bend} {second}");
            }
        }
    }

    #[test]
    fn a_lobe_too_narrow_for_a_polynomial_has_no_curve() {
        assert!(Curve::<f32>::fit(&profile(300.0, [0.0; 4])).is_none());
    }
}
