//! Cold starts: from the planes, from home, without a cell that lies, and from around.
//!
//! The first pose that the data fit is the one, unless it may have mirror images ([`super::images`]):
//! then those are looked for, the best counts, and where two fit alike there is no pose.

use arrayvec::ArrayVec;

use crate::pose::{Pose, Transform};
use crate::scalar::{Linear3, Scalar};

use super::images::{IMAGES, image};
use super::normal::{Problem, Whiteners, Workspace};
use super::outcome::{Directions, Outcome, Solution};
use super::outlier::{OutlierSearch, near};
use super::readings::{Photocurrents, Sorted};
use super::refine::{Ending, Refined};
use super::{
    COLD_LEFTOVER, DISTINCT_SIGMAS, Fit, MAX_ITERATIONS, MotionPrior, Solver, observability, redundancy, starts,
};

/// Evaluations of all cells that one cold solve may take: some 2 ms on a desktop core, by currents to
/// 1e-6 and derivatives.
pub(super) const COLD_WORK: usize = 600;

/// Cells below which mirror images are searched for on any head, unless the tool was followed to where
/// it is. With six lit cells none but the truth keeps all of them lit, if their planes fix a pose.
pub(super) const UNIQUE_FROM: usize = 6;

/// χ² by which a pose must be worse than the best to be out of the question: a likelihood ratio of
/// 1 : 22 000.
const ALIKE: f64 = 20.0;

/// Starts that must all have led to one place for a misfit there to be the answer.
const AGREEING: usize = 8;

/// Steps of a rough approach before it is given up.
const APPROACH_ITERATIONS: usize = 20;

/// Rough approaches that are remembered, so that none is refined twice.
const REMEMBERED: usize = 16;

/// Displacement, in σ of a rough approach, up to which two approaches have led to one place.
const SAME_SIGMAS: f64 = 0.3;

/// Directions, the softest first, along which χ² of a pose that may have images must grow as its
/// covariance says.
const SOFT: usize = 3;

/// χ² at a distance of [`DISTINCT_SIGMAS`], 36 by the covariance, from which on that says nothing: a pose
/// where a head is singular has σ as large as you like, and the currents bend long before.
const TOO_UNLIKE: f64 = 4.0 * DISTINCT_SIGMAS * DISTINCT_SIGMAS;

/// Share of the χ² that noise explains from which on a better fit is looked for beyond a kink of the currents:
/// one in 10⁴ honest scans of six cells has more.
const DOUBTED: f64 = 0.5;

/// Steps along the softest direction, both ways, each twice as long as the one before.
pub(super) const SOFT_STEPS: usize = 10;

/// The first of them, in radians or its equivalent in translation.
const SOFT_STEP: f64 = 0.03;

/// A residual this large a share of a cell's current is no misfit but another place. Gains that
/// calibration has not settled stay well below.
const ELSEWHERE: f64 = 0.1;

/// When a rough approach ends: it needs no more than its neighbourhood.
pub(super) fn approaching<S: Scalar>() -> Ending<S> {
    Ending { max_iterations: APPROACH_ITERATIONS, leftover: S::of(1e-2) }
}

/// When a refinement without a prior ends.
pub(super) fn closing<S: Scalar>() -> Ending<S> {
    Ending { max_iterations: MAX_ITERATIONS, leftover: S::of(COLD_LEFTOVER) }
}

/// How far a search for the pose has come: it may be spread over frames, each of which goes on where
/// the last has stopped, on its own currents.
#[derive(Clone, Copy, Debug)]
pub(super) struct Search<S: Scalar> {
    has_begun: bool,
    /// The next of [`Try`].
    next: usize,
    /// The best two poses so far, which are refined on the currents of the next frame first.
    found: [Option<Transform<S>>; 2],
    /// How far the next start was followed when the work was used up: where to, whether roughly, and
    /// in how many steps.
    under_way: Option<(Transform<S>, bool, usize)>,
    outlier: OutlierSearch<S>,
    /// Whether it goes on with another frame's currents when its work is used up; else it ends.
    may_pause: bool,
    is_over: bool,
}

impl<S: Scalar> Search<S> {
    /// One that has not begun, for the currents of one frame.
    pub(super) fn at_once() -> Self {
        Self {
            has_begun: false,
            next: 0,
            found: [None; 2],
            under_way: None,
            outlier: OutlierSearch::new(false),
            may_pause: false,
            is_over: false,
        }
    }

