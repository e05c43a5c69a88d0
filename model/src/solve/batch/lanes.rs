//! The common course of a solve, a frame per lane.
//!
//! Each step here is the one of the same name in a single solve; the decisions between them become comparisons lane by
//! lane. A lane that has come to its end, or has left, goes on at the pose where it is: it computes the same again,
//! and nothing of it counts.

use arrayvec::ArrayVec;

use crate::lanes::{set, zero_half_one};
use crate::pose::Transform;
use crate::rectangle::MAX_MAGNIFICATION;
use crate::scalar::{Linear3, Real};
use crate::scene::MAX_CELLS;

use super::super::accept::DISTINCT_SIGMAS;
use super::super::accept::{EVEN, MAX_SIGMA};
use super::super::algebra::{Factor, Matrix6, Vector6, add_outer, dot, square};
use super::super::compiled::Compiled;
use super::super::level::Level;
use super::super::levenberg_marquardt::{MAX_SECOND_STEP, PATIENCE, REUSABLE_CHANGE, Stopping};
use super::super::planes::{self, PULL, STEP_M};
use super::super::step::SAFE_ROUNDINGS;
use super::super::weights::Whitener;
use super::super::weights::{ResidualSums, Row};
use super::minimum::{Frames, Minima};

/// Steps with derivatives that a frame of the common course takes at most: no more than six evaluations, to which the
/// descent to an expected pose is limited, and no more than [`PATIENCE`].
const MAX_ROUNDS: usize = 3;

/// σ of the pose up to which a single solve looks for kinks, and a little for the rounding of how far that is.
const REACH: f64 = 1.001 * DISTINCT_SIGMAS;

const _: () = assert!(2 * MAX_ROUNDS <= PATIENCE, "two iterations a round");

/// Where a solve starts, and what ends it.
#[derive(Clone, Copy, Debug)]
pub struct Course {
    pub is_cold: bool,
    pub stopping: Stopping<f64>,
    /// χ² above which a single solve would look further.
    pub most_chi2: f64,
    /// χ² above which it would look beyond kinks, if it ever does.
    pub doubted_chi2: Option<f64>,
}

/// What is measured of a cell, and its weight.
#[derive(Clone, Copy)]
struct Measured<R> {
    pair: [R; 2],
    whitener: Whitener<R>,
}

/// The last linearisation.
struct Linearised<R> {
    rows: ArrayVec<[Row<R>; 2], MAX_CELLS>,
    slacks_m: ArrayVec<R, MAX_CELLS>,
    information: Matrix6<R>,
    sums: ResidualSums<R>,
    /// `None`: the light level is known.
    level: Option<Level<R>>,
    /// The diagonal of the information that went with the light level.
    level_part: Vector6<R>,
    /// One where all cells have a spot and the information has digits enough, else zero.
    is_sound: R,
}

impl<R: Real> Linearised<R> {
    #[inline(always)]
    fn nowhere(zero: R) -> Self {
        let (information, sums) = ([[zero; 6]; 6], ResidualSums::zero(zero));
        Self {
            rows: ArrayVec::new(),
            slacks_m: ArrayVec::new(),
            information,
            sums,
            level: None,
            level_part: [zero; 6],
            is_sound: zero,
        }
    }
}

/// Numbers that lanes are given and keep: one for yes, zero for no.
#[inline(always)]
fn both<R: Real>(a: R, b: R) -> R {
    a * b
}

#[inline(always)]
fn not<R: Real>(a: R) -> R {
    a.constant(1.0) - a
}

#[inline(always)]
fn any<R: Real>(a: R) -> bool {
    R::any_above(a, a.constant(0.0))
}

/// `yes` where `choice` is one, `no` where it is zero.
#[inline(always)]
fn choose<R: Real>(choice: R, yes: R, no: R) -> R {
    R::select_gt(choice, choice.constant(0.0), yes, no)
}

#[inline(always)]
fn choose_pose<R: Real>(choice: R, yes: &Transform<R>, no: &Transform<R>) -> Transform<R> {
    Transform::select_gt(choice, choice.constant(0.0), yes, no)
}

