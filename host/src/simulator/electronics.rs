//! From photocurrents to words: settling, noise, saturation, quantisation.

use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use slitpose_model::{BOLTZMANN_J_PER_K, ELEMENTARY_CHARGE_C, Pair, Scene};
use slitpose_protocol::{AdcScaling, WordPair};

use crate::front_end::ROOM_TEMPERATURE_K;
use crate::scene_file::FrontEnd;

/// Codes between zero current and the end of the converter's range, so that noise at zero current
/// is not cut off.
const PEDESTAL_CODES: f64 = 64.0;

/// Codes from the end of the range where a real stage bends.
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

/// What the filtered noise of one cell is at an instant, in units of its standard deviation.
/// Standing still at zero it is absent.
#[derive(Clone, Copy, Debug, Default)]
pub struct CellNoise {
    johnson: f64,
    shot: f64,
}

impl CellNoise {
    /// As noise is found that nothing is known of. `draw` gives standard normal numbers.
    pub fn unknown(mut draw: impl FnMut() -> f64) -> Self {
        Self { johnson: draw(), shot: draw() }
    }

    /// What becomes of it while `keep` = exp(−t/τ) of it is left: filtered noise is correlated from
    /// one conversion to the next, exactly like this.
    pub fn pass(&mut self, keep: f64, mut draw: impl FnMut() -> f64) {
        let renew = (1.0 - keep * keep).sqrt();
        self.johnson = keep * self.johnson + renew * draw();
        self.shot = keep * self.shot + renew * draw();
    }
}

/// One cell's pair of electrodes.
#[derive(Clone, Debug)]
struct Channel {
    state: [f64; 2],
    half_dark_a: f64,
    dark_a: f64,
    /// Standard deviation of the filtered Johnson current.
    johnson_a: f64,
    /// Variance of the filtered shot noise per ampere.
    shot_a: f64,
}

impl Electronics {
    /// The electronics of `front_end` behind the detectors of `scene`, in the dark for long.
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

    /// What a code of this front end means.
    pub fn scaling(&self) -> AdcScaling {
        self.scaling
    }

    /// exp(−t/τ) for `duration_s`: how much is left of what was there before.
    pub fn decay(&self, duration_s: f64) -> f64 {
        decay(duration_s, self.front_end.time_constant_s)
    }

    /// Lets `duration_s` pass for `cell` with light that changes linearly from `from` to `to`.
    ///
    /// The low-pass τ·y' = u − y has for u = u₀ + s·t the exact solution
    /// y = u − s·τ + (y₀ − u₀ + s·τ)·exp(−t/τ), stable for any ratio of duration and τ.
    ///
    /// # Panics
    /// If there is no such cell.
    pub fn pass(&mut self, cell: usize, duration_s: f64, from: Pair<f64>, to: Pair<f64>) {
        let tau = self.front_end.time_constant_s;
        let channel = &mut self.cells[cell];
        let rest = decay(duration_s, tau);
        let slope = if duration_s > 0.0 { tau / duration_s } else { 0.0 };
        for (state, (from, to)) in channel.state.iter_mut().zip([(from.i_x1_a, to.i_x1_a), (from.i_x2_a, to.i_x2_a)]) {
            let lag = (to - from) * slope;
            let settled = to + channel.half_dark_a - lag;
            *state = settled + (*state - from - channel.half_dark_a + lag) * rest;
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
        let shot_a = noise.shot * (channel.shot_a * total).sqrt();
        // Johnson current flows from one electrode to the other.
        let (current, sign) = match electrode {
            Electrode::X1 => (channel.state[0], 1.0),
            Electrode::X2 => (channel.state[1], -1.0),
        };
        let noisy = current + shot_a * current / total + sign * noise.johnson * channel.johnson_a;
        let code = self.scaling.zero_code
            + noisy / self.scaling.amperes_per_code
            + self.front_end.raw_noise_lsb * converter_noise;
        code.round().clamp(0.0, self.top_code) as u16
    }

    /// Samples `cell` into a word pair; `light` is what falls on it at each conversion. On return
    /// the front end is at the last conversion.
    pub(super) fn sample(&mut self, cell: usize, light: impl Fn(u32) -> Pair<f64>, rng: &mut ChaCha8Rng) -> WordPair {
        let mut draw = || -> f64 { StandardNormal.sample(rng) };
        let mut noise = CellNoise::unknown(&mut draw);
        let mut sums = [0_u32; 2];
        for conversion in 0..self.front_end.oversampling {
            if conversion > 0 {
                self.pass(cell, self.front_end.conversion_s, light(conversion - 1), light(conversion));
                noise.pass(self.conversion_decay, &mut draw);
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
