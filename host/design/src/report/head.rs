//! The head under study: its scene as a solver weighs it, poses at which every cell has light, their currents and noise,
//! errors of poses and run times.

use std::time::Instant;

use glam::DVec3;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use slitpose_head::front_end::{Stage, configuration};
use slitpose_head::scene_file::SceneFile;
use slitpose_head::simulator::{Electronics, noisy_reading};
use slitpose_model::{
    Cell, CompiledScene, MotionPrior, Opening, Pair, Photocurrents, Pose, Profile, Reading, Scene, Solution, Solver,
    Start, Tier, Uncertainty,
};

use super::Settings;
use crate::DesignError;

/// The truth: integrals far more exact than any method under study.
const TRUTH: Tier = Tier::Exact { tolerance: 1e-12 };

/// The same for profiles given as tables: across their points third derivatives jump, and the exact tier
/// pays for each further digit with nearly twice the time.
const TRUTH_OF_TABLES: Tier = Tier::Exact { tolerance: 1e-9 };

/// Exponent of the profile that stands for one given as a table where only arithmetic is studied:
/// half intensity at 55°.
const EXPONENT: f64 = 1.246_972_446_943_724;

pub(super) const STREAM: Tier = Tier::Exact { tolerance: 1e-6 };

/// How far a warm start is off, per axis, metres and radians: what a frame before leaves at some 10 mm/s.
pub(super) const PRIOR: [f64; 2] = [3e-6, 3e-4];

const TRIES: usize = 40;

pub(super) struct Head {
    /// The scene with the noise of its front end; without front end, with that of the file.
    pub(super) scene: Scene,
    /// When the cells are exposed; `None` without front end.
    pub(super) frame: Option<Frame>,
    /// Poses of the workspace at which every cell has light.
    pub(super) poses: Vec<Pose>,
    /// The optics that stand for the truth, and their tier.
    pub(super) truth: CompiledScene<f64>,
    pub(super) truth_tier: Tier,
}

#[derive(Clone, Debug)]
pub(crate) struct Frame {
    /// When the light of each cell leaves its emitter, relative to the reference instant, seconds.
    pub(crate) exposures_s: Vec<f64>,
    /// From one frame to the next, seconds.
    pub(crate) period_s: f64,
}

/// The scene with the noise of its front end, and the times of a frame; without front end, or with one whose schedule fits
/// no frame, with the noise of the file.
pub(crate) fn frame_scene(file: &SceneFile) -> (Scene, Option<Frame>) {
    let (Some(front_end), Ok(configuration)) = (&file.front_end, configuration(file)) else {
        return (file.scene.clone(), None);
    };
    let schedule = &configuration.schedule;
    let scaling = Electronics::new(&file.scene, front_end).scaling();
    let exposures_s = Stage::new(file, schedule, &scaling).exposures_s();
    let frame = Frame { exposures_s, period_s: schedule.frame_rate_hz().recip() };
    (Stage::weighted_scene(file, schedule, &scaling), Some(frame))
}

impl Head {
    pub(super) fn of(file: &SceneFile, settings: &Settings) -> Result<Self, DesignError> {
        let (scene, frame) = frame_scene(file);
        let is_table = |cell: &Cell| matches!(cell.emitter.profile, Profile::Table(_));
        let truth_tier = if scene.cells.iter().any(is_table) { TRUTH_OF_TABLES } else { TRUTH };
        let truth = CompiledScene::compile(&scene, truth_tier)?;
        let home = Solver::<f64>::new(&scene, STREAM)?.solve(
            &currents(&truth, &Pose::HOME),
            Start::Cold,
            &MotionPrior::AT_REST,
        );
        if home.estimate.is_none() {
            return Err(DesignError::Poses(format!(
                "scene `{}` with its {} cells gives no pose at home: {}; a study of poses needs a head that has one, such as \
                 the shipped scene `wide`",
                file.name,
                file.scene.cells.len(),
                home.outcome.as_str()
            )));
        }
        let (wanted, tried) = (settings.poses, TRIES * settings.poses);
        let poses: Vec<Pose> = file.workspace.poses(tried).filter(|pose| is_lit(&truth, pose)).take(wanted).collect();
        if poses.len() < wanted {
            let found = poses.len();
            return Err(DesignError::Poses(format!(
                "all cells of scene `{}` see light in {found} of {tried} poses of its workspace, {wanted} are wanted; make \
                 [workspace] smaller, or give --poses {found}",
                file.name
            )));
        }
        Ok(Self { scene, frame, poses, truth, truth_tier })
    }

