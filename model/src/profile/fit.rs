//! A table as a smooth function: cosⁿγ·P(z), z = 1 − cos γ.
//!
//! A table is rounded, and the rounding is rough: a curve through all of its points takes tens of times the nodes of a
//! smooth one. Hence the polynomial P of the lowest degree with which the function *is* the table when rounded to the
//! decimals that the table has. There is none, and the points stand as they are, if the degree would exceed
//! [`MAX_DEGREE`] or leave fewer points than twice the coefficients, or if the function were negative or rose or fell
//! beyond two neighbouring points between them.
//!
//! n is zero for a table with light at 90°; else the slope of ln I_rel over ln cos γ, weighted by I_rel², if cosⁿγ alone
//! will do, or what leaves the least squares. P is the best approximation in the maximum norm, by Lawson's iteration (1961): least squares, weighted anew by the residuals.

use heapless::Vec;

use crate::scene::MAX_PROFILE_KNOTS;

pub const MAX_DEGREE: usize = 8;

/// Most decimals that count as written; with more, the points stand for themselves to [`EXACT`].
const MAX_DECIMALS: i32 = 11;

/// Allowed deviations, relative to the greatest I_rel: at least the rounding of the arithmetic, and at most that of
/// two decimals, for a table with fewer.
const EXACT: f64 = 1e-12;
const COARSE: f64 = 5e-3;

/// Lawson's iteration takes some tens of steps to within a few percent of the best approximation.
const STEPS: usize = 60;

/// Greatest n: narrower lobes have vanished before 90°.
const MAX_EXPONENT: f64 = 100.0;

/// Factor up to which n differs from the slope over all points.
const NEAREST_RANGE: f64 = 1.5;

/// Golden sections: they narrow the range to a thousandth.
const SECTIONS: usize = 15;
const GOLDEN: f64 = 0.618_033_988_749_894_9;

const CHECKS: usize = 8;

/// The function: n, and the coefficients of z⁰, z¹, …
pub struct Smooth {
    pub exponent: f64,
    pub coefficients: Vec<f64, { MAX_DEGREE + 1 }>,
}

/// A point of the table: cos γ, z, I_rel, and the weight cosⁿγ of P.
#[derive(Clone, Copy)]
struct Point {
    c: f64,
    z: f64,
    value: f64,
    power: f64,
}

impl Point {
    /// How far the function with these coefficients of P is from the point.
    fn residual(&self, coefficients: &Coefficients) -> f64 {
        (self.power * polynomial(coefficients, self.z) - self.value).abs()
    }
}

type Points = Vec<Point, MAX_PROFILE_KNOTS>;
type Coefficients = [f64; MAX_DEGREE + 1];

impl Smooth {
    /// The smooth function of valid `knots` (γ, I_rel), if there is one.
    #[inline(never)]
    pub fn of(knots: &[(f64, f64)]) -> Option<Self> {
        let right_angle = core::f64::consts::FRAC_PI_2;
        let greatest = knots.iter().fold(0.0_f64, |greatest, &(_, value)| greatest.max(value));
        let allowed = half_unit(knots).clamp(EXACT * greatest, COARSE * greatest);
        let mut points: Points = knots
            .iter()
            .map(|&(gamma, value)| {
                let sine = libm::sin(0.5 * gamma);
                let c = if gamma < right_angle { libm::cos(gamma) } else { 0.0 };
                Point { c, z: (2.0 * sine * sine).min(1.0), value, power: 1.0 }
            })
            .collect();
        let slope = exponent(&points)?;
        let basis = legendre();
        raise(&mut points, slope);
        let mut power = [0.0; MAX_DEGREE + 1];
        power[0] = 1.0;
        let (exponent, degree, coefficients) = if worst(&points, &power) <= allowed {
            (slope, 0, power)
        } else {
            (0..=MAX_DEGREE.min(points.len() / 2 - 1)).find_map(|degree| {
                let basis = &basis[..=degree];
                let exponent = if slope > 0.0 { nearest(&mut points, basis, slope)? } else { 0.0 };
                approximation(&points, basis, allowed).map(|found| (exponent, degree, found))
            })?
        };
        let smooth = Self { exponent, coefficients: coefficients[..=degree].iter().copied().collect() };
        smooth.stays_between(&points, allowed).then_some(smooth)
    }

    fn stays_between(&self, points: &Points, allowed: f64) -> bool {
        let at = |c: f64| libm::pow(c, self.exponent) * polynomial(&self.coefficients, 1.0 - c);
        let end = Point { c: 0.0, z: 1.0, value: 0.0, power: 0.0 };
        let next = points[1..].iter().chain([&end]);
        points.iter().zip(next).all(|(a, b)| {
            let (low, high) = (a.value.min(b.value), a.value.max(b.value));
            (1..CHECKS).all(|i| {
                let share = i as f64 / CHECKS as f64;
                let value = at(a.c + share * (b.c - a.c));
                value >= (low - allowed).max(0.0) && value <= high + allowed
            })
        })
    }
}

