//! From photocurrents to a pose.
//!
//! Positions first, currents after: [`planes`] finds a start from home by the ratios alone, which
//! converges everywhere; [`refine`] descends from there on all currents, weighted by their noise
//! ([`weights`], [`normal`]). χ² and the cells that saw no light tell a true solution from a mirror
//! image or a lie ([`search`]); the singular values of the whitened derivatives tell what the data
//! leave open ([`observability`]).

mod algebra;
mod fold;
mod images;
mod kink;
mod normal;
mod observability;
mod outcome;
mod outlier;
mod planes;
mod readings;
mod refine;
mod search;
mod smooth;
mod starts;
mod track;
mod weights;

use heapless::Vec;

use crate::plan::{Plan, Tier};
use crate::pose::{Pose, Transform, Twist};
use crate::response::Pair;
use crate::scalar::{Scalar, Vector3};
use crate::scene::{Cell, MAX_CELLS, Scene, SceneError};

pub use outcome::{AXES, Cells, Directions, Estimate, Outcome, Solution, Verified, Weakness};
pub use readings::{Photocurrents, Reading};
pub use smooth::{Smoothed, TwistEstimate};
pub use track::{Tracked, Tracker};

use normal::{Motion, Problem, Workspace};
use planes::PlaneCell;
use readings::{Limits, Sorted};
use refine::{Ending, Refined};
use search::{COLD_WORK, Search};
use weights::CellNoise;

/// Steps of one refinement before it is given up.
const MAX_ITERATIONS: usize = 40;

/// What a cold start may leave of the way to the minimum, in σ of the pose: next to nothing, for the
/// sake of noise-free data.
const COLD_LEFTOVER: f64 = 1e-7;

/// What following a tool may leave, by an estimate that is tens of times too cautious: a fiftieth of σ in
/// the median.
const WARM_LEFTOVER: f64 = 0.8;

/// Probability of a larger χ² by chance at which a fit is doubted: 1e-9, six one-sided σ.
const GATE_SIGMAS: f64 = 6.0;

/// Two poses this many σ apart are two poses.
const DISTINCT_SIGMAS: f64 = 6.0;

/// How far a solve goes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Effort {
    /// The pose on the planes that the positions of the light give: no currents, no weights.
    Planes,
    /// At most so many steps of refinement on the currents.
    Steps(usize),
    /// To the minimum.
    #[default]
    Full,
}

/// Estimates poses from the photocurrents of one scene.
///
/// Holds the compiled scene and no state: every solve is a function of its arguments.
#[derive(Clone, Debug)]
pub struct Solver<S: Scalar> {
    plan: Plan<S>,
    planes: Vec<PlaneCell<S>, MAX_CELLS>,
    noise: Vec<CellNoise<S>, MAX_CELLS>,
    limits: Vec<Limits<S>, MAX_CELLS>,
    /// Largest χ² that noise explains, by the number of cells used.
    gates: [S; MAX_CELLS + 1],
    /// Empty: all cells are exposed at the reference instant.
    offsets_s: Vec<S, MAX_CELLS>,
    arm: S,
    /// Relative change of the derivatives per unit of a scaled step.
    bend: S,
    effort: Effort,
    /// Whether poses of this head may have mirror images although all cells see light.
    has_images: bool,
}