/// Is a ≤ b? Not where one is NaN.
#[inline(always)]
fn at_most<R: Real>(a: R, b: R) -> R {
    R::select_ge(b, a, a.constant(1.0), a.constant(0.0))
}

/// Is a > b? Not where one is NaN.
#[inline(always)]
fn above<R: Real>(a: R, b: R) -> R {
    R::select_gt(a, b, a.constant(1.0), a.constant(0.0))
}

/// Follows `frames` along `course` in lanes like `like`, and stores what is found. `EXACT`: the head's plan is of the exact
/// tier.
#[inline(always)]
pub fn minimise<R: Real<Element = f64>, const EXACT: bool>(
    head: &Compiled<f64>,
    frames: &Frames,
    course: Course,
    like: R,
    minima: &mut Minima,
) {
    let [zero, _, one] = zero_half_one(like);
    let mut stays = frames.presence(like);
    let mut measured = ArrayVec::<Measured<R>, MAX_CELLS>::new();
    for (cell, noise) in head.noise.iter().enumerate() {
        let pair = frames.pair(cell, like);
        measured.push(Measured { pair, whitener: noise.whitener(pair) });
    }
    let mut pose = frames.start(like);
    if course.is_cold {
        pose = on_planes(head, &measured, pose, &mut stays);
    }
    let (change_rate, scale) = (like.splat(head.jacobian_change_rate), like.splat(head.length_scale_m));
    let tolerance = like.splat(course.stopping.tolerance_sigmas);
    let mut active = stays;
    // χ² that the next linearisation must be below: infinite if it need not.
    let mut before = like.constant(f64::INFINITY);
    let (mut iterations, mut evaluations) = (zero, zero);
    let (mut end, mut end_chi2) = (pose, zero);
    let mut linearised = Linearised::nowhere(zero);
    for round in 1.. {
        linearise::<R, EXACT>(head, &measured, &pose, &mut linearised);
        let Linearised { information, sums, is_sound, .. } = &linearised;
        evaluations += active;
        stays = both(stays, choose(active, both(*is_sound, above(before, sums.chi2)), one));
        let mut is_safe = one;
        let threshold = like.constant(SAFE_ROUNDINGS * f64::EPSILON);
        let factor = factor_of(information, threshold, &mut is_safe);
        let half_way = factor.forward(&sums.by_pose);
        let (step, reduction) = (factor.backward(&half_way), square(&half_way));
        iterations += active;

        let length = square(&step).root();
        stays = both(stays, both(is_safe, at_most(length, like.constant(f64::MAX))));
        active = both(active, stays);
        let jacobian_change = change_rate * length;
        let mut steepness = zero;
        for (i, row) in information.iter().enumerate() {
            steepness = steepness.at_least(row[i] + linearised.level_part[i]);
        }
        let steepness = steepness.root();
        let is_smooth = smooth(head, &linearised, &step, length, &pose);
        let is_tiny = at_most(jacobian_change * jacobian_change, change_rate * like.constant(f64::EPSILON));
        let is_within = both(at_most(jacobian_change * (length * steepness), tolerance), is_smooth);
        let is_last = choose(is_tiny, one, is_within);
        let trial = moved(&pose, &step, scale);
        let chi2_there = (sums.chi2 - reduction).at_least(zero);

        let reuses = both(not(is_last), both(at_most(jacobian_change, like.constant(REUSABLE_CHANGE)), is_smooth));
        let (mut is_end, mut next) = (is_last, trial);
        (end, end_chi2) = (choose_pose(active, &trial, &end), choose(active, chi2_there, end_chi2));
        before = sums.chi2;
        let reusing = both(active, reuses);
        if any(reusing) {
            iterations += reusing;
            evaluations += reusing;
            let again = reevaluate::<R, EXACT>(head, &measured, &linearised, &trial);
            let half_way = factor.forward(&again.by_pose);
            let (second, second_reduction) = (factor.backward(&half_way), square(&half_way));
            let ratio = (second_reduction / reduction).root();
            let is_good = both(reusing, at_most(ratio, like.constant(MAX_SECOND_STEP)));
            let nearer = moved(&trial, &second, scale);
            let remaining = jacobian_change * square(&second).root() * steepness;
            let is_minimum = both(is_good, at_most(remaining.at_least(ratio * second_reduction.root()), tolerance));
            (end, end_chi2) = (
                choose_pose(is_good, &nearer, &end),
                choose(is_good, (again.chi2 - second_reduction).at_least(zero), end_chi2),
            );
            is_end = choose(reuses, is_minimum, is_end);
            next = choose_pose(is_good, &nearer, &next);
            before = choose(is_good, like.constant(f64::INFINITY), before);
        }
        active = both(active, not(is_end));
        if !any(active) || round >= MAX_ROUNDS {
            stays = both(stays, not(active));
            conclude(head, course, &linearised, &factor, (&end, end_chi2), stays, minima);
            set(&mut minima.iterations, iterations);
            set(&mut minima.evaluations, evaluations);
            return;
        }
        pose = choose_pose(active, &next, &pose);
    }
}

