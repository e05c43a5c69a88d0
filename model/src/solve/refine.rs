//! Damped Gauss–Newton (Levenberg 1944, Marquardt 1963) on the whitened currents.
//!
//! Near its end a refinement keeps the derivatives it has and looks at the currents only: such a
//! step leaves an error smaller by as much as the derivatives have changed.

use crate::pose::Transform;
use crate::scalar::{Linear3, Scalar};

use super::algebra::{Factor, Vector6, square};
use super::kink::{Astride, NEAR};
use super::normal::{Expansion, Problem, Step, Whiteners, Workspace};
use super::planes::PlaneCell;

/// First damping after a step that did not help, relative to the diagonal.
const FIRST_DAMPING: f64 = 1e-4;

/// Steps after which the way leads along a valley.
const PATIENCE: usize = 12;

/// χ² that is not worth a step there: a hundredth of σ, squared.
const NOTHING: f64 = 1e-4;

/// Damping at which the search is stuck.
const STUCK: f64 = 1e9;

/// Relative change of the derivatives along a step up to which they are kept for the next.
const KEEP: f64 = 0.02;

/// A kept derivative that leaves more than this of a step was not good enough.
const POOR: f64 = 0.2;

/// What a step from the rows costs more than one by normal equations, in evaluations of all cells.
const ROWS_WORK: usize = 3;

/// When a refinement ends.
#[derive(Clone, Copy, Debug)]
pub(super) struct Ending<S> {
    pub(super) max_iterations: usize,
    /// What may be left of the way to the minimum, in σ of the pose.
    pub(super) leftover: S,
}

/// Where the refinement ended.
#[derive(Clone, Copy, Debug)]
pub(super) struct Refined<S: Scalar> {
    pub(super) pose: Transform<S>,
    pub(super) chi2: S,
    /// Of the information; `None` if that is singular to the precision of the numbers.
    pub(super) factor: Option<Factor<S>>,
    pub(super) iterations: usize,
    pub(super) converged: bool,
}

/// Relative change of a head's derivatives per unit of a scaled step: they bend over the distance
/// between emitter and slit, or slit and detector, whichever is less. Of 3000 random poses and
/// directions the change is 0.18 of this in the mean and 0.32 at most for the scene `wide`, 0.33 and
/// 0.90 for `base`.
pub(super) fn bend<S: Scalar>(cells: &[PlaneCell<S>], arm: S) -> S {
    let shortest = cells.iter().fold(S::infinity(), |shortest, cell| shortest.min(cell.shortest_m()));
    S::of(8.0) * arm / shortest.max(S::of(1e-3) * arm)
}

