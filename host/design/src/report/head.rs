//! The head under study: its scene as a solver weighs it, and poses at which every cell has light.

use slitpose_model::{
    Cell, MotionPrior, Opening, Pair, Photocurrents, Plan, Pose, Profile, Scalar, Scene, Solver, Start, Tier,
    Uncertainty,
};

use super::{ReportError, Settings};
use slitpose_head::front_end::{Stage, configuration};
use slitpose_head::scene_file::SceneFile;
use slitpose_head::simulator::Electronics;

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
    pub(super) truth: Plan<f64>,
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
        let truth = Plan::compile(&scene, truth_tier)?;
        let home = Solver::<f64>::new(&scene, STREAM)?.solve(
            &currents(&truth, &Pose::HOME),
            Start::Cold,
            &MotionPrior::AT_REST,
        );
        if home.estimate.is_none() {
            let (scene, cells) = (file.name.clone(), file.scene.cells.len());
            return Err(ReportError::NoPose { scene, cells, outcome: home.outcome });
        }
        let (wanted, tried) = (settings.poses, TRIES * settings.poses);
        let poses: Vec<Pose> = file.workspace.poses(tried).filter(|pose| is_lit(&truth, pose)).take(wanted).collect();
        if poses.len() < wanted {
            let (scene, found) = (file.name.clone(), poses.len());
            return Err(ReportError::TooFewLit { scene, found, tried, wanted });
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
pub(super) fn currents<S: Scalar>(plan: &Plan<S>, pose: &Pose) -> Photocurrents {
    Photocurrents::of_pairs((0..plan.cell_count()).map(|cell| {
        let pair = plan.photocurrents(cell, pose);
        Pair { i_x1_a: pair.i_x1_a.as_f64(), i_x2_a: pair.i_x2_a.as_f64() }
    }))
}

/// Whether every cell gives a current that can be used.
pub(super) fn is_lit(plan: &Plan<f64>, pose: &Pose) -> bool {
    (0..plan.cell_count()).all(|cell| {
        let response = plan.respond(cell, pose);
        response.status.has_spot() && !response.flags.faint && !response.flags.saturated
    })
}
