//! The head under study: its scene as a solver weighs it, poses at which every cell has light, errors of poses and run times.

use std::time::Instant;

use slitpose_calibration::median;
use slitpose_head::front_end::{Stage, configuration};
use slitpose_head::scene_file::SceneFile;
use slitpose_head::simulator::Electronics;
use slitpose_model::{
    Cell, CompiledScene, MotionPrior, Opening, Pair, Photocurrents, Pose, Profile, Scalar, Scene, Solver, Start, Tier,
    Uncertainty,
};

use super::method::Solved;
use super::{ReportError, Settings};

/// The truth: integrals far more exact than any method under study.
const TRUTH: Tier = Tier::Exact { tolerance: 1e-12 };

/// The same for profiles given as tables: across their points third derivatives jump, and the exact tier
/// pays for each further digit with nearly twice the time.
const TRUTH_OF_TABLES: Tier = Tier::Exact { tolerance: 1e-9 };

/// Exponent of the profile that stands for one given as a table where only arithmetic is studied:
/// half intensity at 55°.
const EXPONENT: f64 = 1.246_972_446_943_724;

/// The default tolerance of a solver.
pub(super) const STREAM: Tier = Tier::Exact { tolerance: 1e-6 };

/// Poses tried for each one wanted.
const TRIES: usize = 40;

/// A scene, prepared for its study.
pub(super) struct Head<'a> {
    pub(super) file: &'a SceneFile,
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

/// The times of one frame.
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

impl<'a> Head<'a> {
    pub(super) fn of(file: &'a SceneFile, settings: &Settings) -> Result<Self, ReportError> {
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
            return Err(ReportError::Poses(format!(
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
            return Err(ReportError::Poses(format!(
                "all cells of scene `{}` see light in {found} of {tried} poses of its workspace, {wanted} are wanted; make \
                 [workspace] smaller, or give --poses {found}",
                file.name
            )));
        }
        Ok(Self { file, scene, frame, poses, truth, truth_tier })
    }

    /// Whether every cell has a slit on the base, and a detector of its own.
    pub(super) fn is_of_slits(&self) -> bool {
        self.scene.cells.iter().all(|cell| cell.opening() == Opening::Slit && cell.other_axis().is_none())
    }

    /// The scene without any noise: only arithmetic remains.
    pub(super) fn silent(&self) -> Scene {
        Scene { noise: None, ..self.scene.clone() }
    }

    /// The scene without noise and with cosine profiles only: for the study of arithmetic.
    pub(super) fn arithmetic(&self) -> Scene {
        let mut scene = Scene { uncertainty: Uncertainty::default(), ..self.silent() };
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

/// The photocurrents of every cell at a pose.
pub(super) fn currents<S: Scalar>(plan: &CompiledScene<S>, pose: &Pose) -> Photocurrents {
    Photocurrents::of_pairs((0..plan.cell_count()).map(|cell| {
        let pair = plan.photocurrents(cell, pose);
        Pair { i_x1_a: pair.i_x1_a.as_f64(), i_x2_a: pair.i_x2_a.as_f64() }
    }))
}

/// Whether every cell gives a current that can be used.
pub(super) fn is_lit(plan: &CompiledScene<f64>, pose: &Pose) -> bool {
    (0..plan.cell_count()).all(|cell| {
        let response = plan.respond(cell, pose);
        response.status.has_spot() && !response.flags.faint && !response.flags.saturated
    })
}

#[derive(Clone, Debug, Default)]
pub(super) struct Errors {
    squares_m2: Vec<f64>,
    squares_rad2: Vec<f64>,
    tried: usize,
    iterations: usize,
}

impl Errors {
    pub(super) fn add(&mut self, solved: &Solved, truth: &Pose) {
        self.tried += 1;
        self.iterations += solved.iterations;
        if let Some(pose) = &solved.pose {
            let (dt, dr) = pose.displacement_from(truth);
            self.squares_m2.push(dt.length_squared());
            self.squares_rad2.push(dr.length_squared());
        }
    }

    pub(super) fn of<'a>(solves: impl IntoIterator<Item = (Solved, &'a Pose)>) -> Self {
        let mut errors = Self::default();
        for (solved, truth) in solves {
            errors.add(&solved, truth);
        }
        errors
    }

    /// Root mean square of the translation's error, metres; NaN without a pose.
    pub(super) fn rms_m(&self) -> f64 {
        mean(&self.squares_m2).sqrt()
    }

    /// Root mean square of the rotation's error, radians; NaN without a pose.
    pub(super) fn rms_rad(&self) -> f64 {
        mean(&self.squares_rad2).sqrt()
    }

    /// Median error of the translation, metres; NaN without a pose.
    pub(super) fn median_m(&self) -> f64 {
        median(self.squares_m2.clone()).sqrt()
    }

    /// Median error of the rotation, radians; NaN without a pose.
    pub(super) fn median_rad(&self) -> f64 {
        median(self.squares_rad2.clone()).sqrt()
    }

    /// Share of the solves that gave a pose.
    pub(super) fn solved(&self) -> f64 {
        self.squares_m2.len() as f64 / self.tried as f64
    }

    /// Mean number of refinement steps.
    pub(super) fn mean_iterations(&self) -> f64 {
        self.iterations as f64 / self.tried as f64
    }
}

/// Root mean squares of translation (metres) and rotation (radians) that covariances allow.
pub(super) fn rms_of_covariances(covariances: impl IntoIterator<Item = [[f64; 6]; 6]>) -> (f64, f64) {
    let (mut square_m2, mut square_rad2, mut count) = (0.0, 0.0, 0.0);
    for covariance in covariances {
        square_m2 += (0..3).map(|axis| covariance[axis][axis]).sum::<f64>();
        square_rad2 += (3..6).map(|axis| covariance[axis][axis]).sum::<f64>();
        count += 1.0;
    }
    ((square_m2 / count).sqrt(), (square_rad2 / count).sqrt())
}

fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len() as f64
}

/// Time of one unit of work.
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
    times
        .into_iter()
        .map(|mut times| {
            times.sort_by(f64::total_cmp);
            RunTime { least_s: times[0], median_s: times[times.len() / 2] }
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::cell::Cell;

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
}
