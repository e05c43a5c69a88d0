//! The interface of the solver, and the compilation of a scene for it.

use heapless::Vec;

use crate::plan::{Plan, Tier};
use crate::pose::{Pose, Transform, Twist};
use crate::response::Pair;
use crate::scalar::{Scalar, Vector3};
use crate::scene::{Cell, MAX_CELLS, Scene, SceneError};

use super::accept::{Fit, chi2_gate, redundancy};
use super::algebra::Factor;
use super::cold_start::{COLD_WORK, Search, TOLERANCE_SIGMAS};
use super::levenberg_marquardt::{self, Stopping};
use super::normal_equations::{Problem, Workspace};
use super::observability;
use super::outcome::{Directions, Outcome, Solution, Weakness};
use super::planes::{self, PlaneCell};
use super::readings::{Limits, Photocurrents, Sorted};
use super::twist::Motion;
use super::weights::CellNoise;

/// Steps of a minimisation before it is given up.
pub(super) const MAX_ITERATIONS: usize = 40;

/// Where a solve starts.
#[derive(Clone, Copy, Debug)]
pub enum Start<'a> {
    /// Anywhere: from the planes, and from many starts if that does not lead to a pose.
    Cold,
    /// At an expected pose. Where the data do not fit near it the start is cold.
    Near(&'a Pose),
    /// On the planes, and there it ends: the pose by the positions of the light alone, without weights, which is
    /// [`Weakness::Unfinished`].
    PlanesOnly,
}

/// What is known beforehand of the tool's motion within a frame.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct MotionPrior {
    /// The twist that carries each cell's exposure to the reference instant.
    pub twist: Twist,
    /// Standard deviation of its linear part, per axis, m/s.
    pub linear_sigma_m_per_s: f64,
    /// Standard deviation of its angular part, per axis, rad/s.
    pub angular_sigma_rad_per_s: f64,
}

impl MotionPrior {
    /// A tool at rest.
    pub const AT_REST: Self = Self {
        twist: Twist { linear_m_per_s: glam::DVec3::ZERO, angular_rad_per_s: glam::DVec3::ZERO },
        linear_sigma_m_per_s: 0.0,
        angular_sigma_rad_per_s: 0.0,
    };
}

/// Estimates poses from the photocurrents of one scene.
///
/// Holds the compiled scene and no state: every solve is a function of its arguments.
#[derive(Clone, Debug)]
pub struct Solver<S: Scalar> {
    pub(super) plan: Plan<S>,
    pub(super) planes: Vec<PlaneCell<S>, MAX_CELLS>,
    pub(super) noise: Vec<CellNoise<S>, MAX_CELLS>,
    pub(super) limits: Vec<Limits<S>, MAX_CELLS>,
    /// Largest χ² that noise explains, by the number of cells used.
    pub(super) gates: [S; MAX_CELLS + 1],
    /// Empty: all cells are exposed at the reference instant.
    pub(super) offsets_s: Vec<S, MAX_CELLS>,
    pub(super) length_scale_m: S,
    /// Relative change of the derivatives per unit of a scaled step.
    jacobian_change_rate: S,
    max_steps: Option<usize>,
    /// Whether poses of this head may have mirror images although all cells see light.
    pub(super) has_images: bool,
}

impl<S: Scalar> Solver<S> {
    /// For cells that are all exposed at the reference instant.
    ///
    /// # Errors
    /// Those of [`Plan::compile`].
    pub fn new(scene: &Scene, tier: Tier) -> Result<Self, SceneError> {
        let mut solver = Self::empty();
        solver.set_scene(scene, tier)?;
        Ok(solver)
    }

    /// For no scene yet: it finds no pose.
    #[inline]
    #[must_use]
    pub fn empty() -> Self {
        Self {
            plan: Plan::empty(),
            planes: Vec::new(),
            noise: Vec::new(),
            limits: Vec::new(),
            gates: [S::zero(); MAX_CELLS + 1],
            offsets_s: Vec::new(),
            length_scale_m: S::one(),
            jacobian_change_rate: S::zero(),
            max_steps: None,
            has_images: false,
        }
    }

