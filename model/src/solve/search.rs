//! Cold starts: from the planes, from home, without a cell that lies, and from around.

use crate::pose::{Pose, Transform};
use crate::scalar::{Scalar, Vector3};

use super::normal::{Problem, Whiteners, Workspace};
use super::outcome::{Outcome, Solution, Weakness};
use super::readings::{Photocurrents, Sorted};
use super::refine::{Ending, Refined};
use super::{COLD_LEFTOVER, Fit, MAX_ITERATIONS, MotionPrior, Solver, observability, redundancy};

/// Cells below which mirror images are searched for, unless the tool was followed to where it is.
/// With six lit cells none but the truth keeps all of them lit.
const UNIQUE_FROM: usize = 6;

/// Evaluations of all cells that one cold solve may take: some 2 ms on a desktop core, one or two µs
/// each.
pub(super) const COLD_WORK: usize = 1000;

/// Starts after which mirror images count as searched for; with no redundancy, where every image fits
/// as well as the truth, only all starts do.
const IMAGE_STARTS: usize = 25;

/// Further starts, spread over the reach of a head, for data that nothing has fitted.
const SPREAD_STARTS: usize = 48;

/// Starts before a lying cell is looked for: the planes and home.
const HONEST_STARTS: usize = 2;

/// How far the further starts of the search lie apart: half the reach of a head.
const SEARCH_ROTATION_RAD: f64 = 0.3;
const SEARCH_TRANSLATION_M: f64 = 3e-3;

/// A residual this large a share of a cell's current is no misfit but another place. Gains that
/// calibration has not settled stay well below.
const ELSEWHERE: f64 = 0.1;

/// Cells that must be left to tell which cell lies: with four, two redundancies fit too much.
const WITNESSES: usize = 5;

/// χ² by which leaving out the liar must beat leaving out any other cell: a likelihood ratio of
/// 1 : 22 000.
const CONVICTION: f64 = 20.0;

/// How far a search for the pose has come: it may be spread over frames, each of which goes on where
/// the last has stopped, on its own currents.
#[derive(Clone, Copy, Debug)]
pub(super) struct Search<S: Scalar> {
    /// The next of [`starts`].
    next: usize,
    /// The best pose so far, which is refined on the currents of the next frame first.
    best: Option<Transform<S>>,
    /// Whether it goes on with another frame's currents when its work is used up; else it ends.
    may_pause: bool,
    is_over: bool,
}

impl<S: Scalar> Search<S> {
    /// One that has not begun, for the currents of one frame.
    pub(super) fn at_once() -> Self {
        Self { next: 0, best: None, may_pause: false, is_over: false }
    }

    /// One that has not begun, a piece a frame.
    pub(super) fn in_pieces() -> Self {
        Self { may_pause: true, ..Self::at_once() }
    }

    /// Whether nothing is left to be tried: what the last piece said is the answer.
    pub(super) fn is_over(&self) -> bool {
        self.is_over
    }
}

impl<S: Scalar> Solver<S> {
    /// A piece of `search` on the currents of one frame, of at most `work` evaluations of all cells.
    pub(super) fn search_on(
        &self,
        readings: &Photocurrents,
        motion: &MotionPrior,
        search: &mut Search<S>,
        work: usize,
    ) -> Solution<S> {
        let sorted = Sorted::of(readings, &self.limits);
        self.too_few(&sorted).unwrap_or_else(|| self.search(&sorted, motion, search, &mut Workspace::with_work(work)))
    }

