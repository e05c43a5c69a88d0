//! Covariance of one reading of a cell.

use slitpose_model::{Cell, ModelError, Noise};

/// Covariance of the currents of one cell, A²: three numbers, [1,1], [1,2] and [2,2].
pub(crate) type Covariance = [f64; 3];

/// Noise of one cell in one frame.
#[derive(Clone, Copy, Debug)]
pub(crate) struct ReadingNoise {
    electrode: f64,
    johnson: f64,
    dark: f64,
    shot_a: f64,
    per_length: f64,
}

/// Least relative error of a current: what the arithmetic of the optics is good for.
const LEAST_RELATIVE: f64 = 1e-6;

impl ReadingNoise {
    pub(crate) fn new(noise: Option<&Noise>, cell: &Cell) -> Self {
        let detector = &cell.detector;
        let of = |value: &dyn Fn(&Noise) -> f64| noise.map_or(0.0, value);
        let dark = of(&|noise| noise.dark_shot_a2(detector));
        Self {
            electrode: of(&|noise| noise.adc_a * noise.adc_a),
            johnson: of(&|noise| noise.johnson_a2(detector)) + dark / 12.0,
            dark,
            shot_a: of(&|noise| noise.shot_a()),
            per_length: detector.length_m.recip(),
        }
    }

    /// Of the mean of `frames` frames, with what the model leaves out.
    pub(crate) fn covariance(&self, pair: [f64; 2], frames: f64, error: &ModelError) -> Covariance {
        let total = (pair[0] + pair[1]).abs().max(f64::MIN_POSITIVE);
        let square = total * total;
        let moved = error.position_m * self.per_length;
        let own =
            self.electrode / frames + error.current_a * error.current_a + LEAST_RELATIVE * LEAST_RELATIVE * square;
        let across = self.johnson / frames + moved * moved * square;
        let even = 0.25 * self.dark / frames;
        let along = self.shot_a / (total * frames) + error.relative * error.relative;
        [
            own + across + even + along * pair[0] * pair[0],
            even - across + along * pair[0] * pair[1],
            own + across + even + along * pair[1] * pair[1],
        ]
    }
}

/// The inverse of the lower Cholesky factor of a covariance: [1,1], [2,1], [2,2].
pub(crate) fn whitener([a, b, c]: Covariance) -> [f64; 3] {
    let first = a.sqrt();
    let below = b / first;
    let second = (c - below * below).max(f64::MIN_POSITIVE).sqrt();
    [first.recip(), -below / (first * second), second.recip()]
}

/// The whitened pair.
pub(crate) fn whiten(w: [f64; 3], pair: [f64; 2]) -> [f64; 2] {
    [w[0] * pair[0], w[1] * pair[0] + w[2] * pair[1]]
}

/// Derivatives of a reading's relative intensity and position by its currents.
pub(crate) fn directions(pair: [f64; 2], half_length_m: f64) -> [[f64; 2]; 2] {
    let total = pair[0] + pair[1];
    let share = (pair[1] - pair[0]) / total;
    let across = half_length_m / total;
    [[total.recip(); 2], [across * (-1.0 - share), across * (1.0 - share)]]
}
