//! An outlier: one cell that contradicts all others is found, left out, and used again once it agrees.
//!
//! Each cell in turn is left out, and the others are solved for. A cell is the outlier if χ² without it passes the
//! gate and is smaller than without any other cell by [`OUTLIER_THRESHOLD`]: a likelihood-ratio test of a mean shift
//! in one cell (Cook and Weisberg, Residuals and Influence in Regression, 1982, section 2.2).

use crate::plan::Optics;
use crate::pose::Transform;
use crate::scalar::Number;

use super::accept::Fit;
use super::compiled::Compiled;
use super::levenberg_marquardt::{Minimum, Stopping};
use super::normal_equations::{Problem, Workspace};
use super::outcome::{DegradedReason, Outcome, Solution};
use super::readings::Sorted;
use super::twist::Prior;

/// Least number of cells besides the outlier: with four, two redundancies leave too much that fits.
const MIN_CELLS: usize = 5;

/// χ² by which leaving out the outlier must beat leaving out any other cell: a likelihood ratio of
/// 1 : 22 000.
const OUTLIER_THRESHOLD: f64 = 20.0;

/// Multiple of the gate up to which a χ² by the linearised problem may still turn out to pass: where the other cells
/// fit, the linearisation errs by less.
const PROMISED_GATES: f64 = 4.0;

/// Evaluations that must be left for one more cell to be tried.
pub const MIN_WORK: usize = 8;

/// The cell that was left out of the last pose.
#[derive(Clone, Copy, Debug)]
pub struct LeftOut {
    pub cell: usize,
    /// Whether to look if it agrees with the others again.
    pub looks_again: bool,
}

/// How far the search for an outlier has come: see [`Compiled::without_outlier`].
#[derive(Clone, Copy, Debug)]
pub struct OutlierSearch<S: Number> {
    next: usize,
    /// The cell without which χ² is least so far, and where; and whether in an earlier frame.
    best: Option<(usize, Minimum<S>)>,
    is_stale: bool,
    runner_up: S,
    may_pause: bool,
    /// Whether cells are left to be tried.
    pub is_paused: bool,
    /// How far the next reading's exclusion has come when the work was used up.
    under_way: Option<UnderWay<S>>,
}

/// Where the others have led so far, and whether by the true weights.
#[derive(Clone, Copy, Debug)]
struct UnderWay<S: Number> {
    pose: Transform<S>,
    is_near: bool,
}

impl<S: Number> OutlierSearch<S> {
    /// One that has not begun; `may_pause`: it goes on with another frame's currents when the work of
    /// one is used up.
    pub fn new(may_pause: bool) -> Self {
        Self {
            next: 0,
            best: None,
            is_stale: false,
            runner_up: S::infinity(),
            may_pause,
            is_paused: false,
            under_way: None,
        }
    }

    /// Pauses before reading `index` is left out, or on the way.
    fn pause(&mut self, index: usize, under_way: Option<UnderWay<S>>) {
        (self.next, self.under_way, self.is_paused, self.is_stale) = (index, under_way, true, true);
    }

    /// Whether `minimum` is no end but a place to go on from: once, for where cells contradict each other without an
    /// outlier among them the way is long and leads nowhere.
    fn is_cut_short(&self, minimum: &Minimum<S>, is_continued: bool, workspace: &Workspace<S>) -> bool {
        self.may_pause && workspace.work == 0 && !minimum.converged && !is_continued
    }
}

