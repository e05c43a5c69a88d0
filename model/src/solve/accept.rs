//! Whether a minimum is believed, and what a solution says of itself.
//!
//! Of a right pose χ² follows the χ² distribution with as many degrees of freedom as there are currents beyond the
//! unknowns; a minimum above its gate, the quantile for 1e-9, is a misfit. Beside χ² the cells without light
//! count: a pose that would light them is a mirror image.
//!
//! An error of length e in the currents of one cell, in σ, has a share r in its residuals and 1 − r in the pose,
//! r the redundancy number. The largest error that χ² leaves unnoticed, and what it does to the pose, are the
//! minimal detectable bias and the external reliability of Baarda (A testing procedure for use in geodetic
//! networks, 1968).

use arrayvec::ArrayVec;

use crate::plan::Optics;
use crate::pose::Transform;
use crate::scalar::Number;

use super::algebra::{Factor, Matrix6, Vector6};
use super::levenberg_marquardt::{Minimum, Stopping};
use super::normal_equations::{Problem, Workspace};
use super::outcome::{DegradedReason, Directions, Estimate, Outcome, Solution};

pub const DISTINCT_SIGMAS: f64 = 6.0;

/// χ² by which a pose must be worse than the best to be out of the question: a likelihood ratio of
/// 1 : 22 000.
pub const ALIKE: f64 = 20.0;

/// Directions, the softest first, along which χ² of a pose that may have images must grow as its
/// covariance says.
const SOFT: usize = 3;

/// How χ² grows along a direction, by what the covariance promises: the square of the distance in σ.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Growth {
    AsTold,
    /// As told near the pose and by more further away: σ is wider than need be.
    Steeper,
    /// By less, or σ is so wide that the currents bend long before.
    Flatter,
}

/// Least share of that promise.
const SHARE: f64 = ALIKE / (DISTINCT_SIGMAS * DISTINCT_SIGMAS);

/// Multiple of it from which on χ² is looked at nearer the pose: a valley may end in a wall.
const TOO_UNLIKE: f64 = 4.0;

/// Distances that are looked at, each half of the one before.
const HALVINGS: usize = 6;

/// A residual this large a share of a cell's current is no small misfit: gains that calibration has not settled stay
/// well below. The pose is then another, or the head.
const ELSEWHERE: f64 = 0.05;

/// Evaluations that are left to [`Problem::taken_roughly`], whatever came before: it takes some eight.
pub const ROUGH_WORK: usize = 16;

/// How well a pose explains the data, worst first.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Fit {
    /// χ² is more than the noise explains.
    None,
    /// The cells that see light fit, but another should see some, too.
    LitOnly,
    Full,
}

