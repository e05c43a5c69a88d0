//! The pose near an expected one.

use crate::pose::Transform;
use crate::scalar::Scalar;

use super::accept::{Fit, is_elsewhere, redundancy};
use super::levenberg_marquardt::{Minimum, Stopping};
use super::normal_equations::{Problem, Whiteners, Workspace};
use super::outcome::{Outcome, Solution};
use super::readings::Sorted;
use super::solver::{MAX_ITERATIONS, MotionPrior, Solver};

/// Distance to the minimum that may remain, by a bound that is tens of times too cautious: a fiftieth of σ in
/// the median.
const TOLERANCE_SIGMAS: f64 = 0.8;

/// Evaluations within which a minimum near the expected pose is reached, but after a jump.
const QUICK: usize = 6;

impl<S: Scalar> Solver<S> {
    /// The pose near `start`, where the tool is expected: of all cells; without the one that was
    /// `left_out` in the frame before; without another; or a misfit.
    pub(super) fn follow(
        &self,
        sorted: &Sorted<S>,
        motion: &MotionPrior,
        start: Transform<S>,
        left_out: Option<usize>,
        workspace: &mut Workspace<S>,
    ) -> Solution<S> {
        let problem = self.problem(sorted, motion);
        if let Some(solution) = left_out.and_then(|cell| self.still_without(sorted, motion, cell, start, workspace)) {
            return solution;
        }
        let whiteners = problem.whiteners();
        let mut minimum = quickly(&problem, &whiteners, start, workspace);
        let fit = self.fit(sorted, &problem, &minimum);
        if fit != Fit::None {
            return self.conclude_near(sorted, &problem, &whiteners, &minimum, workspace, fit);
        }
        let mut iterations = minimum.iterations;
        if let Some(mut solution) = self.without_outlier_near(sorted, motion, start, workspace) {
            solution.iterations += iterations;
            return solution;
        }
        if !minimum.converged {
            minimum = near(&problem, &whiteners, minimum.pose, workspace);
            iterations += minimum.iterations;
        }
        let fit = self.fit(sorted, &problem, &minimum);
        let has_pose = fit != Fit::None || redundancy(sorted.usable.len()) > 0 && !is_elsewhere(&problem, &minimum);
        if !has_pose {
            return Solution { iterations, ..Solution::without_pose(Outcome::Diverged, sorted.used) };
        }
        // The last linearisation may be of other cells.
        problem.linearise(&minimum.pose, &whiteners, workspace);
        Solution { iterations, ..self.conclude_near(sorted, &problem, &whiteners, &minimum, workspace, fit) }
    }
}

/// A minimum of χ² near `start`.
pub(super) fn near<S: Scalar>(
    problem: &Problem<'_, S>,
    whiteners: &Whiteners<S>,
    start: Transform<S>,
    workspace: &mut Workspace<S>,
) -> Minimum<S> {
    let stopping = Stopping { max_iterations: MAX_ITERATIONS, tolerance_sigmas: S::of(TOLERANCE_SIGMAS) };
    problem.minimise(start, whiteners, stopping, workspace)
}

/// The same, given up when it takes long.
pub(super) fn quickly<S: Scalar>(
    problem: &Problem<'_, S>,
    whiteners: &Whiteners<S>,
    start: Transform<S>,
    workspace: &mut Workspace<S>,
) -> Minimum<S> {
    let held_back = workspace.work.saturating_sub(QUICK);
    workspace.work -= held_back;
    let minimum = near(problem, whiteners, start, workspace);
    workspace.work += held_back;
    minimum
}
