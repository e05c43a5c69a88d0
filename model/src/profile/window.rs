//! Polynomials that approximate a table over ranges of cos γ as wide as a spot.
//!
//! With them a node of a rule costs as little as for a cosine power. Windows are spaced evenly over
//! √(1 − cos γ), nearly evenly over γ. Each is as wide as a polynomial of [`DEGREE`] allows within the
//! tolerance; where no window is wide enough for a spot, the table itself is integrated.
//!
//! A processor that evaluates a profile once a spot has one polynomial for all of it: [`Curve`].

use serde::{Deserialize, Serialize};

use crate::scalar::Number;

use super::{CompiledProfile, Falloff, MAX_TERMS, Series};

/// Number of windows from the axis to the end of the light, every 4.5° for light up to 90°. A plan holds
/// 16 tables, and the board has 96 KiB for plan and scene.
const WINDOWS: usize = 20;

/// Degree of the polynomials: for a table in steps of 5° they are right to 1e-6 over 8° to 16°.
pub const DEGREE: usize = MAX_TERMS;

/// Half widths to try, degrees of γ: few spots are wider than the first, few smaller than the last.
const HALF_WIDTHS_DEG: [f64; 10] = [12.0, 10.0, 8.0, 6.8, 5.8, 5.0, 4.2, 3.4, 2.6, 1.8];

/// Shares of the tolerance for the polynomial at its worst point, for its terms neglected within a
/// spot, and for the rule that integrates the remaining terms.
const SHARES: [f64; 3] = [0.5, 0.05, 0.25];

/// Greatest error of Gauss–Legendre rules with N = 1, 2, … nodes for ½∫xᵏ over −1…1, k ≥ 2N.
const REMAINDERS: [f64; 5] = [0.34, 0.12, 0.05, 0.015, 0.0015];

/// Exponents above which the product of profile and distance takes one and two nodes more: a node
/// reduces the error by a factor of a hundred or more.
const STEEPNESSES: [f64; 2] = [3.0, 30.0];

/// A profile given by its values at some positions and smooth between them.
pub trait Piecewise: Falloff<f64> {
    /// 1 − cos γ at the end of the light.
    fn end(&self) -> f64;
    /// 1 − cos γ of each value.
    fn positions(&self) -> impl Iterator<Item = f64> + Clone;
}

#[derive(Clone, Debug)]
pub struct Windows<S> {
    windows: [Window<S>; WINDOWS],
    /// Windows per unit of √(1 − cos γ), and its inverse.
    density: S,
    pitch: S,
    /// Relative errors allowed to neglected terms, and to a rule.
    allowed: [S; 2],
}

/// I_rel = Σ coefficient·(c − c₀)ᵏ.
#[derive(Clone, Copy, Debug)]
struct Window<S> {
    /// The greatest |c − c₀|; zero if no polynomial meets the tolerance.
    reach: S,
    coefficients: [S; DEGREE + 1],
}

impl<S: Number> Windows<S> {
    pub fn none() -> Self {
        let closed = Window { reach: S::zero(), coefficients: [S::zero(); DEGREE + 1] };
        Self { windows: [closed; WINDOWS], density: S::one(), pitch: S::one(), allowed: [S::zero(); 2] }
    }

    /// Windows for `table`, each as wide as `tolerance` allows.
    pub fn fit(table: &impl Piecewise, tolerance: f64) -> Self {
        let root = libm::sqrt(table.end());
        let mut fitted = Self::none();
        fitted.density = S::of(WINDOWS as f64 / root);
        fitted.pitch = S::of(root / WINDOWS as f64);
        fitted.allowed = [SHARES[1], SHARES[2]].map(|share| S::of(share * tolerance));
        for i in 0..WINDOWS {
            let centre = fitted.centre(i).as_f64();
            let fit = HALF_WIDTHS_DEG.into_iter().find_map(|degrees| {
                Fit::over(table, centre, degrees.to_radians()).filter(|fit| fit.error <= SHARES[0] * tolerance)
            });
            if let Some(fit) = fit {
                fitted.windows[i] = Window { reach: S::of(fit.reach), coefficients: fit.coefficients.map(S::of) };
            }
        }
        fitted
    }

    /// cos γ at the middle of a window.
    #[inline(always)]
    fn centre(&self, index: usize) -> S {
        let root = (S::of(index as f64) + S::half()) * self.pitch;
        S::one() - root * root
    }

