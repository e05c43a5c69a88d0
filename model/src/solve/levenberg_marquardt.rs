//! Damped Gauss–Newton on the whitened currents (Levenberg 1944, Marquardt 1963).
//!
//! A step s solves (JᵀJ + λ·diag JᵀJ)·s = Jᵀr. The damping λ is zero until a step fails to reduce χ², grows tenfold
//! while steps fail, and falls as they succeed. Near the minimum the Jacobian is reused: only the currents are
//! evaluated anew, and the second step leaves an error smaller by the relative change of the Jacobian.
//!
//! Derivatives jump where a spot reaches the end of its detector; steps across such a kink are the business of
//! [`super::kink`].

use crate::plan::Optics;
use crate::pose::Transform;
use crate::scalar::{Linear3, Number};

use super::algebra::{Factor, Vector6, square};
use super::kink::{Astride, NEAR};
use super::normal_equations::{NormalEquations, Problem, Workspace};
use super::step::Step;

/// First damping after a step that failed, relative to the diagonal.
const FIRST_DAMPING: f64 = 1e-4;

const STUCK: f64 = 1e9;

/// Steps after which the minimisation is taken to follow a valley.
pub const PATIENCE: usize = 12;

/// Predicted reduction of χ² that is not worth a step along a valley: a hundredth of σ, squared.
const NEGLIGIBLE_REDUCTION: f64 = 1e-4;

/// Relative change of the Jacobian along a step up to which it is reused for the next.
pub const REUSABLE_CHANGE: f64 = 0.02;

/// Relative change of the Jacobian along a step up to which χ² at its end is as promised to a factor of two in its
/// reduction.
const PROMISING_CHANGE: f64 = 0.3;

/// Ratio of the second step to the first above which a reused Jacobian was too old.
pub const MAX_SECOND_STEP: f64 = 0.2;

/// Cost of a QR step beyond one by normal equations, in evaluations of all cells.
const QR_WORK: usize = 3;

#[derive(Clone, Copy, Debug)]
pub struct Stopping<S> {
    pub max_iterations: usize,
    /// Distance to the minimum that may remain, in σ of the pose.
    pub tolerance_sigmas: S,
    /// χ² of a minimum that is not worth being reached.
    pub most_chi2: S,
}

const MAX_ITERATIONS: usize = 40;

/// Steps of a rough approach before it is given up.
const ROUGH_ITERATIONS: usize = 20;

impl<S: Number> Stopping<S> {
    /// Next to the minimum, so that noise-free data give the pose itself.
    pub fn exact() -> Self {
        Self { max_iterations: MAX_ITERATIONS, tolerance_sigmas: S::of(1e-7), most_chi2: S::infinity() }
    }

    /// As near as noise makes worth while: the bound on the distance is tens of times too cautious, so that a
    /// fiftieth of σ remains in the median.
    pub fn near() -> Self {
        Self { tolerance_sigmas: S::of(0.8), ..Self::exact() }
    }

    /// Next to a mirror image, if there is one where it is looked for: most are reached in ten steps.
    pub fn image() -> Self {
        Self { max_iterations: ROUGH_ITERATIONS, ..Self::exact() }
    }

    /// In the neighbourhood of a minimum, with coarse weights.
    pub fn rough() -> Self {
        Self { max_iterations: ROUGH_ITERATIONS, tolerance_sigmas: S::of(1e-2), ..Self::exact() }
    }

    /// Without minima of more χ².
    pub fn if_below(self, most_chi2: S) -> Self {
        Self { most_chi2, ..self }
    }
}

#[derive(Clone, Copy, Debug)]
pub struct Minimum<S: Number> {
    pub pose: Transform<S>,
    pub chi2: S,
    /// Of the information; `None` if that is singular to the precision of the numbers.
    pub factor: Option<Factor<S>>,
    pub iterations: usize,
    pub converged: bool,
}

#[derive(Clone, Copy)]
struct Reach<S> {
    is_smooth: bool,
    length: S,
    /// Bound on the relative change of the Jacobian along the step.
    jacobian_change: S,
    /// Whether the minimum is within the tolerance of its end, or nothing but rounding is left.
    is_last: bool,
}

/// The end of a second step with the Jacobian of the first.
enum Reused<S: Number> {
    /// Within the tolerance of the minimum.
    Minimum(Transform<S>, S),
    Nearer(Transform<S>),
    TooOld,
}

