//! A profile given as a table of (γ, I_rel): smooth between its points and across them.
//!
//! The variable is v = 1 − cos γ, in which a profile that is smooth across the emitter's axis has no
//! kink there. Through each point (v_i, y_i) goes a parabola P_i = y_i + m·(v − v_i) + q·(v − v_i)².
//! Between two points the parabolas are blended (Overhauser 1968) by the quintic step w of Perlin
//! (2002), which is flat at both ends:
//!
//! I_rel = P_i + w(s)·(P_{i+1} − P_i),  w = s³(10 − 15s + 6s²),  s = (v − v_i)/(v_{i+1} − v_i).
//!
//! With d₁, d₂ the secants to the two neighbours and h₁, h₂ their distances, P_i is the parabola
//! through both neighbours, m = (d₁h₂ + d₂h₁)/(h₁ + h₂), q = (d₂ − d₁)/(h₁ + h₂), except
//! * where |m| exceeds 2·min(|d₁|, |d₂|): |m| is limited to that value, and P_i goes only through the
//!   neighbour with the smaller secant;
//! * where the secants differ in sign or one is zero: m = 0, and q = ±min(|d₁|/h₁, |d₂|/h₂), negative
//!   at a maximum.
//!
//! The first and the last parabola have their neighbour's slope at the neighbour's point. I_rel passes
//! through the points, stays between any two neighbouring ones (and so is never negative), and has
//! continuous second derivatives, and third derivatives where no exception applies.

use heapless::Vec;

use crate::scalar::Number;
use crate::scene::MAX_PROFILE_KNOTS;

use super::window::{Piecewise, Windows};
use super::{Emission, Falloff, Series};

/// A table that ends before 90° gets one more point, at 90°.
pub const MAX_POINTS: usize = MAX_PROFILE_KNOTS + 1;

/// The greatest number of points within a panel for which its ten nodes still show its roughness.
const RESOLVED_POINTS: usize = 6;

#[derive(Clone, Debug)]
pub struct Table<S> {
    points: Vec<Point<S>, MAX_POINTS>,
    horizon: S,
    windows: Windows<S>,
}

/// A point. Its parabola is computed when needed: most spots lie within a window and need none.
#[derive(Clone, Copy, Debug)]
struct Point<S> {
    v: S,
    value: S,
}

impl<S: Number> Table<S> {
    /// Compiles valid knots: at least two, ascending from zero, none beyond 90°. `tolerance`: relative
    /// error allowed to [`Emission::near`]; zero if that is not called.
    pub fn compile(knots: &[(f64, f64)], tolerance: f64) -> Self {
        let right_angle = core::f64::consts::FRAC_PI_2;
        let mut given: Vec<(f64, f64), MAX_POINTS> = knots.iter().copied().collect();
        if given[given.len() - 1].0 < right_angle {
            // The capacity is one more than the most knots of a profile.
            let _ = given.push((right_angle, 0.0));
        }
        let horizon = given[given.len() - 1].1;
        // 2·sin²(γ/2) = 1 − cos γ, without cancellation near the axis.
        let points = given.iter().map(|&(gamma, value)| {
            let sine = libm::sin(0.5 * gamma);
            Point { v: (2.0 * sine * sine).min(1.0), value }
        });
        let exact = Table::<f64> { points: points.collect(), horizon, windows: Windows::none() };
        let windows = if tolerance > 0.0 { Windows::fit(&exact, tolerance) } else { Windows::none() };
        let points = exact.points.iter().map(|point| Point { v: S::of(point.v), value: S::of(point.value) });
        Self { points: points.collect(), horizon: S::of(horizon), windows }
    }

    fn step(&self, i: usize) -> (S, S) {
        let (a, b) = (&self.points[i], &self.points[i + 1]);
        let width = b.v - a.v;
        (width, (b.value - a.value) / width)
    }

