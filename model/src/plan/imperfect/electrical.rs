//! From light on the detector to the currents that are read.

use heapless::Vec;
use serde::{Deserialize, Serialize};

use crate::effects::{Effects, MAX_CONVERTER, MAX_NONLINEARITY, Stray};
use crate::pose::Transform;
use crate::scalar::{Linear3, Number, Real, array, zero_half_one};

use super::super::optics::Receiver;
use super::Sums;

/// From a detector's light to the readings of its two currents; one detector per lane.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Electrical<R> {
    pub per_half_length: R,
    pub nonlinearity: Option<[R; MAX_NONLINEARITY]>,
    pub stray: Option<CompiledStray<R>>,
    pub gain: [R; 2],
    pub converters: Option<CompiledConverters<R>>,
}

#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct CompiledStray<R> {
    pub constant: [R; 2],
    pub linear: [[R; 3]; 2],
    pub quadratic: [[R; 6]; 2],
    pub turning: Option<[[R; 3]; 2]>,
}

#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct CompiledConverters<R> {
    pub per_half_scale: R,
    pub curves: [[R; MAX_CONVERTER]; 2],
}

/// Σ coefficient·xᵏ and its derivative, N even: even and odd powers apart, for each multiplication waits for the one
/// before.
#[inline(always)]
fn polynomial<R: Real, const N: usize>(coefficients: &[R; N], x: R) -> (R, R) {
    let (zero, square) = (x.constant(0.0), x * x);
    let (mut values, mut slopes) = ([zero; 2], [zero; 2]);
    for pair in (0..N / 2).rev() {
        for odd in 0..2 {
            slopes[odd] = slopes[odd] * square + values[odd];
            values[odd] = values[odd] * square + coefficients[2 * pair + odd];
        }
    }
    (values[0] + x * values[1], x.constant(2.0) * x * (slopes[0] + x * slopes[1]) + values[1])
}

/// Coefficients, and zeros up to the most that there may be.
fn filled<S: Number, const N: usize>(coefficients: &Vec<f64, N>) -> [S; N] {
    core::array::from_fn(|k| S::of(coefficients.get(k).copied().unwrap_or(0.0)))
}

impl<S: Number> Electrical<S> {
    pub fn compile(effects: &Effects, half_length_m: f64) -> Self {
        Self {
            per_half_length: S::of(half_length_m).recip(),
            nonlinearity: (!effects.nonlinearity_m.is_empty()).then(|| filled(&effects.nonlinearity_m)),
            stray: effects.stray.map(|stray: Stray| CompiledStray {
                constant: stray.constant_a.map(S::of),
                linear: stray.linear_a_per_m.map(|row| row.map(S::of)),
                quadratic: stray.quadratic_a_per_m2.map(|row| row.map(S::of)),
                turning: (stray.turning_a != [[0.0; 3]; 2]).then(|| stray.turning_a.map(|row| row.map(S::of))),
            }),
            gain: effects.electrode_gain.map(S::of),
            converters: effects.converters.as_ref().map(|converters| CompiledConverters {
                per_half_scale: S::of(2.0 / converters.full_scale_a),
                curves: [0, 1].map(|k| filled(&converters.curves_a[k])),
            }),
        }
    }
}

impl<R: Real> Electrical<R> {
    /// The position that the detector shows for light at `x_a`, and its derivative.
    #[inline(always)]
    pub fn measured(&self, x_a: R) -> (R, R) {
        let one = x_a.constant(1.0);
        let Some(nonlinearity) = &self.nonlinearity else {
            return (x_a, one);
        };
        let (shift, slope) = polynomial(nonlinearity, x_a * self.per_half_length);
        (x_a + shift, one + slope * self.per_half_length)
    }

    /// The currents above dark with the cell's own emitter at `own_level`, relative to nominal, and the tool's origin at
    /// `translation`, and their derivatives by the pose; it is turned as at `pose`. In the paper tier I_D is divided, too: `divides_dark`.
    #[inline(always)]
    pub fn currents<const GRADIENT: bool>(
        &self,
        receiver: &Receiver<R>,
        divides_dark: bool,
        sums: &Sums<R>,
        own_level: R,
        (translation, pose): (R::Vec3, &Transform<R>),
    ) -> ([R; 2], [[R; 6]; 2]) {
        let ([zero, half, one], per_length) = (zero_half_one(sums.total), receiver.per_length);
        let mut imbalance = sums.moment * per_length;
        let mut jacobian = [[zero; 6]; 2];
        let mut moment_by = sums.moment_by;
        if divides_dark {
            // Divided like the light: I_D·X̄, X̄ = moment/total.
            let share = R::select_gt(sums.total, zero, receiver.dark / sums.total, zero);
            let centroid = R::select_gt(sums.total, zero, sums.moment / sums.total, zero);
            imbalance += imbalance * share;
            for i in 0..6 {
                moment_by[i] += share * (moment_by[i] - centroid * sums.total_by[i]);
            }
        }
        if GRADIENT {
            for i in 0..6 {
                let (half, across) = (half * sums.total_by[i], moment_by[i] * per_length);
                (jacobian[0][i], jacobian[1][i]) = (half - across, half + across);
            }
        }
        let mut pair = [half * sums.total - imbalance, half * sums.total + imbalance];
        if let Some(stray) = &self.stray {
            let t = [translation.x(), translation.y(), translation.z()];
            for k in 0..2 {
                let (linear, [xx, yy, zz, xy, yz, zx]) = (stray.linear[k], stray.quadratic[k]);
                // The quadratic form's gradient without the factor two, whose product with t is its value.
                let bend = [
                    xx * t[0] + half * (xy * t[1] + zx * t[2]),
                    yy * t[1] + half * (xy * t[0] + yz * t[2]),
                    zz * t[2] + half * (yz * t[1] + zx * t[0]),
                ];
                let mut moving = zero;
                for i in 0..3 {
                    moving += (linear[i] + bend[i]) * t[i];
                    if GRADIENT {
                        jacobian[k][i] += own_level * (linear[i] + (one + one) * bend[i]);
                    }
                }
                if let Some(turning) = &stray.turning {
                    let (value, by_turn) = pose.turn(&turning[k]);
                    moving += value;
                    if GRADIENT {
                        jacobian[k][3] += own_level * by_turn.x();
                        jacobian[k][4] += own_level * by_turn.y();
                        jacobian[k][5] += own_level * by_turn.z();
                    }
                }
                pair[k] += own_level * (stray.constant[k] + moving);
            }
        }
        for k in 0..2 {
            let mut gain = self.gain[k];
            pair[k] = pair[k] * gain;
            if let Some(converters) = &self.converters {
                let reading = pair[k] * converters.per_half_scale - one;
                // Beyond its range a converter shows the end of it, and a polynomial of high order anything.
                let within = one.at_most((-one).at_least(reading));
                let (error, slope) = polynomial(&converters.curves[k], within);
                pair[k] += R::select_gt(own_level, zero, error, zero);
                let slope = R::select_gt(own_level, zero, slope, zero);
                let beyond = (reading - within).magnitude();
                gain = R::select_gt(beyond, zero, gain, gain * (one + slope * converters.per_half_scale));
            }
            if GRADIENT {
                jacobian[k] = array(zero, |i| jacobian[k][i] * gain);
            }
        }
        (pair, jacobian)
    }
}
