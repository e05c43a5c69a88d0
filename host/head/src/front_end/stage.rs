//! Conversion of scans to photocurrents, and the noise of a lit-minus-dark current.

use slitpose_model::{Noise, Pair, Photocurrents, Reading, Scene};
use slitpose_protocol::{AdcScaling, RawScan, Schedule};

use super::settling::Settling;
use crate::scene_file::{FrontEnd, SceneFile};

/// Least settling gain of a front end that measures.
const MIN_GAIN: f64 = 1e-9;

/// Converts the scans of one configuration of one board.
#[derive(Clone, Debug)]
pub struct Stage {
    scaling: AdcScaling,
    oversampling: u16,
    cells: Vec<CellStage>,
}

#[derive(Clone, Copy, Debug)]
struct CellStage {
    /// Photocurrent at nominal drive per step of a word, amperes.
    amperes_per_word: f64,
    exposure_s: f64,
    /// I_D/2, for schedules without a dark slot.
    half_dark_a: f64,
    /// Whether the front end has at least the gain [`MIN_GAIN`].
    measures: bool,
}

impl Stage {
    /// The stage for a board that runs `schedule` with `scaling` on the head of `file`. A scene without
    /// front end is taken as ideal, without settling time.
    ///
    /// The schedule and the scaling must be valid and have a slot for each of the scene's cells.
    pub fn new(file: &SceneFile, schedule: &Schedule, scaling: &AdcScaling) -> Self {
        let time_constant_s = file.front_end.map_or(0.0, |front_end| front_end.time_constant_s);
        let tick_s = f64::from(schedule.tick_hz).recip();
        let reference = schedule.reference_ticks();
        let cells = (0..file.scene.cells.len())
            .map(|cell| {
                let settling =
                    Settling::of_cell(schedule, cell, time_constant_s).unwrap_or(Settling { gain: 1.0, delay_s: 0.0 });
                let sampled = schedule.lit_sample_ticks(cell).unwrap_or(reference);
                CellStage {
                    amperes_per_word: scaling.amperes_per_code / f64::from(schedule.oversampling) / settling.gain,
                    exposure_s: (sampled - reference) * tick_s - settling.delay_s,
                    measures: settling.gain.abs() >= MIN_GAIN,
                    half_dark_a: 0.5 * file.scene.cells[cell].detector.dark_current_a,
                }
            })
            .collect();
        Self { scaling: *scaling, oversampling: schedule.oversampling, cells }
    }

    /// The scene of `file` with the noise of its front end, for the solver's weights.
    pub fn weighted_scene(file: &SceneFile, schedule: &Schedule, scaling: &AdcScaling) -> Scene {
        let mut scene = file.scene.clone();
        if let Some(front_end) = &file.front_end {
            let gain = (0..scene.cells.len())
                .filter_map(|cell| Settling::of_cell(schedule, cell, front_end.time_constant_s))
                .map(|settling| settling.gain.abs())
                .fold(1.0, f64::min)
                .max(MIN_GAIN);
            scene.noise = Some(of_lit_minus_dark(&scene, front_end, schedule, scaling, gain));
        }
        scene
    }

    /// Time at which the light of each cell left its emitter, relative to the reference instant, seconds.
    pub fn exposures_s(&self) -> Vec<f64> {
        self.cells.iter().map(|cell| cell.exposure_s).collect()
    }

    /// Photocurrent of cell `cell` at nominal drive per step of a word, amperes, zero if it does not measure; and the
    /// word of no light, for schedules without a dark slot.
    pub(crate) fn line(&self, cell: usize) -> (f64, f64) {
        let stage = &self.cells[cell];
        let zero = self.scaling.zero_code * f64::from(self.oversampling);
        if stage.measures {
            (stage.amperes_per_word, zero + stage.half_dark_a / stage.amperes_per_word)
        } else {
            (0.0, zero)
        }
    }

    /// The photocurrents of a scan, without dark current, at nominal drive.
    ///
    /// Without a dark slot, the code at zero current replaces the dark words, and the scene's I_D the
    /// dark current. A cell whose emitter was off has no photocurrents.
    pub fn photocurrents(&self, scan: &RawScan) -> Photocurrents {
        let zero = self.scaling.zero_code * f64::from(self.oversampling);
        let dark_words = scan.dark();
        let readings =
            self.cells.iter().zip(scan.lit()).zip(scan.levels()).enumerate().map(|(cell, ((stage, &lit), level))| {
                let level = level.relative();
                if level == 0.0 || !stage.measures {
                    return Reading::Missing;
                }
                if lit.iter().any(|&word| self.scaling.is_saturated(word, self.oversampling)) {
                    return Reading::Saturated;
                }
                let current = |electrode: usize| match dark_words {
                    Some(dark) => {
                        (f64::from(lit[electrode]) - f64::from(dark[cell][electrode])) * stage.amperes_per_word / level
                    }
                    None => ((f64::from(lit[electrode]) - zero) * stage.amperes_per_word - stage.half_dark_a) / level,
                };
                Reading::Light(Pair { i_x1_a: current(0), i_x2_a: current(1) })
            });
        Photocurrents { cells: readings.collect() }
    }
}

/// Temperature of detectors whose scene gives none.
pub const ROOM_TEMPERATURE_K: f64 = 300.0;

/// Converter noise, in steps, from which on the rounding errors of successive conversions are independent,
/// so that summing averages them.
const DITHER_LSB: f64 = 0.5;

/// The noise of one current, lit minus dark, after division by the settling `gain`.
///
/// Shot noise of light is only in the lit word; that of the dark current, Johnson noise, converter noise
/// and rounding are in the lit and in the dark word.
fn of_lit_minus_dark(
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