    /// Compiles `scene` in place, for a processor whose RAM holds one solver and not two: cells
    /// exposed at the reference instant, the limit of steps as before.
    ///
    /// # Errors
    /// Those of [`Plan::compile`]. The solver is then an empty one.
    #[inline(never)]
    pub fn set_scene(&mut self, scene: &Scene, tier: Tier) -> Result<(), SceneError> {
        self.planes.clear();
        self.noise.clear();
        self.limits.clear();
        self.offsets_s.clear();
        self.plan.set_scene(scene, tier)?;
        let rounding = 16.0 * S::epsilon().as_f64();
        let relative_error = match tier {
            Tier::Paper => rounding,
            Tier::Exact { tolerance } => tolerance.max(rounding),
        };
        let cells = scene.cells.iter();
        self.length_scale_m = S::of(scene.length_scale_m());
        self.planes.extend(cells.clone().map(|cell| PlaneCell::compile(cell, tier == Tier::Paper)));
        self.noise.extend((0..scene.cells.len()).map(|cell| CellNoise::compile(scene, cell, relative_error)));
        self.limits.extend(cells.map(|Cell { detector, .. }| Limits {
            faint_a: S::of(detector.faint_a),
            saturation_a: detector.saturation_a.map_or(S::infinity(), |limit| S::of(limit - detector.dark_current_a)),
            most_share: S::infinity(),
        }));
        self.gates = core::array::from_fn(|cells| S::of(chi2_gate(redundancy(cells))));
        self.jacobian_change_rate = levenberg_marquardt::jacobian_change_rate(&self.planes, self.length_scale_m);
        self.has_images = self.may_have_images();
        Ok(())
    }

    /// The directions that the currents of the head leave free at `pose`; `None` if there is none, or if
    /// fewer than three cells see light there.
    pub fn free_directions(&self, pose: &Pose) -> Option<Directions> {
        observability::free_directions(&self.factor_at(pose)?)
    }

    /// Whether poses of this head may have mirror images, other poses with nearly the same currents,
    /// although six cells or more see light: a cold solve then looks for them, takes the best, and says
    /// [`Outcome::Ambiguous`] where two fit alike. Of fewer cells this holds for every head.
    pub fn has_mirror_images(&self) -> bool {
        self.has_images
    }

    /// The factor of the information of all cells with light at `pose`, the tool at rest.
    fn factor_at(&self, pose: &Pose) -> Option<Factor<S>> {
        let pairs = (0..self.plan.cell_count()).map(|cell| {
            let pair = self.plan.photocurrents(cell, pose);
            Pair { i_x1_a: pair.i_x1_a.as_f64(), i_x2_a: pair.i_x2_a.as_f64() }
        });
        let sorted = Sorted::of(&Photocurrents::of_pairs(pairs), &self.limits);
        if sorted.usable.len() < 3 {
            return None;
        }
        let problem = self.problem(&sorted, &MotionPrior::AT_REST);
        problem.factor_at(&Transform::of(pose), &problem.whiteners(), &mut Workspace::new())
    }

    /// With cell k exposed `offsets_s[k]` seconds after the reference instant.
    ///
    /// # Panics
    /// If there are fewer offsets than cells.
    #[must_use]
    pub fn with_exposures(mut self, offsets_s: &[f64]) -> Self {
        let offsets_s = &offsets_s[..self.plan.cell_count()];
        self.offsets_s.clear();
        if offsets_s.iter().any(|&offset| offset != 0.0) {
            self.offsets_s.extend(offsets_s.iter().map(|&offset| S::of(offset)));
        }
        self
    }

    /// Leaves out cells whose light falls so near an end of the detector that its spot is probably
    /// clipped there, as from an emitter at home: for heads whose detectors have ends that are not known well.
    #[must_use]
    pub fn without_clipped(mut self) -> Self {
        for (limits, plane) in self.limits.iter_mut().zip(&self.planes) {
            limits.most_share = plane.unclipped_share();
        }
        self
    }

    /// Stops after `steps` from one start, to weigh error against time. A pose that has not reached its minimum is
    /// [`Weakness::Unfinished`]; whether the data fit is not asked. A [`super::Tracker`] ignores it.
    #[must_use]
    pub fn with_max_steps(mut self, steps: usize) -> Self {
        self.max_steps = Some(steps);
        self
    }

    /// The Cramér–Rao bound at `pose`: the least covariance that an unbiased estimate from one frame
    /// of this scene's photocurrents can have, the tool at rest and all cells with light used.
    /// m², m·rad, rad²; `None` where the data leave a direction free.
    pub fn bound(&self, pose: &Pose) -> Option<[[S; 6]; 6]> {
        observability::covariance(&self.factor_at(pose)?, self.length_scale_m)
    }

    /// The compiled scene.
    pub fn plan(&self) -> &Plan<S> {
        &self.plan
    }

