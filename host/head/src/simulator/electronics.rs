//! Conversion of photocurrents to words: settling, noise, saturation, quantisation.

use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use slitpose_model::{BOLTZMANN_J_PER_K, ELEMENTARY_CHARGE_C, Pair, Scene};
use slitpose_protocol::{AdcScaling, WordPair};

use crate::front_end::ROOM_TEMPERATURE_K;
use crate::scene_file::FrontEnd;

/// Codes between zero current and the end of the converter's range, so that noise at zero current
/// is not cut off.
const PEDESTAL_CODES: f64 = 64.0;

/// Codes at the end of the range where a real stage is nonlinear.
const HEADROOM_CODES: u16 = 16;

/// The scaling of a front end like the board's: it swings down from near the top code as the
/// current rises, and `full_scale_a` is reached at code 0.
pub(super) fn scaling(front_end: &FrontEnd) -> AdcScaling {
    let top = f64::from((1_u32 << front_end.adc_bits) - 1);
    let zero_code = top - PEDESTAL_CODES;
    AdcScaling {
        zero_code,
        amperes_per_code: -front_end.full_scale_a / zero_code,
        bits: front_end.adc_bits as u8,
        saturation_code: HEADROOM_CODES,
    }
}

/// The front end of all cells: one low-pass state per electrode.
#[derive(Clone, Debug)]
pub struct Electronics {
    front_end: FrontEnd,
    scaling: AdcScaling,
    top_code: f64,
    cells: Vec<Channel>,
    /// exp(−t/τ) for one conversion.
    conversion_decay: f64,
}

/// The two electrodes of a cell's detector.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Electrode {
    /// I_X1.
    X1,
    /// I_X2.
    X2,
}

/// The filtered noise of one cell at an instant; by default zero.
#[derive(Clone, Copy, Debug, Default)]
pub struct CellNoise {
    /// In units of its standard deviation.
    johnson: f64,
    /// Of both electrodes together, amperes, and its variance over 2qB, amperes.
    shot: f64,
    shot_of: f64,
}

#[derive(Clone, Debug)]
struct Channel {
    state: [f64; 2],
    half_dark_a: f64,
    dark_a: f64,
    /// Standard deviation of the filtered Johnson current.
    johnson_a: f64,
    /// The current whose shot noise, filtered, is there: see [`Electronics::pass`].
    shot_of: f64,
    /// Variance of the filtered shot noise per ampere, 2qB.
    shot_a: f64,
}

impl Electronics {
    /// The electronics of `front_end` behind the detectors of `scene`, settled in the dark.
    pub fn new(scene: &Scene, front_end: &FrontEnd) -> Self {
        let temperature_k = scene.noise.map_or(ROOM_TEMPERATURE_K, |noise| noise.temperature_k);
        let tau = front_end.time_constant_s;
        // White noise through a first-order low-pass has the bandwidth 1/(4τ).
        let bandwidth_hz = if tau > 0.0 {
            0.25 / tau
        } else if front_end.conversion_s > 0.0 {
            0.5 / front_end.conversion_s
        } else {
            0.0
        };
        let cells = scene.cells.iter().map(|cell| {
            let johnson = cell
                .detector
                .interelectrode_ohm
                .map_or(0.0, |ohm| 4.0 * BOLTZMANN_J_PER_K * temperature_k * bandwidth_hz / ohm);
            let half_dark_a = 0.5 * cell.detector.dark_current_a;
            Channel {
                state: [half_dark_a; 2],
                half_dark_a,
                dark_a: cell.detector.dark_current_a,
                johnson_a: johnson.sqrt(),
                shot_of: cell.detector.dark_current_a,
                shot_a: 2.0 * ELEMENTARY_CHARGE_C * bandwidth_hz,
            }
        });
        Self {
            front_end: *front_end,
            scaling: scaling(front_end),
            top_code: f64::from((1_u32 << front_end.adc_bits) - 1),
            cells: cells.collect(),
            conversion_decay: decay(front_end.conversion_s, tau),
        }
    }

