//! Poses frame after frame.
//!
//! The cells of a frame are exposed one after another; a pose belongs to one instant. A cell exposed τ after it sees
//! the pose (t + τ·v + τ²·a, exp(τ·ω + τ²·α)·R). The tracker takes the twist (v, ω) and the bend (a, α), half the acceleration,
//! from the frames before, by a fading-memory polynomial ([`super::filter`]). The uncertainty of the twist enters the
//! covariance ([`super::twist`]), that of the bend as long as it is not fitted. Poses are not filtered: each is solved from the
//! currents of its own frame. A filtered pose can be had beside it.
//!
//! A pose is accepted although it is far from the prediction: a tool may hit a wall. If the currents of its own
//! frame confirm it, the motion before is forgotten. Three cells have no redundancy to confirm a pose with: there
//! only a pose that the tool can have reached is accepted.
//!
//! A frame with cells missing may leave no pose, or one of little worth. What these frames, and a few of those, say of the
//! motion is passed over: it goes on as it was, also if it seems not to.
//!
//! Each frame has a budget of work. Following a tool takes a few evaluations, with or without an outlier. A tool that
//! is lost, or followed where no pose explains the currents, is searched for over several frames, each part of the
//! search on the currents of its own frame.

use crate::plan::{CompiledScene, Optics};
use crate::pose::{Pose, Rigid, Transform};
use crate::scalar::{Linear3, Number};

use super::cold_start::{COLD_WORK, Search};
use super::filter::{FadingFilter, Prediction};
use super::normal_equations::Workspace;
use super::outcome::{Cells, DegradedReason, Estimate, Outcome, Solution};
use super::outlier::LeftOut;
use super::readings::{Photocurrents, Sorted};
use super::solver::Solver;
use super::twist::{Bend, Prior};

/// Frames without a pose over which the motion is extrapolated.
pub const MAX_EXTRAPOLATED_FRAMES: u32 = 8;

/// Standard deviation per axis of an unknown twist: a fast hand.
pub const UNKNOWN_LINEAR_M_PER_S: f64 = 0.5;
pub const UNKNOWN_ANGULAR_RAD_PER_S: f64 = 5.0;

/// Weak poses of other cells in a row over which the motion is extrapolated: with more of them poses are what they are now.
const MAX_WEAK: u32 = 2;

/// Acceleration allowed for while only a straight line can be fitted: a fast hand reverses
/// 0.5 m/s within some 2 ms.
const ACCELERATION_M_PER_S2: f64 = 300.0;
const ANGULAR_ACCELERATION_RAD_PER_S2: f64 = 3000.0;

/// Standard deviation per axis of half the acceleration while that is not fitted.
const UNKNOWN_BENDS: [f64; 2] = [0.5 * ACCELERATION_M_PER_S2, 0.5 * ANGULAR_ACCELERATION_RAD_PER_S2];

/// Frames from which on acceleration is fitted.
const BEND_FROM: u32 = 5;

/// Squared error of a prediction, six axes together and in units of what noise explains, beyond
/// which the tool did not go on as before: 1e-6 of honest frames (χ² with six degrees of freedom).
const MANOEUVRE: f64 = 38.3;

/// Largest factor by which past prediction errors may widen this bound.
const MAX_STRAIN: f64 = 10.0;

/// Noise that is allowed for beyond the distance that a tool can have moved, in σ. A tool that hits something may
/// turn back as fast as it came.
const REACH_SIGMAS: f64 = 6.0;

/// A misfit elsewhere must have less than this share of the χ² of the one that is followed.
const BETTER: f64 = 0.5;

/// Frames over which the light level is averaged for frames that do not tell it.
const LEVEL_MEMORY: f64 = 64.0;

/// Finds the poses of consecutive frames.
#[derive(Clone, Debug)]
pub struct PoseTracker<S: Number, P = CompiledScene<S>> {
    solver: Solver<S, P>,
    period_s: f64,
    frame_rate_hz: S,
    /// Share of σ of a pose that the motion within a frame may be unknown by and yet count as known.
    negligible: S,
    budget: Budget,
    motion: FadingFilter<S>,
    next_frame: u64,
    /// Twist before the tool was lost: the tool may still be as fast.
    last_twist: [S::Vec3; 2],
    /// Cells of the last pose that says something of the motion.
    cells: Cells,
    weak: u32,
    /// Whether the motion is to be forgotten, if this frame says enough.
    forgets: bool,
    extrapolated_frames: u32,
    /// The cell that was left out of the last pose.
    left_out: Option<usize>,
    /// The frame in which it was looked at again.
    last_look: u64,
    is_misfit: bool,
    /// How bright all light was in the last frames that told it.
    light_level: S,
    lost: Lost<S>,
}

