//! Conversion of scans to photocurrents, and the noise of a lit-minus-dark current.

use slitpose_model::{Noise, Pair, Photocurrents, Reading, Scene};
use slitpose_protocol::{AdcScaling, RawScan, Schedule};

use crate::scene_file::{FrontEnd, SceneFile};

/// Least settling gain of a front end that measures.
const MIN_GAIN: f64 = 1e-9;

/// Converts the scans of one configuration of one board.
///
/// ```
/// use slitpose_head::{front_end::{self, Stage}, scene_file::WIDE};
/// use slitpose_protocol::{AdcScaling, Level, RawScan};
///
/// let file = WIDE.read()?;
/// let schedule = front_end::configuration(&file)?.schedule;
/// let scaling = AdcScaling { zero_code: 4031.0, amperes_per_code: -2.5e-9, bits: 12, saturation_code: 32 };
/// let stage = Stage::new(&file, &schedule, &scaling);
/// let mut scan = RawScan::new(6, true);
/// scan.levels_mut().fill(Level(0));
/// assert!(stage.photocurrents(&scan).cells.iter().all(|cell| *cell == slitpose_model::Reading::Missing), "dark emitters");
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
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
            scene.noise = Some(of_lit_minus_dark(&scene, &front_end.as_scheduled(schedule), schedule, scaling, gain));
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

/// Standard deviation of one dark word of `cell` by the front end of `file` and the conversions of `schedule`, the same for
/// both electrodes, amperes; `None` for a scene without front end.
///
/// Shot noise of the dark current divides between the electrodes like the current.
pub fn dark_word_noise_a(file: &SceneFile, cell: usize, schedule: &Schedule, scaling: &AdcScaling) -> Option<f64> {
    let front_end = file.front_end?.as_scheduled(schedule);
    let detector = &file.scene.cells.get(cell)?.detector;
    let bandwidth_hz = word_bandwidth_hz(&front_end);
    let noise = Noise {
        shot_bandwidth_hz: bandwidth_hz,
        johnson_bandwidth_hz: bandwidth_hz,
        temperature_k: temperature_k(&file.scene),
        adc_a: converter_variance_lsb2(&front_end).sqrt() * scaling.amperes_per_code.abs(),
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
        (1..conversions).map(|lag| 2.0 * (n - f64::from(lag)) * libm::exp(-f64::from(lag) * step / tau)).sum();
    (n + pairs) / (n * n) / (4.0 * tau)
}

/// Gain and delay of one cell's lit-minus-dark sample, of a first-order front end.
///
/// Light of one cell is on in its slot and off for the rest of the frame, frame after frame. The output then follows, with
/// a = exp(−T_on/τ) and b = exp(−T_off/τ),
///
/// * lit, x after switching on: I·(1 − A·exp(−x/τ)), A = (1 − b)/(1 − ab);
/// * dark, x after switching off: I·A'·exp(−x/τ), A' = (1 − a)/(1 − ab),
///
/// for any τ from far below to far above the frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Settling {
    /// Sample over photocurrent: 1 for an ideal front end, near zero for one slower than the frame, and
    /// negative if the output is higher at the dark sample than at the lit one.
    pub gain: f64,
    /// Mean age of the light in a lit sample, seconds.
    pub delay_s: f64,
}

impl Settling {
    /// Gain and delay of `cell` in `schedule`, for a front end of `time_constant_s`.
    ///
    /// `None` if the schedule does not light the cell.
    pub fn of_cell(schedule: &Schedule, cell: usize, time_constant_s: f64) -> Option<Self> {
        let slot = schedule.lit_slot(cell)?;
        if time_constant_s <= 0.0 {
            return Some(Self { gain: 1.0, delay_s: 0.0 });
        }
        let tick_s = f64::from(schedule.tick_hz).recip();
        // In units of the time constant.
        let in_tau = |ticks: f64| ticks * tick_s / time_constant_s;
        let on = in_tau(f64::from(schedule.slot_ticks));
        let frame = in_tau(f64::from(schedule.frame_ticks));
        let first = |slot| schedule.first_sample_ticks(slot, cell).map(|ticks| ticks as f64);
        let samples = |after_ticks: f64| {
            (0..schedule.oversampling)
                .map(move |j| in_tau(after_ticks + f64::from(j) * f64::from(schedule.conversion_ticks)))
        };
        let count = f64::from(schedule.oversampling);

        // 1 − exp(−x) without cancellation.
        let rise = |x: f64| -libm::expm1(-x);
        let lit_ticks = first(slot)? - slot as f64 * f64::from(schedule.slot_ticks);
        let off_share = rise(frame - on) / rise(frame);
        let lit: f64 = samples(lit_ticks).map(|x| 1.0 - off_share * libm::exp(-x)).sum::<f64>() / count;
        let dark: f64 = match schedule.dark_slot().and_then(first) {
            Some(dark_ticks) => {
                let switched_off = (slot as f64 + 1.0) * f64::from(schedule.slot_ticks);
                let frame_ticks = f64::from(schedule.frame_ticks);
                let since = (dark_ticks - switched_off).rem_euclid(frame_ticks);
                let on_share = rise(on) / rise(frame);
                samples(since).map(|x| on_share * libm::exp(-x)).sum::<f64>() / count
            }
            None => 0.0,
        };
        // Light that left s before the sample counts with exp(−s/τ)/τ, 0 ≤ s ≤ x: on average
        // τ·(1 − x/(exp(x) − 1)).
        let delay = samples(lit_ticks).map(|x| 1.0 - x / libm::expm1(x)).sum::<f64>() / count;
        Some(Self { gain: lit - dark, delay_s: if delay.is_finite() { delay * time_constant_s } else { 0.0 } })
    }
}