/// The pose on the planes of the light.
#[inline(always)]
fn on_planes<R: Real<Element = f64>>(
    head: &Compiled<f64>,
    measured: &[Measured<R>],
    start: Transform<R>,
    stays: &mut R,
) -> Transform<R> {
    let like = *stays;
    let (zero, one) = (like.constant(0.0), like.constant(1.0));
    let mut planes = ArrayVec::<(R::Vec3, R), MAX_CELLS>::new();
    for (cell, measured) in head.planes.iter().zip(measured) {
        let (landing, weight) = cell.landing(measured.pair);
        planes.push((cell.normal::<R>(landing), weight));
    }
    let mut pose = start;
    let mut active = *stays;
    let per_length = like.splat(head.length_scale_m.recip());
    for _ in 0..planes::MAX_STEPS {
        let mut matrix: Matrix6<R> = [[zero; 6]; 6];
        let mut right: Vector6<R> = [zero; 6];
        for (cell, &(normal, weight)) in head.planes.iter().zip(&planes) {
            let (row, distance) = cell.row_from_slit(normal, &pose, head.length_scale_m);
            for i in 0..6 {
                let weighted = weight * row[i];
                right[i] = right[i] - weighted * distance;
                for j in 0..=i {
                    matrix[i][j] += weighted * row[j];
                }
            }
        }
        let mut is_safe = one;
        for (i, row) in matrix.iter_mut().enumerate() {
            row[i] += like.constant(PULL);
        }
        let factor = factor_of(&matrix, zero, &mut is_safe);
        *stays = both(*stays, choose(active, is_safe, one));
        let step = factor.solve(&right);
        let there =
            pose.moved(R::Vec3::new(step[0], step[1], step[2]), R::Vec3::new(step[3], step[4], step[5]) * per_length);
        pose = choose_pose(active, &there, &pose);
        let size = square(&step).root();
        // Written so that NaN goes on, as alone.
        active = both(active, not(above(like.constant(STEP_M), size)));
        if !any(active) {
            break;
        }
    }
    pose
}

/// The Cholesky factor of `matrix`; `is_safe` becomes zero where a pivot is no more than
/// `threshold` of its diagonal element.
#[inline(always)]
fn factor_of<R: Real<Element = f64>>(matrix: &Matrix6<R>, threshold: R, is_safe: &mut R) -> Factor<R> {
    let mut factor = Factor::of_parts(*matrix, matrix[0]);
    add_row::<R, 0>(&mut factor, matrix, threshold, is_safe);
    add_row::<R, 1>(&mut factor, matrix, threshold, is_safe);
    add_row::<R, 2>(&mut factor, matrix, threshold, is_safe);
    add_row::<R, 3>(&mut factor, matrix, threshold, is_safe);
    add_row::<R, 4>(&mut factor, matrix, threshold, is_safe);
    add_row::<R, 5>(&mut factor, matrix, threshold, is_safe);
    factor
}

/// Row `I` of the factor: a constant, so that the compiler unrolls its loops.
#[inline(always)]
fn add_row<R: Real<Element = f64>, const I: usize>(
    factor: &mut Factor<R>,
    matrix: &Matrix6<R>,
    threshold: R,
    is_safe: &mut R,
) {
    let diagonal = matrix[I][I];
    let pivot = factor.pivot(matrix, I, diagonal);
    *is_safe = both(*is_safe, above(pivot, threshold * diagonal));
    factor.set_pivot(I, pivot);
}