impl<S: Number, P: Optics<S>> PoseTracker<S, P> {
    /// For frames `period_s` seconds apart.
    pub fn new(solver: Solver<S, P>, period_s: f64) -> Self {
        Self {
            solver,
            period_s,
            frame_rate_hz: S::of(period_s.recip()),
            negligible: S::zero(),
            budget: Budget::HOST,
            motion: FadingFilter::new(period_s),
            next_frame: 0,
            last_twist: [S::Vec3::default(); 2],
            cells: Cells::default(),
            weak: 0,
            forgets: false,
            extrapolated_frames: 0,
            left_out: None,
            last_look: 0,
            is_misfit: false,
            light_level: S::one(),
            lost: Lost::new(Budget::HOST.first),
        }
    }

    /// How bright all light was in the last 64 frames or so that told it, relative to the scene; `None` where it is taken for
    /// known.
    pub(crate) fn light_level(&self) -> Option<S> {
        self.solver.compiled.level_information.map(|_| self.light_level)
    }

    pub(crate) fn period_s(&self) -> f64 {
        self.period_s
    }

    /// The motion that is expected within the next frame; `None`: it is not known how the tool moves.
    pub(crate) fn expected_motion(&self) -> Option<Prior<S>> {
        self.motion
            .predict()
            .filter(|expected| expected.frames >= BEND_FROM)
            .map(|expected| self.motion_prior(&expected))
    }

    /// The solver of each frame.
    pub fn solver(&self) -> &Solver<S, P> {
        &self.solver
    }

    /// The solver, to be changed: [`Self::restart`] then.
    pub fn solver_mut(&mut self) -> &mut Solver<S, P> {
        &mut self.solver
    }

    /// Begins anew, for frames `period_s` seconds apart.
    pub fn restart(&mut self, period_s: f64) {
        self.period_s = period_s;
        self.frame_rate_hz = S::of(period_s.recip());
        self.motion = FadingFilter::new(period_s);
        self.next_frame = 0;
        self.last_twist = [S::Vec3::default(); 2];
        self.cells = Cells::default();
        self.weak = 0;
        self.extrapolated_frames = 0;
        self.left_out = None;
        self.last_look = 0;
        self.is_misfit = false;
        self.light_level = S::one();
        self.lost = Lost::new(self.budget.first);
    }

    /// Takes the motion within a frame for known once it is unknown by no more than `share` of σ of a pose: the
    /// covariance is then too small by the square of that, and a solve saves a quarter of its work.
    #[must_use]
    pub fn neglecting_motion(mut self, share: f64) -> Self {
        self.negligible = S::of(share);
        self
    }

    pub(crate) fn with_budget(mut self, budget: Budget) -> Self {
        self.budget = budget;
        self.lost = Lost::new(budget.first);
        self
    }

    /// [`Self::track`], compiled where it is called.
    #[inline(always)]
    pub(crate) fn track_here(&mut self, frame: u64, readings: &Photocurrents<S>) -> Solution<S> {
        let mut solution = self.advance(frame, readings);
        solution.inflate_covariance();
        solution
    }

