//! Readings of a head as its covariance has them: noise that is drawn anew for each.

use slitpose_model::{Detector, Noise, Pair};

/// The photocurrents `clean` of `detector` with `noise`; `normal` gives standard normal numbers, four for each reading.
///
/// Shot noise of a point spot is common to both electrodes and divides like the current; Johnson noise flows from one
/// to the other; that of the converter is each electrode's own.
pub fn noisy_reading(
    clean: Pair<f64>,
    detector: &Detector,
    noise: &Noise,
    mut normal: impl FnMut() -> f64,
) -> Pair<f64> {
    let total_a = clean.total_a();
    let variance_a2 = noise.shot_a() * total_a.abs() + noise.dark_shot_a2(detector);
    let shot = normal() * if total_a == 0.0 { 0.0 } else { variance_a2.sqrt() / total_a };
    let johnson_a = noise.johnson_a2(detector).sqrt() * normal();
    Pair {
        i_x1_a: clean.i_x1_a * (1.0 + shot) + johnson_a + noise.adc_a * normal(),
        i_x2_a: clean.i_x2_a * (1.0 + shot) - johnson_a + noise.adc_a * normal(),
    }
}