impl<S: Number, P: Optics<S>> Problem<'_, S, P> {
    /// `pose` after a scaled step.
    pub fn moved(&self, pose: &Transform<S>, step: &Vector6<S>) -> Transform<S> {
        pose.moved(
            S::Vec3::new(step[0], step[1], step[2]) * self.head.length_scale_m,
            S::Vec3::new(step[3], step[4], step[5]),
        )
    }

    /// The minimum of χ² that is reached from `start`.
    pub fn minimise(&self, start: Transform<S>, stopping: Stopping<S>, workspace: &mut Workspace<S>) -> Minimum<S> {
        let at = self.linearise(&start, workspace);
        // Apart from what follows, because most end here where the tool is expected, and a board has little room for
        // fast code.
        let first =
            if stopping.max_iterations > 0 && workspace.work > 0 { self.step(&at, S::zero(), workspace) } else { None };
        if let Some(step) = first.as_ref().filter(|step| !step.is_by_qr && step.is_finite())
            && self.reach(step, (&start, &at), 1, stopping, workspace).is_last
        {
            let end = self.end_of(step, self.moved(&start, &step.step), &at, 1);
            if P::CROSSES_WALLS && self.may_cross_wall(step, workspace) {
                return if workspace.is_unhurried {
                    self.second_step(step, (&start, end), workspace)
                } else {
                    self.relinearise_at_walls(step, (&start, end), workspace)
                };
            }
            return end;
        }
        self.descend(start, at, first, stopping, workspace)
    }

    /// The minimum at `end`, where the undamped `step` from where the normal equations are `at` has led.
    #[inline(always)]
    pub fn end_of(&self, step: &Step<S>, end: Transform<S>, at: &NormalEquations<S>, iterations: usize) -> Minimum<S> {
        let chi2 = (at.chi2 - step.predicted_reduction).max(S::zero());
        Minimum { pose: end, chi2, factor: Some(step.factor), iterations, converged: true }
    }

    /// The minimum of χ² that is reached in steps from `pose`, where the normal equations are `at`, and the `first` of
    /// them is known.
    #[cold]
    #[inline(never)]
    fn descend(
        &self,
        mut pose: Transform<S>,
        mut at: NormalEquations<S>,
        mut first: Option<Step<S>>,
        stopping: Stopping<S>,
        workspace: &mut Workspace<S>,
    ) -> Minimum<S> {
        let mut damping = S::zero();
        let mut iterations = 0;
        let mut converged = false;
        while iterations < stopping.max_iterations && damping < S::of(STUCK) && workspace.work > 0 {
            let proposed = first.take().or_else(|| self.step(&at, damping, workspace));
            let Some(step) = proposed.as_ref().filter(|step| step.is_finite()) else {
                damping = raised(damping);
                continue;
            };
            iterations += 1;
            if step.is_by_qr {
                workspace.work = workspace.work.saturating_sub(QR_WORK);
            }
            let reach = self.reach(step, (&pose, &at), iterations, stopping, workspace);
            // Near the minimum even twice the reduction that the linearisation promises would not do.
            let is_near = damping == S::zero() && reach.jacobian_change <= S::of(PROMISING_CHANGE);
            if is_near && at.chi2 - S::two() * step.predicted_reduction > stopping.most_chi2 {
                break;
            }
            let trial = self.moved(&pose, &step.step);
            let is_hardly_damped = damping <= S::of(FIRST_DAMPING);
            if reach.is_last && is_hardly_damped {
                let minimum = self.end_of(step, trial, &at, iterations);
                if damping == S::zero() {
                    return minimum;
                }
                (pose, at.chi2, converged) = (minimum.pose, minimum.chi2, true);
                break;
            }
            if is_hardly_damped && iterations < stopping.max_iterations && is_reusable(step, reach) {
                iterations += 1;
                match self.reuse_jacobian(step, reach, (&trial, &at), stopping, workspace) {
                    Reused::Minimum(end, chi2) if damping == S::zero() => {
                        return Minimum { pose: end, chi2, factor: Some(step.factor), iterations, converged: true };
                    }
                    Reused::Minimum(end, chi2) => {
                        (pose, at.chi2, converged) = (end, chi2, true);
                        break;
                    }
                    Reused::Nearer(end) => {
                        pose = end;
                        at = self.linearise(&pose, workspace);
                        continue;
                    }
                    Reused::TooOld => {}
                }
            }
            let there = self.linearise(&trial, workspace);
            if there.chi2 < at.chi2 {
                (pose, at) = (trial, there);
                damping = lowered(damping);
                continue;
            }
            if step.is_below_rounding(at.chi2) {
                if damping == S::zero() {
                    return Minimum { pose, chi2: at.chi2, factor: Some(step.factor), iterations, converged: true };
                }
                converged = true;
                break;
            }
            if damping == S::zero() && self.may_cross_kink(step, reach, workspace) {
                match self.astride(&pose, &at, &there, &step.step, workspace) {
                    Astride::Least(factor) => {
                        return Minimum { pose, chi2: at.chi2, factor, iterations, converged: true };
                    }
                    Astride::Lower(nearer, linearised) => {
                        (pose, at) = (nearer, linearised);
                        continue;
                    }
                    Astride::Nothing => {}
                }
            }
            damping = raised(damping);
            at = self.linearise(&pose, workspace);
        }
        // Damping is no information: along directions that the data hardly hold it would be most of it.
        let factor = self.factor(&at, workspace);
        Minimum { pose, chi2: at.chi2, factor, iterations, converged }
    }

    /// The minimum near `start`, where the tool is expected; given up after a few evaluations.
    pub fn minimise_quickly(&self, start: Transform<S>, workspace: &mut Workspace<S>) -> Minimum<S> {
        let near = if workspace.is_unhurried { P::NEAR_UNHURRIED } else { P::NEAR };
        let held_back = workspace.work.saturating_sub(near.work);
        workspace.work -= held_back;
        let stopping = Stopping { tolerance_sigmas: S::of(near.sigmas), ..Stopping::near() };
        let minimum = self.minimise(start, stopping, workspace);
        workspace.work += held_back;
        minimum
    }

    /// How far the step number `iterations` leads from `pose`, where the normal equations are `at`.
    #[inline(always)]
    fn reach(
        &self,
        step: &Step<S>,
        (pose, at): (&Transform<S>, &NormalEquations<S>),
        iterations: usize,
        stopping: Stopping<S>,
        workspace: &Workspace<S>,
    ) -> Reach<S> {
        let length = square(&step.step).root();
        let jacobian_change = self.head.jacobian_change_rate * length;
        // At its end the currents differ from the linearised ones by that share of their change at most. In a valley
        // this bound stays above any tolerance, although nothing is left to gain.
        let is_in_valley = iterations > PATIENCE && step.predicted_reduction <= S::of(NEGLIGIBLE_REDUCTION);
        let change = if is_in_valley { step.predicted_reduction.root() } else { length * at.steepness() };
        let is_tiny = jacobian_change * jacobian_change <= self.head.jacobian_change_rate * S::epsilon();
        let is_smooth = self.is_smooth(length, workspace) || self.is_smooth_in_each_cell(&step.step, pose, workspace);
        let is_within = jacobian_change * change <= stopping.tolerance_sigmas && is_smooth;
        Reach { length, jacobian_change, is_smooth, is_last: is_tiny || is_within }
    }

    /// A second step from `trial`, the end of the first, with the Jacobian from its start, `at`.
    #[inline(never)]
    fn reuse_jacobian(
        &self,
        first: &Step<S>,
        reach: Reach<S>,
        (trial, at): (&Transform<S>, &NormalEquations<S>),
        stopping: Stopping<S>,
        workspace: &mut Workspace<S>,
    ) -> Reused<S> {
        let (chi2, gradient) = self.reevaluate(trial, workspace);
        let half_way = first.factor.forward(&gradient);
        let (second, reduction) = (first.factor.backward(&half_way), square(&half_way));
        let ratio = (reduction / first.predicted_reduction).root();
        // Written so that NaN is too old.
        let is_good = ratio <= S::of(MAX_SECOND_STEP);
        if !is_good {
            return Reused::TooOld;
        }
        let end = self.moved(trial, &second);
        let remaining = reach.jacobian_change * square(&second).root() * at.steepness();
        if remaining.max(ratio * reduction.root()) <= stopping.tolerance_sigmas {
            Reused::Minimum(end, (chi2 - reduction).max(S::zero()))
        } else {
            Reused::Nearer(end)
        }
    }

    /// Whether a kink lies so near that it may be why the step failed.
    fn may_cross_kink(&self, step: &Step<S>, reach: Reach<S>, workspace: &Workspace<S>) -> bool {
        step.predicted_reduction <= S::of(NEAR) && !self.is_smooth(reach.length, workspace)
    }
}

