//! Where derivatives jump: a spot reaches the end of its detector, or an emitter the wall of a thick mask.
//!
//! Either side of such a kink has its own linearisation, and a step by the one may lead into the other.
//! Where both say that χ² falls towards the other side its minimum lies on the kink; where both say that it
//! falls away from there each side has a minimum of its own.

use arrayvec::ArrayVec;

use crate::plan::Optics;
use crate::pose::Transform;
use crate::rectangle::{MAX_MAGNIFICATION, WALL_SLACK};
use crate::scalar::Number;
use crate::scene::MAX_CELLS;

use super::accept::{DISTINCT_SIGMAS, is_singular};
use super::algebra::{Factor, Matrix6, Vector6, add_outer, dot, mirror, square};
use super::level::Level;
use super::levenberg_marquardt::{Minimum, Stopping};
use super::normal_equations::{NormalEquations, Problem, Workspace};
use super::readings::Usable;
use super::step::Step;

/// χ² of a step, 20 σ squared, beyond which its end is too far for a kink on the way to matter.
pub const NEAR: f64 = 400.0;

/// χ² that is not worth a step on a kink, where derivatives change with the side: a tenth of σ, squared.
const LITTLE: f64 = 1e-2;

/// How exactly two sides of a kink are weighed: what is left of the way is left to the next step.
const HALVINGS: usize = 12;

/// What there is on a kink between two poses.
pub enum Astride<S: Number> {
    /// The first of them is the least of χ². The factor of the side that tells less: the truth may lie there.
    Least(Option<Factor<S>>),
    /// A pose with less χ², and the normal equations there.
    Lower(Transform<S>, NormalEquations<S>),
    Nothing,
}

/// Where the derivatives jump between `at` and `there`, a `step` away, and either side says that χ² falls
/// towards the other: the step from `at` to the least of the larger of both linearised χ², and that least χ².
///
/// It is the least of λ times the one and 1 − λ times the other for the λ at which both are equal.
fn on_kink<S: Number>(
    at: &NormalEquations<S>,
    there: &NormalEquations<S>,
    step: &Vector6<S>,
) -> Option<(Vector6<S>, S)> {
    let (mut low, mut high) = (S::zero(), S::one());
    let beyond = there.times(step);
    let mut least = None;
    for _ in 0..HALVINGS {
        let share = S::half() * (low + high);
        let mix = |a: S, b: S| share * a + (S::one() - share) * b;
        let information: Matrix6<S> =
            core::array::from_fn(|i| core::array::from_fn(|j| mix(at.information[i][j], there.information[i][j])));
        let gradient: Vector6<S> = core::array::from_fn(|i| mix(at.gradient[i], there.gradient[i] + beyond[i]));
        let between = Factor::of_matrix(&information, S::zero(), S::zero())?.solve(&gradient);
        let rest: Vector6<S> = core::array::from_fn(|i| between[i] - step[i]);
        let (own, other) = (at.chi2_after(&between), there.chi2_after(&rest));
        if own > other {
            low = share;
        } else {
            high = share;
        }
        least = Some((between, own.max(other)));
    }
    least
}