/// Half a unit of the last decimal that any of the values has.
fn half_unit(knots: &[(f64, f64)]) -> f64 {
    let is_whole = |value: f64| (value - libm::round(value)).abs() <= 4.0 * f64::EPSILON * value.abs();
    let units = (0..=MAX_DECIMALS).map(|decimals| libm::pow(10.0, f64::from(decimals)));
    let mut units = units.filter(|unit| knots.iter().all(|&(_, value)| is_whole(value * unit)));
    units.next().map_or(0.0, |unit| 0.5 / unit)
}

/// n of the power that is nearest to the table; `None` if it does not fall towards 90°.
fn exponent(points: &Points) -> Option<f64> {
    if points.last().is_some_and(|last| last.c == 0.0 && last.value > 0.0) {
        return Some(0.0);
    }
    let first = points.first().map_or(0.0, |first| first.value);
    let (mut squares, mut products) = (0.0, 0.0);
    for point in points.iter().filter(|point| point.z > 0.0 && point.c > 0.0 && point.value > 0.0) {
        let (log_c, log_value) = (libm::log(point.c), libm::log(point.value / first));
        let weight = point.value * point.value;
        squares += weight * log_c * log_c;
        products += weight * log_c * log_value;
    }
    let exponent = products / squares;
    // NaN fails, too: no light on the axis or beside it.
    (exponent > 0.0 && exponent <= MAX_EXPONENT).then_some(exponent)
}

fn raise(points: &mut Points, exponent: f64) {
    points.iter_mut().for_each(|point| point.power = libm::pow(point.c, exponent));
}

/// The n, near `exponent`, with which a polynomial in `basis` meets the points best in the mean: by golden sections.
/// The points are then weighted by it.
fn nearest(points: &mut Points, basis: &[Coefficients], exponent: f64) -> Option<f64> {
    let even = [1.0; MAX_PROFILE_KNOTS];
    let mut error = |exponent: f64| {
        raise(points, exponent);
        let coefficients = least_squares(points, &even[..points.len()], basis)?;
        Some(points.iter().map(|point| point.residual(&coefficients)).map(|residual| residual * residual).sum::<f64>())
    };
    let (mut low, mut high) = (exponent / NEAREST_RANGE, exponent * NEAREST_RANGE);
    let at = |low: f64, high: f64| [high - GOLDEN * (high - low), low + GOLDEN * (high - low)];
    for _ in 0..SECTIONS {
        let [first, second] = at(low, high);
        if error(first)? < error(second)? { high = second } else { low = first }
    }
    let exponent = 0.5 * (low + high);
    raise(points, exponent);
    Some(exponent)
}

/// Legendre polynomials of 2z − 1 in powers of z.
fn legendre() -> [Coefficients; MAX_DEGREE + 1] {
    let mut basis = [[0.0; MAX_DEGREE + 1]; MAX_DEGREE + 1];
    basis[0][0] = 1.0;
    for k in 0..MAX_DEGREE {
        for j in 0..=k + 1 {
            let turned = if j > 0 { 2.0 * basis[k][j - 1] } else { 0.0 } - basis[k][j];
            let before = if k > 0 { basis[k - 1][j] } else { 0.0 };
            basis[k + 1][j] = ((2 * k + 1) as f64 * turned - k as f64 * before) / (k + 1) as f64;
        }
    }
    basis
}

fn polynomial(coefficients: &[f64], z: f64) -> f64 {
    coefficients.iter().rev().fold(0.0, |sum, coefficient| sum * z + coefficient)
}

fn worst(points: &Points, coefficients: &Coefficients) -> f64 {
    points.iter().map(|point| point.residual(coefficients)).fold(0.0, f64::max)
}

/// P as a sum of the polynomials in `basis` that meets all points to `allowed`.
fn approximation(points: &Points, basis: &[Coefficients], allowed: f64) -> Option<Coefficients> {
    let mut weights: Vec<f64, MAX_PROFILE_KNOTS> = points.iter().map(|_| 1.0 / points.len() as f64).collect();
    for _ in 0..STEPS {
        let coefficients = least_squares(points, &weights, basis)?;
        if worst(points, &coefficients) <= allowed {
            return Some(coefficients);
        }
        let (mut mean_square, mut sum) = (0.0, 0.0);
        for (weight, point) in weights.iter_mut().zip(points) {
            let residual = point.residual(&coefficients);
            mean_square += *weight * residual * residual;
            *weight *= residual;
            sum += *weight;
        }
        // No polynomial meets all points better than this one does in the mean (de La Vallée Poussin 1911).
        if mean_square > allowed * allowed {
            return None;
        }
        weights.iter_mut().for_each(|weight| *weight /= sum);
    }
    None
}