/// `pose` after a scaled step.
#[inline(always)]
fn moved<R: Real>(pose: &Transform<R>, step: &Vector6<R>, scale: R) -> Transform<R> {
    pose.moved(R::Vec3::new(step[0], step[1], step[2]) * scale, R::Vec3::new(step[3], step[4], step[5]))
}

/// Rows, χ² and normal equations at `pose`.
#[inline(always)]
fn linearise<R: Real<Element = f64>, const EXACT: bool>(
    head: &Compiled<f64>,
    measured: &[Measured<R>],
    pose: &Transform<R>,
    linearised: &mut Linearised<R>,
) {
    let like = pose.translation().x();
    let [zero, _, one] = zero_half_one(like);
    let scale = like.splat(head.length_scale_m);
    linearised.rows.clear();
    linearised.slacks_m.clear();
    (linearised.information, linearised.sums, linearised.is_sound) = ([[zero; 6]; 6], ResidualSums::zero(zero), one);
    linearised.level = head.level_information.map(|prior| Level::of_prior(like.splat(prior)));
    for (cell, Measured { pair, whitener }) in measured.iter().enumerate() {
        let Some(terms) = head.plan.linearise_lanes::<R, EXACT>(cell, pose) else {
            linearised.is_sound = zero;
            return;
        };
        let scaled_whitener = whitener.scaled(scale);
        let currents = terms.currents;
        let residual = whitener.apply([pair[0] - currents.pair[0], pair[1] - currents.pair[1]]);
        let [first, second] = residual;
        let mut rows = [first, second].map(|residual| Row { by_pose: [zero; 6], by_level: zero, residual });
        if linearised.level.is_some() {
            [rows[0].by_level, rows[1].by_level] = whitener.apply(currents.pair);
        }
        for axis in 0..6 {
            let whitener = if axis < 3 { &scaled_whitener } else { whitener };
            let column = whitener.apply([terms.jacobian[0][axis], terms.jacobian[1][axis]]);
            rows[0].by_pose[axis] = column[0];
            rows[1].by_pose[axis] = column[1];
        }
        let own = [&rows[0].by_pose, &rows[1].by_pose];
        add_outer(&mut linearised.information, own, own);
        if let Some(level) = &mut linearised.level {
            level.add(&rows);
        }
        linearised.sums.add(&rows, zero, false);
        linearised.is_sound = both(linearised.is_sound, currents.lit);
        linearised.slacks_m.push(terms.slack_m);
        linearised.rows.push(rows);
    }
    if let Some(level) = &mut linearised.level {
        let threshold = like.constant(SAFE_ROUNDINGS * f64::EPSILON);
        let (level_part, is_safe) = level.marginalise(&mut linearised.information, &linearised.sums, threshold);
        level.take_from_sums(&mut linearised.sums);
        linearised.level_part = level_part;
        linearised.is_sound = both(linearised.is_sound, is_safe);
    }
}

/// χ² and gradient at `pose` with the Jacobian of `rows`.
#[inline(always)]
fn reevaluate<R: Real<Element = f64>, const EXACT: bool>(
    head: &Compiled<f64>,
    measured: &[Measured<R>],
    linearised: &Linearised<R>,
    pose: &Transform<R>,
) -> ResidualSums<R> {
    let zero = pose.translation().x().constant(0.0);
    let mut sums = ResidualSums::zero(zero);
    for (cell, (Measured { pair, whitener }, rows)) in measured.iter().zip(&linearised.rows).enumerate() {
        let Some(currents) = head.plan.currents_lanes::<R, EXACT>(cell, pose) else { break };
        let residual = whitener.apply([pair[0] - currents.pair[0], pair[1] - currents.pair[1]]);
        let [first, second] = rows;
        let rows = [Row { residual: residual[0], ..*first }, Row { residual: residual[1], ..*second }];
        sums.add(&rows, zero, false);
    }
    if let Some(level) = &linearised.level {
        level.take_from_sums(&mut sums);
    }
    sums
}