impl<S: Number, P: Optics<S>> Problem<'_, S, P> {
    /// How well `minimum` explains the data: χ² by the noise, and no light where none was seen.
    pub fn fit(&self, minimum: &Minimum<S>) -> Fit {
        // Written so that NaN does not fit.
        let fits = minimum.converged && minimum.chi2 <= self.gate();
        if !fits {
            Fit::None
        } else if self.sorted.faint.count() == 0 || self.is_dark_where_dark(minimum) {
            Fit::Full
        } else {
            Fit::LitOnly
        }
    }

    /// Whether cells that were found without light are without light at the pose, too.
    #[cold]
    #[inline(never)]
    fn is_dark_where_dark(&self, minimum: &Minimum<S>) -> bool {
        let predicted = self.predicted(&minimum.pose);
        self.sorted
            .faint
            .iter()
            .all(|cell| predicted[cell][0] + predicted[cell][1] < S::two() * self.head.limits[cell].faint_a)
    }

    /// The solution at a minimum whose linearisation is in `workspace`.
    pub fn conclude(&self, minimum: &Minimum<S>, workspace: &Workspace<S>, fit: Fit) -> Solution<S> {
        let redundancy = self.head.redundancy(self.sorted.usable.len());
        let mut solution = Solution {
            chi2: minimum.chi2,
            redundancy,
            iterations: minimum.iterations,
            factor: minimum.factor,
            ..Solution::without_pose(Outcome::Diverged, self.sorted.used)
        };
        let Some(factor) = &minimum.factor else {
            return solution;
        };
        let Some(covariance) = covariance(factor, self.head.length_scale_m) else {
            let free = free_directions(factor).unwrap_or_default();
            solution.outcome = Outcome::Unobservable(free);
            return solution;
        };
        if !minimum.pose.is_finite() {
            return solution;
        }
        let gate = self.gate();
        if P::TELLS_RELIABILITY {
            solution.unnoticed_sigmas = unnoticed_sigmas(gate, redundancy, self.least_visible(factor, workspace));
        }
        solution.outcome = if fit == Fit::None {
            Outcome::Degraded(DegradedReason::Misfit)
        } else if self.sorted.usable.len() < self.head.plan.cell_count() {
            Outcome::Degraded(DegradedReason::FewerCells)
        } else {
            Outcome::Converged
        };
        solution.rigid = minimum.pose.to_rigid();
        solution.estimate = Some(Estimate { pose: solution.rigid.to_pose(), covariance });
        solution
    }

    /// The pose near `start` of a head that is not as its scene says: by coarse weights, under which gains and places that
    /// are off draw the pose less. χ² is by these weights.
    #[cold]
    #[inline(never)]
    pub fn taken_roughly(&self, start: Transform<S>, workspace: &mut Workspace<S>) -> Solution<S> {
        let coarse = self.coarse();
        let minimum = coarse.minimise(start, Stopping::near(), workspace);
        if !minimum.converged {
            return Solution::without_pose(Outcome::Diverged, self.sorted.used);
        }
        coarse.linearise(&minimum.pose, workspace);
        coarse.conclude(&minimum, workspace, Fit::None)
    }

    /// [`Self::conclude`] where the tool is expected and images are not looked for: one that is so near that
    /// the two are one minimum is.
    #[inline(always)]
    pub fn conclude_near(&self, minimum: &Minimum<S>, workspace: &mut Workspace<S>, fit: Fit) -> Solution<S> {
        let mut solution = self.conclude(minimum, workspace, fit);
        if self.head.has_images && fit != Fit::None {
            self.unless_soft(&mut solution, minimum, workspace);
        }
        solution
    }

    /// Leaves `solution` as it is if along its softest directions χ² grows as its covariance says; else an image is so
    /// near that the two are one minimum, and the data leave those directions free.
    #[inline(never)]
    pub fn unless_soft(&self, solution: &mut Solution<S>, minimum: &Minimum<S>, workspace: &mut Workspace<S>) {
        let has_free = matches!(solution.outcome, Outcome::Unobservable(_));
        let Some(factor) = minimum.factor.as_ref().filter(|_| has_free || solution.outcome.has_pose()) else {
            return;
        };
        let singular = factor.singular();
        let growths: ArrayVec<Growth, SOFT> =
            singular[..SOFT].iter().map(|along| self.growth(minimum, along, singular[5].0, workspace)).collect();
        if growths.contains(&Growth::Flatter) {
            // Of the others σ says nothing either, where the currents bend before it is reached.
            let soft = singular.iter().zip(&growths).filter(|(_, growth)| **growth != Growth::AsTold);
            let soft: ArrayVec<[f64; 6], SOFT> = soft.map(|((_, direction), _)| direction.map(S::as_f64)).collect();
            solution.outcome = Outcome::Unobservable(Directions::of_free(&soft));
            solution.estimate = None;
        }
    }

    /// How χ² grows from `minimum` both ways along a direction of its information, with that singular value, of which the
    /// `largest` is another.
    fn growth(
        &self,
        minimum: &Minimum<S>,
        (value, direction): &(S, Vector6<S>),
        largest: S,
        workspace: &mut Workspace<S>,
    ) -> Growth {
        if is_free(*value) {
            return Growth::Flatter;
        }
        let mut one_way = |sign: f64| {
            let (mut sigmas, mut growth) = (DISTINCT_SIGMAS, Growth::AsTold);
            for _ in 0..HALVINGS {
                let far = direction.map(|element| element * (S::of(sign * sigmas) / *value));
                let chi2 = self.linearise(&self.moved(&minimum.pose, &far), workspace).chi2;
                let promised = S::of(sigmas * sigmas);
                let is_enough = chi2 - minimum.chi2 >= S::of(SHARE) * promised;
                if !is_enough {
                    break;
                }
                if chi2 - minimum.chi2 <= S::of(TOO_UNLIKE) * promised {
                    return growth;
                }
                (sigmas, growth) = (0.5 * sigmas, Growth::Steeper);
            }
            Growth::Flatter
        };
        // Near a fold the singular value is in proportion to the distance from it, and χ² to the fourth power of that: a
        // value that small is no more than rounding makes of a fold.
        let is_rounded = *value <= (S::of(RANK_ROUNDINGS) * S::epsilon()).root() * largest;
        match one_way(-1.0).max(one_way(1.0)) {
            Growth::Steeper if is_rounded => Growth::Flatter,
            growth => growth,
        }
    }

    /// Whether the best pose found is too far from the data to call it one.
    pub fn is_elsewhere(&self, minimum: &Minimum<S>) -> bool {
        let predicted = self.predicted(&minimum.pose);
        let level = self.light_level(&predicted);
        !minimum.converged
            || self.sorted.usable.iter().any(|reading| {
                let [first, second] = reading.pair;
                let [i_x1_a, i_x2_a] = predicted[reading.cell].map(|current| level * current);
                let off = (first - i_x1_a).abs().max((second - i_x2_a).abs());
                off > S::of(ELSEWHERE) * (first + second)
            })
    }
}

