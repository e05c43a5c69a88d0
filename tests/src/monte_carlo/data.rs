//! Photocurrents of a pose, disturbed as the scene says.
//!
//! The noise of a cell's two currents, each term with the covariance physics gives it:
//! * shot noise 2q·B·(I_O) of a point-like spot is common to both and divides like the current;
//! * Johnson noise 4kT·B/R_ie of the inter-electrode resistance leaves one and enters the other;
//! * the converter's is their own.

use glam::DVec3;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use slitpose_model::{BOLTZMANN_J_PER_K, ELEMENTARY_CHARGE_C, Pair, Photocurrents, Plan, Pose, Scene};

/// Covariance of a pair of currents, A².
pub type Covariance2 = [[f64; 2]; 2];

/// What disturbs the currents of a scene.
#[derive(Clone, Debug)]
pub struct Disturbance {
    cells: Vec<CellDisturbance>,
}

#[derive(Clone, Copy, Debug)]
struct CellDisturbance {
    /// 2q·B: variance of I_O per ampere.
    shot_a: f64,
    dark_a: f64,
    /// Standard deviations.
    johnson_a: f64,
    converter_a: f64,
    emitter_gain: f64,
    electrode_gain: f64,
}

fn normal(rng: &mut ChaCha8Rng) -> f64 {
    StandardNormal.sample(rng)
}

impl Disturbance {
    /// Noise and calibration errors of `scene`.
    pub fn of(scene: &Scene) -> Self {
        let uncertainty = scene.uncertainty;
        let cells = scene.cells.iter().map(|cell| {
            let detector = &cell.detector;
            let mut disturbance = CellDisturbance {
                shot_a: 0.0,
                dark_a: detector.dark_current_a,
                johnson_a: 0.0,
                converter_a: 0.0,
                emitter_gain: uncertainty.emitter_gain_relative,
                electrode_gain: uncertainty.electrode_gain_relative,
            };
            if let Some(noise) = scene.noise {
                disturbance.shot_a = 2.0 * ELEMENTARY_CHARGE_C * noise.shot_bandwidth_hz;
                disturbance.converter_a = noise.adc_a;
                let kt = BOLTZMANN_J_PER_K * noise.temperature_k;
                disturbance.johnson_a =
                    detector.interelectrode_ohm.map_or(0.0, |ohm| (4.0 * kt * noise.johnson_bandwidth_hz / ohm).sqrt());
            }
            disturbance
        });
        Self { cells: cells.collect() }
    }

    /// `pair` as cell `cell` would measure it: gains drawn anew, then noise.
    pub fn measure(&self, cell: usize, pair: Pair<f64>, rng: &mut ChaCha8Rng) -> Pair<f64> {
        let cell = &self.cells[cell];
        let emitter = 1.0 + cell.emitter_gain * normal(rng);
        let mut electrode = |current_a: f64| current_a * emitter * (1.0 + cell.electrode_gain * normal(rng));
        let first = electrode(pair.i_x1_a);
        let second = electrode(pair.i_x2_a);

        let total = first + second;
        let shot = if total > 0.0 { (cell.shot_a * (total + cell.dark_a)).sqrt() * normal(rng) / total } else { 0.0 };
        let johnson = cell.johnson_a * normal(rng);
        Pair {
            i_x1_a: first * (1.0 + shot) + johnson + cell.converter_a * normal(rng),
            i_x2_a: second * (1.0 + shot) - johnson + cell.converter_a * normal(rng),
        }
    }

    /// Covariance of what [`Self::measure`] makes of `pair`.
    pub fn covariance(&self, cell: usize, pair: Pair<f64>) -> Covariance2 {
        let cell = &self.cells[cell];
        let (a, b, total) = (pair.i_x1_a, pair.i_x2_a, pair.total_a());
        let common = cell.emitter_gain.powi(2)
            + if total > 0.0 { cell.shot_a * (total + cell.dark_a) / (total * total) } else { 0.0 };
        let opposed = cell.johnson_a.powi(2);
        let own = |current_a: f64| cell.converter_a.powi(2) + (cell.electrode_gain * current_a).powi(2);
        [
            [common * a * a + opposed + own(a), common * a * b - opposed],
            [common * a * b - opposed, common * b * b + opposed + own(b)],
        ]
    }