#[cfg(test)]
mod tests {
    use slitpose_firmware::pcb::default_configuration;

    use super::*;
    use crate::scene_file::Shipped;

    #[test]
    fn slow_front_ends_average_nothing_and_fast_ones_everything() {
        let mut front_end = Shipped::named("wide").unwrap().read().unwrap().front_end.unwrap();
        front_end.time_constant_s = 1.0;
        assert!((word_bandwidth_hz(&front_end) - 0.25).abs() < 1e-5);
        front_end.time_constant_s = 1e-9;
        assert!((word_bandwidth_hz(&front_end) - 0.25e9 / 8.0).abs() < 1.0);
        // Without a low-pass, half the rate of eight conversions of 0.87 µs.
        front_end.time_constant_s = 0.0;
        assert!((word_bandwidth_hz(&front_end) - 71_839.08).abs() < 0.01);
        front_end.conversion_s = 0.0;
        assert_eq!(word_bandwidth_hz(&front_end), 0.0);
    }

    #[test]
    fn rounding_is_averaged_where_noise_makes_it_independent() {
        let mut front_end = Shipped::named("wide").unwrap().read().unwrap().front_end.unwrap();
        for (raw_noise_lsb, variance_lsb2) in
            [(0.0, 1.0 / 12.0), (0.4, 0.02 + 1.0 / 12.0), (0.5, 1.0 / 24.0), (2.0, 49.0 / 96.0)]
        {
            front_end.raw_noise_lsb = raw_noise_lsb;
            let found = converter_variance_lsb2(&front_end);
            assert!((found - variance_lsb2).abs() < 1e-12, "{raw_noise_lsb}: {found}, not {variance_lsb2}");
        }
    }

    /// Integrates the front end in steps of half a tick, period after period, until it repeats.
    fn brute_force(schedule: &Schedule, cell: usize, time_constant_s: f64) -> f64 {
        let ticks = |ticks: f64| (2.0 * ticks).round() as u64;
        let decay = (-0.5 / f64::from(schedule.tick_hz) / time_constant_s).exp();
        let slot = schedule.lit_slot(cell).unwrap() as u64;
        let on = slot * 2 * u64::from(schedule.slot_ticks)..(slot + 1) * 2 * u64::from(schedule.slot_ticks);
        let instants = |slot: usize| {
            let first = schedule.first_sample_ticks(slot, cell).unwrap() as f64;
            (0..schedule.oversampling)
                .map(|j| ticks(first + f64::from(j) * f64::from(schedule.conversion_ticks)))
                .collect::<Vec<_>>()
        };
        let (lit, dark) = (instants(slot as usize), instants(schedule.dark_slot().unwrap()));
        let (mut y, mut before) = (0.0, f64::NAN);
        loop {
            let mut sum = 0.0;
            for step in 0..2 * u64::from(schedule.frame_ticks) {
                if lit.contains(&step) {
                    sum += y;
                }
                if dark.contains(&step) {
                    sum -= y;
                }
                let light = if on.contains(&step) { 1.0 } else { 0.0 };
                y = light + (y - light) * decay;
            }
            let gain = sum / f64::from(schedule.oversampling);
            if (gain - before).abs() < 1e-13 {
                return gain;
            }
            before = gain;
        }
    }

    #[test]
    fn gain_equals_step_by_step_integration() {
        let schedule = default_configuration().schedule;
        for time_constant_s in [1e-7, 1.36e-6, 2e-5, 2e-4] {
            for cell in [0, 4, 5] {
                let gain = Settling::of_cell(&schedule, cell, time_constant_s).unwrap().gain;
                let expected = brute_force(&schedule, cell, time_constant_s);
                assert!((gain - expected).abs() < 1e-10, "{time_constant_s} {cell}: {gain} {expected}");
            }
        }
    }

    #[test]
    fn any_time_constant_gives_numbers() {
        let schedule = default_configuration().schedule;
        for exponent in -12..=3 {
            let settling = Settling::of_cell(&schedule, 0, 10_f64.powi(exponent)).unwrap();
            assert!(settling.gain.abs() <= 1.0, "1e{exponent}: {settling:?}");
            assert!((0.0..1e-4).contains(&settling.delay_s), "1e{exponent}: {settling:?}");
        }
        let ideal = Settling::of_cell(&schedule, 0, 0.0).unwrap();
        assert_eq!(ideal, Settling { gain: 1.0, delay_s: 0.0 });
    }

    /// The age of light at a sample, weighted by what is left of it, summed in steps of a thousandth of
    /// the exposure.
    #[test]
    fn delay_equals_step_by_step_integration() {
        let mut schedule = default_configuration().schedule;
        schedule.oversampling = 1;
        for time_constant_s in [2e-6, 2e-5, 2e-4] {
            let exposure_s = f64::from(schedule.settling_ticks) / f64::from(schedule.tick_hz);
            let ages = (0..1000).map(|step| (f64::from(step) + 0.5) * 1e-3 * exposure_s);
            let (sum, weight) = ages.fold((0.0, 0.0), |(sum, weight), age_s| {
                let left = (-age_s / time_constant_s).exp();
                (sum + age_s * left, weight + left)
            });
            let delay_s = Settling::of_cell(&schedule, 0, time_constant_s).unwrap().delay_s;
            assert!((delay_s / (sum / weight) - 1.0).abs() < 1e-5, "{time_constant_s}: {delay_s} {}", sum / weight);
        }
    }
}