    /// [`Self::track_here`], but the covariance of a misfit is not inflated yet.
    #[inline(always)]
    fn advance(&mut self, frame: u64, readings: &Photocurrents<S>) -> Solution<S> {
        match frame.checked_sub(self.next_frame) {
            Some(missed) if missed <= u64::from(MAX_EXTRAPOLATED_FRAMES) => {
                (0..missed).for_each(|_| self.extrapolate());
            }
            _ => self.forget(),
        }
        self.next_frame = frame.wrapping_add(1);
        self.forgets = false;
        let solution = self.solve(readings);
        let is_weak = solution.cells_used != self.cells && self.says_little(&solution);
        if self.forgets && !is_weak {
            self.forget();
        }
        let Some(estimate) = &solution.estimate else {
            self.extrapolate();
            self.is_misfit = false;
            self.lost.wait = 0;
            return solution;
        };
        if is_weak {
            self.weak += 1;
            self.extrapolate();
        } else {
            let (pose, covariance) = (solution.rigid, &estimate.covariance);
            let solver = &self.solver;
            let squared_sigmas = |displacement| solver.compiled.squared_sigmas(&solution, displacement);
            self.motion.update(&pose, covariance, squared_sigmas);
            (self.cells, self.weak) = (solution.cells_used, 0);
        }
        self.extrapolated_frames = 0;
        self.left_out = solution.excluded.iter().next();
        self.is_misfit = is_misfit(&solution);
        let most_saved = self.budget.most_saved;
        if !self.is_misfit && self.lost.is_under_way(most_saved) {
            self.lost = Lost::new(self.lost.saved_work.min(most_saved));
        }
        solution
    }

    /// Whether a frame without pose, or with one of other cells than the last, says too little of the motion to change it, or to
    /// know by that the tool did not go on as before.
    #[cold]
    #[inline(never)]
    fn says_little(&self, solution: &Solution<S>) -> bool {
        let is_weak = |estimate: &Estimate<S>| self.weak < MAX_WEAK && self.motion.is_weak(&estimate.covariance);
        solution.estimate.as_ref().is_none_or(is_weak)
    }

    #[cold]
    #[inline(never)]
    fn forget(&mut self) {
        self.motion.forget();
        self.extrapolated_frames = 0;
    }

    #[cold]
    #[inline(never)]
    fn extrapolate(&mut self) {
        self.extrapolated_frames += 1;
        if self.extrapolated_frames > MAX_EXTRAPOLATED_FRAMES {
            return self.forget();
        }
        self.motion.extrapolate();
    }

    fn solve(&mut self, readings: &Photocurrents<S>) -> Solution<S> {
        let mut sorted = Sorted::of(readings, &self.solver.compiled.limits);
        if let Some(solution) = self.solver.compiled.too_few(&sorted) {
            return solution;
        }
        let tells_level = self.solver.compiled.level_information(sorted.usable.len()).is_some();
        if P::FINDS_LIGHT_LEVEL && !tells_level {
            sorted.divide_by(self.light_level);
        }
        let workspace = &mut Workspace::with_work(self.budget.frame);
        workspace.is_unhurried = self.period_s >= P::UNHURRIED_S;
        let mut solution = match self.motion.predict() {
            Some(expected) => self.follow(&sorted, &expected, workspace),
            None => self.find(&sorted, &self.unknown_motion(&self.last_twist), workspace),
        };
        if self.lost.saved_work < self.budget.most_saved {
            self.lost.saved_work += self.budget.saved_a_frame;
        }
        if P::FINDS_LIGHT_LEVEL
            && tells_level
            && solution.outcome == Outcome::Converged
            && let Some(level) = &workspace.level
        {
            self.light_level += (level.factor() - self.light_level) * S::of(LEVEL_MEMORY.recip());
        }
        solution.evaluations = workspace.evaluations;
        solution
    }

    /// The cell that was left out of the last pose, and whether it is time to look at it again.
    fn left_out(&mut self) -> Option<LeftOut> {
        let cell = self.left_out?;
        // A frame that is followed twice looks twice. Frames may be numbered anew.
        let since = self.next_frame.checked_sub(self.last_look);
        let looks_again = since.is_none_or(|since| since == 0 || since >= P::LOOKS_AGAIN_AFTER);
        if looks_again {
            self.last_look = self.next_frame;
        }
        Some(LeftOut { cell, looks_again })
    }

