//! Relative radiant intensity of an emitter, compiled: I_rel as a function of c = cos γ.
//!
//! Callers ask only for c > 0; an emitter sends nothing to γ ≥ 90°.

use heapless::Vec;

use crate::power::{Power, PowerLanes};
use crate::real::Real;
use crate::scalar::Scalar;
use crate::scene::{MAX_PROFILE_KNOTS, Profile};

/// I_rel and its derivative by cos γ, for one cell or several.
pub(crate) trait Falloff<R> {
    /// I_rel at cos γ = `c` > 0.
    fn relative(&self, c: R) -> R;
    /// (I_rel, dI_rel/dc) at cos γ = `c` > 0.
    fn with_slope(&self, c: R) -> (R, R);
}

/// What integrals over a spot need to know of a profile besides.
pub(crate) trait Emission<S>: Falloff<S> {
    /// Whether derivatives jump anywhere between axis and horizon.
    const HAS_KINKS: bool;
    /// I_rel at γ = 90° from within: zero unless the profile jumps there.
    fn at_horizon(&self) -> S;
    /// What stands for this profile where c differs from `centre` by no more than `spread`·`centre`:
    /// cheaper, and right to the tolerance the profile was compiled with. `None`: nothing is cheaper.
    fn near(&self, centre: S, spread: S) -> Option<Series<S>>;
    /// An exponent n so that the profile varies across a spot no more than cosⁿ does.
    fn steepness(&self) -> S;
    /// The largest jump of d²I_rel/dγ² between pieces of the profile, and whether `lower..upper`
    /// (values of cos γ) contains one.
    fn kink(&self, lower: S, upper: S) -> Option<S>;
}

/// Most terms of a [`Series`] after its first.
const MAX_TERMS: usize = 10;

/// I_rel = cⁿ.
#[derive(Clone, Debug)]
pub(crate) struct Cosine<S> {
    power: Power<S>,
    /// Binomial coefficients of n.
    binomials: [S; MAX_TERMS + 1],
    /// The greatest |δ| for which the series may end after so many terms.
    spreads: [S; MAX_TERMS + 1],
}

impl<S: Scalar> Cosine<S> {
    /// For the exponent n; `tolerance`: relative error allowed to [`Emission::near`].
    fn compile(exponent: f64, tolerance: f64) -> Self {
        let mut binomial = 1.0;
        let mut binomials = [S::one(); MAX_TERMS + 1];
        let mut spreads = [S::zero(); MAX_TERMS + 1];
        for k in 0..=MAX_TERMS {
            binomials[k] = S::of(binomial);
            binomial *= (exponent - k as f64) / (k as f64 + 1.0);
            // The first neglected term, an eighth of the tolerance; the rest of the tail is a
            // geometric series of ratio δ ≤ ½.
            let first_neglected = 0.125 * tolerance / binomial.abs().max(f64::MIN_POSITIVE);
            spreads[k] = S::of(libm::pow(first_neglected, 1.0 / (k as f64 + 1.0)).min(0.5));
        }
        Self { power: Power::compile(exponent), binomials, spreads }
    }
}

impl<S: Scalar> Falloff<S> for Cosine<S> {
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

impl<R: Real> Falloff<R> for PowerLanes<R> {
    #[inline(always)]
    fn relative(&self, c: R) -> R {
        self.of_lanes(c)
    }

    #[inline(always)]
    fn with_slope(&self, c: R) -> (R, R) {
        let value = self.of_lanes(c);
        (value, self.exponent * value / c)
    }
}

impl<S: Scalar> Emission<S> for Cosine<S> {
    const HAS_KINKS: bool = false;

    fn at_horizon(&self) -> S {
        if self.power.exponent() == S::zero() { S::one() } else { S::zero() }
    }

    #[inline(always)]
    fn near(&self, centre: S, spread: S) -> Option<Series<S>> {
        let terms = self.spreads.iter().position(|&most| spread <= most)?;
        let inverse = centre.recip();
        let value = self.power.of(centre);
        let mut coefficients = [S::zero(); MAX_TERMS + 1];
        for (coefficient, binomial) in coefficients.iter_mut().zip(&self.binomials[..=terms]) {
            *coefficient = value * *binomial;
        }
        Some(Series { inverse, coefficients, terms })
    }

    #[inline(always)]
    fn steepness(&self) -> S {
        self.power.exponent()
    }

    #[inline(always)]
    fn kink(&self, _: S, _: S) -> Option<S> {
        None
    }
}

/// cⁿ around a centre c₀: with c = c₀(1 + δ), cⁿ = c₀ⁿ·Σ binomial(n, k)·δᵏ. A spot is small, so
/// a few terms replace a power at each of its nodes.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Series<S> {
    inverse: S,
    coefficients: [S; MAX_TERMS + 1],
    terms: usize,
}

impl<S: Scalar> Falloff<S> for Series<S> {
    #[inline(always)]
    fn relative(&self, c: S) -> S {
        let delta = c * self.inverse - S::one();
        self.coefficients[..=self.terms].iter().rev().fold(S::zero(), |sum, &coefficient| sum * delta + coefficient)
    }