    /// Scaling of the codes of this front end.
    pub fn scaling(&self) -> AdcScaling {
        self.scaling
    }

    /// exp(−t/τ) for `duration_s`: the share of the earlier output that is left.
    pub fn decay(&self, duration_s: f64) -> f64 {
        decay(duration_s, self.front_end.time_constant_s)
    }

    /// Lets `duration_s` pass for `cell` with light that changes linearly from `from` to `to`.
    ///
    /// The low-pass τ·y' = u − y has for u = u₀ + s·t the exact solution
    /// y = u − s·τ + (y₀ − u₀ + s·τ)·exp(−t/τ), stable for any ratio of duration and τ.
    ///
    /// An electron that passed the detector t ago shows in the output as exp(−t/τ)/τ, and in the variance of its
    /// shot noise (Campbell's theorem) as the square: what counts is the current behind a low-pass of τ/2. After light
    /// is switched on for x, the output is 1 − exp(−x/τ) of what it settles to, the variance 1 − exp(−2x/τ).
    ///
    /// # Panics
    /// If there is no such cell.
    pub fn pass(&mut self, cell: usize, duration_s: f64, from: Pair<f64>, to: Pair<f64>) {
        let tau = self.front_end.time_constant_s;
        let channel = &mut self.cells[cell];
        let rest = decay(duration_s, tau);
        let slope = if duration_s > 0.0 { tau / duration_s } else { 0.0 };
        let low_pass = |state: &mut f64, from: f64, to: f64, slope: f64, rest: f64| {
            let lag = (to - from) * slope;
            *state = to - lag + (*state - from + lag) * rest;
        };
        let half = channel.half_dark_a;
        low_pass(&mut channel.state[0], from.i_x1_a + half, to.i_x1_a + half, slope, rest);
        low_pass(&mut channel.state[1], from.i_x2_a + half, to.i_x2_a + half, slope, rest);
        let [from, to] = [from, to].map(|light| light.total_a() + channel.dark_a);
        low_pass(&mut channel.shot_of, from, to, 0.5 * slope, rest * rest);
    }

    /// The noise of `cell` now, where `keep` = exp(−t/τ) is left of that of t ago: filtered noise is correlated from
    /// one conversion to the next, exactly like this. `before` of which nothing is left may be any. `draw` gives
    /// standard normal numbers.
    ///
    /// # Panics
    /// If there is no such cell.
    pub fn noise(&self, cell: usize, before: &CellNoise, keep: f64, mut draw: impl FnMut() -> f64) -> CellNoise {
        let Channel { shot_of, shot_a, .. } = self.cells[cell];
        let kept = keep * keep;
        let fresh = shot_a * (shot_of - kept * before.shot_of).max(0.0);
        CellNoise {
            johnson: keep * before.johnson + (1.0 - kept).sqrt() * draw(),
            shot: keep * before.shot + fresh.sqrt() * draw(),
            shot_of,
        }
    }

    /// One conversion of `electrode` of `cell`, disturbed by `noise` and by the converter's own,
    /// `converter_noise` in units of its standard deviation.
    ///
    /// # Panics
    /// If there is no such cell.
    pub fn convert(&self, cell: usize, electrode: Electrode, noise: &CellNoise, converter_noise: f64) -> u16 {
        let channel = &self.cells[cell];
        let total = (channel.state[0] + channel.state[1]).max(channel.dark_a).max(f64::MIN_POSITIVE);
        // Shot noise of a point-like spot divides between the electrodes like the current.
        // Johnson current flows from one electrode to the other.
        let (current, sign) = match electrode {
            Electrode::X1 => (channel.state[0], 1.0),
            Electrode::X2 => (channel.state[1], -1.0),
        };
        let noisy = current + noise.shot * current / total + sign * noise.johnson * channel.johnson_a;
        let code = self.scaling.zero_code
            + noisy / self.scaling.amperes_per_code
            + self.front_end.raw_noise_lsb * converter_noise;
        code.round().clamp(0.0, self.top_code) as u16
    }

