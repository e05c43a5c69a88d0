//! Cold starts: from the planes, from home, without an outlier, and from around.

use crate::pose::{Pose, Transform};
use crate::scalar::{Scalar, Vector3};

use super::normal::{Problem, Whiteners, Workspace};
use super::outcome::{Outcome, Solution};
use super::outlier::{OutlierSearch, near};
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

/// How far a search for the pose has come: it may be spread over frames, each of which goes on where
/// the last has stopped, on its own currents.
#[derive(Clone, Copy, Debug)]
pub(super) struct Search<S: Scalar> {
    /// The next of [`starts`].
    next: usize,
    /// The best pose so far, which is refined on the currents of the next frame first.
    best: Option<Transform<S>>,
    /// How far the next start was followed when the work was used up, in so many steps.
    under_way: Option<(Transform<S>, usize)>,
    outlier: OutlierSearch<S>,
    /// Two distinct poses that explained the currents alike.
    images: Option<[Transform<S>; 2]>,
    /// Whether it goes on with another frame's currents when its work is used up; else it ends.
    may_pause: bool,
    is_over: bool,
}

impl<S: Scalar> Search<S> {
    /// One that has not begun, for the currents of one frame.
    pub(super) fn at_once() -> Self {
        Self {
            next: 0,
            best: None,
            under_way: None,
            outlier: OutlierSearch::new(false),
            images: None,
            may_pause: false,
            is_over: false,
        }
    }

    /// One that has not begun, a piece a frame.
    pub(super) fn in_pieces() -> Self {
        Self { may_pause: true, outlier: OutlierSearch::new(true), ..Self::at_once() }
    }

    /// The two poses that make the answer ambiguous.
    pub(super) fn images(&self) -> Option<[Transform<S>; 2]> {
        self.images
    }

    /// Whether nothing is left to be tried: what the last piece said is the answer.
    pub(super) fn is_over(&self) -> bool {
        self.is_over
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
        let [a, b] = images.map(|image| {
            let refined = near(&problem, &whiteners, image, room);
            (refined, self.fit(sorted, &problem, &refined))
        });
        let is_between = a.1 != Fit::None
            && a.1 == b.1
            && a.0.factor.is_none_or(|factor| observability::distinct(&factor, &a.0.pose, &b.0.pose, self.arm));
        is_between.then_some([a.0.pose, b.0.pose])
    }

    /// Goes on with `search` until it is over or the work in `room` is used up: the pose on the planes
    /// first, then turned and shifted starts until the data fit. A search that is not over has no pose
    /// yet.
    pub(super) fn search(
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
        let paused = |search: &mut Search<S>, best: Option<(Refined<S>, Fit)>, iterations| {
            search.best = best.map(|(refined, _)| refined.pose);
            Solution { iterations, ..Solution::without_pose(Outcome::Diverged, sorted.used) }
        };
        for (tried, start) in starts(self.on_planes(sorted)).enumerate().skip(search.next) {
            if room.work == 0 && search.may_pause {
                return paused(search, best, iterations);
            }
            if room.work == 0 {
                break;
            }
            if tried == HONEST_STARTS && search.under_way.is_none() && best.is_none_or(|(_, fit)| fit == Fit::None) {
                if let Some(mut solution) = self.without_outlier(sorted, motion, &mut search.outlier, room) {
                    solution.iterations += iterations;
                    search.is_over = true;
                    return solution;
                }
                if search.outlier.is_paused() {
                    return paused(search, best, iterations);
                }
            }
            let (start, before) = search.under_way.take().unwrap_or((start, 0));
            let refined = descend(problem, &whiteners, start, tried > 0, room);
            iterations += refined.iterations;
            let steps = before + refined.iterations;
            if room.work == 0 && search.may_pause && !refined.converged && steps < MAX_ITERATIONS {
                search.under_way = Some((refined.pose, steps));
                return paused(search, best, iterations);
            }
            search.next = tried + 1;
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
                        search.images = Some([before.pose, refined.pose]);
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
}

/// A minimum of χ² reached from `start`; `far`: the start is no estimate but a guess.
pub(super) fn descend<S: Scalar>(
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