    #[inline(always)]
    fn with_slope(&self, c: S) -> (S, S) {
        let delta = c * self.inverse - S::one();
        let (mut value, mut slope) = (S::zero(), S::zero());
        for &coefficient in self.coefficients[..=self.terms].iter().rev() {
            slope = slope * delta + value;
            value = value * delta + coefficient;
        }
        (value, slope * self.inverse)
    }
}

impl<S: Scalar> Emission<S> for Series<S> {
    const HAS_KINKS: bool = false;

    fn at_horizon(&self) -> S {
        S::zero()
    }

    fn near(&self, _: S, _: S) -> Option<Self> {
        None
    }

    fn steepness(&self) -> S {
        S::zero()
    }

    fn kink(&self, _: S, _: S) -> Option<S> {
        None
    }
}

/// A monotone piecewise cubic in γ (Fritsch and Carlson 1980, with the weighted harmonic means of
/// Fritsch and Butland 1984). The first piece is value + square·γ² + quartic·γ⁴ instead: a profile
/// is even in γ, so that it is smooth where the axis pierces a spot.
#[derive(Clone, Debug)]
pub(crate) struct Table<S> {
    first: AxialPiece<S>,
    /// The pieces after the first.
    pieces: Vec<Piece<S>, MAX_PROFILE_KNOTS>,
    horizon: S,
    largest_jump: S,
}

/// I_rel = value + square·γ² + quartic·γ⁴.
#[derive(Clone, Copy, Debug)]
struct AxialPiece<S> {
    value: S,
    square: S,
    quartic: S,
}

/// I_rel = value + slope·s + square·s² + cube·s³ with s = γ − start, from `start` to the next piece.
#[derive(Clone, Copy, Debug)]
struct Piece<S> {
    start: S,
    cosine_start: S,
    value: S,
    slope: S,
    square: S,
    cube: S,
}

impl<S: Scalar> Table<S> {
    /// From valid knots: at least two, ascending from zero, none beyond 90°.
    fn compile(knots: &[(f64, f64)]) -> Self {
        let right_angle = core::f64::consts::FRAC_PI_2;
        let mut points: Vec<(f64, f64), { MAX_PROFILE_KNOTS + 1 }> = knots.iter().copied().collect();
        let (last_angle, last_value) = points[points.len() - 1];
        if last_angle < right_angle {
            // Capacity is one more than the knots a profile can have.
            let _ = points.push((right_angle, 0.0));
        }
        let secant = |i: usize| (points[i + 1].1 - points[i].1) / (points[i + 1].0 - points[i].0);
        let width = |i: usize| points[i + 1].0 - points[i].0;
        let last = points.len() - 1;
        let slope_at = |i: usize| match i {
            i if i == last => secant(last - 1),
            i => {
                let (left, right) = (secant(i - 1), secant(i));
                if left * right <= 0.0 {
                    return 0.0;
                }
                let (h0, h1) = (width(i - 1), width(i));
                let (w0, w1) = (2.0 * h1 + h0, h1 + 2.0 * h0);
                (w0 + w1) / (w0 / left + w1 / right)
            }
        };
        // On the first piece: value and slope at its end fix square and quartic. It is monotone
        // as long as |slope| ≤ 4·|secant|; the harmonic mean keeps within 3.
        let (h, d, m) = (width(0), points[1].1 - points[0].1, slope_at(1));
        let h4 = h * h * h * h;
        let quartic = (m * h - 2.0 * d) / (2.0 * h4);
        let square = (d - quartic * h4) / (h * h);
        let first = AxialPiece { value: S::of(points[0].1), square: S::of(square), quartic: S::of(quartic) };
        let mut second_before = 2.0 * square + 12.0 * quartic * h * h;

        let mut pieces = Vec::new();
        let mut largest_jump = 0.0_f64;
        for i in 1..last {
            let (h, d) = (width(i), secant(i));
            let (m0, m1) = (slope_at(i), slope_at(i + 1));
            let square = (3.0 * d - 2.0 * m0 - m1) / h;
            let cube = (m0 + m1 - 2.0 * d) / (h * h);
            largest_jump = largest_jump.max((2.0 * square - second_before).abs());
            second_before = 2.0 * square + 6.0 * cube * h;
            let _ = pieces.push(Piece {
                start: S::of(points[i].0),
                cosine_start: S::of(libm::cos(points[i].0)),
                value: S::of(points[i].1),
                slope: S::of(m0),
                square: S::of(square),
                cube: S::of(cube),
            });
        }
        Self {
            first,
            pieces,
            horizon: S::of(if last_angle < right_angle { 0.0 } else { last_value }),
            largest_jump: S::of(largest_jump),
        }
    }

    /// The piece after the first that holds c; `None`: the first.
    #[inline]
    fn piece(&self, c: S) -> Option<usize> {
        self.pieces.iter().rposition(|piece| c <= piece.cosine_start)
    }
}