impl<S: Number, P: Optics<S>> Problem<'_, S, P> {
    /// Looks for less χ² between `pose`, where the normal equations are `at`, and the end of `step`, where they are
    /// `there`.
    #[cold]
    #[inline(never)]
    pub fn astride(
        &self,
        pose: &Transform<S>,
        at: &NormalEquations<S>,
        there: &NormalEquations<S>,
        step: &Vector6<S>,
        workspace: &mut Workspace<S>,
    ) -> Astride<S> {
        let Some((between, promised)) = on_kink(at, there, step) else { return Astride::Nothing };
        if at.chi2 - promised <= S::of(LITTLE) {
            if at.along(step) >= there.along(step) {
                return Astride::Least(self.factor(there, workspace));
            }
            let at = self.linearise(pose, workspace);
            return Astride::Least(self.factor(&at, workspace));
        }
        let nearer = self.moved(pose, &between);
        let there = self.linearise(&nearer, workspace);
        if there.chi2 < at.chi2 { Astride::Lower(nearer, there) } else { Astride::Nothing }
    }

    /// `minimum`, or what fits better beyond a kink beside it if that has more χ² than `doubted`: on either side χ² may
    /// have a minimum of its own. Of each cell whose kink is within reach the emitter is put across its plane, both
    /// ways, with the least χ² by the covariance; the last linearisation is at `minimum`.
    #[cold]
    #[inline(never)]
    pub fn beyond_kink(&self, minimum: Minimum<S>, doubted: S, workspace: &mut Workspace<S>) -> Minimum<S> {
        let may_tell = |factor: &Factor<S>| minimum.chi2 > doubted && !is_singular(factor);
        let Some(factor) = minimum.factor.filter(may_tell) else { return minimum };
        let across = |reading: &Usable<S>| {
            let (row, _) = self.head.planes[reading.cell].row(reading, &minimum.pose, self.head.length_scale_m);
            let step = factor.solve(&row);
            let length = S::of(DISTINCT_SIGMAS) / factor.length(&step);
            step.map(|element| element * length)
        };
        // It is not known where the kinks of a polygonal spot lie.
        let may_cross = |&index: &usize| {
            let step = across(&self.sorted.usable[index]);
            workspace.slacks_m[index] > S::zero() && !self.is_smooth_in_cell(index, &step, &minimum.pose, workspace)
        };
        let crossing: ArrayVec<usize, MAX_CELLS> = (0..self.sorted.usable.len()).filter(may_cross).collect();
        let mut best = minimum;
        let mut iterations = minimum.iterations;
        for &index in &crossing {
            let way = across(&self.sorted.usable[index]);
            for step in [way, way.map(|element| -element)] {
                if workspace.work == 0 {
                    break;
                }
                let start = self.moved(&minimum.pose, &step);
                let other = self.minimise(start, Stopping::exact(), workspace);
                iterations += other.iterations;
                if other.converged && other.chi2 < best.chi2 {
                    best = other;
                }
            }
        }
        if !crossing.is_empty() {
            self.linearise(&best.pose, workspace);
        }
        Minimum { iterations, ..best }
    }

    /// Whether a step from the last linearisation may take an emitter to a wall.
    #[inline(always)]
    pub fn may_cross_wall(&self, step: &Step<S>, workspace: &Workspace<S>) -> bool {
        let most_moved_m = S::of(MAX_MAGNIFICATION / WALL_SLACK) * square(&step.step).root() * self.head.length_scale_m;
        workspace.walls_m.iter().any(|&wall_m| wall_m <= most_moved_m)
    }

    /// The minimum near that to which the `step` from `start` leads, where it takes emitters to walls of their masks: all
    /// cells are linearised anew at its end.
    #[cold]
    #[inline(never)]
    pub fn second_step(
        &self,
        step: &Step<S>,
        (start, minimum): (&Transform<S>, Minimum<S>),
        workspace: &mut Workspace<S>,
    ) -> Minimum<S> {
        if !(0..self.sorted.usable.len()).any(|index| self.crosses_wall(index, step, start, workspace)) {
            return minimum;
        }
        let at = self.linearise(&minimum.pose, workspace);
        self.one_step_on(&at, minimum, workspace)
    }

    /// One more step from `minimum`, where the normal equations are `at`.
    #[cold]
    #[inline(never)]
    fn one_step_on(&self, at: &NormalEquations<S>, minimum: Minimum<S>, workspace: &mut Workspace<S>) -> Minimum<S> {
        match self.step(at, S::zero(), workspace) {
            Some(next) if !next.is_by_qr && next.is_finite() => {
                self.end_of(&next, self.moved(&minimum.pose, &next.step), at, minimum.iterations + 1)
            }
            _ => minimum,
        }
    }

    /// Whether a step takes the emitter of reading `index` to a wall.
    #[inline(always)]
    fn crosses_wall(&self, index: usize, step: &Step<S>, start: &Transform<S>, workspace: &Workspace<S>) -> bool {
        let wall_m = workspace.walls_m.get(index).copied().unwrap_or(S::infinity());
        wall_m <= self.emitter_moves_m(&step.step, start, &self.sorted.usable[index])
    }

    /// [`Self::second_step`], but only the cells at walls are linearised anew, where the motion is known.
    #[cold]
    #[inline(never)]
    pub fn relinearise_at_walls(
        &self,
        step: &Step<S>,
        (start, minimum): (&Transform<S>, Minimum<S>),
        workspace: &mut Workspace<S>,
    ) -> Minimum<S> {
        let crosses = |&index: &usize| self.crosses_wall(index, step, start, workspace);
        let crossing: ArrayVec<usize, MAX_CELLS> = (0..self.sorted.usable.len()).filter(crosses).collect();
        // What the other cells say of a motion that is not known, and of a cell without a spot, would have to be found anew.
        if crossing.is_empty() || workspace.elimination.is_under_way() || !workspace.plane_rows.is_empty() {
            return minimum;
        }
        let factor = self.level(workspace).map_or(S::one(), Level::factor);
        for row in workspace.rows.iter_mut().flatten() {
            let change = dot(&row.by_pose, &step.step);
            row.residual -= factor * change;
            if P::FINDS_LIGHT_LEVEL {
                row.by_level += change;
            }
        }
        let crossing_cell =
            |cell: usize| crossing.iter().copied().find(|&index| self.sorted.usable[index].cell == cell);
        let Workspace { rows, displaced, .. } = &mut *workspace;
        self.head.plan.linearise_all(
            &self.instant(&minimum.pose),
            |cell| crossing_cell(cell).is_some(),
            |cell, terms| {
                if let Some(index) = crossing_cell(cell) {
                    let whitener = displaced.get(index).unwrap_or(&self.whiteners[index]);
                    rows[index] = self.rows(&self.sorted.usable[index], terms, whitener);
                }
            },
        );
        let mut information = [[S::zero(); 6]; 6];
        workspace.level = self.level_information().map(Level::of_prior);
        for (rows @ [first, second], reading) in workspace.rows.iter().zip(&self.sorted.usable) {
            let own = [&first.by_pose, &second.by_pose];
            add_outer(&mut information, own, own);
            if let Some(level) = workspace.level.as_mut().filter(|_| P::FINDS_LIGHT_LEVEL) {
                self.add_level(level, rows, reading);
            }
        }
        mirror(&mut information);
        let sums = self.residual_sums(workspace);
        let at = self.marginalised(information, sums, workspace.level.as_mut(), &mut workspace.elimination);
        self.one_step_on(&at, minimum, workspace)
    }
}