    /// Slope m and curvature q of the parabola through point i.
    fn parabola(&self, i: usize) -> (S, S) {
        let (last, two) = (self.points.len() - 1, S::two());
        if last == 1 {
            return (self.step(0).1, S::zero());
        }
        if i == 0 {
            let (h, d) = self.step(0);
            let next = self.parabola(1).0;
            return (two * d - next, (next - d) / h);
        }
        if i == last {
            let (h, d) = self.step(last - 1);
            let slope = two * d - self.parabola(last - 1).0;
            return (slope, (slope - d) / h);
        }
        let ((h1, d1), (h2, d2)) = (self.step(i - 1), self.step(i));
        if d1 == S::zero() || d2 == S::zero() || (d1 > S::zero()) != (d2 > S::zero()) {
            let bend = (d1.abs() / h1).min(d2.abs() / h2);
            return (S::zero(), if d2 > d1 { bend } else { -bend });
        }
        let slope = (d1 * h2 + d2 * h1) / (h1 + h2);
        let steepest = two * d1.abs().min(d2.abs());
        if slope.abs() <= steepest {
            return (slope, (d2 - d1) / (h1 + h2));
        }
        let slope = if slope > S::zero() { steepest } else { -steepest };
        (slope, if d1.abs() < d2.abs() { (slope - d1) / h1 } else { (d2 - slope) / h2 })
    }

    /// Index of the point at or below v, the last point excluded.
    #[inline]
    fn index(&self, v: S) -> usize {
        let pieces = &self.points[..self.points.len() - 1];
        pieces.partition_point(|point| point.v <= v).max(1) - 1
    }
}

impl Piecewise for Table<f64> {
    fn end(&self) -> f64 {
        let last_lit = self.points.iter().rposition(|point| point.value > 0.0).unwrap_or(0);
        self.points[(last_lit + 1).min(self.points.len() - 1)].v
    }

    fn positions(&self) -> impl Iterator<Item = f64> + Clone {
        self.points.iter().map(|point| point.v)
    }
}

impl<S: Number> Falloff<S> for Table<S> {
    fn relative(&self, c: S) -> S {
        self.with_slope(c).0
    }

    fn with_slope(&self, c: S) -> (S, S) {
        let v = (S::one() - c).max(S::zero());
        let index = self.index(v);
        let parabola = |i: usize| {
            let (slope, square) = self.parabola(i);
            let t = v - self.points[i].v;
            (self.points[i].value + t * (slope + square * t), slope + S::two() * square * t)
        };
        let ((p, p_slope), (q, q_slope)) = (parabola(index), parabola(index + 1));
        let per_width = (self.points[index + 1].v - self.points[index].v).recip();
        let s = ((v - self.points[index].v) * per_width).min(S::one());
        let rest = S::one() - s;
        let step = s * s * s * (S::of(10.0) + s * (S::of(6.0) * s - S::of(15.0)));
        let step_slope = S::of(30.0) * s * s * rest * rest * per_width;
        let by_v = p_slope + step * (q_slope - p_slope) + step_slope * (q - p);
        (p + step * (q - p), -by_v)
    }
}

impl<S: Number> Emission<S> for Table<S> {
    fn at_horizon(&self) -> S {
        self.horizon
    }

    #[inline(always)]
    fn near(&self, centre: S, spread: S) -> Option<Series<S>> {
        self.windows.near(centre, spread)
    }

    fn greatest(&self, lower: S, upper: S) -> S {
        let range = self.index(S::one() - upper)..=self.index(S::one() - lower.max(S::zero())) + 1;
        self.points[range].iter().fold(S::zero(), |greatest, point| greatest.max(point.value))
    }

    fn is_resolved(&self, lower: S, upper: S) -> bool {
        self.index(S::one() - lower) - self.index(S::one() - upper) <= RESOLVED_POINTS
    }

    fn is_smooth(&self, lower: S, upper: S) -> bool {
        self.index(S::one() - lower) == self.index(S::one() - upper)
    }

