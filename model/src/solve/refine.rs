//! Damped Gauss–Newton (Levenberg 1944, Marquardt 1963) on the whitened currents.
//!
//! Unknowns are (δt/arm, δθ): translations counted in units of the emitters' distance from the
//! tool's origin, so that the normal matrix mixes like with like.

use heapless::Vec;

use crate::plan::Plan;
use crate::pose::Transform;
use crate::scalar::{Scalar, Vector3};
use crate::scene::MAX_CELLS;

use super::algebra::{Cholesky, Matrix6, Vector6};
use super::planes::PlaneCell;
use super::readings::Usable;
use super::weights::{CellNoise, TwistVariance, Whitener};

/// A step this small (in σ of the pose, squared) is the last: what it leaves is second order in it.
const LAST_STEP: f64 = 1e-4;

/// First damping after a step that did not help, relative to the diagonal.
const FIRST_DAMPING: f64 = 1e-4;

/// Damping at which the search is stuck.
const STUCK: f64 = 1e9;

/// Motion of the tool within a frame, and how well it is known.
#[derive(Clone, Copy, Debug)]
pub(super) struct Motion<S: Scalar> {
    pub(super) linear: S::Vec3,
    pub(super) angular: S::Vec3,
    pub(super) variance: TwistVariance<S>,
}

/// How firmly a plane guides: its distance is worth one σ per so much.
const GUIDE_M: f64 = 20e-6;

/// What does not change during one refinement.
pub(super) struct Problem<'a, S: Scalar> {
    pub(super) plan: &'a Plan<S>,
    pub(super) planes: &'a [PlaneCell<S>],
    pub(super) noise: &'a [CellNoise<S>],
    /// Exposure of each cell relative to the reference instant, seconds.
    pub(super) exposure: &'a [S],
    pub(super) readings: &'a [Usable<S>],
    pub(super) motion: Motion<S>,
    pub(super) arm: S,
}

/// Cost and its expansion at a pose.
#[derive(Clone, Copy, Debug)]
pub(super) struct Expansion<S> {
    pub(super) chi2: S,
    pub(super) information: Matrix6<S>,
    descent: Vector6<S>,
}

/// Where the refinement ended.
#[derive(Clone, Copy, Debug)]
pub(super) struct Refined<S: Scalar> {
    pub(super) pose: Transform<S>,
    pub(super) at: Expansion<S>,
    pub(super) iterations: usize,
    pub(super) converged: bool,
}

/// One whitening per usable reading.
pub(super) type Whiteners<S> = Vec<Whitener<S>, MAX_CELLS>;