/// How far, in σ of the pose, an error can move it that leaves χ² as likely above its gate as below:
/// of an error of length e in σ of its cell, r·e² stays visible and (1 − r)·e² is in the pose.
pub fn unnoticed_sigmas<S: Number>(gate: S, redundancy: usize, visible: S) -> S {
    // Of next to nothing, rounding is what is left.
    let negligible = S::of(1e-6).max(S::of(64.0) * S::epsilon());
    if redundancy == 0 || visible <= negligible {
        return S::infinity();
    }
    ((gate - S::of(redundancy as f64)) * (S::one() - visible) / visible).root()
}

/// A direction is free if its singular value is this far below the largest, in units of the number
/// type's rounding: condition numbers up to 7e13 in `f64`, 1.3e5 in `f32`.
const RANK_ROUNDINGS: f64 = 64.0;

/// A direction is free, too, if its σ exceeds one radian (or its equivalent in translation): the
/// linearisation it stems from holds much less far.
pub const MAX_SIGMA: f64 = 1.0;

/// A factor whose diagonal spans less than this has full rank without further proof.
pub const EVEN: f64 = 1e-3;

/// Covariance in metres and radians from the information in scaled coordinates; `None` if a
/// direction is free.
pub fn covariance<S: Number>(factor: &Factor<S>, length_scale_m: S) -> Option<Matrix6<S>> {
    if is_singular(factor) {
        return None;
    }
    let inverse = factor.inverse();
    // Written so that NaN fails, too.
    let is_bounded = inverse.iter().enumerate().all(|(i, row)| row[i] <= S::of(MAX_SIGMA * MAX_SIGMA));
    if !is_bounded {
        return None;
    }
    Some(unscaled(&inverse, length_scale_m))
}

/// A covariance of scaled coordinates in metres and radians.
#[inline(always)]
pub fn unscaled<S: Number>(covariance: &Matrix6<S>, length_scale_m: S) -> Matrix6<S> {
    let scale = |axis: usize| if axis < 3 { length_scale_m } else { S::one() };
    core::array::from_fn(|i| core::array::from_fn(|j| covariance[i][j] * (scale(i) * scale(j))))
}

pub fn is_singular<S: Number>(factor: &Factor<S>) -> bool {
    !factor.is_even(S::of(EVEN)) && free_directions(factor).is_some()
}

pub fn free_directions<S: Number>(factor: &Factor<S>) -> Option<Directions> {
    let pairs = factor.singular();
    let largest = pairs[5].0;
    let least = (S::of(RANK_ROUNDINGS) * S::epsilon() * largest).max(S::of(MAX_SIGMA.recip()));
    let free: heapless::Vec<[f64; 6], 6> = pairs
        .iter()
        .filter(|(value, _)| *value <= least || value.is_nan())
        .map(|(_, vector)| vector.map(S::as_f64))
        .collect();
    (!free.is_empty()).then(|| Directions::of_free(&free))
}

/// Whether the σ of a direction with this singular value is infinite, or beyond the range of any linearisation.
pub fn is_free<S: Number>(value: S) -> bool {
    // Written so that NaN is.
    let is_held = value > S::of(MAX_SIGMA.recip());
    !is_held
}

/// The displacement between two poses, in σ of the data of `factor`.
pub fn sigmas_between<S: Number>(factor: &Factor<S>, a: &Transform<S>, b: &Transform<S>, length_scale_m: S) -> S {
    let (dt, dr) = b.to_pose().displacement_from(&a.to_pose());
    let dt = dt / length_scale_m.as_f64();
    factor.length(&[dt.x, dt.y, dt.z, dr.x, dr.y, dr.z].map(S::of))
}

#[cfg(test)]
mod tests {
    use super::super::fixture::{compiled, currents, pose};
    use super::super::readings::{Reading, Sorted};
    use super::super::twist::Prior;
    use super::*;
    use crate::response::Pair;

    #[test]
    fn a_pose_that_lights_a_dark_cell_fits_the_lit_cells_only() {
        let (head, start) = (compiled(), Transform::of(&pose()));
        let mut readings = currents(&head.plan, &pose());
        let fits = [Reading::Missing, Reading::Light(Pair::default())].map(|reading| {
            readings.cells[0] = reading;
            let sorted = Sorted::of(&readings, &head.limits);
            let problem = head.problem(&sorted, &Prior::at_rest());
            problem.fit(&problem.minimise(start, Stopping::exact(), &mut Workspace::new()))
        });
        assert_eq!(fits, [Fit::Full, Fit::LitOnly]);
    }
}