    /// The pose near the expected one; else wherever it is.
    fn follow(&mut self, sorted: &Sorted<S>, expected: &Prediction<S>, workspace: &mut Workspace<S>) -> Solution<S> {
        let start = expected.pose.to_transform();
        let motion = self.motion_prior(expected);
        let left_out = self.left_out();
        let compiled = &self.solver.compiled;
        let mut solution = if P::DOUBTS_MOTION_FIRST && !self.is_misfit && expected.frames >= BEND_FROM {
            compiled.follow_agreeing(sorted, &motion, start, left_out, workspace, |minimum, _| Solution {
                iterations: minimum.iterations,
                ..Solution::without_pose(Outcome::Diverged, sorted.used)
            })
        } else {
            compiled.follow(sorted, &motion, start, left_out, workspace)
        };
        // While the motion is not known yet, any is as expected.
        let is_expected = solution.estimate.is_some()
            && (expected.frames < BEND_FROM || self.is_near(&solution.rigid, &solution, expected));
        if is_expected && !is_misfit(&solution) {
            let is_expected = |twin: &Pose| self.is_near(&Rigid::of(twin), &solution, expected);
            if self.solver.compiled.has_twin(sorted, &motion, &solution, is_expected, workspace) {
                solution = Solution::without_pose(Outcome::Ambiguous, sorted.used);
            }
            return solution;
        }
        self.follow_unexpected(sorted, expected, solution, is_expected, workspace)
    }

    /// The pose of a tool that is not where it was expected, or where nothing fits: `solution` so far.
    #[cold]
    #[inline(never)]
    fn follow_unexpected(
        &mut self,
        sorted: &Sorted<S>,
        expected: &Prediction<S>,
        mut solution: Solution<S>,
        is_expected: bool,
        workspace: &mut Workspace<S>,
    ) -> Solution<S> {
        let start = expected.pose.to_transform();
        let unknown = self.unknown_motion(&expected.twist);
        if !(is_expected && self.is_misfit) {
            // The tool did not go on as before: what it did within this frame is unknown.
            let time_s = S::of(self.period_s * f64::from(self.extrapolated_frames + 1));
            let sigmas = self.motion.sigmas();
            let reach = [0, 1].map(|i| S::two() * unknown.sigmas[i] * time_s + S::of(REACH_SIGMAS) * sigmas[i]);
            self.forgets = true;
            self.last_twist = expected.twist;
            let before = solution.iterations;
            let left_out = self.left_out();
            solution = self.solver.compiled.follow(sorted, &unknown, start, left_out, workspace);
            solution.iterations += before;
            let is_within_reach = |pose: &Pose| {
                let [shift, turn] = Rigid::of(pose).displacement_from(&expected.pose);
                shift.length() <= reach[0] && turn.length() <= reach[1]
            };
            let is_believed = solution.estimate.as_ref().is_some_and(|estimate| {
                solution.redundancy > 0
                    || is_within_reach(&estimate.pose)
                        && !self.solver.compiled.has_twin(sorted, &unknown, &solution, is_within_reach, workspace)
            });
            if !is_misfit(&solution) && is_believed {
                return solution;
            }
        }
        // A misfit is followed where it is while better is looked for.
        let mut found = self.find(sorted, &unknown, workspace);
        let is_better = found.estimate.is_some()
            && !(is_misfit(&found) && is_misfit(&solution) && found.chi2 >= S::of(BETTER) * solution.chi2);
        if is_misfit(&solution) && !is_better {
            solution.iterations += found.iterations;
            return solution;
        }
        self.forgets = true;
        found.iterations += solution.iterations;
        found
    }

    /// Whether `pose` is where the tool would be if it went on as before, in σ of `solution`.
    fn is_near(&self, pose: &Rigid<S>, solution: &Solution<S>, expected: &Prediction<S>) -> bool {
        let displacement = pose.displacement_from(&expected.pose);
        let squared = self.solver.compiled.squared_sigmas(solution, displacement) / (S::one() + expected.pose_variance);
        squared <= S::of(MANOEUVRE) * expected.strain.min(S::of(MAX_STRAIN))
    }

    /// How the tool is expected to move within the next frame.
    fn motion_prior(&self, expected: &Prediction<S>) -> Prior<S> {
        if expected.frames < 2 {
            return self.unknown_motion(&self.last_twist);
        }
        let per_second = expected.step_variance.root() * self.frame_rate_hz;
        let mut sigmas = self.motion.sigmas().map(|sigma| sigma * per_second);
        if expected.frames < BEND_FROM {
            // A line through n frames lags half of them behind a bend.
            let behind_s = 0.5 * (f64::from(expected.frames) + 1.0) * self.period_s;
            let bends = [ACCELERATION_M_PER_S2, ANGULAR_ACCELERATION_RAD_PER_S2].map(|most| S::of(most * behind_s));
            sigmas = [0, 1].map(|i| S::norm(sigmas[i], bends[i]));
        } else if per_second * self.solver.compiled.duration_s() <= self.negligible {
            sigmas = [S::zero(); 2];
        }
        Prior { twist: expected.twist, sigmas, bend: self.bend(expected.frames) }
    }