/// Whether a `step` of this `length` from `pose`, the last linearisation's, moves no spot so far that derivatives jump.
#[inline(always)]
fn smooth<R: Real<Element = f64>>(
    head: &Compiled<f64>,
    linearised: &Linearised<R>,
    step: &Vector6<R>,
    length: R,
    pose: &Transform<R>,
) -> R {
    let one = length.constant(1.0);
    let (scale, magnification) = (length.splat(head.length_scale_m), length.constant(MAX_MAGNIFICATION));
    let most_moved = magnification * length * scale;
    let mut anyhow = one;
    for &slack_m in &linearised.slacks_m {
        anyhow = both(anyhow, above(slack_m, most_moved));
    }
    if !any(not(anyhow)) {
        return anyhow;
    }
    let shift = R::Vec3::new(step[0], step[1], step[2]) * scale;
    let turn = R::Vec3::new(step[3], step[4], step[5]);
    let scale2 = scale * scale;
    let mut each = one;
    for (cell, &slack_m) in linearised.slacks_m.iter().enumerate() {
        let arm = head.plan.arm_lanes(cell, pose);
        let moved_m = (shift + turn.cross(arm)).length();
        let most = (one + arm.dot(arm) / scale2).root();
        each = both(each, above(slack_m * most, magnification * moved_m));
    }
    choose(anyhow, one, each)
}

/// Stores the minima at `end` of lanes that stay, where nothing speaks against them.
#[inline(always)]
fn conclude<R: Real<Element = f64>>(
    head: &Compiled<f64>,
    course: Course,
    linearised: &Linearised<R>,
    factor: &Factor<R>,
    (end, chi2): (&Transform<R>, R),
    mut stays: R,
    minima: &mut Minima,
) {
    let [zero, half, one] = zero_half_one(chi2);
    stays = both(stays, at_most(chi2, chi2.splat(course.most_chi2)));
    let (mut least, mut largest) = (chi2.constant(f64::INFINITY), zero);
    for (i, row) in factor.lower().iter().enumerate() {
        (least, largest) = (least.at_most(row[i]), largest.at_least(row[i]));
    }
    stays = both(stays, above(least, chi2.constant(EVEN) * largest));
    let inverse = factor.inverse();
    for (i, row) in inverse.iter().enumerate() {
        stays = both(stays, at_most(row[i], chi2.constant(MAX_SIGMA * MAX_SIGMA)));
    }
    if let Some(doubted) = course.doubted_chi2 {
        // No step of so many σ is longer than the root of the covariance's trace allows: beyond no kink can there be
        // another minimum.
        let trace = inverse.iter().enumerate().fold(zero, |sum, (i, row)| sum + row[i]);
        let most_moved = trace.root() * chi2.splat(REACH * MAX_MAGNIFICATION * head.length_scale_m);
        let far = linearised.slacks_m.iter().fold(one, |far, &slack_m| both(far, above(slack_m, most_moved)));
        stays = both(stays, choose(at_most(chi2, chi2.splat(doubted)), one, far));
    }
    let mut size = zero;
    for component in end.rotation() {
        size += component * component;
    }
    let distance = end.translation().dot(end.translation());
    stays = both(stays, at_most(size + distance, chi2.constant(f64::MAX)));
    let mut least_visible = one;
    for [first, second] in &linearised.rows {
        let reduced = |row: &Row<R>| linearised.level.as_ref().map_or((row.by_pose, zero), |level| level.reduced(row));
        let ((by_first, p), (by_second, q)) = (reduced(first), reduced(second));
        let (u, v) = (factor.forward(&by_first), factor.forward(&by_second));
        let (uu, vv, uv) = (square(&u) + p * p, square(&v) + q * q, dot(&u, &v) + p * q);
        let half_difference = half * (uu - vv);
        let radius = (half_difference * half_difference + uv * uv).root();
        least_visible = least_visible.at_most(one - half * (uu + vv) - radius);
    }
    minima.set_pose(end);
    minima.set_factor(factor, &inverse);
    set(&mut minima.chi2, chi2);
    set(&mut minima.least_visible, least_visible);
    for lane in 0..R::LANES {
        minima.is_found[lane] = stays.lane(lane) > 0.0;
    }
}
