//! Noise of a lit-minus-dark current after the front end.

use slitpose_model::{Noise, Scene};
use slitpose_protocol::{AdcScaling, Schedule};

use crate::scene_file::{FrontEnd, SceneFile};

/// Temperature of detectors whose scene gives none.
pub const ROOM_TEMPERATURE_K: f64 = 300.0;

/// Converter noise, in steps, from which on the rounding errors of successive conversions are independent,
/// so that summing averages them.
const DITHER_LSB: f64 = 0.5;

/// The noise of one current, lit minus dark, after division by the settling `gain`.
///
/// Shot noise of light is only in the lit word; that of the dark current, Johnson noise, converter noise
/// and rounding are in the lit and in the dark word.
pub(super) fn of_lit_minus_dark(
    scene: &Scene,
    front_end: &FrontEnd,
    schedule: &Schedule,
    scaling: &AdcScaling,
    gain: f64,
) -> Noise {
    let words = if schedule.dark_slot().is_some() { 2.0 } else { 1.0 };
    let bandwidth_hz = word_bandwidth_hz(front_end) / (gain * gain);
    Noise {
        shot_bandwidth_hz: bandwidth_hz,
        johnson_bandwidth_hz: words * bandwidth_hz,
        temperature_k: temperature_k(scene),
        adc_a: (words * converter_variance_lsb2(front_end)).sqrt() * scaling.amperes_per_code.abs() / gain,
    }
}

/// Standard deviation of one dark word of `cell` by the front end of `file`, the same for both
/// electrodes, amperes; `None` for a scene without front end.
///
/// Shot noise of the dark current divides between the electrodes like the current.
pub fn dark_word_noise_a(file: &SceneFile, cell: usize, scaling: &AdcScaling) -> Option<f64> {
    let front_end = file.front_end.as_ref()?;
    let detector = &file.scene.cells.get(cell)?.detector;
    let bandwidth_hz = word_bandwidth_hz(front_end);
    let noise = Noise {
        shot_bandwidth_hz: bandwidth_hz,
        johnson_bandwidth_hz: bandwidth_hz,
        temperature_k: temperature_k(&file.scene),
        adc_a: converter_variance_lsb2(front_end).sqrt() * scaling.amperes_per_code.abs(),
    };
    Some((noise.adc_a * noise.adc_a + noise.johnson_a2(detector) + 0.25 * noise.dark_shot_a2(detector)).sqrt())
}

fn temperature_k(scene: &Scene) -> f64 {
    scene.noise.map_or(ROOM_TEMPERATURE_K, |noise| noise.temperature_k)
}

/// Variance of the mean of a word's conversions, in squared steps: noise, and rounding (1/12).
fn converter_variance_lsb2(front_end: &FrontEnd) -> f64 {
    let conversions = f64::from(front_end.oversampling);
    let rounding = if front_end.raw_noise_lsb >= DITHER_LSB { 1.0 / conversions } else { 1.0 } / 12.0;
    front_end.raw_noise_lsb * front_end.raw_noise_lsb / conversions + rounding
}

/// One-sided bandwidth of white noise that passes the first-order front end and is averaged over
/// the conversions of a word: 1/(4τ) times the mean of exp(−|i − j|·t/τ) over all pairs.
fn word_bandwidth_hz(front_end: &FrontEnd) -> f64 {
    let conversions = front_end.oversampling;
    let (tau, step) = (front_end.time_constant_s, front_end.conversion_s);
    if tau <= 0.0 {
        // Without a low-pass the converter's own sampling sets the band, half its rate.
        return if step > 0.0 { 0.5 / (step * f64::from(conversions)) } else { 0.0 };
    }
    let n = f64::from(conversions);
    let pairs: f64 =
        (1..conversions).map(|lag| 2.0 * (n - f64::from(lag)) * (-f64::from(lag) * step / tau).exp()).sum();
    (n + pairs) / (n * n) / (4.0 * tau)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene_file::Shipped;

    #[test]
    fn the_default_front_end_has_the_noise_its_arithmetic_says() {
        let front_end = Shipped::named("wide").unwrap().read().unwrap().front_end.unwrap();
        // One step of 10 µA/4096 = 2.44 nA, halved by four conversions, √2 for lit minus dark.
        let step_a = 10e-6 / 4096.0;
        let converter = (2.0 * converter_variance_lsb2(&front_end)).sqrt() * step_a;
        assert!((converter - 1.8e-9).abs() < 0.05e-9, "{converter}");
        // 184 kHz of the low-pass, averaged over 3.5 µs.
        assert!((word_bandwidth_hz(&front_end) - 100e3).abs() < 20e3, "{}", word_bandwidth_hz(&front_end));
    }

    #[test]
    fn slow_front_ends_average_nothing_and_fast_ones_everything() {
        let mut front_end = Shipped::named("wide").unwrap().read().unwrap().front_end.unwrap();
        front_end.time_constant_s = 1.0;
        assert!((word_bandwidth_hz(&front_end) - 0.25).abs() < 1e-5);
        front_end.time_constant_s = 1e-9;
        assert!((word_bandwidth_hz(&front_end) - 0.25e9 / 4.0).abs() < 1.0);
        // Without a low-pass, half the rate of four conversions of 0.87 µs.
        front_end.time_constant_s = 0.0;
        assert!((word_bandwidth_hz(&front_end) - 143_678.16).abs() < 0.01);
        front_end.conversion_s = 0.0;
        assert_eq!(word_bandwidth_hz(&front_end), 0.0);
    }

    #[test]
    fn rounding_is_averaged_where_noise_makes_it_independent() {
        let mut front_end = Shipped::named("wide").unwrap().read().unwrap().front_end.unwrap();
        for (raw_noise_lsb, variance_lsb2) in
            [(0.0, 1.0 / 12.0), (0.4, 0.04 + 1.0 / 12.0), (0.5, 1.0 / 12.0), (2.0, 49.0 / 48.0)]
        {
            front_end.raw_noise_lsb = raw_noise_lsb;
            let found = converter_variance_lsb2(&front_end);
            assert!((found - variance_lsb2).abs() < 1e-12, "{raw_noise_lsb}: {found}, not {variance_lsb2}");
        }
    }
}