    /// Samples `cell` into a word pair, the sum of `conversions`; `light` is what falls on it at each conversion. On
    /// return the front end is at the last conversion.
    pub(super) fn sample(
        &mut self,
        cell: usize,
        conversions: u16,
        light: impl Fn(u32) -> Pair<f64>,
        rng: &mut ChaCha8Rng,
    ) -> WordPair {
        let mut draw = || -> f64 { StandardNormal.sample(rng) };
        // That of the last word has long gone.
        let mut noise = self.noise(cell, &CellNoise::default(), 0.0, &mut draw);
        let mut sums = [0_u32; 2];
        for conversion in 0..u32::from(conversions) {
            if conversion > 0 {
                self.pass(cell, self.front_end.conversion_s, light(conversion - 1), light(conversion));
                noise = self.noise(cell, &noise, self.conversion_decay, &mut draw);
            }
            for (sum, electrode) in sums.iter_mut().zip([Electrode::X1, Electrode::X2]) {
                *sum += u32::from(self.convert(cell, electrode, &noise, draw()));
            }
        }
        // A valid configuration keeps the sum within 16 bits.
        sums.map(|sum| sum.min(u32::from(u16::MAX)) as u16)
    }
}

/// exp(−t/τ); nothing is left without a low-pass.
fn decay(duration_s: f64, time_constant_s: f64) -> f64 {
    if time_constant_s > 0.0 { (-duration_s / time_constant_s).exp() } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng;

    use super::*;
    use crate::scene_file::WIDE;

    /// Against q·∫I(x − s)·h(s)·h(s + d) ds for the impulse response h = exp(−s/τ)/τ of the low-pass (Campbell's
    /// theorem; Rice 1944, section 1.5).
    #[test]
    fn shot_noise_of_light_that_has_not_settled_has_the_variance_of_the_electrons_that_came() {
        let file = WIDE.read().unwrap();
        let front_end = file.front_end.unwrap();
        let tau = front_end.time_constant_s;
        let mut rng = ChaCha8Rng::seed_from_u64(9);
        let light = Pair { i_x1_a: 1e-6, i_x2_a: 3e-6 };
        let settled = ELEMENTARY_CHARGE_C * light.total_a() / (2.0 * tau);
        let (on_s, apart_s) = (0.9 * tau, 0.4 * tau);
        let mut electronics = Electronics::new(&file.scene, &front_end);
        electronics.pass(0, on_s, light, light);
        let mut later = electronics.clone();
        later.pass(0, apart_s, light, light);
        let mut off = electronics.clone();
        off.pass(0, apart_s, Pair::default(), Pair::default());

        let count = 100_000;
        let (mut sums, mut draw) = ([0.0; 4], || StandardNormal.sample(&mut rng));
        for _ in 0..count {
            let first = electronics.noise(0, &CellNoise::default(), 0.0, &mut draw);
            let second = later.noise(0, &first, later.decay(apart_s), &mut draw);
            let dark = off.noise(0, &first, off.decay(apart_s), &mut draw);
            let products = [first.shot * first.shot, second.shot * second.shot, first.shot * second.shot];
            for (sum, product) in sums.iter_mut().zip(products.into_iter().chain([dark.shot * dark.shot])) {
                *sum += product / f64::from(count);
            }
        }
        let [on, apart] = [on_s, apart_s].map(|time_s| (-time_s / tau).exp());
        let rise = 1.0 - on * on;
        let expected = [rise, 1.0 - on * on * apart * apart, apart * rise, apart * apart * rise];
        for (sum, expected) in sums.into_iter().zip(expected.map(|share| share * settled)) {
            println!("{sum:e} A², {expected:e} expected");
            // Six standard deviations of the mean of so many squares, 0.45 % each.
            assert!((sum / expected - 1.0).abs() < 0.027, "seed 9: {sum:e}, not {expected:e}");
        }
    }
}
