//! Whether a minimum is believed, and what a solution says of itself.
//!
//! Of a right pose χ² follows the χ² distribution with as many degrees of freedom as there are currents beyond six
//! unknowns; a minimum above its gate, the quantile for 1e-9, is a misfit. Beside χ² the cells without light
//! count: a pose that would light them is a mirror image.
//!
//! An error of length e in the currents of one cell, in σ, has a share r in its residuals and 1 − r in the pose,
//! r the redundancy number. The largest error that χ² leaves unnoticed, and what it does to the pose, are the
//! minimal detectable bias and the external reliability of Baarda (A testing procedure for use in geodetic
//! networks, 1968).

use arrayvec::ArrayVec;

use crate::plan::Optics;
use crate::pose::Transform;
use crate::scalar::Number;

use super::chi2::redundancy;
use super::compiled::Compiled;
use super::levenberg_marquardt::{Minimum, Stopping};
use super::normal_equations::{Problem, Whiteners, Workspace};
use super::observability;
use super::outcome::{DegradedReason, Directions, Estimate, Outcome, Solution};
use super::readings::Sorted;

/// Two poses this many σ apart are two poses.
pub(super) const DISTINCT_SIGMAS: f64 = 6.0;

/// χ² by which a pose must be worse than the best to be out of the question: a likelihood ratio of
/// 1 : 22 000.
pub(super) const ALIKE: f64 = 20.0;

/// Directions, the softest first, along which χ² of a pose that may have images must grow as its
/// covariance says.
const SOFT: usize = 3;

/// χ² at a distance of [`DISTINCT_SIGMAS`], 36 by the covariance, from which on that says nothing: a pose
/// where a head is singular has σ as large as you like, and the currents bend long before.
const TOO_UNLIKE: f64 = 4.0 * DISTINCT_SIGMAS * DISTINCT_SIGMAS;

/// A residual this large a share of a cell's current is no small misfit: gains that calibration has not settled stay
/// well below. The pose is then another, or the head.
const ELSEWHERE: f64 = 0.05;

/// Evaluations that are left to [`Compiled::taken_roughly`], whatever came before: it takes some eight.
pub(super) const ROUGH_WORK: usize = 16;

/// How well a pose explains the data, worst first.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Fit {
    /// χ² is more than the noise explains.
    None,
    /// The cells that see light fit, but another should see some, too.
    LitOnly,
    /// All cells agree.
    Full,
}

impl<S: Number, P: Optics<S>> Compiled<S, P> {
    /// How well `minimum` explains the data: χ² by the noise, and no light where none was seen.
    pub(super) fn fit(&self, sorted: &Sorted<S>, problem: &Problem<'_, S, P>, minimum: &Minimum<S>) -> Fit {
        // Written so that NaN does not fit.
        let fits = minimum.converged && minimum.chi2 <= self.gates[sorted.usable.len()];
        if !fits {
            Fit::None
        } else if sorted.faint.count() == 0 || self.is_dark_where_dark(sorted, problem, minimum) {
            Fit::Full
        } else {
            Fit::LitOnly
        }
    }

    /// Whether cells that were found without light are without light at the pose, too.
    #[cold]
    #[inline(never)]
    fn is_dark_where_dark(&self, sorted: &Sorted<S>, problem: &Problem<'_, S, P>, minimum: &Minimum<S>) -> bool {
        let predicted = problem.predicted(&minimum.pose);
        sorted.faint.iter().all(|cell| predicted[cell][0] + predicted[cell][1] < S::two() * self.limits[cell].faint_a)
    }

    /// The solution at a minimum whose linearisation is in `workspace`.
    pub(super) fn conclude(
        &self,
        sorted: &Sorted<S>,
        problem: &Problem<'_, S, P>,
        minimum: &Minimum<S>,
        workspace: &Workspace<S>,
        fit: Fit,
    ) -> Solution<S> {
        let redundancy = redundancy(sorted.usable.len());
        let mut solution = Solution {
            chi2: minimum.chi2,
            redundancy,
            iterations: minimum.iterations,
            factor: minimum.factor,
            ..Solution::without_pose(Outcome::Diverged, sorted.used)
        };
        let Some(factor) = &minimum.factor else {
            return solution;
        };
        let Some(covariance) = observability::covariance(factor, self.length_scale_m) else {
            let free = observability::free_directions(factor).unwrap_or_default();
            solution.outcome = Outcome::Unobservable(free);
            return solution;
        };
        if !minimum.pose.is_finite() {
            return solution;
        }
        let gate = self.gates[sorted.usable.len()];
        if P::TELLS_RELIABILITY {
            solution.unnoticed_sigmas = unnoticed_sigmas(gate, redundancy, problem.least_visible(factor, workspace));
        }
        solution.outcome = if fit == Fit::None {
            Outcome::Degraded(DegradedReason::Misfit)
        } else if sorted.usable.len() < self.plan.cell_count() {
            Outcome::Degraded(DegradedReason::FewerCells)
        } else {
            Outcome::Converged
        };
        solution.rigid = minimum.pose.to_rigid();
        solution.estimate = Some(Estimate { pose: solution.rigid.to_pose(), covariance });
        solution
    }