impl<S: Number> Step<S> {
    pub fn is_finite(&self) -> bool {
        self.step.iter().all(|value| value.is_finite())
    }

    /// Whether rounding, and not the shape of χ², keeps the step from reducing it.
    fn is_below_rounding(&self, chi2: S) -> bool {
        self.predicted_reduction <= S::of(64.0) * S::epsilon() * chi2
            || self.step.iter().all(|value| value.abs() < S::of(8.0) * S::epsilon())
    }
}

#[inline(always)]
fn is_reusable<S: Number>(step: &Step<S>, reach: Reach<S>) -> bool {
    !step.is_by_qr && reach.jacobian_change <= S::of(REUSABLE_CHANGE) && reach.is_smooth
}

fn raised<S: Number>(damping: S) -> S {
    (damping * S::of(10.0)).max(S::of(FIRST_DAMPING))
}

fn lowered<S: Number>(damping: S) -> S {
    if damping > S::of(FIRST_DAMPING) { damping * S::of(0.1) } else { S::zero() }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn damping_rises_tenfold_from_its_first_value_and_falls_back_to_none() {
        assert_eq!([0.0, 1e-4].map(raised::<f64>), [1e-4, 1e-4 * 10.0]);
        assert_eq!([1e-4, 0.0].map(lowered::<f64>), [0.0; 2]);
        assert!((lowered(1e-2_f64) - 1e-3).abs() < 1e-18);
    }
}