impl<S: Scalar> Problem<'_, S> {
    /// `pose` after a scaled step.
    pub(super) fn moved(&self, pose: &Transform<S>, step: &Vector6<S>) -> Transform<S> {
        pose.moved(
            <S as Scalar>::Vec3::new(step[0], step[1], step[2]) * self.arm,
            <S as Scalar>::Vec3::new(step[3], step[4], step[5]),
        )
    }

    /// Descends from `start` to a minimum of χ².
    pub(super) fn refine(
        &self,
        start: Transform<S>,
        whiteners: &Whiteners<S>,
        ending: Ending<S>,
        room: &mut Workspace<S>,
    ) -> Refined<S> {
        let mut pose = start;
        let mut at = self.expand(&pose, whiteners, room);
        let mut damping = S::zero();
        let mut iterations = 0;
        let mut bare = false;
        let raise = |damping: S| (damping * S::of(10.0)).max(S::of(FIRST_DAMPING));
        let ended = |pose, chi2, factor, iterations| Refined { pose, chi2, factor, iterations, converged: true };
        let mut converged = false;
        while iterations < ending.max_iterations && damping < S::of(STUCK) && room.work > 0 {
            let next = self.step(&at, damping, room).filter(|next| is_finite(&next.step));
            let Some(Step { factor, step, gain, by_rows }) = next else {
                damping = raise(damping);
                continue;
            };
            iterations += 1;
            if by_rows {
                room.work = room.work.saturating_sub(ROWS_WORK);
            }
            // The derivatives change along the step by this share, and the currents by as much of what
            // the step could do to them at most.
            let length = square(&step).square_root();
            let change = self.bend * length;
            // Along the floor of a valley that bound is never met, and nothing is left to win.
            let on_floor = iterations > PATIENCE && gain <= S::of(NOTHING);
            let left = change * if on_floor { gain.square_root() } else { length * at.steepness() };
            let trial = self.moved(&pose, &step);
            let is_tiny = change * change <= self.bend * S::epsilon();
            let is_last = left <= ending.leftover && self.is_smooth(length, room);
            if damping > S::zero() && damping <= S::of(FIRST_DAMPING) && (is_tiny || is_last) && !bare {
                // A damped step stops short of the minimum: the last one is tried without.
                bare = true;
                damping = S::zero();
                continue;
            }
            let is_free = damping <= S::of(FIRST_DAMPING);
            if is_free && (is_tiny || is_last) {
                let chi2 = (at.chi2 - gain).max(S::zero());
                if damping > S::zero() {
                    (pose, at.chi2, converged) = (trial, chi2, true);
                    break;
                }
                return ended(trial, chi2, Some(factor), iterations);
            }
            let may_keep = is_free && !by_rows && change <= S::of(KEEP) && self.is_smooth(length, room);
            if may_keep && iterations < ending.max_iterations {
                iterations += 1;
                let (chi2, descent) = self.revisit(&trial, whiteners, room);
                let half_way = factor.forward(&descent);
                let (second, second_gain) = (factor.backward(&half_way), square(&half_way));
                let ratio = (second_gain / gain).square_root();
                if ratio <= S::of(POOR) {
                    let end = self.moved(&trial, &second);
                    let left = change * square(&second).square_root() * at.steepness();
                    if left.max(ratio * second_gain.square_root()) <= ending.leftover {
                        let chi2 = (chi2 - second_gain).max(S::zero());
                        if damping > S::zero() {
                            (pose, at.chi2, converged) = (end, chi2, true);
                            break;
                        }
                        return ended(end, chi2, Some(factor), iterations);
                    }
                    pose = end;
                    at = self.expand(&pose, whiteners, room);
                    continue;
                }
            }
            let there = self.expand(&trial, whiteners, room);
            if there.chi2 < at.chi2 {
                pose = trial;
                at = there;
                damping = if damping > S::of(FIRST_DAMPING) { damping * S::of(0.1) } else { S::zero() };
            } else if gain <= S::of(64.0) * S::epsilon() * at.chi2
                || step.iter().all(|value| value.abs() < S::of(8.0) * S::epsilon())
            {
                // Rounding, not the landscape, stands in the way.
                if damping > S::zero() {
                    converged = true;
                    break;
                }
                return ended(pose, at.chi2, Some(factor), iterations);
            } else {
                if damping == S::zero() && gain <= S::of(NEAR) && !self.is_smooth(length, room) {
                    match self.astride(&pose, &at, &there, &step, whiteners, room) {
                        Astride::Least(factor) => return ended(pose, at.chi2, factor, iterations),
                        Astride::Lower(nearer, expansion) => {
                            (pose, at) = (nearer, expansion);
                            continue;
                        }
                        Astride::Nothing => {}
                    }
                }
                damping = raise(damping);
                at = self.expand(&pose, whiteners, room);
            }
        }
        // Damping is no information: of directions that the data hardly hold it would be most.
        let factor = self.factor(&at, room);
        Refined { pose, chi2: at.chi2, factor, iterations, converged }
    }

    /// The factor of the information at `pose`.
    pub(super) fn factor_at(
        &self,
        pose: &Transform<S>,
        whiteners: &Whiteners<S>,
        room: &mut Workspace<S>,
    ) -> Option<Factor<S>> {
        let at: Expansion<S> = self.expand(pose, whiteners, room);
        self.factor(&at, room)
    }
}

fn is_finite<S: Scalar>(step: &Vector6<S>) -> bool {
    step.iter().all(|value| value.is_finite())
}
