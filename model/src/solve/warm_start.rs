//! The pose near an expected one.

use crate::plan::Optics;
use crate::pose::Transform;
use crate::scalar::Number;

use super::accept::Fit;
use super::compiled::Compiled;
use super::levenberg_marquardt::{Minimum, Stopping};
use super::normal_equations::Workspace;
use super::outcome::{Outcome, Solution};
use super::outlier::LeftOut;
use super::readings::Sorted;
use super::twist::Prior;

/// Evaluations that are left to [`Compiled::taken_roughly`], which takes some five near an expected pose.
const ROUGH_STEPS: usize = 12;

impl<S: Number, P: Optics<S>> Compiled<S, P> {
    /// The pose near `start`, where the tool is expected: of all cells; without the one that was
    /// `left_out` in the frame before; without another; or a misfit.
    pub fn follow(
        &self,
        sorted: &Sorted<S>,
        motion: &Prior<S>,
        start: Transform<S>,
        left_out: Option<LeftOut>,
        workspace: &mut Workspace<S>,
    ) -> Solution<S> {
        self.follow_agreeing(sorted, motion, start, left_out, workspace, |minimum, workspace| {
            self.follow_misfit(sorted, motion, start, minimum, workspace)
        })
    }

    /// The pose near `start` if all cells agree on it, or all but the one that was `left_out` in the frame before. Else
    /// what `otherwise` makes of the minimum of χ².
    #[inline(always)]
    pub fn follow_agreeing(
        &self,
        sorted: &Sorted<S>,
        motion: &Prior<S>,
        start: Transform<S>,
        left_out: Option<LeftOut>,
        workspace: &mut Workspace<S>,
        otherwise: impl FnOnce(&Minimum<S>, &mut Workspace<S>) -> Solution<S>,
    ) -> Solution<S> {
        if let Some(solution) = left_out.and_then(|cell| self.still_without(sorted, motion, cell, start, workspace)) {
            return solution;
        }
        let problem = self.problem(sorted, motion);
        let minimum = problem.minimise_quickly(start, workspace);
        let fit = problem.fit(&minimum);
        if fit != Fit::None {
            return problem.conclude_near(&minimum, workspace, fit);
        }
        otherwise(&minimum, workspace)
    }

    /// The pose near `start` where not all cells agree at the `minimum` of χ²: of all cells but one; or at the minimum
    /// of a longer descent, agreeing or not.
    #[cold]
    #[inline(never)]
    fn follow_misfit(
        &self,
        sorted: &Sorted<S>,
        motion: &Prior<S>,
        start: Transform<S>,
        minimum: &Minimum<S>,
        workspace: &mut Workspace<S>,
    ) -> Solution<S> {
        let mut iterations = minimum.iterations;
        if let Some(solution) = self.without_outlier_near(sorted, motion, start, workspace) {
            return Solution { iterations: iterations + solution.iterations, ..solution };
        }
        let problem = self.problem(sorted, motion);
        let mut minimum = *minimum;
        if !minimum.converged {
            let held_back = workspace.work.min(ROUGH_STEPS);
            workspace.work -= held_back;
            minimum = problem.minimise(minimum.pose, Stopping::near(), workspace);
            workspace.work += held_back;
            iterations += minimum.iterations;
        }
        let fit = problem.fit(&minimum);
        let has_pose = fit != Fit::None || self.redundancy(sorted.usable.len()) > 0 && !problem.is_elsewhere(&minimum);
        if !has_pose {
            if sorted.usable.len() >= P::UNIQUE_FROM {
                let solution = problem.taken_roughly(start, workspace);
                return Solution { iterations: iterations + solution.iterations, ..solution };
            }
            return Solution { iterations, ..Solution::without_pose(Outcome::Diverged, sorted.used) };
        }
        // The last linearisation may be of other cells.
        problem.linearise(&minimum.pose, workspace);
        Solution { iterations, ..problem.conclude_near(&minimum, workspace, fit) }
    }
}
