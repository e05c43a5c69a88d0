//! Noise as the scene's covariance has it.

use glam::DVec3;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use slitpose_head::simulator::noisy_reading;
use slitpose_model::{Cell, CompiledScene, Pair, Photocurrents, Pose, Reading, Scene, Uncertainty};

/// Draws the noise and the calibration errors of a scene.
pub(super) struct NoiseSource {
    rng: ChaCha8Rng,
}

impl NoiseSource {
    pub(super) fn seeded(seed: u64) -> Self {
        Self { rng: ChaCha8Rng::seed_from_u64(seed) }
    }

    fn normal(&mut self) -> f64 {
        StandardNormal.sample(&mut self.rng)
    }

    /// The `clean` light of `plan` at `pose` as `scene` would measure it. Gains and places of parts err anew each
    /// time, as the covariance of a single solve has it.
    pub(super) fn disturb(
        &mut self,
        scene: &Scene,
        plan: &CompiledScene<f64>,
        pose: &Pose,
        clean: &Photocurrents,
    ) -> Photocurrents {
        let cells = clean.cells.iter().zip(&scene.cells).enumerate().map(|(index, (reading, cell))| match reading {
            Reading::Light(pair) => {
                let moved = self.displaced(plan, index, pose, scene.uncertainty.position_m, *pair);
                Reading::Light(self.pair(scene, cell, moved))
            }
            other => *other,
        });
        Photocurrents { cells: cells.collect() }
    }

    /// `clean` light of a cell whose detector and slit are off by `position_m` on each axis: they see the emitter off
    /// the other way.
    fn displaced(
        &mut self,
        plan: &CompiledScene<f64>,
        cell: usize,
        pose: &Pose,
        position_m: f64,
        clean: Pair<f64>,
    ) -> Pair<f64> {
        let off_m = DVec3::from_array([0; 3].map(|_| position_m * self.normal()));
        if position_m == 0.0 {
            return clean;
        }
        let from = plan.photocurrents(cell, pose);
        let to = plan.photocurrents(cell, &Pose { translation_m: pose.translation_m - off_m, ..*pose });
        Pair { i_x1_a: clean.i_x1_a + to.i_x1_a - from.i_x1_a, i_x2_a: clean.i_x2_a + to.i_x2_a - from.i_x2_a }
    }

    fn pair(&mut self, scene: &Scene, cell: &Cell, clean: Pair<f64>) -> Pair<f64> {
        let Uncertainty { emitter_gain_relative, electrode_gain_relative, .. } = scene.uncertainty;
        let common = emitter_gain_relative * self.normal();
        let mut own = || electrode_gain_relative * self.normal();
        let mut pair =
            Pair { i_x1_a: clean.i_x1_a * (1.0 + common + own()), i_x2_a: clean.i_x2_a * (1.0 + common + own()) };
        if let Some(noise) = &scene.noise {
            pair = noisy_reading(pair, &cell.detector, noise, || self.normal());
        }
        pair
    }

    /// A pose near `pose`: each axis off by a normal number of `sigma_m` or `sigma_rad`.
    pub(super) fn near(&mut self, pose: &Pose, sigma_m: f64, sigma_rad: f64) -> Pose {
        let mut vector = |sigma: f64| DVec3::from_array([0; 3].map(|_| sigma * self.normal()));
        let (dt, dr) = (vector(sigma_m), vector(sigma_rad));
        pose.perturbed(dt, dr)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use slitpose_head::scene_file::WIDE;
    use slitpose_model::{BOLTZMANN_J_PER_K, ELEMENTARY_CHARGE_C, MotionPrior, Noise, Solver, Start, Tier};

    /// Variances of both electrodes and their covariance, in units of what the parts add up to.
    #[test]
    fn drawn_noise_has_the_covariance_of_its_parts() {
        let mut scene = WIDE.read().unwrap().scene;
        scene.noise =
            Some(Noise { shot_bandwidth_hz: 1e6, johnson_bandwidth_hz: 1e5, temperature_k: 300.0, adc_a: 1e-9 });
        let clean = Pair { i_x1_a: 2e-6, i_x2_a: 5e-6 };
        let readings = Photocurrents::of_pairs([clean; 6]);
        let plan = CompiledScene::compile(&scene, Tier::Paper).unwrap();
        let mut source = NoiseSource::seeded(7);
        let (mut sums, mut count) = ([0.0; 3], 0.0);
        for _ in 0..10_000 {
            for reading in source.disturb(&scene, &plan, &Pose::HOME, &readings).cells {
                let Reading::Light(pair) = reading else { panic!("{reading:?}") };
                let (a, b) = (pair.i_x1_a - clean.i_x1_a, pair.i_x2_a - clean.i_x2_a);
                for (sum, product) in sums.iter_mut().zip([a * a, b * b, a * b]) {
                    *sum += product;
                }
                count += 1.0;
            }
        }
        let shot = 2.0 * ELEMENTARY_CHARGE_C * 1e6 * 7e-6;
        let johnson = 4.0 * BOLTZMANN_J_PER_K * 300.0 * 1e5 / 50e3;
        let (first, second) = (2.0 / 7.0, 5.0 / 7.0);
        let expected = [
            shot * first * first + johnson + 1e-18,
            shot * second * second + johnson + 1e-18,
            shot * first * second - johnson,
        ];
        for (sum, expected) in sums.into_iter().zip(expected) {
            // A variance of 60 000 draws scatters by 0.6 %, a covariance by a little more.
            assert!((sum / count / expected - 1.0).abs() < 0.03, "{} {expected}", sum / count);
        }
    }

    #[test]
    fn poses_of_displaced_parts_err_as_their_covariance_says() {
        const SEED: u64 = 11;
        const POSES: u32 = 2000;
        let mut scene = WIDE.read().unwrap().scene;
        scene.uncertainty.position_m = 20e-6;
        let plan = CompiledScene::compile(&scene, Tier::Paper).unwrap();
        let solver = Solver::<f64>::new(&scene, Tier::Paper).unwrap();
        let mut source = NoiseSource::seeded(SEED);
        let mut sum = 0.0;
        for _ in 0..POSES {
            let pose = source.near(&Pose::HOME, 1e-3, 0.05);
            let clean = Photocurrents::of_pairs((0..6).map(|cell| plan.photocurrents(cell, &pose)));
            let estimate = solver
                .solve(&source.disturb(&scene, &plan, &pose, &clean), Start::Cold, &MotionPrior::AT_REST)
                .estimate
                .unwrap();
            sum += estimate.nees(&pose).unwrap();
        }
        let mean = sum / f64::from(POSES);
        println!("seed {SEED}: mean normalised squared error {mean:.2}");
        // χ² of six degrees has the variance 12: four standard deviations of the mean.
        assert!((mean - 6.0).abs() < 4.0 * (12.0 / f64::from(POSES)).sqrt(), "seed {SEED}: {mean}");
    }
}