    /// The polynomial for c within `spread`·`centre` of `centre`.
    #[inline(always)]
    pub fn near(&self, centre: S, spread: S) -> Option<Series<S>> {
        let index = ((S::one() - centre).max(S::zero()).root() * self.density).to_usize()?;
        let window = self.windows.get(index)?;
        let (offset, reach) = (centre - self.centre(index), spread * centre);
        if offset.abs() + reach > window.reach {
            return None;
        }
        // Around the middle of the spot, by Horner's synthetic divisions.
        let mut coefficients = window.coefficients;
        for i in 0..DEGREE {
            for j in (i..DEGREE).rev() {
                coefficients[j] += offset * coefficients[j + 1];
            }
        }
        // In powers of δ = c/centre − 1, with the greatest size of each term within the spot.
        let (mut scale, mut size) = (S::one(), S::one());
        let mut terms = [S::zero(); DEGREE + 1];
        for (coefficient, term) in coefficients.iter_mut().zip(&mut terms) {
            *term = (*coefficient * size).abs();
            *coefficient *= scale;
            (scale, size) = (scale * centre, size * reach);
        }
        let [left_out, by_rule] = self.allowed.map(|share| share * terms[0]);
        let (mut last, mut tail) = (DEGREE, S::zero());
        while last > 1 && tail + terms[last] <= left_out {
            tail += terms[last];
            last -= 1;
        }
        let nodes = rule_nodes(&terms, by_rule);
        // d ln I/d ln c: the exponent of an equally steep power.
        let steepness = (coefficients[1] / coefficients[0]).abs();
        let more = STEEPNESSES.iter().filter(|&&steep| steepness > S::of(steep)).count();
        Some(Series { inverse: centre.recip(), coefficients, terms: last, nodes, more })
    }
}

/// Gauss–Legendre nodes that integrate a polynomial and its first moment, with terms of these greatest sizes, to within
/// `allowed`. Of fixed length: the loops are unrolled.
#[inline(always)]
pub fn rule_nodes<S: Number, const N: usize>(sizes: &[S; N], allowed: S) -> usize {
    // Of each term and all after it.
    let mut sums = *sizes;
    for k in (0..N - 1).rev() {
        sums[k] += sums[k + 1];
    }
    let is_enough = |nodes: usize| {
        let rest = if 2 * nodes < N { sums[2 * nodes] } else { S::zero() };
        // The first moment adds a part of the next lower power.
        let moment = if 2 * nodes <= N { S::of(0.25) * sizes[2 * nodes - 1] } else { S::zero() };
        S::of(REMAINDERS[nodes - 1]) * (rest + moment) <= allowed
    };
    (1..REMAINDERS.len()).find(|&nodes| is_enough(nodes)).unwrap_or(REMAINDERS.len())
}

/// Coefficients of the powers of c − `centre` of the polynomial of degree [`DEGREE`] through `of` at the Chebyshev nodes of
/// middle ± half.
pub fn interpolate(centre: f64, (middle, half): (f64, f64), of: impl Fn(f64) -> f64) -> [f64; DEGREE + 1] {
    let count = (DEGREE + 1) as f64;
    // Newton's divided differences.
    let nodes: [f64; DEGREE + 1] =
        core::array::from_fn(|i| middle + half * libm::cos(core::f64::consts::PI * (i as f64 + 0.5) / count));
    let mut newton = nodes.map(of);
    for k in 1..=DEGREE {
        for i in (k..=DEGREE).rev() {
            newton[i] = (newton[i] - newton[i - 1]) / (nodes[i] - nodes[i - k]);
        }
    }
    // Expanded in powers of c − centre, from the innermost factor outward.
    let mut powers = [0.0; DEGREE + 1];
    powers[0] = newton[DEGREE];
    for k in (0..DEGREE).rev() {
        let shift = centre - nodes[k];
        for j in (1..=DEGREE).rev() {
            powers[j] = powers[j] * shift + powers[j - 1];
        }
        powers[0] = powers[0] * shift + newton[k];
    }
    powers
}

/// A polynomial of degree [`DEGREE`] fitted to the table around one cosine.
struct Fit {
    reach: f64,
    coefficients: [f64; DEGREE + 1],
    /// Greatest difference from the table, relative to the least I_rel of the range.
    error: f64,
}

