//! The pose of a tool that may be anywhere: from the planes, from home, without an outlier, and from starts around.
//!
//! The first pose that fits the data is the answer, unless it may have mirror images ([`super::images`]):
//! then the search goes on for those, the best one counts, and where two fit alike the answer is ambiguous.

use crate::plan::Optics;
use crate::pose::Transform;
use crate::scalar::Number;

use super::accept::{Fit, ROUGH_WORK};
use super::compiled::Compiled;
use super::home::{STARTS_AROUND, STARTS_SPREAD, around, spread};
use super::images::{IMAGES, Minima, SOFT_STEPS, Seen, image, is_likely};
use super::levenberg_marquardt::Stopping;
use super::normal_equations::{Problem, Workspace};
use super::outcome::{Outcome, Solution};
use super::outlier::{MIN_WORK, OutlierSearch, exclude};
use super::readings::Sorted;
use super::twist::Prior;

/// Evaluations of all cells that one cold solve may take: some 2 ms on a desktop core, by currents to
/// 1e-6 and derivatives. Twice as many on a head with mirror images that has an outlier, too: without it the
/// search begins anew.
pub const COLD_WORK: usize = 600;

/// The same where poses may have mirror images: all places for them are looked at, which takes 500 in the mean.
pub const WORK_FOR_IMAGES: usize = 2 * COLD_WORK;

/// Evaluations after which a search in pieces ends, if there are no images to be found: of two cold solves, for each piece
/// begins with the planes again.
const MAX_WORK: usize = 2 * COLD_WORK;

/// Planes that fix a pose: of fewer each start leads to another place on them, and one place in vain says nothing of others.
const FIXING_PLANES: usize = 6;

/// Starts that must all have led to one place for a misfit there to be the answer.
const AGREEING: usize = 8;

/// Share of the χ² that noise explains from which on a better fit is looked for beyond a kink of the currents:
/// one in 30 honest scans of six cells has more.
pub const DOUBTED: f64 = 0.25;

/// How far a search for the pose has come: it may be spread over frames, each of which goes on where
/// the last has stopped, on its own currents.
#[derive(Clone, Copy, Debug)]
pub struct Search<S: Number> {
    has_begun: bool,
    /// The next of [`Try`].
    next: usize,
    /// The best two poses so far. Those that fit are refined on the currents of the next frame first; others,
    /// which take many steps, once nothing else is left to be tried.
    found: [Option<Transform<S>>; 2],
    fits: bool,
    /// How far the next start was followed when the work was used up: where to, whether roughly, and
    /// in how many steps.
    under_way: Option<(Transform<S>, bool, usize)>,
    outlier: OutlierSearch<S>,
    /// The cell that is an outlier: the search for mirror images of the pose without it.
    without: Option<usize>,
    /// Evaluations that its earlier pieces took.
    spent: usize,
    /// Whether it goes on with another frame's currents when its work is used up; else it ends.
    may_pause: bool,
    /// Whether nothing is left to be tried: what the last piece said is the answer.
    pub is_over: bool,
}

impl<S: Number> Search<S> {
    /// One that has not begun, for the currents of one frame.
    pub fn at_once() -> Self {
        Self {
            has_begun: false,
            next: 0,
            found: [None; 2],
            fits: false,
            under_way: None,
            outlier: OutlierSearch::new(false),
            without: None,
            spent: 0,
            may_pause: false,
            is_over: false,
        }
    }

    /// One that has not begun, a piece a frame.
    pub fn in_pieces() -> Self {
        Self { may_pause: true, outlier: OutlierSearch::new(true), ..Self::at_once() }
    }

    /// The two poses that make the answer of a search that is over ambiguous.
    pub fn images(&self) -> Option<[Transform<S>; 2]> {
        match self.found {
            [Some(best), Some(rival)] if self.is_over => Some([best, rival]),
            _ => None,
        }
    }

    /// With what has been found and no answer yet.
    fn pause(&mut self, minima: &Minima<S>, solution: Solution<S>) -> Solution<S> {
        if minima.best.is_some() {
            self.found = minima.places();
            self.fits = minima.best_fit() != Fit::None;
        }
        solution
    }

