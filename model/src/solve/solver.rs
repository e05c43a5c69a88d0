//! The interface of the solver.

use crate::entries::Scalar;
use crate::plan::{CompiledScene, Optics, Tier};
use crate::pose::{Pose, Transform};
use crate::scalar::Number;
use crate::scene::{Scene, SceneError};

use super::accept::{Fit, covariance, free_directions};
use super::cold_start::{COLD_WORK, Search, WORK_FOR_IMAGES};
use super::compiled::Compiled;
use super::levenberg_marquardt::Stopping;
use super::normal_equations::Workspace;
use super::outcome::{DegradedReason, Directions, Outcome, Solution};
use super::readings::{Photocurrents, Sorted};
use super::twist::{MotionPrior, Prior};

/// Where a solve starts.
#[derive(Clone, Copy, Debug)]
pub enum Start<'a> {
    /// Anywhere: from the planes, and from many starts if that does not lead to a pose.
    Cold,
    /// At an expected pose. Where the data do not fit near it the start is cold.
    Near(&'a Pose),
    /// On the planes, and there it ends: the pose by the positions of the light alone, without weights, which is
    /// [`DegradedReason::Unfinished`].
    PlanesOnly,
}

/// Estimates poses from the photocurrents of one scene.
///
/// Holds the compiled scene and no state: every solve is a function of its arguments.
///
/// ```
/// # let scene: slitpose_model::Scene = include!(concat!(env!("CARGO_MANIFEST_DIR"), "/doc/ring.rs"));
/// // `scene` has six cells in a ring, as in the example of this crate.
/// use slitpose_model::*;
/// let solver = Solver::<f64>::new(&scene, Tier::Exact { tolerance: 1e-6 })?;
/// let truth = Pose::from_vectors(glam::DVec3::splat(1e-3), glam::DVec3::Z * 0.1);
/// let mut currents = Photocurrents::of_pairs((0..6).map(|cell| solver.plan().photocurrents(cell, &truth)));
/// currents.cells[5] = Reading::Missing;
/// let solution = solver.solve(&currents, Start::Near(&Pose::HOME), &MotionPrior::AT_REST);
/// assert!(!solution.cells_used.contains(5));
/// let found = solution.estimate.expect("a pose").pose;
/// assert!(found.translation_m.distance(truth.translation_m) < 1e-9);
/// # Ok::<(), SceneError>(())
/// ```
#[derive(Clone, Debug)]
pub struct Solver<S: Number, P = CompiledScene<S>> {
    pub(crate) compiled: Compiled<S, P>,
    pub(crate) max_steps: Option<usize>,
}

impl<S: Scalar> Solver<S> {
    /// For cells that are all exposed at the reference instant.
    ///
    /// # Errors
    /// Those of [`CompiledScene::compile`].
    pub fn new(scene: &Scene, tier: Tier) -> Result<Self, SceneError> {
        S::solver(scene, tier)
    }

    #[inline(always)]
    pub(crate) fn new_here(scene: &Scene, tier: Tier) -> Result<Self, SceneError> {
        let mut compiled = Compiled::of(scene, tier, CompiledScene::compile(scene, tier)?);
        compiled.has_images = compiled.may_have_images();
        Ok(Self { compiled, max_steps: None })
    }

    /// The directions that the currents of the head leave free at `pose`; `None` if there is none, or if
    /// fewer than three cells see light there.
    pub fn free_directions(&self, pose: &Pose) -> Option<Directions> {
        S::free_directions(self, pose)
    }

    #[inline(always)]
    pub(crate) fn free_directions_here(&self, pose: &Pose) -> Option<Directions> {
        free_directions(&self.compiled.factor_at(pose)?)
    }

    /// The Cramér–Rao bound at `pose`: the least covariance that an unbiased estimate from one frame
    /// of this scene's photocurrents can have, the tool at rest and all cells with light used.
    /// m², m·rad, rad²; `None` where the data leave a direction free.
    pub fn bound(&self, pose: &Pose) -> Option<[[S; 6]; 6]> {
        S::bound(self, pose)
    }

    #[inline(always)]
    pub(crate) fn bound_here(&self, pose: &Pose) -> Option<[[S; 6]; 6]> {
        covariance(&self.compiled.factor_at(pose)?, self.compiled.length_scale_m)
    }
}

impl<S: Number, P: Optics<S>> Solver<S, P> {
    /// With cell k exposed `offsets_s[k]` seconds after the reference instant.
    ///
    /// # Panics
    /// If there are fewer offsets than cells.
    #[must_use]
    pub fn with_exposures(mut self, offsets_s: &[f64]) -> Self {
        let offsets_s = &offsets_s[..self.compiled.plan.cell_count()];
        self.compiled.offsets_s.clear();
        if offsets_s.iter().any(|&offset| offset != 0.0) {
            self.compiled.offsets_s.extend(offsets_s.iter().map(|&offset| S::of(offset)));
        }
        self
    }