/// The weighted least squares, by normal equations: the Legendre basis keeps them well conditioned.
fn least_squares(points: &Points, weights: &[f64], basis: &[Coefficients]) -> Option<Coefficients> {
    const COLUMNS: usize = MAX_DEGREE + 2;
    let count = basis.len();
    let mut matrix = [[0.0; COLUMNS]; MAX_DEGREE + 1];
    for (point, weight) in points.iter().zip(weights) {
        let mut row = [0.0; COLUMNS];
        for (value, polynomial_of) in row.iter_mut().zip(basis) {
            *value = point.power * polynomial(polynomial_of, point.z);
        }
        row[count] = point.value;
        for i in 0..count {
            for j in 0..=count {
                matrix[i][j] += weight * row[i] * row[j];
            }
        }
    }
    for i in 0..count {
        let pivot = matrix[i][i];
        if pivot <= 0.0 {
            return None;
        }
        for k in (0..count).filter(|&k| k != i) {
            let factor = matrix[k][i] / pivot;
            for j in i..=count {
                matrix[k][j] -= factor * matrix[i][j];
            }
        }
    }
    let mut coefficients = [0.0; MAX_DEGREE + 1];
    for (i, polynomial_of) in basis.iter().enumerate() {
        for (coefficient, of_basis) in coefficients.iter_mut().zip(polynomial_of) {
            *coefficient += matrix[i][count] / matrix[i][i] * of_basis;
        }
    }
    Some(coefficients)
}

#[cfg(test)]
mod tests {
    extern crate std;

    use std::println;

    use super::*;

    type Knots = Vec<(f64, f64), MAX_PROFILE_KNOTS>;

    /// Every `step` degrees below 90, with so many decimals.
    fn rounded(step: usize, decimals: i32, of: impl Fn(f64) -> f64) -> Knots {
        let unit = 10_f64.powi(decimals);
        let angles = (0..90).step_by(step).map(|degrees| (degrees as f64).to_radians());
        angles.map(|gamma| (gamma, (of(gamma) * unit).round() / unit)).collect()
    }

    fn bumpy(gamma: f64) -> f64 {
        let z = 1.0 - gamma.cos();
        gamma.cos().powf(1.247) * (1.0 + 0.1 * z - 0.15 * z * z + 0.3 * z * z * z)
    }

    #[test]
    fn a_rounded_table_is_the_function_that_rounds_to_it() {
        for (step, decimals) in [(5, 3), (5, 4), (5, 5), (10, 3), (2, 3), (2, 2)] {
            let knots = rounded(step, decimals, bumpy);
            let smooth = Smooth::of(&knots).expect("smooth");
            let at =
                |gamma: f64| gamma.cos().powf(smooth.exponent) * polynomial(&smooth.coefficients, 1.0 - gamma.cos());
            let allowed = half_unit(&knots).min(COARSE);
            for &(gamma, value) in &knots {
                assert!((at(gamma) - value).abs() <= allowed * (1.0 + 1e-9), "{step} {decimals} {gamma}");
            }
            let worst =
                (0..90).map(|degrees| f64::from(degrees).to_radians()).map(|gamma| (at(gamma) - bumpy(gamma)).abs());
            let worst = worst.fold(0.0, f64::max);
            println!("{step}°, {decimals} decimals: {:?}, off by {worst:.1e}", smooth.coefficients);
            // As far from the table, and that as far from the curve.
            assert!(worst <= 2.5 * allowed, "{worst:e}");
        }
    }

    #[test]
    fn a_power_is_known_by_its_values() {
        for exponent in [0.5, 1.0, 1.247, 11.0] {
            let exact: Knots = (0..18)
                .map(|i| (f64::from(5 * i).to_radians(), f64::from(5 * i).to_radians().cos().powf(exponent)))
                .collect();
            for knots in [rounded(5, 3, |gamma| gamma.cos().powf(exponent)), exact] {
                let smooth = Smooth::of(&knots).expect("a power");
                println!("{exponent}: {} {:?}", smooth.exponent, smooth.coefficients);
                assert!((smooth.exponent / exponent - 1.0).abs() < 5e-3 && smooth.coefficients.len() <= 2);
                assert!((smooth.coefficients[0] - 1.0).abs() <= COARSE);
            }
        }
    }

    #[test]
    fn what_is_not_smooth_stays_as_it_is() {
        let tables: [&[(f64, f64)]; 6] = [
            &[(0.0, 1.0), (0.17, 0.9), (0.35, 0.6), (0.5, 0.75), (0.7, 0.5), (0.9, 0.45), (1.05, 0.2), (1.2, 0.1)],
            &[(0.0, 0.0), (0.5, 1.0), (1.0, 0.0)],
            &[(0.0, 0.0), (1.0, 0.0)],
            &[(0.0, 1.0), (0.3, 0.9), (0.6, 0.7), (0.9, 0.3)],
            &[(0.0, 0.5), (0.5, 1.0), (1.0, 2.0), (1.5, 3.0)],
            &[(0.0, 1.0), (0.02, 0.5), (0.04, 0.01), (0.05, 0.0)],
        ];
        for knots in tables {
            assert!(Smooth::of(knots).is_none(), "{knots:?}");
        }
        // A step of 2 % at 45° is more than rounding.
        let stepped = rounded(5, 3, |gamma| gamma.cos() * if gamma > 0.8 { 0.98 } else { 1.0 });
        assert!(Smooth::of(&stepped).is_none());
    }
}