impl<S: Number, P: Optics<S>> Compiled<S, P> {
    /// The pose of all cells but one, if leaving out that one, and no other, makes the data fit: from
    /// the planes of the others. Goes on with `search`, and stops where that is paused.
    pub fn without_outlier(
        &self,
        sorted: &Sorted<S>,
        motion: &Prior<S>,
        search: &mut OutlierSearch<S>,
        workspace: &mut Workspace<S>,
    ) -> Option<Solution<S>> {
        search.is_paused = false;
        if sorted.usable.len() <= MIN_CELLS {
            return None;
        }
        let mut iterations = 0;
        for index in search.next..sorted.usable.len() {
            if search.may_pause && workspace.work < MIN_WORK {
                search.pause(index, search.under_way);
                return None;
            }
            let others = sorted.without(index);
            let problem = self.problem(&others, motion);
            let before = search.under_way.take();
            let mut near = before.filter(|before| before.is_near).map(|before| before.pose);
            if near.is_none() {
                let start = before.map_or_else(|| self.on_planes(&others), |before| before.pose);
                let approach = problem.coarse().minimise(start, Stopping::rough(), workspace);
                iterations += approach.iterations;
                if P::HAS_SMALL_FRAMES && search.is_cut_short(&approach, before.is_some(), workspace) {
                    search.pause(index, Some(UnderWay { pose: approach.pose, is_near: false }));
                    return None;
                }
                // No coarse weight exceeds the true one, so χ² by the true ones is no less.
                if search.best.is_some_and(|(_, best)| approach.chi2 - best.chi2 >= S::of(OUTLIER_THRESHOLD)) {
                    search.runner_up = search.runner_up.min(approach.chi2);
                    continue;
                }
                near = Some(approach.pose);
            }
            let Some(start) = near else { continue };
            let minimum = problem.minimise(start, Stopping::exact(), workspace);
            iterations += minimum.iterations;
            if P::HAS_SMALL_FRAMES
                && search.is_cut_short(&minimum, before.is_some_and(|before| before.is_near), workspace)
            {
                search.pause(index, Some(UnderWay { pose: minimum.pose, is_near: true }));
                return None;
            }
            if !minimum.converged {
                continue;
            }
            let cell = sorted.usable[index].cell;
            match &search.best {
                Some((_, before)) if before.chi2 <= minimum.chi2 => {
                    search.runner_up = search.runner_up.min(minimum.chi2);
                }
                _ => {
                    search.runner_up = search.best.map_or(search.runner_up, |(_, before)| before.chi2);
                    search.best = Some((cell, minimum));
                }
            }
        }
        let (cell, mut found) = search.best?;
        if P::HAS_SMALL_FRAMES && search.may_pause && workspace.work < MIN_WORK {
            search.pause(sorted.usable.len(), None);
            return None;
        }
        let index = sorted.usable.iter().position(|reading| reading.cell == cell)?;
        if search.is_stale {
            let others = sorted.without(index);
            let problem = self.problem(&others, motion);
            found = problem.minimise(found.pose, Stopping::exact(), workspace);
        }
        let mut solution = self.unless_alone(sorted, motion, index, &found, search.runner_up, workspace)?;
        solution.iterations += iterations;
        Some(solution)
    }

    /// The pose near `start` of all cells but one, if leaving out that one, and no other, makes the data
    /// fit there. The normal equations of all cells at `start` rank the cells; only the first two are tried.
    pub fn without_outlier_near(
        &self,
        sorted: &Sorted<S>,
        motion: &Prior<S>,
        start: Transform<S>,
        workspace: &mut Workspace<S>,
    ) -> Option<Solution<S>> {
        if sorted.usable.len() <= MIN_CELLS {
            return None;
        }
        let all = self.problem(sorted, motion);
        all.linearise(&start, workspace);
        let mut ranked: [Option<(usize, S)>; 2] = [None; 2];
        for index in 0..sorted.usable.len() {
            let Some(chi2) = all.least_chi2_without(index, workspace) else { continue };
            if ranked[0].is_none_or(|(_, least)| chi2 < least) {
                ranked = [Some((index, chi2)), ranked[0]];
            } else if ranked[1].is_none_or(|(_, second)| chi2 < second) {
                ranked[1] = Some((index, chi2));
            }
        }
        // Where the linearised χ² is far above the noise, no step from there makes the others fit.
        let promised = |chi2: S| chi2 <= S::of(PROMISED_GATES) * self.gates[sorted.usable.len() - 1];
        let mut tried = ranked.map(|ranked| {
            let (index, _) = ranked.filter(|(_, chi2)| promised(*chi2))?;
            let others = sorted.without(index);
            let problem = self.problem(&others, motion);
            let minimum = problem.minimise_quickly(start, workspace);
            minimum.converged.then_some((index, minimum))
        });
        if let [Some((_, first)), Some((_, second))] = &tried
            && second.chi2 < first.chi2
        {
            tried.swap(0, 1);
            ranked.swap(0, 1);
        }
        let (index, found) = tried[0]?;
        let runner_up = match (&tried[1], &ranked[1]) {
            (Some((_, minimum)), _) => minimum.chi2,
            (None, Some((_, chi2))) if !promised(*chi2) => *chi2,
            _ => S::infinity(),
        };
        self.unless_alone(sorted, motion, index, &found, runner_up, workspace)
    }