impl<S: Scalar> Problem<'_, S> {
    fn exposed(&self, pose: &Transform<S>, cell: usize) -> Transform<S> {
        let offset = self.exposure[cell];
        if offset == S::zero() {
            return *pose;
        }
        pose.moved(self.motion.linear * offset, self.motion.angular * offset)
    }

    /// Whether weights depend on the pose.
    pub(super) fn weights_vary(&self) -> bool {
        let variance = &self.motion.variance;
        variance.linear > S::zero() || variance.angular > S::zero()
    }

    /// The currents above dark that cell `cell` delivers with the tool at `pose` at the reference
    /// instant.
    pub(super) fn predicted(&self, cell: usize, pose: &Transform<S>) -> crate::Pair<S> {
        self.plan.linearise_at(cell, &self.exposed(pose, cell)).1
    }

    /// The weights of the readings with the tool near `pose`.
    pub(super) fn whiteners(&self, pose: &Transform<S>) -> Whiteners<S> {
        let twist_matters = self.weights_vary();
        self.readings
            .iter()
            .map(|reading| {
                let pair = crate::Pair { i_x1_a: reading.pair[0], i_x2_a: reading.pair[1] };
                let mut covariance = self.noise[reading.cell].covariance(&pair);
                if twist_matters {
                    let (_, _, jacobian) = self.plan.linearise_at(reading.cell, pose);
                    self.motion.variance.add_to(&mut covariance, &jacobian, self.exposure[reading.cell]);
                }
                covariance.whitener()
            })
            .collect()
    }

    /// Weights for the way from far off.
    pub(super) fn coarse_whiteners(&self) -> Whiteners<S> {
        self.readings
            .iter()
            .map(|reading| {
                let pair = crate::Pair { i_x1_a: reading.pair[0], i_x2_a: reading.pair[1] };
                let length = self.planes[reading.cell].detector_length_m();
                self.noise[reading.cell].coarse(length).covariance(&pair).whitener()
            })
            .collect()
    }

    /// χ² and its expansion at `pose`.
    pub(super) fn expand(&self, pose: &Transform<S>, whiteners: &Whiteners<S>) -> Expansion<S> {
        let mut chi2 = S::zero();
        let mut information = [[S::zero(); 6]; 6];
        let mut descent = [S::zero(); 6];
        for (reading, whitener) in self.readings.iter().zip(whiteners) {
            let (status, predicted, jacobian) = self.plan.linearise_at(reading.cell, &self.exposed(pose, reading.cell));
            if !status.has_spot() {
                // A cell that saw light and should see none here has no slope to descend on: its
                // plane shows the way.
                let (row, distance) = self.planes[reading.cell].row(reading, pose, self.arm);
                let residual = -distance / S::of(GUIDE_M);
                let row = row.map(|value| value * self.arm / S::of(GUIDE_M));
                chi2 += residual * residual;
                for i in 0..6 {
                    descent[i] += row[i] * residual;
                    for j in 0..=i {
                        information[i][j] += row[i] * row[j];
                    }
                }
            }
            let residual = whitener.apply([reading.pair[0] - predicted.i_x1_a, reading.pair[1] - predicted.i_x2_a]);
            let mut rows = [[S::zero(); 6]; 2];
            for axis in 0..6 {
                let scale = if axis < 3 { self.arm } else { S::one() };
                let column = whitener.apply([jacobian[0][axis] * scale, jacobian[1][axis] * scale]);
                rows[0][axis] = column[0];
                rows[1][axis] = column[1];
            }
            for (row, residual) in rows.iter().zip(residual) {
                chi2 += residual * residual;
                for i in 0..6 {
                    descent[i] += row[i] * residual;
                    for j in 0..=i {
                        information[i][j] += row[i] * row[j];
                    }
                }
            }
        }
        for i in 0..6 {
            for j in i + 1..6 {
                information[i][j] = information[j][i];
            }
        }
        Expansion { chi2, information, descent }
    }

    fn moved(&self, pose: &Transform<S>, step: &Vector6<S>) -> Transform<S> {
        pose.moved(S::Vec3::new(step[0], step[1], step[2]) * self.arm, S::Vec3::new(step[3], step[4], step[5]))
    }

    /// Descends from `start` to a minimum of χ².
    pub(super) fn refine(&self, start: Transform<S>, whiteners: &Whiteners<S>, max_iterations: usize) -> Refined<S> {
        let mut pose = start;
        let mut at = self.expand(&pose, whiteners);
        let mut damping = S::zero();
        let mut iterations = 0;
        let raise = |damping: S| (damping * S::of(10.0)).max(S::of(FIRST_DAMPING));
        while iterations < max_iterations && damping < S::of(STUCK) {
            // Undamped, a matrix that is singular to rounding needs damping, not a wild step.
            let threshold = S::of(16.0) * S::epsilon();
            let Some(factor) = Cholesky::factorise(&at.information, damping, threshold) else {
                damping = raise(damping);
                continue;
            };
            iterations += 1;
            let step = factor.solve(&at.descent);
            let gain = step.iter().zip(&at.descent).fold(S::zero(), |sum, (&a, &b)| sum + a * b);
            let trial = self.moved(&pose, &step);
            if damping <= S::of(FIRST_DAMPING) && gain <= S::of(LAST_STEP) {
                at.chi2 = (at.chi2 - gain).max(S::zero());
                return Refined { pose: trial, at, iterations, converged: true };
            }
            let there = self.expand(&trial, whiteners);
            if there.chi2 < at.chi2 {
                pose = trial;
                at = there;
                damping = if damping > S::of(FIRST_DAMPING) { damping * S::of(0.1) } else { S::zero() };
            } else if gain <= S::of(64.0) * S::epsilon() * at.chi2
                || step.iter().all(|value| value.abs() < S::of(8.0) * S::epsilon())
            {
                // Rounding, not the landscape, stands in the way.
                return Refined { pose, at, iterations, converged: true };
            } else {
                damping = raise(damping);
            }
        }
        Refined { pose, at, iterations, converged: false }
    }
}