    pub fn has_begun(&self) -> bool {
        self.has_begun || self.without.is_some()
    }
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum Try {
    Home,
    /// Without each of the cells: at once, or, where images may lead astray, after all places for them.
    Exclusion {
        late: bool,
    },
    /// [`Compiled::softened`] from the best pose so far.
    Soft(usize),
    Image(usize),
    Around(usize),
    Spread(usize),
}

impl Try {
    /// The first that is not to find images but a pose at all.
    const FURTHER: usize = 2 + SOFT_STEPS + IMAGES + STARTS_AROUND;

    fn of(index: usize) -> Option<Self> {
        const IMAGE: usize = 2 + SOFT_STEPS;
        const AROUND: usize = IMAGE + IMAGES;
        const SPREAD: usize = Try::FURTHER + 1;
        const END: usize = SPREAD + STARTS_SPREAD;
        Some(match index {
            0 => Self::Home,
            1 => Self::Exclusion { late: false },
            2..IMAGE => Self::Soft(index - 2),
            IMAGE..AROUND => Self::Image(index - IMAGE),
            AROUND..Self::FURTHER => Self::Around(index - AROUND),
            Self::FURTHER => Self::Exclusion { late: true },
            SPREAD..END => Self::Spread(index - SPREAD),
            _ => return None,
        })
    }
}

impl<S: Number, P: Optics<S>> Compiled<S, P> {
    /// Two poses between which the currents of the frame before did not decide, on those of this one;
    /// `None` if these do.
    pub fn still_images(
        &self,
        sorted: &Sorted<S>,
        motion: &Prior<S>,
        images: [Transform<S>; 2],
        workspace: &mut Workspace<S>,
    ) -> Option<[Transform<S>; 2]> {
        let mut minima = Minima::new(self.length_scale_m);
        minima.add_near(images.map(Some), &self.problem(sorted, motion), Stopping::near(), workspace);
        match minima.places() {
            [Some(a), Some(b)] if minima.are_alike() => Some([a, b]),
            _ => None,
        }
    }

    /// Goes on with `search` until it is over or the work in `workspace` is used up. A search that is not
    /// over has no pose yet.
    pub fn search(
        &self,
        sorted: &Sorted<S>,
        motion: &Prior<S>,
        search: &mut Search<S>,
        workspace: &mut Workspace<S>,
    ) -> Solution<S> {
        if search.without.is_some() {
            return self.search_without(sorted, motion, search, workspace);
        }
        let solution = self.search_all(sorted, motion, search, workspace);
        let outlier = solution.excluded.iter().next().filter(|_| self.has_images);
        let (Some(cell), Some(estimate)) = (outlier, solution.estimate) else { return solution };
        // Among the others there may be an image that fits as well.
        let anew = if search.may_pause {
            Search::in_pieces()
        } else {
            workspace.work = workspace.work.max(COLD_WORK);
            Search::at_once()
        };
        let found = [Some(Transform::of(&estimate.pose)), None];
        *search = Search { found, fits: true, without: Some(cell), ..anew };
        let mut searched = self.search_without(sorted, motion, search, workspace);
        searched.iterations += solution.iterations;
        searched
    }

    /// [`Self::search`] for mirror images of the pose without the outlier.
    #[cold]
    #[inline(never)]
    fn search_without(
        &self,
        sorted: &Sorted<S>,
        motion: &Prior<S>,
        search: &mut Search<S>,
        workspace: &mut Workspace<S>,
    ) -> Solution<S> {
        let outlier = sorted.usable.iter().position(|reading| Some(reading.cell) == search.without);
        let Some(index) = outlier else {
            return self.search_all(sorted, motion, search, workspace);
        };
        let mut solution = self.search_all(&sorted.without(index), motion, search, workspace);
        exclude(&mut solution, sorted.usable[index].cell);
        solution
    }