    /// The pose near `start` without the cell that was left out in the frame before; with it, if it agrees with the others
    /// again.
    #[cold]
    #[inline(never)]
    pub fn still_without(
        &self,
        sorted: &Sorted<S>,
        motion: &Prior<S>,
        LeftOut { cell, looks_again }: LeftOut,
        start: Transform<S>,
        workspace: &mut Workspace<S>,
    ) -> Option<Solution<S>> {
        let index = sorted.usable.iter().position(|reading| reading.cell == cell)?;
        if sorted.usable.len() <= MIN_CELLS {
            return None;
        }
        let others = sorted.without(index);
        let problem = self.problem(&others, motion);
        let minimum = problem.minimise_quickly(start, workspace);
        let fit = problem.fit(&minimum);
        if fit == Fit::None {
            return None;
        }
        let mut solution = problem.conclude_near(&minimum, workspace, fit);
        if !looks_again {
            exclude(&mut solution, cell);
            return Some(solution);
        }
        let all = self.problem(sorted, motion);
        if all.may_agree(minimum.pose, workspace) {
            let together = all.minimise_quickly(minimum.pose, workspace);
            let fit = all.fit(&together);
            if fit != Fit::None {
                solution = all.conclude_near(&together, workspace, fit);
                solution.iterations += minimum.iterations;
                return Some(solution);
            }
        }
        exclude(&mut solution, cell);
        Some(solution)
    }

    /// Without reading `index` the pose is `found`: that, if the reading is convicted; or the pose of
    /// all, if a start as good as this makes them agree.
    fn unless_alone(
        &self,
        sorted: &Sorted<S>,
        motion: &Prior<S>,
        index: usize,
        found: &Minimum<S>,
        runner_up: S,
        workspace: &mut Workspace<S>,
    ) -> Option<Solution<S>> {
        let mut iterations = 0;
        let mut fit = Fit::None;
        let all = self.problem(sorted, motion);
        let mut together = *found;
        if all.may_agree(found.pose, workspace) {
            // Honest cells may have been led astray by their planes: with a good start they agree.
            together = all.minimise(found.pose, Stopping::exact(), workspace);
            iterations = together.iterations;
            fit = all.fit(&together);
        }
        let mut solution = if fit == Fit::None {
            let others = sorted.without(index);
            let problem = self.problem(&others, motion);
            let fit = problem.fit(found);
            let is_convicted = runner_up - found.chi2 >= S::of(OUTLIER_THRESHOLD);
            if fit == Fit::None || !is_convicted {
                return None;
            }
            problem.linearise(&found.pose, workspace);
            let mut solution = problem.conclude_near(found, workspace, fit);
            exclude(&mut solution, sorted.usable[index].cell);
            solution
        } else {
            all.conclude_near(&together, workspace, fit)
        };
        solution.iterations = iterations;
        Some(solution)
    }
}

impl<S: Number, P: Optics<S>> Problem<'_, S, P> {
    /// Whether all cells may agree near `pose`, by the linearised χ².
    fn may_agree(&self, pose: Transform<S>, workspace: &mut Workspace<S>) -> bool {
        let at = self.linearise(&pose, workspace);
        let promised = self.step(&at, S::zero(), workspace).map(|next| at.chi2 - next.predicted_reduction);
        promised.is_none_or(|chi2| chi2 <= S::of(PROMISED_GATES) * self.gate())
    }
}

pub fn exclude<S: Number>(solution: &mut Solution<S>, cell: usize) {
    solution.excluded.insert(cell);
    if solution.outcome.has_pose() {
        solution.outcome = Outcome::Degraded(DegradedReason::CellExcluded);
    }
}
