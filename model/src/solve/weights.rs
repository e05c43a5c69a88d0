//! How much a current is worth: the covariance of a cell's two currents, and whitening by it.

use crate::plan::CurrentsJacobian;
use crate::response::Pair;
use crate::scalar::Scalar;
use crate::scene::{Noise, Scene, Uncertainty};

/// Elementary charge, coulombs (SI, exact).
pub const ELEMENTARY_CHARGE_C: f64 = 1.602_176_634e-19;

/// Boltzmann constant, J/K (SI, exact).
pub const BOLTZMANN_J_PER_K: f64 = 1.380_649e-23;

/// Covariance of the two currents of a cell, A²: variances of I_X1 and I_X2, and covariance.
#[derive(Clone, Copy, Debug)]
pub(crate) struct PairCovariance<S> {
    first: S,
    second: S,
    mixed: S,
}

impl<S: Scalar> PairCovariance<S> {
    fn add_outer(&mut self, pair: [S; 2], factor: S) {
        self.first += factor * pair[0] * pair[0];
        self.second += factor * pair[1] * pair[1];
        self.mixed += factor * pair[0] * pair[1];
    }

    /// Inverse of the lower Cholesky factor: multiplies residuals into uncorrelated ones of unit
    /// variance.
    pub(crate) fn whitener(&self) -> Whitener<S> {
        let a = self.first.sqrt();
        let b = self.mixed / a;
        // Of two nearly proportional currents rounding must not leave less than nothing.
        let c = (self.second - b * b).max(S::epsilon() * self.second).sqrt();
        Whitener { first: a.recip(), mixed: -b / (a * c), second: c.recip() }
    }
}

/// A lower triangular 2×2 matrix.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Whitener<S> {
    first: S,
    mixed: S,
    second: S,
}

impl<S: Scalar> Whitener<S> {
    #[inline(always)]
    pub(crate) fn apply(&self, pair: [S; 2]) -> [S; 2] {
        [self.first * pair[0], self.mixed * pair[0] + self.second * pair[1]]
    }
}

/// The noise of one cell, compiled.
#[derive(Clone, Copy, Debug)]
pub(crate) struct CellNoise<S> {
    /// 2qB: variance of the total current per ampere.
    shot: S,
    /// 4kT·B/R_ie.
    johnson: S,
    /// Of converter and amplifier, per electrode.
    converter: S,
    emitter_gain: S,
    electrode_gain: S,
    /// Variance of X_A/Lx.
    position: S,
    /// Square of the relative error of the arithmetic: of the exact tier's integrals, or rounding.
    arithmetic: S,
    dark: S,
}

impl<S: Scalar> CellNoise<S> {
    pub(crate) fn compile(scene: &Scene, cell: usize, relative_error: f64) -> Self {
        let detector = &scene.cells[cell].detector;
        let (shot, johnson, converter) = match scene.noise {
            Some(Noise { shot_bandwidth_hz, johnson_bandwidth_hz, temperature_k, adc_a }) => (
                2.0 * ELEMENTARY_CHARGE_C * shot_bandwidth_hz,
                detector
                    .interelectrode_ohm
                    .map_or(0.0, |ohm| 4.0 * BOLTZMANN_J_PER_K * temperature_k * johnson_bandwidth_hz / ohm),
                adc_a * adc_a,
            ),
            None => (0.0, 0.0, 0.0),
        };
        let Uncertainty { emitter_gain_relative, electrode_gain_relative, position_m } = scene.uncertainty;
        let position = position_m / detector.length_m;
        Self {
            shot: S::of(shot),
            johnson: S::of(johnson),
            converter: S::of(converter),
            emitter_gain: S::of(emitter_gain_relative * emitter_gain_relative),
            electrode_gain: S::of(electrode_gain_relative * electrode_gain_relative),
            position: S::of(position * position),
            arithmetic: S::of(relative_error * relative_error),
            dark: S::of(detector.dark_current_a),
        }
    }

    /// The same cell taken less literally: gain known to 5 %, position to 0.1 mm. Far from the
    /// solution true weights turn χ² into narrow bent valleys; these keep it round.
    pub(crate) fn coarse(&self, detector_length_m: S) -> Self {
        let position = S::of(1e-4) / detector_length_m;
        Self { emitter_gain: S::of(0.05 * 0.05), position: position * position, ..*self }
    }

    /// Covariance at the measured `currents` (above dark).
    ///
    /// Shot noise of a point spot is common to both electrodes and divides like the current;
    /// Johnson noise of the inter-electrode resistance flows out of one electrode into the other;
    /// unknown gains and an unknown position are nuisance parameters marginalised here: each
    /// belongs to this cell alone, so its effect is a covariance of this pair.
    pub(crate) fn covariance(&self, currents: &Pair<S>) -> PairCovariance<S> {
        let pair = [currents.i_x1_a, currents.i_x2_a];
        let total = currents.total_a().abs();
        let square = total * total;
        let gain = self.electrode_gain;
        let own = self.converter + self.arithmetic * square + self.johnson;
        let mut covariance = PairCovariance {
            first: own + gain * pair[0] * pair[0],
            second: own + gain * pair[1] * pair[1],
            mixed: -self.johnson,
        };
        if square > S::zero() {
            let shot = self.shot * (total + self.dark) / square;
            covariance.add_outer(pair, shot + self.emitter_gain);
        }
        covariance.add_outer([-total, total], self.position);
        covariance
    }
}

/// Uncertainty of the twist that carried a cell's exposure to the reference instant: variances of
/// the linear and the angular velocity, per axis.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct TwistVariance<S> {
    pub(crate) linear: S,
    pub(crate) angular: S,
}

impl<S: Scalar> TwistVariance<S> {
    /// Adds what this uncertainty does to currents with `jacobian`, exposed `offset_s` away from
    /// the reference instant.
    pub(crate) fn add_to(&self, covariance: &mut PairCovariance<S>, jacobian: &CurrentsJacobian<S>, offset_s: S) {
        let square = offset_s * offset_s;
        for axis in 0..6 {
            let variance = if axis < 3 { self.linear } else { self.angular };
            covariance.add_outer([jacobian[0][axis], jacobian[1][axis]], variance * square);
        }
    }
}