    /// [`Self::search`], but the pose without an outlier is not yet told from its images.
    fn search_all(
        &self,
        sorted: &Sorted<S>,
        motion: &Prior<S>,
        search: &mut Search<S>,
        workspace: &mut Workspace<S>,
    ) -> Solution<S> {
        let problem = &self.problem(sorted, motion);
        let may_have_images = self.looks_for_images(sorted);
        let on_planes = self.on_planes(sorted);
        let mut minima = Minima::new(self.length_scale_m);
        let mut iterations = 0;
        // Half of a small piece does not suffice to leave out the next cell.
        let is_all_for_outlier = P::HAS_SMALL_FRAMES && search.outlier.is_paused && workspace.work / 2 < MIN_WORK;
        if !search.has_begun || !may_have_images && !is_all_for_outlier {
            // A start that fails on the currents of one frame may succeed on those of another.
            // It leaves half of a later piece to the starts that have not been tried yet.
            let held_back = if search.has_begun { workspace.work / 2 } else { 0 };
            workspace.work -= held_back;
            let mut minimum = problem.minimise(on_planes, Stopping::exact(), workspace);
            workspace.work += held_back;
            let gate = problem.gate();
            if minimum.converged && minimum.chi2 <= gate {
                minimum = problem.beyond_kink(minimum, S::of(DOUBTED) * gate, workspace);
            }
            let fit = problem.fit(&minimum);
            if fit == Fit::Full && is_likely(minimum.chi2, gate) && !may_have_images {
                // By far the most frequent end, with the last linearisation still at hand.
                search.is_over = true;
                return problem.conclude(&minimum, workspace, fit);
            }
            iterations += minimum.iterations;
            minima.add(minimum, fit);
        }
        if may_have_images && search.fits {
            iterations += minima.add_near(search.found, problem, Stopping::exact(), workspace);
        }
        search.has_begun = true;
        // Of three cells alone no pose will come of it.
        let outcome = if self.is_unchecked(sorted) { Outcome::Ambiguous } else { Outcome::Diverged };
        let unfinished = |iterations| Solution { iterations, ..nothing(sorted, outcome) };
        let mut seen = Seen::new();
        let mut is_cut_short = false;
        while let Some(next) =
            Try::of(search.next).filter(|_| !self.is_enough(sorted, problem.gate(), &minima, &seen, search.next))
        {
            if workspace.work == 0 {
                if search.may_pause && (may_have_images || search.spent < MAX_WORK) {
                    search.spent += workspace.evaluations;
                    return search.pause(&minima, unfinished(iterations));
                }
                is_cut_short = true;
                break;
            }
            let fit = minima.best_fit();
            if next == (Try::Exclusion { late: self.has_images }) && fit == Fit::None && search.without.is_none() {
                if let Some(solution) = self.without_outlier(sorted, motion, &mut search.outlier, workspace) {
                    search.is_over = true;
                    return Solution { iterations: iterations + solution.iterations, ..solution };
                }
                if search.outlier.is_paused {
                    return search.pause(&minima, unfinished(iterations));
                }
            }
            let start = search.under_way.take().or_else(|| {
                self.start_of(next, sorted, &minima, &on_planes).map(|(start, is_rough)| (start, is_rough, 0))
            });
            search.next += 1;
            let Some((start, is_rough, before)) = start else { continue };
            let gate = problem.gate();
            let stopping = match next {
                _ if is_rough && fit == Fit::None => Stopping::rough(),
                _ if is_rough => Stopping::rough().if_below(gate),
                Try::Soft(_) | Try::Image(_) => Stopping::image().if_below(gate),
                _ => Stopping::exact(),
            };
            let mut minimum = if is_rough {
                problem.coarse().minimise(start, stopping, workspace)
            } else {
                problem.minimise(start, stopping, workspace)
            };
            iterations += minimum.iterations;
            let steps = before + minimum.iterations;
            if workspace.work == 0 && search.may_pause && !minimum.converged && steps < stopping.max_iterations {
                search.next -= 1;
                search.under_way = Some((minimum.pose, is_rough, steps));
                continue;
            }
            if is_rough {
                if seen.has(&minimum, self.length_scale_m) {
                    continue;
                }
                // χ² by the true weights is no less: nothing fits here. Where a pose is known, what is still far after
                // so many steps is not followed any further: its image has other starts, too.
                let is_hopeless = minimum.converged || fit != Fit::None;
                if is_hopeless && minimum.chi2 > gate && next != Try::Home {
                    continue;
                }
                minimum = problem.minimise(minimum.pose, Stopping::exact(), workspace);
                iterations += minimum.iterations;
            }
            minima.add(minimum, problem.fit(&minimum));
        }
        if minima.best_fit() == Fit::None && may_have_images && !search.fits {
            if workspace.work == 0 && search.may_pause {
                return search.pause(&minima, unfinished(iterations));
            }
            iterations += minima.add_near(search.found, problem, Stopping::exact(), workspace);
        }
        search.is_over = true;
        let mut solution = self.judge(sorted, problem, &minima, &on_planes, workspace);
        if is_cut_short && self.has_images && solution.outcome.has_pose() && minima.best_fit() != Fit::None {
            // An image may fit as well, and was not looked for to the end.
            solution = nothing(sorted, Outcome::Ambiguous);
        }
        search.found = if solution.outcome == Outcome::Ambiguous { minima.places() } else { [None; 2] };
        Solution { iterations, ..solution }
    }