    /// `difference` in uncorrelated units of σ of cell `cell` at `pair`: its length is the
    /// Mahalanobis norm.
    pub fn whiten(&self, cell: usize, pair: Pair<f64>, difference: [f64; 2]) -> [f64; 2] {
        let [[first, mixed], [_, second]] = self.covariance(cell, pair);
        let sigma = first.sqrt();
        let lean = mixed / sigma;
        let x = difference[0] / sigma;
        [x, (difference[1] - lean * x) / (second - lean * lean).sqrt()]
    }
}

/// The photocurrents of all cells at `pose`, undisturbed.
pub fn pairs(plan: &Plan<f64>, pose: &Pose) -> Vec<Pair<f64>> {
    (0..plan.cell_count()).map(|cell| plan.photocurrents(cell, pose)).collect()
}

/// The same where each cell's detector and slit are off by `position_m` along each axis, drawn anew: they
/// see the emitter off the other way.
pub fn displaced_pairs(plan: &Plan<f64>, pose: &Pose, position_m: f64, rng: &mut ChaCha8Rng) -> Vec<Pair<f64>> {
    let mut displaced = || {
        let off_m = DVec3::from_array([0; 3].map(|_| position_m * normal(rng)));
        Pose { translation_m: pose.translation_m - off_m, ..*pose }
    };
    (0..plan.cell_count()).map(|cell| plan.photocurrents(cell, &displaced())).collect()
}

/// How many of `pairs` are not faint, clipped spots included.
pub fn lit_count(scene: &Scene, pairs: &[Pair<f64>]) -> usize {
    scene.cells.iter().zip(pairs).filter(|(cell, pair)| pair.total_a() >= cell.detector.faint_a).count()
}

/// `pairs` as the cells would measure them.
pub fn measured(disturbance: &Disturbance, pairs: &[Pair<f64>], rng: &mut ChaCha8Rng) -> Photocurrents {
    Photocurrents::of_pairs(pairs.iter().enumerate().map(|(cell, &pair)| disturbance.measure(cell, pair, rng)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::monte_carlo::trials::Trials;
    use slitpose_head::scene_file::WIDE;
    use slitpose_model::Uncertainty;

    #[test]
    fn draws_have_the_stated_covariance() {
        let mut scene = WIDE.read().expect("shipped").scene;
        // Bandwidths that give each kind of noise a like share.
        let noise = scene.noise.as_mut().expect("noise");
        (noise.shot_bandwidth_hz, noise.johnson_bandwidth_hz) = (1e6, 1e6);
        let pair = Pair { i_x1_a: 1e-6, i_x2_a: 3e-6 };
        let calibrated = Uncertainty::default();
        for uncertainty in [
            calibrated,
            Uncertainty { emitter_gain_relative: 1e-3, ..calibrated },
            Uncertainty { electrode_gain_relative: 1e-3, ..calibrated },
        ] {
            scene.uncertainty = uncertainty;
            let disturbance = Disturbance::of(&scene);
            let count = 40_000;
            let draws = Trials { count, seed: 3 }.run(|_, rng| {
                let measured = disturbance.measure(0, pair, rng);
                disturbance.whiten(0, pair, [measured.i_x1_a - pair.i_x1_a, measured.i_x2_a - pair.i_x2_a])
            });
            let mean = |i: usize, j: usize| draws.iter().map(|z| z[i] * z[j]).sum::<f64>() / count as f64;
            // 4.5 σ: variances scatter by √(2/n), products by √(1/n).
            let sigma = 4.5 / (count as f64).sqrt();
            let moments = [mean(0, 0), mean(0, 1), mean(1, 1)];
            assert!((moments[0] - 1.0).abs() < sigma * 2f64.sqrt(), "{uncertainty:?}: {moments:?}");
            assert!((moments[2] - 1.0).abs() < sigma * 2f64.sqrt(), "{uncertainty:?}: {moments:?}");
            assert!(moments[1].abs() < sigma, "{uncertainty:?}: {moments:?}");
        }
    }
}