impl<S: Scalar> Falloff<S> for Table<S> {
    fn relative(&self, c: S) -> S {
        let gamma = c.min(S::one()).arc_cosine();
        match self.piece(c) {
            None => {
                let square = gamma * gamma;
                self.first.value + square * (self.first.square + square * self.first.quartic)
            }
            Some(i) => {
                let piece = &self.pieces[i];
                let s = gamma - piece.start;
                piece.value + s * (piece.slope + s * (piece.square + s * piece.cube))
            }
        }
    }

    fn with_slope(&self, c: S) -> (S, S) {
        let value = self.relative(c);
        let c = c.min(S::one());
        let gamma = c.arc_cosine();
        let sine = (S::one() - c * c).max(S::zero()).sqrt();
        let by_cosine = match self.piece(c) {
            None => {
                // dI/dγ has the factor γ here: divided by sin γ before both vanish.
                let ratio = if sine > S::zero() { gamma / sine } else { S::one() };
                -(S::two() * self.first.square + S::of(4.0) * self.first.quartic * gamma * gamma) * ratio
            }
            Some(i) => {
                let piece = &self.pieces[i];
                let s = gamma - piece.start;
                -(piece.slope + s * (S::two() * piece.square + S::of(3.0) * s * piece.cube)) / sine
            }
        };
        (value, by_cosine)
    }
}

impl<S: Scalar> Emission<S> for Table<S> {
    const HAS_KINKS: bool = true;

    fn at_horizon(&self) -> S {
        self.horizon
    }

    fn near(&self, _: S, _: S) -> Option<Series<S>> {
        None
    }

    fn steepness(&self) -> S {
        // A measured profile inside one piece is a cubic; the fourth power varies faster.
        S::of(4.0)
    }

    fn kink(&self, lower: S, upper: S) -> Option<S> {
        (self.piece(lower) != self.piece(upper)).then_some(self.largest_jump)
    }
}

/// The compiled profile of one emitter.
#[derive(Clone, Debug)]
#[allow(clippy::large_enum_variant, reason = "no heap on the board; a plan has at most 16 of them")]
pub(crate) enum CompiledProfile<S> {
    Cosine(Cosine<S>),
    Table(Table<S>),
}

impl<S: Scalar> CompiledProfile<S> {
    /// `tolerance`: relative error allowed where a cheaper form stands for the profile.
    pub(crate) fn compile(profile: &Profile, tolerance: f64) -> Self {
        match profile {
            Profile::Cosine { exponent } => Self::Cosine(Cosine::compile(*exponent, tolerance)),
            Profile::Table(knots) => Self::Table(Table::compile(knots)),
        }
    }

    /// The power, if that is what the profile is.
    pub(crate) fn as_power(&self) -> Option<&Power<S>> {
        match self {
            Self::Cosine(cosine) => Some(&cosine.power),
            Self::Table(_) => None,
        }
    }

    pub(crate) fn steepness(&self) -> S {
        match self {
            Self::Cosine(cosine) => cosine.steepness(),
            Self::Table(table) => table.steepness(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn table(knots: &[(f64, f64)]) -> Table<f64> {
        Table::compile(knots)
    }

    #[test]
    fn a_table_passes_through_its_knots_and_stays_between_them() {
        let knots: [(f64, f64); 5] = [(0.0, 1.0), (0.3, 0.95), (0.7, 0.7), (1.1, 0.25), (1.4, 0.05)];
        let table = table(&knots);
        for (gamma, value) in knots {
            assert!((table.relative(gamma.cos()) - value).abs() < 1e-14);
        }
        for pair in knots.windows(2) {
            for i in 0..=50 {
                let gamma = pair[0].0 + (pair[1].0 - pair[0].0) * f64::from(i) / 50.0;
                let value = table.relative(gamma.cos());
                assert!(value <= pair[0].1 + 1e-14 && value >= pair[1].1 - 1e-14);
            }
        }
        assert!(table.relative((core::f64::consts::FRAC_PI_2 - 1e-9).cos()) < 1e-8);
    }

    #[test]
    fn slopes_equal_central_differences() {
        let table = table(&[(0.0, 1.0), (0.2, 0.98), (0.6, 0.8), (1.2, 0.2), (1.5, 0.01)]);
        let cosine = Cosine::compile(1.247, 1e-10);
        for i in 1..400 {
            let c = f64::from(i) / 400.0;
            let h = 1e-6;
            for (slope, numeric) in [
                (table.with_slope(c).1, (table.relative(c + h) - table.relative(c - h)) / (2.0 * h)),
                (cosine.with_slope(c).1, (cosine.relative(c + h) - cosine.relative(c - h)) / (2.0 * h)),
            ] {
                // Second differences of a cubic in γ: h²·|I'''| and rounding 1e-16/h; at a knot h·|I''|.
                assert!((slope - numeric).abs() < 2e-5 * (1.0 + slope.abs()), "{c}: {slope} {numeric}");
            }
        }
    }

    #[test]
    fn the_slope_on_the_axis_is_finite() {
        let (value, slope) = table(&[(0.0, 1.0), (0.5, 0.9), (1.0, 0.4)]).with_slope(1.0);
        assert_eq!(value, 1.0);
        assert!(slope.is_finite() && slope > 0.0);
    }
}