    fn rescaling(&self, _: impl FnOnce() -> S, _: S) -> (S, S) {
        (S::one(), S::one())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use core::f64::consts::FRAC_PI_2;

    fn table(knots: &[(f64, f64)]) -> Table<f64> {
        Table::compile(knots, 1e-6)
    }

    /// Bumps, plateaus, a zero between lights, and points close together.
    const TABLES: [&[(f64, f64)]; 5] = [
        &[(0.0, 1.0), (0.3, 0.95), (0.7, 0.7), (1.1, 0.25), (1.4, 0.05)],
        &[(0.0, 1.0), (0.17, 0.9), (0.35, 0.6), (0.5, 0.75), (0.7, 0.5), (0.9, 0.45), (1.2, 0.1)],
        &[(0.0, 0.2), (0.2, 0.2), (0.4, 1.0), (0.6, 0.0), (0.8, 0.4), (0.81, 0.0), (1.3, 0.0), (1.5, 0.3)],
        &[(0.0, 1.0), (0.02, 0.5), (0.04, 0.01), (0.05, 0.0)],
        &[(0.0, 1.0), (FRAC_PI_2, 0.4)],
    ];

    #[test]
    fn a_table_passes_through_its_points_and_stays_between_them() {
        for knots in TABLES {
            let table = table(knots);
            for &(gamma, value) in knots {
                // cos γ rounds, and the steepest table rises by 2500 per unit of it.
                assert!((table.relative(gamma.cos()) - value).abs() < 1e-12, "{gamma}");
            }
            for pair in knots.windows(2) {
                let (low, high) = (pair[0].1.min(pair[1].1), pair[0].1.max(pair[1].1));
                for i in 0..=50 {
                    let gamma = pair[0].0 + (pair[1].0 - pair[0].0) * f64::from(i) / 50.0;
                    let value = table.relative(gamma.cos());
                    assert!(value <= high + 1e-12 && value >= low - 1e-12 && value >= 0.0, "{gamma}: {value}");
                }
            }
        }
        // Zero at the horizon, unless the table has a point there.
        assert!(table(TABLES[0]).relative((FRAC_PI_2 - 1e-9).cos()) < 1e-8);
        assert!((table(TABLES[4]).relative(1e-12) - 0.4).abs() < 1e-11);
    }

    #[test]
    fn value_slope_and_curvature_have_no_jump() {
        for knots in TABLES {
            let table = table(knots);
            for &(gamma, _) in &knots[1..] {
                let (c, h) = (gamma.cos(), 1e-7);
                if c < 1e-3 {
                    continue;
                }
                let around = [c - 2.0 * h, c - h, c + h, c + 2.0 * h].map(|c| table.with_slope(c).1);
                let (below, above) = ((around[1] - around[0]) / h, (around[3] - around[2]) / h);
                // Third derivatives reach 60·Δ/h³ of the closest points, 2e-4 apart in v; slopes round at 1e-14·Δ/h.
                let scale = 1.0 + below.abs() + if knots[1].0 < 0.1 { 1e7 } else { 2e5 };
                assert!((below - above).abs() < 1e-2 * scale, "{gamma}: {below:e} {above:e}");
            }
        }
    }

    #[test]
    fn parabolas_are_met_exactly() {
        // A profile quadratic in cos γ at uneven angles.
        let f = |gamma: f64| 0.3 + 0.6 * gamma.cos() + 0.1 * gamma.cos() * gamma.cos();
        let knots = [0.0, 0.2, 0.35, 0.8, 1.0, 1.4, FRAC_PI_2].map(|gamma| (gamma, f(gamma)));
        let table = table(&knots);
        for i in 0..=100 {
            let gamma = FRAC_PI_2 * f64::from(i) / 101.0;
            assert!((table.relative(gamma.cos()) - f(gamma)).abs() < 1e-13, "{gamma}");
        }
    }

    #[test]
    fn the_slope_on_the_axis_is_finite() {
        let (value, slope) = table(&[(0.0, 1.0), (0.5, 0.9), (1.0, 0.4)]).with_slope(1.0);
        assert_eq!(value, 1.0);
        assert!(slope.is_finite() && slope > 0.0);
    }
}
