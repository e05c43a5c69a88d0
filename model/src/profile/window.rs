//! Polynomials that stand for a table over ranges of cos γ as wide as a spot.
//!
//! A node of a rule then costs as little as one of a cosine power. Windows are laid evenly over
//! √(1 − cos γ), about evenly over γ, and each is as wide as the tolerance lets a polynomial of
//! [`DEGREE`] be; where none is wide enough for a spot, the table itself is integrated.

use crate::scalar::Scalar;

use super::{Falloff, MAX_TERMS, Series};

/// Number of windows from the axis to where the light ends: 4.5° each for light up to 90°. A plan has room
/// for 16 tables, and the board 96 KiB for it and its scene.
const WINDOWS: usize = 20;

/// Degree of the polynomials: those of a table in steps of 5° then stand for it to 1e-6 over 8° to 16°.
const DEGREE: usize = MAX_TERMS;

/// Half widths that are tried, degrees of γ: beyond the first, few spots are that wide; within the last,
/// few spots are that small.
const HALF_WIDTHS_DEG: [f64; 10] = [12.0, 10.0, 8.0, 6.8, 5.8, 5.0, 4.2, 3.4, 2.6, 1.8];

/// Shares of the tolerance for the polynomial at its worst point, for terms left out of it within a
/// spot, and for the rule that integrates the rest.
const SHARES: [f64; 3] = [0.5, 0.05, 0.25];

/// What Gauss–Legendre rules with 1, 2, … nodes leave out of ∫xᵏ, k ≥ 2N, half of it on −1…1, at most.
const REMAINDERS: [f64; 5] = [0.34, 0.12, 0.05, 0.015, 0.0015];

/// Exponents above which the product of profile and distance takes a node more, and another one: a node
/// is worth a factor of a hundred and more.
const STEEPNESSES: [f64; 2] = [3.0, 30.0];

/// A profile given by its values at some positions, smooth between them.
pub(super) trait Piecewise: Falloff<f64> {
    /// 1 − cos γ where the light ends.
    fn end(&self) -> f64;
    /// 1 − cos γ of the values.
    fn positions(&self) -> impl Iterator<Item = f64> + Clone;
}

#[derive(Clone, Debug)]
pub(super) struct Windows<S> {
    windows: [Window<S>; WINDOWS],
    /// Windows per unit of √v, and its inverse.
    density: S,
    pitch: S,
    /// Relative error allowed to terms left out, and to a rule.
    allowed: [S; 2],
}

/// I_rel = Σ coefficient·(c − c₀)ᵏ.
#[derive(Clone, Copy, Debug)]
struct Window<S> {
    /// The greatest |c − c₀|; zero: the window is closed.
    reach: S,
    coefficients: [S; DEGREE + 1],
}

impl<S: Scalar> Windows<S> {
    /// All closed.
    pub(super) fn none() -> Self {
        let closed = Window { reach: S::zero(), coefficients: [S::zero(); DEGREE + 1] };
        Self { windows: [closed; WINDOWS], density: S::one(), pitch: S::one(), allowed: [S::zero(); 2] }
    }

    /// As wide as `tolerance` allows.
    pub(super) fn fit(table: &impl Piecewise, tolerance: f64) -> Self {
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

    /// cos γ in the middle of a window.
    #[inline(always)]
    fn centre(&self, index: usize) -> S {
        let root = (S::of(index as f64) + S::half()) * self.pitch;
        S::one() - root * root
    }

    /// The polynomial for c within `spread`·`centre` of `centre`.
    #[inline(always)]
    pub(super) fn near(&self, centre: S, spread: S) -> Option<Series<S>> {
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
        // In powers of δ = c/centre − 1, and what each contributes at most within the spot.
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
        let mut nodes = REMAINDERS.len();
        let mut rest = terms[DEGREE];
        while nodes > 1 {
            // Of the power below, the first moment takes a part.
            let fewer = nodes - 1;
            rest += terms[2 * fewer] + terms[2 * fewer + 1];
            if S::of(REMAINDERS[fewer - 1]) * (rest + S::of(0.25) * terms[2 * fewer - 1]) > by_rule {
                break;
            }
            nodes = fewer;
        }
        // d ln I/d ln c, the exponent of a power as steep.
        let steepness = (coefficients[1] / coefficients[0]).abs();
        let more = STEEPNESSES.iter().filter(|&&steep| steepness > S::of(steep)).count();
        Some(Series { inverse: centre.recip(), coefficients, terms: last, nodes, more })
    }
}

/// A polynomial of degree [`DEGREE`] for the table around one cosine.
struct Fit {
    reach: f64,
    coefficients: [f64; DEGREE + 1],
    /// Greatest difference, relative to the least I_rel of the range.
    error: f64,
}

impl Fit {
    /// Over γ ± `half_width` around the angle of cosine `centre`. `None` where there is no light.
    fn over(table: &impl Piecewise, centre: f64, half_width: f64) -> Option<Self> {
        let gamma = libm::acos(centre);
        let farther = libm::cos((gamma + half_width).min(core::f64::consts::FRAC_PI_2)).max(0.0);
        let nearer = libm::cos((gamma - half_width).max(0.0));
        // As far to both sides, as long as there are cosines.
        let reach = (centre - farther).max(nearer - centre);
        let (low, high) = ((centre - reach).max(0.0), (centre + reach).min(1.0));
        let (middle, half) = (0.5 * (low + high), 0.5 * (high - low));
        let count = (DEGREE + 1) as f64;

        // Newton's divided differences at the Chebyshev nodes.
        let nodes: [f64; DEGREE + 1] =
            core::array::from_fn(|i| middle + half * libm::cos(core::f64::consts::PI * (i as f64 + 0.5) / count));
        let mut newton = nodes.map(|c| table.relative(c));
        for k in 1..=DEGREE {
            for i in (k..=DEGREE).rev() {
                newton[i] = (newton[i] - newton[i - 1]) / (nodes[i] - nodes[i - k]);
            }
        }
        // From the innermost factor outward, in powers of c − centre.
        let mut powers = [0.0; DEGREE + 1];
        powers[0] = newton[DEGREE];
        for k in (0..DEGREE).rev() {
            let shift = centre - nodes[k];
            for j in (1..=DEGREE).rev() {
                powers[j] = powers[j] * shift + powers[j - 1];
            }
            powers[0] = powers[0] * shift + newton[k];
        }
        // Where a smooth remainder is greatest, and at the points, where the table is least smooth.
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

#[cfg(test)]
mod tests {
    extern crate std;

    use std::println;

    use super::*;
    use crate::profile::Emission;
    use crate::profile::table::Table;

    #[test]
    fn windows_stand_for_the_table_to_the_tolerance() {
        // As a data sheet gives it, every 5° to four digits.
        let rounded = |degrees: f64| (degrees.to_radians().cos().powf(1.247) * 1e4).round() / 1e4;
        let knots: heapless::Vec<_, 18> =
            (0..18).map(|i| f64::from(i) * 5.0).map(|degrees| (degrees.to_radians(), rounded(degrees))).collect();
        // Of 1800 spots: what a looser tolerance leaves without a window are those next to the horizon.
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
                        // Sampled a little finer than the fit itself samples.
                        assert!(error <= 0.7 * tolerance, "{tolerance:e} {centre} {spread} {c}: {error:e}");
                    }
                }
            }
            println!("{tolerance:e}: {found}");
            assert!(found >= least, "{tolerance:e}: {found}");
        }
    }
}
