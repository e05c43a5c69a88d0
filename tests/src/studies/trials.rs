//! Random trials on all cores, each with a generator of its own: trial 4711 is the same whatever
//! the count and however many cores, so what failed in a long run can be repeated alone. And the photocurrents of a pose,
//! disturbed as the scene says.
//!
//! The noise of a cell's two currents, each term with the covariance physics gives it:
//! * shot noise 2q·B·(I_O) of a point-like spot is common to both and divides like the current;
//! * Johnson noise 4kT·B/R_ie of the inter-electrode resistance leaves one and enters the other;
//! * the converter's is their own.

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use slitpose_head::threads::on_all_cores;
use slitpose_model::{BOLTZMANN_J_PER_K, CompiledScene, ELEMENTARY_CHARGE_C, Pair, Photocurrents, Pose, Scene};

use crate::poses::{PoseRow, one_in_box, pose};

/// Half sides of the box of poses that a head is meant for, mm and degrees.
pub const HALF: [f64; 2] = [4.0, 15.0];

#[derive(Clone, Copy, Debug)]
pub struct Trials {
    pub count: usize,
    pub seed: u64,
}

impl Trials {
    /// The generator of trial `index`: a stream of the seed's own.
    pub fn generator(&self, index: usize) -> ChaCha8Rng {
        let mut rng = ChaCha8Rng::seed_from_u64(self.seed);
        rng.set_stream(index as u64);
        rng
    }

    /// Runs `trial` with its number and generator, for all numbers; results in their order.
    pub fn run<T: Send>(&self, trial: impl Fn(usize, &mut ChaCha8Rng) -> T + Sync) -> Vec<T> {
        let numbers: Vec<usize> = (0..self.count).collect();
        on_all_cores(&numbers, |&number| trial(number, &mut self.generator(number)))
    }
}

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

    /// `pairs` as the cells would measure them: gains drawn anew, then noise.
    pub fn measured(&self, pairs: &[Pair<f64>], rng: &mut ChaCha8Rng) -> Photocurrents {
        Photocurrents::of_pairs(self.cells.iter().zip(pairs).map(|(cell, pair)| cell.measure(*pair, rng)))
    }
}

impl CellDisturbance {
    fn measure(&self, pair: Pair<f64>, rng: &mut ChaCha8Rng) -> Pair<f64> {
        let emitter = 1.0 + self.emitter_gain * normal(rng);
        let mut electrode = |current_a: f64| current_a * emitter * (1.0 + self.electrode_gain * normal(rng));
        let first = electrode(pair.i_x1_a);
        let second = electrode(pair.i_x2_a);

        let total = first + second;
        let shot = if total > 0.0 { (self.shot_a * (total + self.dark_a)).sqrt() * normal(rng) / total } else { 0.0 };
        let johnson = self.johnson_a * normal(rng);
        Pair {
            i_x1_a: first * (1.0 + shot) + johnson + self.converter_a * normal(rng),
            i_x2_a: second * (1.0 + shot) - johnson + self.converter_a * normal(rng),
        }
    }
}

/// The photocurrents of all cells at `pose`, undisturbed.
pub fn pairs(plan: &CompiledScene<f64>, pose: &Pose) -> Vec<Pair<f64>> {
    (0..plan.cell_count()).map(|cell| plan.photocurrents(cell, pose)).collect()
}

/// A random pose of a box, and its currents.
pub fn any_pose(
    plan: &CompiledScene<f64>,
    [half_mm, half_deg]: [f64; 2],
    rng: &mut ChaCha8Rng,
) -> (PoseRow, Vec<Pair<f64>>) {
    let row = one_in_box(rng, half_mm, half_deg);
    (row, pairs(plan, &pose(row)))
}

/// One at which no cell of `scene` is faint; clipped spots are not.
pub fn lit_pose(
    scene: &Scene,
    plan: &CompiledScene<f64>,
    half: [f64; 2],
    rng: &mut ChaCha8Rng,
) -> (PoseRow, Vec<Pair<f64>>) {
    loop {
        let (row, pairs) = any_pose(plan, half, rng);
        if scene.cells.iter().zip(&pairs).all(|(cell, pair)| pair.total_a() >= cell.detector.faint_a) {
            return (row, pairs);
        }
    }
}