    /// Leaves out cells whose light falls so near an end of the detector that its spot is probably
    /// clipped there, as from an emitter at home: for heads whose detectors have ends that are not known well.
    #[must_use]
    pub fn without_clipped(mut self) -> Self {
        for (limits, plane) in self.compiled.limits.iter_mut().zip(&self.compiled.planes) {
            limits.most_share = plane.unclipped_share();
        }
        self
    }

    /// Takes the common light level for that of the head's scene: see [`crate::Uncertainty::light_level_relative`].
    #[must_use]
    pub fn with_known_light_level(mut self) -> Self {
        self.compiled.take_light_level_for_known();
        self
    }

    /// Whether poses of this head may have mirror images, other poses with nearly the same currents,
    /// although six cells or more see light: a cold solve then looks for them, takes the best, and says
    /// [`Outcome::Ambiguous`] where two fit alike. Of fewer cells this holds for every head.
    pub fn has_mirror_images(&self) -> bool {
        self.compiled.has_images
    }

    /// Stops after `steps` from one start, to weigh error against time. A pose that has not reached its minimum is
    /// [`DegradedReason::Unfinished`]; whether the data fit is not asked. A [`super::Tracker`] ignores it.
    #[must_use]
    pub fn with_max_steps(mut self, steps: usize) -> Self {
        self.max_steps = Some(steps);
        self
    }

    /// The compiled scene.
    pub fn plan(&self) -> &P {
        &self.compiled.plan
    }

    /// The pose that explains `readings`, of a tool that moves within the frame as `motion` says.
    pub fn solve(&self, readings: &Photocurrents<S>, start: Start<'_>, motion: &MotionPrior) -> Solution<S> {
        P::solve(self, readings, start, motion)
    }

    #[inline(always)]
    pub(crate) fn solve_here(
        &self,
        readings: &Photocurrents<S>,
        start: Start<'_>,
        motion: &MotionPrior,
    ) -> Solution<S> {
        let sorted = Sorted::of(readings, &self.compiled.limits);
        if let Some(solution) = self.compiled.too_few(&sorted) {
            return solution;
        }
        let motion = &Prior::of(motion);
        match (start, self.max_steps) {
            (Start::PlanesOnly, _) => self.unfinished(&sorted, motion, self.compiled.on_planes(&sorted), 0),
            (Start::Cold, Some(steps)) => self.unfinished(&sorted, motion, self.compiled.on_planes(&sorted), steps),
            (Start::Near(pose), Some(steps)) => self.unfinished(&sorted, motion, Transform::of(pose), steps),
            (Start::Cold, None) => self.cold(&sorted, motion),
            (Start::Near(pose), None) => self.near(&sorted, pose, motion),
        }
    }

    /// At most `max_iterations` steps from `start`, without asking whether the data fit.
    #[inline(never)]
    fn unfinished(
        &self,
        sorted: &Sorted<S>,
        motion: &Prior<S>,
        start: Transform<S>,
        max_iterations: usize,
    ) -> Solution<S> {
        let problem = self.compiled.problem(sorted, motion);
        let workspace = &mut Workspace::new();
        let stopping = Stopping { max_iterations, ..Stopping::exact() };
        let minimum = problem.minimise(start, stopping, workspace);
        let mut solution = problem.conclude(&minimum, workspace, Fit::Full);
        if solution.outcome.has_pose() && !minimum.converged {
            solution.outcome = Outcome::Degraded(DegradedReason::Unfinished);
        }
        solution
    }

    /// The only source of misfits: what [`Self::near`] finds to be one is searched for here, too.
    #[inline(never)]
    fn cold(&self, sorted: &Sorted<S>, motion: &Prior<S>) -> Solution<S> {
        let work = if self.compiled.looks_for_images(sorted) { WORK_FOR_IMAGES } else { COLD_WORK };
        let workspace = &mut Workspace::with_work(work);
        let mut solution = self.compiled.search(sorted, motion, &mut Search::at_once(), workspace);
        solution.evaluations = workspace.evaluations;
        solution.inflate_covariance();
        solution
    }

    fn near(&self, sorted: &Sorted<S>, pose: &Pose, motion: &Prior<S>) -> Solution<S> {
        let workspace = &mut Workspace::new();
        let mut solution = self.compiled.follow(sorted, motion, Transform::of(pose), None, workspace);
        if matches!(solution.outcome, Outcome::Diverged | Outcome::Degraded(DegradedReason::Misfit)) {
            let before = solution.iterations;
            solution = self.cold(sorted, motion);
            solution.iterations += before;
        }
        solution.evaluations += workspace.evaluations;
        solution
    }
}