    /// The pose near `start` of a head that is not as its scene says: by coarse weights, under which gains and places that
    /// are off draw the pose less. χ² is by these weights.
    #[cold]
    #[inline(never)]
    pub(super) fn taken_roughly(
        &self,
        sorted: &Sorted<S>,
        problem: &Problem<'_, S, P>,
        start: Transform<S>,
        workspace: &mut Workspace<S>,
    ) -> Solution<S> {
        let whiteners = problem.coarse_whiteners();
        let minimum = problem.minimise(start, &whiteners, Stopping::near(), workspace);
        if !minimum.converged {
            return Solution::without_pose(Outcome::Diverged, sorted.used);
        }
        problem.linearise(&minimum.pose, &whiteners, workspace);
        self.conclude(sorted, problem, &minimum, workspace, Fit::None)
    }

    /// [`Self::conclude`] where the tool is expected and images are not looked for: one that is so near that
    /// the two are one minimum is.
    #[inline(always)]
    pub(super) fn conclude_near(
        &self,
        sorted: &Sorted<S>,
        problem: &Problem<'_, S, P>,
        whiteners: &Whiteners<S>,
        minimum: &Minimum<S>,
        workspace: &mut Workspace<S>,
        fit: Fit,
    ) -> Solution<S> {
        let mut solution = self.conclude(sorted, problem, minimum, workspace, fit);
        if self.has_images && fit != Fit::None {
            self.unless_soft(&mut solution, problem, whiteners, minimum, workspace);
        }
        solution
    }

    /// Leaves `solution` as it is if along its softest directions χ² grows as its covariance says; else an image is so
    /// near that the two are one minimum, and the data leave those directions free.
    #[inline(never)]
    pub(super) fn unless_soft(
        &self,
        solution: &mut Solution<S>,
        problem: &Problem<'_, S, P>,
        whiteners: &Whiteners<S>,
        minimum: &Minimum<S>,
        workspace: &mut Workspace<S>,
    ) {
        let is_free = matches!(solution.outcome, Outcome::Unobservable(_));
        let Some(factor) = minimum.factor.as_ref().filter(|_| is_free || solution.outcome.has_pose()) else {
            return;
        };
        let mut soft = ArrayVec::<[f64; 6], SOFT>::new();
        for (value, direction) in &factor.singular()[..SOFT] {
            let grows = |sign: f64, workspace: &mut Workspace<S>| {
                let far = direction.map(|element| element * (S::of(sign * DISTINCT_SIGMAS) / *value));
                let there = problem.linearise(&problem.moved(&minimum.pose, &far), whiteners, workspace);
                (S::of(ALIKE)..S::of(TOO_UNLIKE)).contains(&(there.chi2 - minimum.chi2))
            };
            if observability::is_free(*value) || !(grows(-1.0, workspace) && grows(1.0, workspace)) {
                soft.push(direction.map(S::as_f64));
            }
        }
        if !soft.is_empty() {
            solution.outcome = Outcome::Unobservable(Directions::of_free(&soft));
            solution.estimate = None;
        }
    }
}

/// Whether the best pose found is too far from the data to call it one.
pub(super) fn is_elsewhere<S: Number, P: Optics<S>>(problem: &Problem<'_, S, P>, minimum: &Minimum<S>) -> bool {
    let predicted = problem.predicted(&minimum.pose);
    !minimum.converged
        || problem.readings.iter().any(|reading| {
            let [first, second] = reading.pair;
            let [i_x1_a, i_x2_a] = predicted[reading.cell];
            let off = (first - i_x1_a).abs().max((second - i_x2_a).abs());
            off > S::of(ELSEWHERE) * (first + second)
        })
}

/// How far, in σ of the pose, an error can move it that leaves χ² as likely above its gate as below:
/// of an error of length e in σ of its cell, r·e² stays visible and (1 − r)·e² is in the pose.
pub(super) fn unnoticed_sigmas<S: Number>(gate: S, redundancy: usize, visible: S) -> S {
    // Of next to nothing, rounding is what is left.
    let negligible = S::of(1e-6).max(S::of(64.0) * S::epsilon());
    if redundancy == 0 || visible <= negligible {
        return S::infinity();
    }
    ((gate - S::of(redundancy as f64)) * (S::one() - visible) / visible).root()
}