    /// Goes on with `search` until it is over or the work in `room` is used up: the pose on the planes
    /// first, then turned and shifted starts until the data fit. A search that is not over has no pose
    /// yet.
    fn search(
        &self,
        sorted: &Sorted<S>,
        motion: &MotionPrior,
        search: &mut Search<S>,
        room: &mut Workspace<S>,
    ) -> Solution<S> {
        let problem = &self.problem(sorted, motion);
        let whiteners = problem.whiteners();
        let mut iterations = 0;
        let mut best: Option<(Refined<S>, Fit)> = None;
        let need_all = sorted.usable.len() < UNIQUE_FROM;
        if search.next > 0 {
            // The tool has moved on; and planes that led nowhere in one frame may lead to it in another.
            let before = search.best.filter(|_| need_all).unwrap_or_else(|| self.on_planes(sorted));
            let refined = descend(problem, &whiteners, before, false, room);
            iterations += refined.iterations;
            let fit = self.fit(sorted, problem, &refined);
            if fit == Fit::Full && !need_all {
                search.is_over = true;
                return Solution { iterations, ..self.conclude(sorted, problem, &refined, room, fit) };
            }
            best = Some((refined, fit));
        }
        for (tried, start) in starts(self.on_planes(sorted)).enumerate().skip(search.next) {
            if room.work == 0 && search.may_pause {
                search.best = best.map(|(refined, _)| refined.pose);
                return Solution { iterations, ..Solution::without_pose(Outcome::Diverged, sorted.used) };
            }
            if room.work == 0 {
                break;
            }
            search.next = tried + 1;
            if tried == HONEST_STARTS
                && best.is_none_or(|(_, fit)| fit == Fit::None)
                && let Some(mut solution) = self.without_liar(sorted, motion, None, room)
            {
                solution.iterations += iterations;
                search.is_over = true;
                return solution;
            }
            let refined = descend(problem, &whiteners, start, tried > 0, room);
            iterations += refined.iterations;
            let fit = self.fit(sorted, problem, &refined);
            // By far the most frequent end, with the last expansion still at hand.
            if tried == 0 && fit == Fit::Full && !need_all {
                search.is_over = true;
                return self.conclude(sorted, problem, &refined, room, fit);
            }
            match &best {
                Some((before, Fit::Full)) if fit == Fit::Full => {
                    let distinct = before
                        .factor
                        .as_ref()
                        .is_none_or(|factor| observability::distinct(factor, &before.pose, &refined.pose, self.arm));
                    if distinct {
                        search.is_over = true;
                        return Solution { iterations, ..Solution::without_pose(Outcome::Ambiguous, sorted.used) };
                    }
                }
                Some((before, best_fit)) if (fit, before.chi2) > (*best_fit, refined.chi2) => {
                    best = Some((refined, fit));
                }
                None => best = Some((refined, fit)),
                Some(_) => {}
            }
            let observable = || refined.factor.is_some_and(|factor| observability::free_directions(&factor).is_none());
            let searched = tried >= IMAGE_STARTS
                && redundancy(sorted.usable.len()) > 0
                && best.is_some_and(|(_, fit)| fit == Fit::Full);
            if searched || fit == Fit::Full && (!need_all || !observable()) {
                break;
            }
        }
        search.is_over = true;
        let shown = best.filter(|(refined, fit)| match fit {
            Fit::Full => true,
            // The cells with light agree on a pose where others should see some, too: those fail.
            Fit::LitOnly => redundancy(sorted.usable.len()) > 0,
            // A misfit is shown only where redundancy tells it from a mirror image.
            Fit::None => !need_all && !is_elsewhere(problem, refined),
        });
        let mut solution = match shown {
            Some((refined, fit)) => {
                // The last expansion is another start's.
                problem.expand(&refined.pose, &whiteners, room);
                self.conclude(sorted, problem, &refined, room, fit)
            }
            None => Solution::without_pose(Outcome::Diverged, sorted.used),
        };
        solution.iterations = iterations;
        solution
    }

    /// The pose of all cells but one, if leaving out that one, and no other, makes the data fit:
    /// near `start`, or on the planes of the others.
    pub(super) fn without_liar(
        &self,
        sorted: &Sorted<S>,
        motion: &MotionPrior,
        start: Option<Transform<S>>,
        room: &mut Workspace<S>,
    ) -> Option<Solution<S>> {
        if sorted.usable.len() <= WITNESSES {
            return None;
        }
        let mut iterations = 0;
        let mut best: Option<(usize, Refined<S>)> = None;
        let mut runner_up = S::infinity();
        for index in 0..sorted.usable.len() {
            let others = sorted.without(index);
            let problem = self.problem(&others, motion);
            let start = start.unwrap_or_else(|| self.on_planes(&others));
            let refined = descend(&problem, &problem.whiteners(), start, false, room);
            iterations += refined.iterations;
            if !refined.converged {
                continue;
            }
            match &best {
                Some((_, before)) if before.chi2 <= refined.chi2 => runner_up = runner_up.min(refined.chi2),
                _ => {
                    runner_up = best.map_or(runner_up, |(_, before)| before.chi2);
                    best = Some((index, refined));
                }
            }
        }
        let (index, found) = best?;
        // Honest cells may have been led astray by their planes: with a good start they agree.
        let all = self.problem(sorted, motion);
        let whiteners = all.whiteners();
        let together = descend(&all, &whiteners, found.pose, false, room);
        iterations += together.iterations;
        let fit = self.fit(sorted, &all, &together);
        let mut solution = if fit == Fit::None {
            let others = sorted.without(index);
            let problem = self.problem(&others, motion);
            let fit = self.fit(&others, &problem, &found);
            let convicted = runner_up - found.chi2 >= S::of(CONVICTION);
            if fit == Fit::None || !convicted {
                return None;
            }
            problem.expand(&found.pose, &problem.whiteners(), room);
            let mut solution = self.conclude(&others, &problem, &found, room, fit);
            solution.excluded.insert(sorted.usable[index].cell);
            if solution.outcome.has_pose() {
                solution.outcome = Outcome::Degraded(Weakness::CellExcluded);
            }
            solution
        } else {
            self.conclude(sorted, &all, &together, room, fit)
        };
        solution.iterations = iterations;
        Some(solution)
    }
}