    /// Whether every cell has a slit on the base, and a detector of its own.
    pub(super) fn is_of_slits(&self) -> bool {
        self.scene.cells.iter().all(|cell| cell.opening() == Opening::Slit && cell.other_axis().is_none())
    }

    /// The scene without noise and with cosine profiles only: for the study of arithmetic.
    pub(super) fn arithmetic(&self) -> Scene {
        let mut scene = Scene { noise: None, uncertainty: Uncertainty::default(), ..self.scene.clone() };
        for cell in &mut scene.cells {
            cell.emitter.profile = Profile::Cosine { exponent: exponent(&cell.emitter.profile) };
        }
        scene
    }
}

/// The exponent of a cosine profile, or the one that stands for a table.
pub(super) fn exponent(profile: &Profile) -> f64 {
    match profile {
        Profile::Cosine { exponent } => *exponent,
        Profile::Table(_) => EXPONENT,
    }
}

pub(crate) fn currents(plan: &CompiledScene<f64>, pose: &Pose) -> Photocurrents {
    Photocurrents::of_pairs((0..plan.cell_count()).map(|cell| plan.photocurrents(cell, pose)))
}

/// Whether every cell gives a current that can be used.
pub(super) fn is_lit(plan: &CompiledScene<f64>, pose: &Pose) -> bool {
    (0..plan.cell_count()).all(|cell| {
        let response = plan.respond(cell, pose);
        response.status.has_spot() && !response.flags.faint && !response.flags.saturated
    })
}

/// Draws the noise and the calibration errors of a scene.
pub(super) struct NoiseSource<'a> {
    rng: ChaCha8Rng,
    scene: &'a Scene,
    /// The light.
    plan: &'a CompiledScene<f64>,
}

impl<'a> NoiseSource<'a> {
    pub(super) fn of(scene: &'a Scene, plan: &'a CompiledScene<f64>, seed: u64) -> Self {
        Self { rng: ChaCha8Rng::seed_from_u64(seed), scene, plan }
    }

    fn normal(&mut self) -> f64 {
        StandardNormal.sample(&mut self.rng)
    }

    /// The `clean` light at `pose` as the scene would measure it. Gains and places of parts err anew each time, as the
    /// covariance of a single solve has it.
    pub(super) fn disturb(&mut self, pose: &Pose, clean: &Photocurrents) -> Photocurrents {
        let readings = clean.cells.iter().enumerate().map(|(number, reading)| match reading {
            Reading::Light(pair) => Reading::Light(self.pair(number, pose, *pair)),
            other => *other,
        });
        Photocurrents { cells: readings.collect() }
    }

    fn pair(&mut self, number: usize, pose: &Pose, mut pair: Pair<f64>) -> Pair<f64> {
        let (scene, plan) = (self.scene, self.plan);
        let Uncertainty { emitter_gain_relative, electrode_gain_relative, position_m, .. } = scene.uncertainty;
        let off_m = DVec3::from_array([0; 3].map(|_| position_m * self.normal()));
        if position_m != 0.0 {
            // Detector and slit that are off see the emitter off the other way.
            let from = plan.photocurrents(number, pose);
            let to = plan.photocurrents(number, &Pose { translation_m: pose.translation_m - off_m, ..*pose });
            pair =
                Pair { i_x1_a: pair.i_x1_a + to.i_x1_a - from.i_x1_a, i_x2_a: pair.i_x2_a + to.i_x2_a - from.i_x2_a };
        }
        let common = emitter_gain_relative * self.normal();
        let mut own = || electrode_gain_relative * self.normal();
        pair = Pair { i_x1_a: pair.i_x1_a * (1.0 + common + own()), i_x2_a: pair.i_x2_a * (1.0 + common + own()) };
        match &scene.noise {
            Some(noise) => noisy_reading(pair, &scene.cells[number].detector, noise, || self.normal()),
            None => pair,
        }
    }

    /// A pose near `pose`: each axis off by a normal number of `sigma_m` or `sigma_rad`.
    pub(super) fn near(&mut self, pose: &Pose, [sigma_m, sigma_rad]: [f64; 2]) -> Pose {
        let mut vector = |sigma: f64| DVec3::from_array([0; 3].map(|_| sigma * self.normal()));
        let (dt, dr) = (vector(sigma_m), vector(sigma_rad));
        pose.perturbed(dt, dr)
    }
}

/// Errors of solves: translation in metres and rotation in radians, NaN without a pose.
#[derive(Clone, Debug)]
pub(crate) struct Errors {
    pub(crate) rms: [f64; 2],
    /// Share of the solves that gave a pose.
    pub(super) solved: f64,
    pub(super) steps: f64,
}