    /// Of a tool that moved with this twist and may do anything now.
    fn unknown_motion(&self, [linear, angular]: &[S::Vec3; 2]) -> Prior<S> {
        Prior {
            twist: [S::Vec3::default(); 2],
            sigmas: [
                S::of(UNKNOWN_LINEAR_M_PER_S).max(linear.length()),
                S::of(UNKNOWN_ANGULAR_RAD_PER_S).max(angular.length()),
            ],
            bend: self.bend(0),
        }
    }

    /// The bend of a motion over so many frames, where it matters. Once it is fitted it is taken for known: where it is far off, poses are not
    /// where they are expected either, and the motion is unknown.
    #[inline(never)]
    fn bend(&self, frames: u32) -> Option<Bend<S>> {
        if !self.solver.compiled.allows_for_bends() {
            return None;
        }
        let predicted = self.motion.predicted_bend().filter(|_| frames >= BEND_FROM);
        let known = predicted.map(|half_acceleration| Bend { half_acceleration, sigmas: [S::zero(); 2] });
        Some(
            known.unwrap_or_else(|| Bend {
                half_acceleration: [S::Vec3::default(); 2],
                sigmas: UNKNOWN_BENDS.map(S::of),
            }),
        )
    }
}

fn is_misfit<S: Number>(solution: &Solution<S>) -> bool {
    solution.outcome == Outcome::Degraded(DegradedReason::Misfit)
}

#[derive(Clone, Copy, Debug)]
pub struct Budget {
    /// Each of them.
    pub frame: usize,
    /// That each leaves to a later search, and the most that are left.
    pub saved_a_frame: usize,
    pub most_saved: usize,
    /// That the first search may take besides.
    pub first: usize,
}

impl Budget {
    /// Of a host: at some 2.4 µs each, exact tier and twist unknown, a frame takes half of the 100 µs that it may cost at
    /// 4 kHz, because minimisations under way are completed; with what others have left, no longer than the 250 µs to
    /// the next. The first search may take as much as a cold solve, so that the first frame has a pose.
    pub const HOST: Self = Self { frame: 20, saved_a_frame: 2, most_saved: 56, first: COLD_WORK };
}

/// Frames between two searches while a misfit is followed.
const PAUSE: u32 = 256;

#[derive(Clone, Debug)]
pub struct Lost<S: Number> {
    search: Search<S>,
    /// Where it may as well be, if it may be in two places.
    images: Option<[Transform<S>; 2]>,
    pub wait: u32,
    /// Evaluations that a search may take besides those of its frame.
    pub saved_work: usize,
}

impl<S: Number> Lost<S> {
    pub fn new(saved_work: usize) -> Self {
        Self { search: Search::in_pieces(), images: None, wait: 0, saved_work }
    }

    /// Whether anything is to be forgotten when the tool has been found.
    pub fn is_under_way(&self, most_saved: usize) -> bool {
        self.search.has_begun() || self.images.is_some() || self.wait > 0 || self.saved_work > most_saved
    }
}

impl<S: Number, P: Optics<S>> PoseTracker<S, P> {
    /// Looks for the tool everywhere, a piece of the search a frame.
    pub(crate) fn find(&mut self, sorted: &Sorted<S>, motion: &Prior<S>, workspace: &mut Workspace<S>) -> Solution<S> {
        let lost = &mut self.lost;
        if let Some(images) = lost.images.take() {
            lost.images = self.solver.compiled.still_images(sorted, motion, images, workspace);
            if lost.images.is_some() {
                return Solution::without_pose(Outcome::Ambiguous, sorted.used);
            }
        }
        if lost.wait > 0 {
            lost.wait -= 1;
            return Solution::without_pose(Outcome::Diverged, sorted.used);
        }
        workspace.work += lost.saved_work;
        let solution = self.solver.compiled.search(sorted, motion, &mut lost.search, workspace);
        lost.saved_work = lost.saved_work.min(workspace.work).min(self.budget.most_saved);
        if lost.search.is_over {
            lost.images = lost.search.images();
            lost.search = Search::in_pieces();
            lost.wait = if self.is_misfit { PAUSE } else { 0 };
        }
        solution
    }
}