    /// The pose that explains `readings`, of a tool that moves within the frame as `motion` says.
    pub fn solve(&self, readings: &Photocurrents, start: Start<'_>, motion: &MotionPrior) -> Solution<S> {
        let sorted = Sorted::of(readings, &self.limits);
        if let Some(solution) = self.too_few(&sorted) {
            return solution;
        }
        match (start, self.max_steps) {
            (Start::PlanesOnly, _) => self.unfinished(&sorted, motion, self.on_planes(&sorted), 0),
            (Start::Cold, Some(steps)) => self.unfinished(&sorted, motion, self.on_planes(&sorted), steps),
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
        motion: &MotionPrior,
        start: Transform<S>,
        max_iterations: usize,
    ) -> Solution<S> {
        let problem = self.problem(sorted, motion);
        let workspace = &mut Workspace::new();
        let stopping = Stopping { max_iterations, tolerance_sigmas: S::of(TOLERANCE_SIGMAS) };
        let minimum = problem.minimise(start, &problem.whiteners(), stopping, workspace);
        let mut solution = self.conclude(sorted, &problem, &minimum, workspace, Fit::Full);
        if solution.outcome.has_pose() && !minimum.converged {
            solution.outcome = Outcome::Degraded(Weakness::Unfinished);
        }
        solution
    }

    #[inline(never)]
    fn cold(&self, sorted: &Sorted<S>, motion: &MotionPrior) -> Solution<S> {
        let workspace = &mut Workspace::with_work(COLD_WORK);
        let solution = self.search(sorted, motion, &mut Search::at_once(), workspace);
        Solution { evaluations: workspace.evaluations, ..solution }
    }

    fn near(&self, sorted: &Sorted<S>, pose: &Pose, motion: &MotionPrior) -> Solution<S> {
        let workspace = &mut Workspace::new();
        let mut solution = self.follow(sorted, motion, Transform::of(pose), None, workspace);
        if matches!(solution.outcome, Outcome::Diverged | Outcome::Degraded(Weakness::Misfit)) {
            let before = solution.iterations;
            solution = self.cold(sorted, motion);
            solution.iterations += before;
        }
        solution.evaluations += workspace.evaluations;
        solution
    }

    /// The pose on the planes of `sorted`.
    pub(super) fn on_planes(&self, sorted: &Sorted<S>) -> Transform<S> {
        planes::pose_on_planes(&self.planes, &sorted.usable, Transform::of(&Pose::HOME), self.length_scale_m)
    }

    pub(super) fn problem<'a>(&'a self, sorted: &'a Sorted<S>, motion: &MotionPrior) -> Problem<'a, S> {
        let sigmas = [motion.linear_sigma_m_per_s, motion.angular_sigma_rad_per_s];
        let vector = |v: glam::DVec3| <S as Scalar>::Vec3::of(v);
        let [linear, angular] = [motion.twist.linear_m_per_s, motion.twist.angular_rad_per_s].map(vector);
        Problem {
            plan: &self.plan,
            planes: &self.planes,
            noise: &self.noise,
            offsets_s: &self.offsets_s,
            readings: &sorted.usable,
            motion: Motion::new(linear, angular, sigmas, &self.offsets_s, self.length_scale_m),
            length_scale_m: self.length_scale_m,
            jacobian_change_rate: self.jacobian_change_rate,
        }
    }

    /// Six unknowns need three cells.
    pub(super) fn too_few(&self, sorted: &Sorted<S>) -> Option<Solution<S>> {
        if sorted.usable.len() >= 3 {
            return None;
        }
        let outcome = if sorted.usable.len() + sorted.faint.count() >= 3 {
            Outcome::TooDark
        } else {
            Outcome::Unobservable(Directions::all())
        };
        Some(Solution::without_pose(outcome, sorted.used))
    }

    /// A displacement in σ of a solution's pose, squared; infinite without a pose.
    pub(super) fn squared_sigmas(
        &self,
        solution: &Solution<S>,
        translation_m: glam::DVec3,
        rotation_rad: glam::DVec3,
    ) -> f64 {
        let t = translation_m / self.length_scale_m.as_f64();
        let scaled = [t.x, t.y, t.z, rotation_rad.x, rotation_rad.y, rotation_rad.z].map(S::of);
        solution.factor.map_or(f64::INFINITY, |factor| {
            let length = factor.length(&scaled).as_f64();
            length * length
        })
    }
}
