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
pub(super) struct Electronics {
    front_end: FrontEnd,
    scaling: AdcScaling,
    top_code: f64,
    cells: Vec<Channel>,
    /// exp(−t/τ) for one conversion.
    conversion_decay: f64,
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
    pub(super) fn new(scene: &Scene, front_end: &FrontEnd) -> Self {
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

    pub(super) fn scaling(&self) -> AdcScaling {
        self.scaling
    }

    /// Lets `duration_s` pass for `cell` with light that changes linearly from `from` to `to`.
    ///
    /// The low-pass τ·y' = u − y has for u = u₀ + s·t the exact solution
    /// y = u − s·τ + (y₀ − u₀ + s·τ)·exp(−t/τ), stable for any ratio of duration and τ.
    pub(super) fn pass(&mut self, cell: usize, duration_s: f64, from: Pair<f64>, to: Pair<f64>) {
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

    /// Samples `cell` into a word pair; `light` is what falls on it at each conversion. On return
    /// the front end is at the last conversion.
    pub(super) fn sample(&mut self, cell: usize, light: impl Fn(u32) -> Pair<f64>, rng: &mut ChaCha8Rng) -> WordPair {
        let conversions = self.front_end.oversampling;
        let mut draw = || -> f64 { StandardNormal.sample(rng) };
        // Filtered noise is correlated from one conversion to the next, exactly like this.
        let keep = self.conversion_decay;
        let renew = (1.0 - keep * keep).sqrt();
        let (mut johnson, mut shot) = (draw(), draw());
        let mut sums = [0_u32; 2];
        for conversion in 0..conversions {
            if conversion > 0 {
                self.pass(cell, self.front_end.conversion_s, light(conversion - 1), light(conversion));
                johnson = keep * johnson + renew * draw();
                shot = keep * shot + renew * draw();
            }
            let channel = &self.cells[cell];
            let total = (channel.state[0] + channel.state[1]).max(channel.dark_a).max(f64::MIN_POSITIVE);
            // Shot noise of a point-like spot divides between the electrodes like the current.
            let shot_a = shot * (channel.shot_a * total).sqrt();
            for (electrode, sum) in sums.iter_mut().enumerate() {
                let current = channel.state[electrode];
                let sign = if electrode == 0 { 1.0 } else { -1.0 };
                let noisy = current + shot_a * current / total + sign * johnson * channel.johnson_a;
                let code = self.scaling.zero_code
                    + noisy / self.scaling.amperes_per_code
                    + self.front_end.raw_noise_lsb * draw();
                *sum += code.round().clamp(0.0, self.top_code) as u32;
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