    /// Whether poses may have images that are worth the search.
    pub fn looks_for_images(&self, sorted: &Sorted<S>) -> bool {
        self.has_images || sorted.usable.len() < P::UNIQUE_FROM
    }

    /// Where `next` starts, and whether that takes a rough approach first; `None` if there is nothing to try.
    fn start_of(
        &self,
        next: Try,
        sorted: &Sorted<S>,
        minima: &Minima<S>,
        on_planes: &Transform<S>,
    ) -> Option<(Transform<S>, bool)> {
        let best = minima.best.filter(|(_, fit)| *fit != Fit::None).map(|(best, _)| best);
        match next {
            Try::Exclusion { .. } => None,
            Try::Home => best.is_none().then(|| (self.home.to_transform(), true)),
            Try::Soft(index) => Some((self.softened(&best?, index)?, false)),
            Try::Image(index) => {
                Some((image(&self.planes, &sorted.usable, &best?.pose, self.length_scale_m, index)?, false))
            }
            Try::Around(index) => {
                Some((self.near_data(sorted, around(&self.home.to_transform(), on_planes, index)), true))
            }
            // Without redundancy a rough approach leads past too many poses.
            Try::Spread(index) => {
                let start = self.near_data(sorted, spread(&self.home.to_transform(), index));
                Some((start, self.redundancy(sorted.usable.len()) > 0))
            }
        }
    }

    /// `start`, moved to where the emitters lie in the planes of their light, if these leave room.
    fn near_data(&self, sorted: &Sorted<S>, start: Transform<S>) -> Transform<S> {
        if sorted.usable.len() < FIXING_PLANES { self.onto_planes(sorted, start) } else { start }
    }

    /// Whether nothing tells a pose from its mirror images. Of three cells nearly every pose has some, and no search is sure
    /// to find them all; that another cell is dark at the pose, too, excludes few of them where emitters are narrow.
    fn is_unchecked(&self, sorted: &Sorted<S>) -> bool {
        self.redundancy(sorted.usable.len()) == 0
    }

    /// Whether nothing after [`Try`] `next` can change the answer.
    fn is_enough(&self, sorted: &Sorted<S>, gate: S, minima: &Minima<S>, seen: &Seen<S>, next: usize) -> bool {
        let may_have_images = self.looks_for_images(sorted);
        match minima.best_fit() {
            Fit::None if sorted.usable.len() < FIXING_PLANES => false,
            Fit::None => seen.again >= AGREEING && (!may_have_images || next > Try::FURTHER),
            Fit::Full if self.is_unchecked(sorted) || !may_have_images && minima.is_likely(gate) => true,
            _ if minima.is_singular() => true,
            _ => minima.are_alike() && minima.cannot_be_beaten() || next >= Try::FURTHER,
        }
    }