/// How well a pose explains the data, worst first.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Fit {
    /// χ² is more than the noise explains.
    None,
    /// The cells that see light fit, but another should see some, too.
    LitOnly,
    /// All cells agree.
    Full,
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
            arm: S::one(),
            bend: S::zero(),
            effort: Effort::Full,
            has_images: false,
        }
    }

    /// Compiles `scene` where the solver is, for a processor whose RAM holds one and not two: cells
    /// exposed at the reference instant, the effort as before.
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
        self.arm = S::of(scene.arm_m());
        self.planes.extend(cells.clone().map(|cell| PlaneCell::compile(cell, tier == Tier::Paper)));
        self.noise.extend((0..scene.cells.len()).map(|cell| CellNoise::compile(scene, cell, relative_error)));
        self.limits.extend(cells.map(|Cell { detector, .. }| Limits {
            faint_a: S::of(detector.faint_a),
            saturation_a: detector.saturation_a.map_or(S::infinity(), |limit| S::of(limit - detector.dark_current_a)),
            most_share: S::infinity(),
        }));
        self.gates = core::array::from_fn(|cells| S::of(chi2_gate(redundancy(cells))));
        self.bend = refine::bend(&self.planes, self.arm);
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
    fn factor_at(&self, pose: &Pose) -> Option<algebra::Factor<S>> {
        let pairs = (0..self.plan.cell_count()).map(|cell| {
            let pair = self.plan.photocurrents(cell, pose);
            Pair { i_x1_a: pair.i_x1_a.as_f64(), i_x2_a: pair.i_x2_a.as_f64() }
        });
        let sorted = Sorted::of(&Photocurrents::of_pairs(pairs), &self.limits);
        if sorted.usable.len() < 3 {
            return None;
        }
        let problem = self.problem(&sorted, &MotionPrior::default());
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
    /// clipped there, as from an emitter at home: for heads whose detectors' ends are not known well.
    #[must_use]
    pub fn without_clipped(mut self) -> Self {
        for (limits, plane) in self.limits.iter_mut().zip(&self.planes) {
            limits.most_share = plane.unclipped_share();
        }
        self
    }

    /// Stops after `effort`: for those who weigh error against time. A pose that is not at its
    /// minimum is [`Weakness::Unfinished`].
    #[must_use]
    pub fn with_effort(mut self, effort: Effort) -> Self {
        self.effort = effort;
        self
    }

    /// The Cramér–Rao bound at `pose`: the least covariance that an unbiased estimate from one frame
    /// of this scene's photocurrents can have, the tool at rest and all cells with light used.
    /// m², m·rad, rad²; `None` where the data leave a direction free.
    pub fn bound(&self, pose: &Pose) -> Option<[[S; 6]; 6]> {
        observability::covariance(&self.factor_at(pose)?, self.arm)
    }

    /// The compiled scene.
    pub fn plan(&self) -> &Plan<S> {
        &self.plan
    }

    /// The pose from `readings` alone, the tool at rest.
    pub fn solve(&self, readings: &Photocurrents) -> Solution<S> {
        self.solve_moving(readings, &MotionPrior::default())
    }

    /// The pose from `readings`, with no idea where the tool is but some of how it moves.
    pub fn solve_moving(&self, readings: &Photocurrents, motion: &MotionPrior) -> Solution<S> {
        if self.effort == Effort::Full {
            return self.search_on(readings, motion, &mut Search::at_once(), COLD_WORK);
        }
        let sorted = Sorted::of(readings, &self.limits);
        if let Some(solution) = self.too_few(&sorted) {
            return solution;
        }
        self.unfinished(&sorted, &self.problem(&sorted, motion), self.on_planes(&sorted))
    }

    /// As far as the effort goes from `start`, and no word on whether the data fit.
    fn unfinished(&self, sorted: &Sorted<S>, problem: &Problem<'_, S>, start: Transform<S>) -> Solution<S> {
        let room = &mut Workspace::new();
        let max_iterations = match self.effort {
            Effort::Planes => 0,
            Effort::Steps(steps) => steps,
            Effort::Full => MAX_ITERATIONS,
        };
        let ending = Ending { max_iterations, leftover: S::of(COLD_LEFTOVER) };
        let refined = problem.refine(start, &problem.whiteners(), ending, room);
        let mut solution = self.conclude(sorted, problem, &refined, room, Fit::Full);
        if solution.outcome.has_pose() && !refined.converged {
            solution.outcome = Outcome::Degraded(Weakness::Unfinished);
        }
        solution
    }

    /// The pose from `readings` near `prior`. Falls back to the search from home if the data do
    /// not fit there.
    pub fn solve_near(&self, readings: &Photocurrents, prior: &Pose, motion: &MotionPrior) -> Solution<S> {
        let sorted = Sorted::of(readings, &self.limits);
        if let Some(solution) = self.too_few(&sorted) {
            return solution;
        }
        let room = &mut Workspace::new();
        let mut solution = self.follow(&sorted, motion, Transform::of(prior), None, room);
        if matches!(solution.outcome, Outcome::Diverged | Outcome::Degraded(Weakness::Misfit)) {
            let before = solution.iterations;
            solution = self.solve_moving(readings, motion);
            solution.iterations += before;
        }
        solution.evaluations += room.evaluations;
        solution
    }

    /// The pose near `start`, where the tool is expected: of all cells; without the one that was
    /// `left_out` in the frame before; without another; or a misfit.
    fn follow(
        &self,
        sorted: &Sorted<S>,
        motion: &MotionPrior,
        start: Transform<S>,
        left_out: Option<usize>,
        room: &mut Workspace<S>,
    ) -> Solution<S> {
        let problem = self.problem(sorted, motion);
        if self.effort != Effort::Full {
            return self.unfinished(sorted, &problem, start);
        }
        if let Some(solution) = left_out.and_then(|cell| self.still_without(sorted, motion, cell, start, room)) {
            return solution;
        }
        let whiteners = problem.whiteners();
        let mut refined = outlier::quickly(&problem, &whiteners, start, room);
        let fit = self.fit(sorted, &problem, &refined);
        if fit != Fit::None {
            return self.conclude_near(sorted, &problem, &whiteners, &refined, room, fit);
        }
        let mut iterations = refined.iterations;
        if let Some(mut solution) = self.without_outlier_near(sorted, motion, start, room) {
            solution.iterations += iterations;
            return solution;
        }
        if !refined.converged {
            refined = outlier::near(&problem, &whiteners, refined.pose, room);
            iterations += refined.iterations;
        }
        let fit = self.fit(sorted, &problem, &refined);
        let has_pose =
            fit != Fit::None || redundancy(sorted.usable.len()) > 0 && !search::is_elsewhere(&problem, &refined);
        if !has_pose {
            return Solution { iterations, ..Solution::without_pose(Outcome::Diverged, sorted.used) };
        }
        // The last expansion may be of other cells.
        problem.expand(&refined.pose, &whiteners, room);
        Solution { iterations, ..self.conclude_near(sorted, &problem, &whiteners, &refined, room, fit) }
    }

    /// A displacement in σ of a solution's pose, squared; infinite without a pose.
    fn squared_sigmas(&self, solution: &Solution<S>, translation_m: glam::DVec3, rotation_rad: glam::DVec3) -> f64 {
        let t = translation_m / self.arm.as_f64();
        let scaled = [t.x, t.y, t.z, rotation_rad.x, rotation_rad.y, rotation_rad.z].map(S::of);
        solution.factor.map_or(f64::INFINITY, |factor| {
            let length = factor.length(&scaled).as_f64();
            length * length
        })
    }

    /// The pose on the planes of `sorted`.
    fn on_planes(&self, sorted: &Sorted<S>) -> Transform<S> {
        planes::pose_on_planes(&self.planes, &sorted.usable, Transform::of(&Pose::HOME), self.arm)
    }

    fn problem<'a>(&'a self, sorted: &'a Sorted<S>, motion: &MotionPrior) -> Problem<'a, S> {
        let sigmas = [motion.linear_sigma_m_per_s, motion.angular_sigma_rad_per_s];
        let vector = |v: glam::DVec3| <S as Scalar>::Vec3::of(v);
        let [linear, angular] = [motion.twist.linear_m_per_s, motion.twist.angular_rad_per_s].map(vector);
        Problem {
            plan: &self.plan,
            planes: &self.planes,
            noise: &self.noise,
            offsets_s: &self.offsets_s,
            readings: &sorted.usable,
            motion: Motion::new(linear, angular, sigmas, &self.offsets_s, self.arm),
            arm: self.arm,
            bend: self.bend,
        }
    }

    /// Six unknowns need three cells.
    fn too_few(&self, sorted: &Sorted<S>) -> Option<Solution<S>> {
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

    /// How well `refined` explains the data: χ² by the noise, and no light where none was seen.
    fn fit(&self, sorted: &Sorted<S>, problem: &Problem<'_, S>, refined: &Refined<S>) -> Fit {
        // Written so that NaN does not fit.
        let fits = refined.converged && refined.chi2 <= self.gates[sorted.usable.len()];
        if !fits {
            Fit::None
        } else if sorted.faint.count() == 0 || self.is_dark_where_dark(sorted, problem, refined) {
            Fit::Full
        } else {
            Fit::LitOnly
        }
    }

    /// Whether cells that were found without light are without light at the pose, too.
    fn is_dark_where_dark(&self, sorted: &Sorted<S>, problem: &Problem<'_, S>, refined: &Refined<S>) -> bool {
        let predicted = problem.predicted(&refined.pose);
        sorted.faint.iter().all(|cell| predicted[cell][0] + predicted[cell][1] < S::two() * self.limits[cell].faint_a)
    }

    /// What to tell of a refinement whose last expansion is in `room`.
    fn conclude(
        &self,
        sorted: &Sorted<S>,
        problem: &Problem<'_, S>,
        refined: &Refined<S>,
        room: &Workspace<S>,
        fit: Fit,
    ) -> Solution<S> {
        let redundancy = redundancy(sorted.usable.len());
        let mut solution = Solution {
            chi2: refined.chi2,
            redundancy,
            iterations: refined.iterations,
            factor: refined.factor,
            ..Solution::without_pose(Outcome::Diverged, sorted.used)
        };
        let Some(factor) = &refined.factor else {
            return solution;
        };
        let Some(covariance) = observability::covariance(factor, self.arm) else {
            let free = observability::free_directions(factor).unwrap_or_default();
            solution.outcome = Outcome::Unobservable(free);
            return solution;
        };
        let pose = refined.pose.to_pose();
        if !pose.is_finite() {
            return solution;
        }
        let gate = self.gates[sorted.usable.len()];
        solution.unnoticed_sigmas = unnoticed_sigmas(gate, redundancy, problem.least_visible(factor, room));
        solution.outcome = if fit == Fit::None {
            Outcome::Degraded(Weakness::Misfit)
        } else if sorted.usable.len() < self.plan.cell_count() {
            Outcome::Degraded(Weakness::FewerCells)
        } else {
            Outcome::Converged
        };
        solution.estimate = Some(Estimate { pose, covariance });
        solution
    }
}

/// How far, in σ of the pose, an error can move it that leaves χ² as likely above its gate as below:
/// of an error of length e in σ of its cell, r·e² stays visible and (1 − r)·e² is in the pose.
fn unnoticed_sigmas<S: Scalar>(gate: S, redundancy: usize, visible: S) -> S {
    // Of next to nothing, rounding is what is left.
    let negligible = S::of(1e-6).max(S::of(64.0) * S::epsilon());
    if redundancy == 0 || visible <= negligible {
        return S::infinity();
    }
    ((gate - S::of(redundancy as f64)) * (S::one() - visible) / visible).square_root()
}

/// Two currents a cell, less six unknowns.
fn redundancy(cells: usize) -> usize {
    (2 * cells).saturating_sub(6)
}

/// The χ² that `freedom` degrees of freedom exceed with probability 1e-9 (Wilson and Hilferty
/// 1931). Without redundancy a fit is exact, but for noise that leads past a fold of the currents:
/// counted as one degree.
fn chi2_gate(freedom: usize) -> f64 {
    let k = freedom.max(1) as f64;
    let spread = 2.0 / (9.0 * k);
    let root = 1.0 - spread + GATE_SIGMAS * libm::sqrt(spread);
    k * root * root * root
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_gate_of_chi2_is_passed_by_chance_once_in_a_billion() {
        // Quantiles of χ² for 9.9e-10, from its closed form for even degrees of freedom. The cube root is
        // a normal deviate to a few percent, least so for few degrees.
        for (freedom, quantile) in [(2, 41.47), (4, 47.91), (6, 53.37), (10, 62.98), (26, 94.63)] {
            let ratio = chi2_gate(freedom) / quantile;
            assert!((0.99..1.2).contains(&ratio), "{freedom}: {ratio}");
        }
    }
}
