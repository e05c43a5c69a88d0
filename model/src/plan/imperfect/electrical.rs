//! From light on the detector to the currents that are read.

use heapless::Vec;
use serde::{Deserialize, Serialize};

use crate::effects::{Effects, MAX_CONVERTER, MAX_NONLINEARITY, Stray};
use crate::scalar::{Linear3, Number};

use super::super::CurrentsJacobian;
use super::super::optics::Receiver;
use super::Sums;

#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(bound = "")]
pub struct Electrical<S: Number> {
    per_half_length: S,
    nonlinearity: Option<[S; MAX_NONLINEARITY]>,
    stray: Option<CompiledStray<S>>,
    gain: [S; 2],
    converters: Option<CompiledConverters<S>>,
}

#[derive(Clone, Debug, Serialize, Deserialize)]
struct CompiledStray<S> {
    constant: [S; 2],
    linear: [[S; 3]; 2],
    quadratic: [[S; 6]; 2],
}

#[derive(Clone, Debug, Serialize, Deserialize)]
struct CompiledConverters<S> {
    per_half_scale: S,
    curves: [[S; MAX_CONVERTER]; 2],
}

/// Σ coefficient·xᵏ and its derivative, N even: even and odd powers apart, for each multiplication waits for the one
/// before.
#[inline(always)]
fn polynomial<S: Number, const N: usize>(coefficients: &[S; N], x: S) -> (S, S) {
    let (square, twice) = (x * x, S::two() * x);
    let [even, odd] = [0, 1].map(|first| {
        let (mut value, mut slope) = (S::zero(), S::zero());
        for pair in (0..N / 2).rev() {
            slope = slope * square + value;
            value = value * square + coefficients[2 * pair + first];
        }
        (value, slope)
    });
    (even.0 + x * odd.0, twice * (even.1 + x * odd.1) + odd.0)
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
            }),
            gain: effects.electrode_gain.map(S::of),
            converters: effects.converters.as_ref().map(|converters| CompiledConverters {
                per_half_scale: S::of(2.0 / converters.full_scale_a),
                curves: [0, 1].map(|k| filled(&converters.curves_a[k])),
            }),
        }
    }

    /// The position that the detector shows for light at `x_a`, and its derivative.
    #[inline(always)]
    pub fn measured(&self, x_a: S) -> (S, S) {
        let Some(nonlinearity) = &self.nonlinearity else {
            return (x_a, S::one());
        };
        let (shift, slope) = polynomial(nonlinearity, x_a * self.per_half_length);
        (x_a + shift, S::one() + slope * self.per_half_length)
    }

    /// The currents above dark with the cell's own emitter at `own_level`, relative to nominal, and the tool's origin at
    /// `translation`, and their derivatives by the pose. In the paper tier I_D is divided, too: `divides_dark`.
    #[inline(always)]
    pub fn currents<const GRADIENT: bool>(
        &self,
        receiver: &Receiver<S>,
        divides_dark: bool,
        sums: &Sums<S>,
        own_level: S,
        translation: S::Vec3,
    ) -> ([S; 2], CurrentsJacobian<S>) {
        let (half, per_length) = (S::half(), receiver.per_length);
        let mut imbalance = sums.moment * per_length;
        let mut jacobian = [[S::zero(); 6]; 2];
        // Divided like the light: I_D·X̄, X̄ = moment/total.
        let divides_dark = divides_dark && receiver.dark > S::zero() && sums.total > S::zero();
        let dark_share = if divides_dark { receiver.dark / sums.total } else { S::zero() };
        if GRADIENT {
            let centroid = if divides_dark { sums.moment / sums.total } else { S::zero() };
            for i in 0..6 {
                let moved = sums.moment_by[i] + dark_share * (sums.moment_by[i] - centroid * sums.total_by[i]);
                let (half, across) = (half * sums.total_by[i], moved * per_length);
                (jacobian[0][i], jacobian[1][i]) = (half - across, half + across);
            }
        }
        imbalance += imbalance * dark_share;
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
                let moving = (0..3).fold(S::zero(), |sum, i| sum + (linear[i] + bend[i]) * t[i]);
                pair[k] += own_level * (stray.constant[k] + moving);
                if GRADIENT {
                    for i in 0..3 {
                        jacobian[k][i] += own_level * (linear[i] + S::two() * bend[i]);
                    }
                }
            }
        }
        for k in 0..2 {
            let mut gain = self.gain[k];
            pair[k] *= gain;
            if let Some(converters) = self.converters.as_ref().filter(|_| own_level > S::zero()) {
                let reading = pair[k] * converters.per_half_scale - S::one();
                // Beyond its range a converter shows the end of it, and a polynomial of high order anything.
                let within = reading.max(-S::one()).min(S::one());
                let (error, slope) = polynomial(&converters.curves[k], within);
                pair[k] += error;
                if within == reading {
                    gain *= S::one() + slope * converters.per_half_scale;
                }
            }
            if GRADIENT {
                jacobian[k] = jacobian[k].map(|value| value * gain);
            }
        }
        (pair, jacobian)
    }
}