    /// The answer, by the minima that a search has found.
    fn judge(
        &self,
        sorted: &Sorted<S>,
        problem: &Problem<'_, S, P>,
        minima: &Minima<S>,
        on_planes: &Transform<S>,
        workspace: &mut Workspace<S>,
    ) -> Solution<S> {
        let Some((best, fit)) = minima.best else {
            return nothing(sorted, Outcome::Diverged);
        };
        // Fewer cells leave a mirror image that may be the pose; there, what fits nowhere has none.
        let is_nowhere = fit == Fit::None && (sorted.usable.len() < P::UNIQUE_FROM || problem.is_elsewhere(&best));
        // A valley without an end fits as well: what the data leave free along it is told.
        let is_valley = fit == Fit::None && best.chi2 <= problem.gate();
        if is_nowhere && !is_valley {
            if sorted.usable.len() < P::UNIQUE_FROM {
                return nothing(sorted, Outcome::Diverged);
            }
            workspace.work = workspace.work.max(ROUGH_WORK);
            return problem.taken_roughly(*on_planes, workspace);
        }
        let may_have_images = self.looks_for_images(sorted);
        if may_have_images
            && fit != Fit::None
            && !minima.is_singular()
            && (minima.are_alike() || self.is_unchecked(sorted))
        {
            return nothing(sorted, Outcome::Ambiguous);
        }
        // The last linearisation belongs to another start.
        problem.linearise(&best.pose, workspace);
        let mut solution = problem.conclude(&best, workspace, fit);
        if !may_have_images || fit == Fit::None && !is_valley {
            return solution;
        }
        problem.unless_soft(&mut solution, &best, workspace);
        if is_nowhere && solution.outcome.has_pose() { nothing(sorted, Outcome::Diverged) } else { solution }
    }
}

fn nothing<S: Number>(sorted: &Sorted<S>, outcome: Outcome) -> Solution<S> {
    Solution::without_pose(outcome, sorted.used)
}

#[cfg(test)]
mod tests {
    use super::super::fixture::{compiled, currents, pose};
    use super::*;

    #[test]
    fn everything_is_tried_once_and_an_outlier_before_and_after_the_images() {
        let tries: heapless::Vec<Try, 200> = (0..).map_while(Try::of).collect();
        assert_eq!(tries.len(), 3 + SOFT_STEPS + IMAGES + STARTS_AROUND + STARTS_SPREAD);
        for (i, one) in tries.iter().enumerate() {
            assert!(!tries[..i].contains(one), "{one:?}");
        }
        assert_eq!([tries[1], tries[Try::FURTHER]], [false, true].map(|late| Try::Exclusion { late }));
    }

    #[test]
    fn a_search_in_pieces_ends_at_the_pose_of_one_at_once() {
        let (head, truth) = (compiled(), pose());
        let mut readings = currents(&head.plan, &truth);
        // With the currents of cell 0 exchanged no start fits before the outlier is left out.
        if let crate::solve::Reading::Light(pair) = &mut readings.cells[0] {
            core::mem::swap(&mut pair.i_x1_a, &mut pair.i_x2_a);
        }
        let sorted = Sorted::of(&readings, &head.limits);
        let at_once = head.search(&sorted, &Prior::at_rest(), &mut Search::at_once(), &mut Workspace::new());
        assert!(at_once.excluded.contains(0), "{:?}", at_once.outcome);
        let (mut search, mut pieces) = (Search::in_pieces(), 0);
        let found = loop {
            pieces += 1;
            let workspace = &mut Workspace::with_work(30);
            let solution = head.search(&sorted, &Prior::at_rest(), &mut search, workspace);
            if search.is_over {
                break solution;
            }
            assert!(!solution.outcome.has_pose() && pieces < 100);
        };
        let (dt, dr) = found.estimate.expect("a pose").pose.displacement_from(&truth);
        assert!(
            pieces > 1 && found.excluded == at_once.excluded && dt.length() < 1e-10 && dr.length() < 1e-8,
            "{dt} {dr}"
        );
    }
}