impl Errors {
    pub(crate) fn of<'a>(solves: impl IntoIterator<Item = (Solution, &'a Pose)>) -> Self {
        let (mut squares, mut found, mut tried, mut steps) = ([0.0; 2], 0.0, 0.0, 0.0);
        for (solved, truth) in solves {
            tried += 1.0;
            steps += solved.iterations as f64;
            if let Some(estimate) = &solved.estimate {
                let (dt, dr) = estimate.pose.displacement_from(truth);
                squares = [squares[0] + dt.length_squared(), squares[1] + dr.length_squared()];
                found += 1.0;
            }
        }
        Self { rms: squares.map(|square: f64| (square / found).sqrt()), solved: found / tried, steps: steps / tried }
    }
}

/// Root mean squares of translation (metres) and rotation (radians) that covariances allow.
pub(super) fn rms_of_covariances(covariances: impl IntoIterator<Item = [[f64; 6]; 6]>) -> [f64; 2] {
    let (mut squares, mut count) = ([0.0; 2], 0.0);
    for covariance in covariances {
        for axis in 0..6 {
            squares[axis / 3] += covariance[axis][axis];
        }
        count += 1.0;
    }
    squares.map(|square: f64| (square / count).sqrt())
}

/// The word for a tier in tables.
pub(super) fn tier_name(tier: Tier) -> String {
    match tier {
        Tier::Paper => "paper".to_owned(),
        Tier::Exact { tolerance } => format!("exact {tolerance:e}"),
    }
}

#[derive(Clone, Copy, Debug)]
pub(super) struct RunTime {
    /// In the fastest round, seconds.
    pub(super) least_s: f64,
    /// In the middle round, seconds.
    pub(super) median_s: f64,
}

/// One of several ways to do something: does all units of work once.
pub(super) type Candidate<'a> = Box<dyn FnMut() + 'a>;

/// Times `candidates` in turn over `rounds`; each does `units` of work a round. One round more
/// goes ahead, to fill caches.
pub(super) fn race(candidates: &mut [Candidate<'_>], rounds: usize, units: usize) -> Vec<RunTime> {
    let mut times: Vec<Vec<f64>> = candidates.iter().map(|_| Vec::with_capacity(rounds)).collect();
    for round in 0..=rounds {
        for (candidate, times) in candidates.iter_mut().zip(&mut times) {
            let start = Instant::now();
            candidate();
            let took_s = start.elapsed().as_secs_f64() / units as f64;
            if round > 0 {
                times.push(took_s);
            }
        }
    }
    let run_time = |mut times: Vec<f64>| {
        times.sort_by(f64::total_cmp);
        RunTime { least_s: times[0], median_s: times[times.len() / 2] }
    };
    times.into_iter().map(run_time).collect()
}

#[cfg(test)]
mod tests {
    use std::cell::Cell;

    use super::*;
    use slitpose_head::scene_file::WIDE;

    #[test]
    fn candidates_take_turns() {
        let (first, second) = (Cell::new(0), Cell::new(0));
        let mut candidates: [Candidate<'_>; 2] = [
            Box::new(|| {
                assert_eq!(first.get(), second.get(), "the first is ahead");
                first.set(first.get() + 1);
            }),
            Box::new(|| second.set(second.get() + 1)),
        ];
        let run_times = race(&mut candidates, 5, 1);
        drop(candidates);
        assert_eq!((first.get(), second.get()), (6, 6));
        assert!(run_times.iter().all(|run_time| run_time.least_s <= run_time.median_s));
    }

    #[test]
    fn poses_of_displaced_parts_err_as_their_covariance_says() {
        const SEED: u64 = 11;
        const POSES: u32 = 2000;
        let mut scene = WIDE.read().unwrap().scene;
        scene.uncertainty.position_m = 20e-6;
        let plan = CompiledScene::compile(&scene, Tier::Paper).unwrap();
        let solver = Solver::<f64>::new(&scene, Tier::Paper).unwrap();
        let mut source = NoiseSource::of(&scene, &plan, SEED);
        let mut sum = 0.0;
        for _ in 0..POSES {
            let pose = source.near(&Pose::HOME, [1e-3, 0.05]);
            let readings = source.disturb(&pose, &currents(&plan, &pose));
            let estimate = solver.solve(&readings, Start::Cold, &MotionPrior::AT_REST).estimate.unwrap();
            sum += estimate.nees(&pose).unwrap();
        }
        let mean = sum / f64::from(POSES);
        println!("seed {SEED}: mean normalised squared error {mean:.2}");
        // χ² of six degrees has the variance 12: four standard deviations of the mean.
        assert!((mean - 6.0).abs() < 4.0 * (12.0 / f64::from(POSES)).sqrt(), "seed {SEED}: {mean}");
    }
}