    /// One that has not begun, a piece a frame.
    pub(super) fn in_pieces() -> Self {
        Self { may_pause: true, outlier: OutlierSearch::new(true), ..Self::at_once() }
    }

    /// The two poses that make the answer of a search that is over ambiguous.
    pub(super) fn images(&self) -> Option<[Transform<S>; 2]> {
        match self.found {
            [Some(best), Some(rival)] if self.is_over => Some([best, rival]),
            _ => None,
        }
    }

    /// With what has been found and no answer yet.
    fn pause(&mut self, minima: &Minima<S>, solution: Solution<S>) -> Solution<S> {
        self.found = minima.places();
        solution
    }

    /// Whether nothing is left to be tried: what the last piece said is the answer.
    pub(super) fn is_over(&self) -> bool {
        self.is_over
    }
}

/// What a search tries, in this order.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Try {
    Home,
    /// Without each of the cells: at once, or, where images may lead astray, after all places for them.
    Exclusion {
        late: bool,
    },
    /// [`Solver::softened`] from the best pose so far.
    Soft(usize),
    /// [`image`] of the best pose so far.
    Image(usize),
    /// [`starts::around`].
    Around(usize),
    /// [`starts::spread`].
    Spread(usize),
}

impl Try {
    /// The first that is not to find images but a pose at all.
    const FURTHER: usize = 2 + SOFT_STEPS + IMAGES + starts::AROUND;