/// A minimum of χ² reached from `start`; `far`: the start is no estimate but a guess.
fn descend<S: Scalar>(
    problem: &Problem<'_, S>,
    whiteners: &Whiteners<S>,
    start: Transform<S>,
    far: bool,
    room: &mut Workspace<S>,
) -> Refined<S> {
    let ending = Ending { max_iterations: MAX_ITERATIONS, leftover: S::of(COLD_LEFTOVER) };
    let (start, before) = if far {
        // A rough approach needs no more than its neighbourhood.
        let near = Ending { leftover: S::of(1e-2), ..ending };
        let approach = problem.refine(start, &problem.coarse_whiteners(), near, room);
        (approach.pose, approach.iterations)
    } else {
        (start, 0)
    };
    let refined = problem.refine(start, whiteners, ending, room);
    Refined { iterations: before + refined.iterations, ..refined }
}

/// Whether the best pose found is too far from the data to call it one.
fn is_elsewhere<S: Scalar>(problem: &Problem<'_, S>, refined: &Refined<S>) -> bool {
    let predicted = problem.predicted(&refined.pose);
    !refined.converged
        || problem.readings.iter().any(|reading| {
            let [first, second] = reading.pair;
            let [i_x1_a, i_x2_a] = predicted[reading.cell];
            let off = (first - i_x1_a).abs().max((second - i_x2_a).abs());
            off > S::of(ELSEWHERE) * (first + second)
        })
}

/// The pose on the planes; then, where clipped spots have led the planes astray, home and its
/// surroundings; then the surroundings of the pose on the planes.
fn starts<S: Scalar>(on_planes: Transform<S>) -> impl Iterator<Item = Transform<S>> {
    let vector = |v: glam::DVec3| <S as Scalar>::Vec3::of(v);
    // A turn about one axis and a shift along the next, both ways.
    let around = move |i: usize| {
        let mut turn = [0.0; 3];
        let mut shift = [0.0; 3];
        let sign = if i.is_multiple_of(2) { 1.0 } else { -1.0 };
        turn[i / 2 % 3] = sign * SEARCH_ROTATION_RAD;
        shift[(i / 2 + 1) % 3] = sign * SEARCH_TRANSLATION_M * if i < 6 { 1.0 } else { -1.0 };
        (vector(shift.into()), vector(turn.into()))
    };
    let home = Transform::of(&Pose::HOME);
    let of = move |centre: Transform<S>| {
        (0..12).map(move |i| {
            let (shift, turn) = around(i);
            centre.moved(shift, turn)
        })
    };
    // The generalised golden ratio in six dimensions fills a box evenly (Roberts 2018): powers of
    // the inverse of the root of x⁷ = x + 1.
    let spread = (1..=SPREAD_STARTS).map(move |n| {
        let mut share = 1.0;
        let coordinates: [f64; 6] = core::array::from_fn(|_| {
            share *= 0.898_653_712_628_699;
            let position = n as f64 * share;
            2.0 * (position - libm::floor(position)) - 1.0
        });
        let [tx, ty, tz, rx, ry, rz] = coordinates;
        let (shift, turn) = (glam::DVec3::new(tx, ty, tz), glam::DVec3::new(rx, ry, rz));
        home.moved(vector(shift * 4.0 / 3.0 * SEARCH_TRANSLATION_M), vector(turn * SEARCH_ROTATION_RAD))
    });
    [on_planes, home].into_iter().chain(of(home)).chain(of(on_planes)).chain(spread)
}