impl Fit {
    /// Fits over γ ± `half_width` around the angle of cosine `centre`. `None` where I_rel is zero.
    fn over(table: &impl Piecewise, centre: f64, half_width: f64) -> Option<Self> {
        let gamma = libm::acos(centre);
        let farther = libm::cos((gamma + half_width).min(core::f64::consts::FRAC_PI_2)).max(0.0);
        let nearer = libm::cos((gamma - half_width).max(0.0));
        // Equally far to both sides, within 0…1.
        let reach = (centre - farther).max(nearer - centre);
        let (low, high) = ((centre - reach).max(0.0), (centre + reach).min(1.0));
        let (middle, half) = (0.5 * (low + high), 0.5 * (high - low));
        let count = (DEGREE + 1) as f64;
        let powers = interpolate(centre, (middle, half), |c| table.relative(c));
        // Compared where a smooth remainder is greatest, and at the points, where the table is least smooth.
        let extremes =
            (0..=2 * (DEGREE + 1)).map(|i| middle + half * libm::cos(core::f64::consts::PI * i as f64 / (2.0 * count)));
        let points = table.positions().map(|v| 1.0 - v).filter(|c| (low..high).contains(c));
        let (mut worst, mut least) = (0.0_f64, f64::INFINITY);
        for c in extremes.chain(points).filter(|&c| c > 0.0) {
            let exact = table.relative(c);
            let near = powers.iter().rev().fold(0.0, |sum, coefficient| sum * (c - centre) + coefficient);
            worst = worst.max((near - exact).abs());
            least = least.min(exact);
        }
        (least > 0.0).then(|| Self { reach, coefficients: powers, error: worst / least })
    }
}

/// Cosines down to which the polynomial may reach, the lowest that fits counts: 78°, and up to 37°.
const LOWEST: [f64; 7] = [0.2, 0.25, 0.3, 0.4, 0.5, 0.65, 0.8];

/// Greatest relative error of the polynomial: a few roundings of `f32`.
const MAX_ERROR: f64 = 1e-6;

const CHECKS: usize = 200;

/// I_rel = Σ coefficient·(c − c₀)ᵏ from [`Self::lowest`] to 1, c₀ their mean; below, the power of c that goes on as steep.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Curve<S> {
    lowest: S,
    coefficients: [S; DEGREE + 1],
}

impl<S: Number> Curve<S> {
    /// `None`: no polynomial is near enough to `profile` over an angle worth it.
    pub fn fit(profile: &CompiledProfile<f64>) -> Option<Self> {
        LOWEST.into_iter().find_map(|lowest| {
            let (centre, half) = (0.5 * (1.0 + lowest), 0.5 * (1.0 - lowest));
            let curve = Curve { lowest, coefficients: interpolate(centre, (centre, half), |c| profile.relative(c)) };
            let fits = (0..=CHECKS).all(|i| {
                let c = lowest + (1.0 - lowest) * i as f64 / CHECKS as f64;
                let exact = profile.relative(c);
                // Written so that NaN does not fit.
                exact > 0.0 && (curve.bends(c)[0] - exact).abs() <= MAX_ERROR * exact
            });
            fits.then(|| Self { lowest: S::of(lowest), coefficients: curve.coefficients.map(S::of) })
        })
    }

    /// I_rel at cos γ = `c` > 0, and its first two derivatives relative to it.
    #[inline(always)]
    pub fn bends(&self, c: S) -> [S; 3] {
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

#[cfg(test)]
mod tests {
    extern crate std;

    use std::println;

    use super::*;
    use crate::profile::Emission;
    use crate::profile::table::Table;
    use crate::scene::Profile;

    #[test]
    fn windows_stand_for_the_table_to_the_tolerance() {
        // As in a data sheet: every 5°, four digits.
        let rounded = |degrees: f64| (degrees.to_radians().cos().powf(1.247) * 1e4).round() / 1e4;
        let knots: heapless::Vec<_, 18> =
            (0..18).map(|i| f64::from(i) * 5.0).map(|degrees| (degrees.to_radians(), rounded(degrees))).collect();
        // Of 1800 spots. At a loose tolerance only those near the horizon have no window.
        for (tolerance, least) in [(1e-3, 1600), (1e-6, 1000), (1e-9, 100)] {
            let table = Table::<f64>::compile(&knots, tolerance);
            let mut found = 0;
            for i in 0..600 {
                let centre = (f64::from(i) * 0.1).to_radians().cos();
                for spread in [1e-3, 0.01, 0.05] {
                    let Some(series) = table.near(centre, spread) else { continue };
                    found += 1;
                    for j in -4..=4 {
                        let c = (centre * (1.0 + spread * f64::from(j) / 4.0)).min(1.0);
                        let error = (series.relative(c) / table.relative(c) - 1.0).abs();
                        // Sampled a little more finely than in the fit.
                        assert!(error <= 0.7 * tolerance, "{tolerance:e} {centre} {spread} {c}: {error:e}");
                    }
                }
            }
            println!("{tolerance:e}: {found}");
            assert!(found >= least, "{tolerance:e}: {found}");
        }
    }

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