    fn of(index: usize) -> Option<Self> {
        const IMAGE: usize = 2 + SOFT_STEPS;
        const AROUND: usize = IMAGE + IMAGES;
        const SPREAD: usize = Try::FURTHER + 1;
        const END: usize = SPREAD + starts::SPREAD;
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

/// Where rough approaches have led.
struct Seen<S: Scalar> {
    places: ArrayVec<Transform<S>, REMEMBERED>,
    /// How many led to one that was known.
    again: usize,
}

impl<S: Scalar> Seen<S> {
    fn new() -> Self {
        Self { places: ArrayVec::new(), again: 0 }
    }

    /// Whether `approach` has led where another has before; it is remembered.
    fn has(&mut self, approach: &Refined<S>, arm: S) -> bool {
        let is_known = self.places.iter().any(|before| {
            approach.factor.as_ref().is_some_and(|factor| {
                observability::sigmas_between(factor, before, &approach.pose, arm) <= S::of(SAME_SIGMAS)
            })
        });
        if is_known {
            self.again += 1;
        } else {
            // One that does not fit only makes for more work.
            let _ = self.places.try_push(approach.pose);
        }
        is_known
    }
}

/// The best pose so far, and the best of those that are not the same.
#[derive(Clone, Copy, Debug)]
struct Minima<S: Scalar> {
    best: Option<(Refined<S>, Fit)>,
    rival: Option<(Refined<S>, Fit)>,
    arm: S,
}

impl<S: Scalar> Minima<S> {
    fn add(&mut self, refined: Refined<S>, fit: Fit) {
        let is_better = |other: &Option<(Refined<S>, Fit)>| {
            other.is_none_or(|(other, other_fit)| fit > other_fit || fit == other_fit && refined.chi2 < other.chi2)
        };
        let is_new = self.best.is_none_or(|(best, _)| are_distinct(&best, &refined, self.arm));
        if is_better(&self.best) {
            if is_new {
                self.rival = self.best;
            }
            self.best = Some((refined, fit));
        } else if is_new && is_better(&self.rival) {
            self.rival = Some((refined, fit));
        }
    }

    fn places(&self) -> [Option<Transform<S>>; 2] {
        [self.best, self.rival].map(|found| found.map(|(refined, _)| refined.pose))
    }

    /// Whether the data leave directions free at the best pose.
    fn is_singular(&self) -> bool {
        self.best.is_some_and(|(best, _)| best.factor.as_ref().is_none_or(observability::is_singular))
    }

    fn best_fit(&self) -> Fit {
        self.best.map_or(Fit::None, |(_, fit)| fit)
    }

    /// Whether two poses fit alike, and no third can be so much better that neither counts.
    fn are_alike(&self) -> bool {
        match (self.best, self.rival) {
            (Some((best, fit)), Some((rival, rival_fit))) => {
                fit != Fit::None && rival_fit == fit && rival.chi2 - best.chi2 < S::of(ALIKE)
            }
            _ => false,
        }
    }

    fn cannot_be_beaten(&self) -> bool {
        self.best.is_some_and(|(best, fit)| fit == Fit::Full && best.chi2 < S::of(ALIKE))
    }
}

impl<S: Scalar> Solver<S> {
    /// `search` on the currents of one frame, of at most `work` evaluations of all cells.
    pub(super) fn search_on(
        &self,
        readings: &Photocurrents,
        motion: &MotionPrior,
        search: &mut Search<S>,
        work: usize,
    ) -> Solution<S> {
        let sorted = Sorted::of(readings, &self.limits);
        let room = &mut Workspace::with_work(work);
        let solution = self.too_few(&sorted).unwrap_or_else(|| self.search(&sorted, motion, search, room));
        Solution { evaluations: room.evaluations, ..solution }
    }

    /// Two poses between which the currents of the frame before did not decide, on those of this one;
    /// `None` if these do.
    pub(super) fn still_images(
        &self,
        sorted: &Sorted<S>,
        motion: &MotionPrior,
        images: [Transform<S>; 2],
        room: &mut Workspace<S>,
    ) -> Option<[Transform<S>; 2]> {
        let problem = self.problem(sorted, motion);
        let whiteners = problem.whiteners();
        let mut minima = Minima { best: None, rival: None, arm: self.arm };
        for image in images {
            let refined = near(&problem, &whiteners, image, room);
            minima.add(refined, self.fit(sorted, &problem, &refined));
        }
        match minima.places() {
            [Some(a), Some(b)] if minima.are_alike() => Some([a, b]),
            _ => None,
        }
    }

    /// Goes on with `search` until it is over or the work in `room` is used up. A search that is not
    /// over has no pose yet.
    pub(super) fn search(
        &self,
        sorted: &Sorted<S>,
        motion: &MotionPrior,
        search: &mut Search<S>,
        room: &mut Workspace<S>,
    ) -> Solution<S> {
        let problem = &self.problem(sorted, motion);
        let whiteners = problem.whiteners();
        let may_have_images = self.has_images || sorted.usable.len() < UNIQUE_FROM;
        let on_planes = self.on_planes(sorted);
        let mut minima = Minima { best: None, rival: None, arm: self.arm };
        let mut iterations = 0;
        if !search.has_begun || !may_have_images {
            // What led nowhere in one frame may lead to it in another.
            let mut refined = problem.refine(on_planes, &whiteners, closing(), room);
            let gate = self.gates[sorted.usable.len()];
            if refined.converged && refined.chi2 <= gate {
                refined = problem.beyond_kink(refined, &whiteners, S::of(DOUBTED) * gate, room);
            }
            let fit = self.fit(sorted, problem, &refined);
            if fit == Fit::Full && !may_have_images {
                // By far the most frequent end, with the last expansion still at hand.
                search.is_over = true;
                return self.conclude(sorted, problem, &refined, room, fit);
            }
            iterations += refined.iterations;
            minima.add(refined, fit);
        }
        for before in search.found.into_iter().flatten().filter(|_| may_have_images) {
            let refined = problem.refine(before, &whiteners, closing(), room);
            iterations += refined.iterations;
            minima.add(refined, self.fit(sorted, problem, &refined));
        }
        search.has_begun = true;
        // Of three cells alone no pose will come of it.
        let unfinished = if is_unchecked(sorted) { Outcome::Ambiguous } else { Outcome::Diverged };
        let mut seen = Seen::new();
        while let Some(next) = Try::of(search.next).filter(|_| !self.is_enough(sorted, &minima, &seen, search.next)) {
            if room.work == 0 {
                if search.may_pause {
                    return search.pause(&minima, Solution { iterations, ..nothing(sorted, unfinished) });
                }
                break;
            }
            let fit = minima.best_fit();
            if next == (Try::Exclusion { late: self.has_images }) && fit == Fit::None {
                if let Some(solution) = self.without_outlier(sorted, motion, &mut search.outlier, room) {
                    search.is_over = true;
                    return Solution { iterations: iterations + solution.iterations, ..solution };
                }
                if search.outlier.is_paused() {
                    return search.pause(&minima, Solution { iterations, ..nothing(sorted, unfinished) });
                }
            }
            let start = search.under_way.take().or_else(|| {
                let best = minima.best.filter(|_| fit != Fit::None).map(|(best, _)| best);
                let (start, is_rough) = match next {
                    Try::Exclusion { .. } => None,
                    Try::Home => (fit == Fit::None).then(|| (Transform::of(&Pose::HOME), true)),
                    Try::Soft(index) => best.and_then(|best| self.softened(&best, index)).map(|start| (start, false)),
                    Try::Image(index) => best
                        .and_then(|best| image(&self.planes, &sorted.usable, &best.pose, self.arm, index))
                        .map(|start| (start, false)),
                    Try::Around(index) => Some((starts::around(&on_planes, index), true)),
                    // Without redundancy a rough approach leads past too many poses.
                    Try::Spread(index) => Some((starts::spread(index), redundancy(sorted.usable.len()) > 0)),
                }?;
                Some((start, is_rough, 0))
            });
            search.next += 1;
            let Some((start, is_rough, before)) = start else { continue };
            let ending = if is_rough { approaching() } else { closing() };
            let mut refined = if is_rough {
                problem.refine(start, &problem.coarse_whiteners(), ending, room)
            } else {
                problem.refine(start, &whiteners, ending, room)
            };
            iterations += refined.iterations;
            let steps = before + refined.iterations;
            if room.work == 0 && search.may_pause && !refined.converged && steps < ending.max_iterations {
                search.next -= 1;
                search.under_way = Some((refined.pose, is_rough, steps));
                continue;
            }
            if is_rough {
                if seen.has(&refined, self.arm) {
                    continue;
                }
                // By rough weights χ² is nowhere larger than by true ones: here nothing fits.
                if refined.converged && refined.chi2 > self.gates[sorted.usable.len()] && next != Try::Home {
                    continue;
                }
                refined = problem.refine(refined.pose, &whiteners, closing(), room);
                iterations += refined.iterations;
            }
            minima.add(refined, self.fit(sorted, problem, &refined));
        }
        search.is_over = true;
        let solution = self.judge(sorted, problem, &whiteners, &minima, room);
        search.found = if solution.outcome == Outcome::Ambiguous { minima.places() } else { [None; 2] };
        Solution { iterations, ..solution }
    }

    /// Whether nothing after [`Try`] `next` can change the answer.
    fn is_enough(&self, sorted: &Sorted<S>, minima: &Minima<S>, seen: &Seen<S>, next: usize) -> bool {
        let may_have_images = self.has_images || sorted.usable.len() < UNIQUE_FROM;
        match minima.best_fit() {
            Fit::None => seen.again >= AGREEING && (!may_have_images || next > Try::FURTHER),
            Fit::Full if !may_have_images || is_unchecked(sorted) => true,
            _ if minima.is_singular() => true,
            _ => minima.are_alike() && minima.cannot_be_beaten() || next >= Try::FURTHER,
        }
    }

    /// `refined` moved along the direction that its data hold least: one of [`SOFT_STEPS`].
    pub(super) fn softened(&self, refined: &Refined<S>, index: usize) -> Option<Transform<S>> {
        let (_, direction) = refined.factor.as_ref()?.singular()[0];
        let sign = if index.is_multiple_of(2) { 1.0 } else { -1.0 };
        let length = S::of(sign * SOFT_STEP * f64::from(1_u32 << (index / 2)));
        let [shift, turn] = [0, 3].map(|i| <S as Scalar>::Vec3::new(direction[i], direction[i + 1], direction[i + 2]));
        Some(refined.pose.moved(shift * (length * self.arm), turn * length))
    }

    /// What to tell of the poses that a search has found.
    fn judge(
        &self,
        sorted: &Sorted<S>,
        problem: &Problem<'_, S>,
        whiteners: &Whiteners<S>,
        minima: &Minima<S>,
        room: &mut Workspace<S>,
    ) -> Solution<S> {
        let Some((best, fit)) = minima.best else {
            return nothing(sorted, Outcome::Diverged);
        };
        // A misfit is shown only where redundancy tells it from a mirror image.
        let is_nowhere = fit == Fit::None && (sorted.usable.len() < UNIQUE_FROM || is_elsewhere(problem, &best));
        // A valley without an end fits as well: what the data leave free along it is told.
        let is_valley = fit == Fit::None && best.chi2 <= self.gates[sorted.usable.len()];
        if is_nowhere && !is_valley {
            return nothing(sorted, Outcome::Diverged);
        }
        let may_have_images = self.has_images || sorted.usable.len() < UNIQUE_FROM;
        if may_have_images
            && fit != Fit::None
            && !minima.is_singular()
            && (minima.are_alike()
                || is_unchecked(sorted)
                || fit == Fit::LitOnly && redundancy(sorted.usable.len()) == 0)
        {
            return nothing(sorted, Outcome::Ambiguous);
        }
        // The last expansion is another start's.
        problem.expand(&best.pose, whiteners, room);
        let solution = self.conclude(sorted, problem, &best, room, fit);
        if !may_have_images || fit == Fit::None && !is_valley {
            return solution;
        }
        let solution = self.unless_soft(solution, problem, whiteners, &best, room);
        if is_nowhere && solution.outcome.has_pose() { nothing(sorted, Outcome::Diverged) } else { solution }
    }

    /// [`Self::conclude`] where the tool is expected and images are not looked for: one that is so near that
    /// the two are one minimum is.
    pub(super) fn conclude_near(
        &self,
        sorted: &Sorted<S>,
        problem: &Problem<'_, S>,
        whiteners: &Whiteners<S>,
        refined: &Refined<S>,
        room: &mut Workspace<S>,
        fit: Fit,
    ) -> Solution<S> {
        let solution = self.conclude(sorted, problem, refined, room, fit);
        if self.has_images && fit != Fit::None {
            self.unless_soft(solution, problem, whiteners, refined, room)
        } else {
            solution
        }
    }

    /// `solution`, if along its softest directions χ² grows as its covariance says; else an image is so
    /// near that the two are one minimum, and the data leave those directions free.
    fn unless_soft(
        &self,
        mut solution: Solution<S>,
        problem: &Problem<'_, S>,
        whiteners: &Whiteners<S>,
        refined: &Refined<S>,
        room: &mut Workspace<S>,
    ) -> Solution<S> {
        let is_free = matches!(solution.outcome, Outcome::Unobservable(_));
        let Some(factor) = refined.factor.as_ref().filter(|_| is_free || solution.outcome.has_pose()) else {
            return solution;
        };
        let mut soft = ArrayVec::<[f64; 6], SOFT>::new();
        for (value, direction) in &factor.singular()[..SOFT] {
            let grows = |sign: f64, room: &mut Workspace<S>| {
                let far = direction.map(|element| element * (S::of(sign * DISTINCT_SIGMAS) / *value));
                let there = problem.expand(&problem.moved(&refined.pose, &far), whiteners, room);
                (S::of(ALIKE)..S::of(TOO_UNLIKE)).contains(&(there.chi2 - refined.chi2))
            };
            if observability::is_free(*value) || !(grows(-1.0, room) && grows(1.0, room)) {
                soft.push(direction.map(S::as_f64));
            }
        }
        if !soft.is_empty() {
            solution.outcome = Outcome::Unobservable(Directions::of_free(&soft));
            solution.estimate = None;
        }
        solution
    }
}

fn nothing<S: Scalar>(sorted: &Sorted<S>, outcome: Outcome) -> Solution<S> {
    Solution::without_pose(outcome, sorted.used)
}

/// Whether nothing tells a pose from its mirror images: neither redundancy, nor a cell without light.
/// Of three cells alone nearly every pose has one, and no search is sure to find it.
fn is_unchecked<S: Scalar>(sorted: &Sorted<S>) -> bool {
    redundancy(sorted.usable.len()) == 0 && sorted.faint.is_empty()
}

/// Whether two poses differ by more than the data of either allow.
pub(super) fn are_distinct<S: Scalar>(a: &Refined<S>, b: &Refined<S>, arm: S) -> bool {
    [a, b].iter().any(|by| {
        by.factor.as_ref().is_none_or(|factor| {
            let sigmas = observability::sigmas_between(factor, &a.pose, &b.pose, arm);
            sigmas.is_nan() || sigmas > S::of(DISTINCT_SIGMAS)
        })
    })
}

/// Whether the best pose found is too far from the data to call it one.
pub(super) fn is_elsewhere<S: Scalar>(problem: &Problem<'_, S>, refined: &Refined<S>) -> bool {
    let predicted = problem.predicted(&refined.pose);
    !refined.converged
        || problem.readings.iter().any(|reading| {
            let [first, second] = reading.pair;
            let [i_x1_a, i_x2_a] = predicted[reading.cell];
            let off = (first - i_x1_a).abs().max((second - i_x2_a).abs());
            off > S::of(ELSEWHERE) * (first + second)
        })
}
