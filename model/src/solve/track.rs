//! Following the tool from frame to frame.
//!
//! The cells of a frame are exposed one after another; a pose belongs to one instant. The tracker
//! carries each exposure to that instant with the tool's twist, which it takes from the poses of
//! the frames before: a parabola is fitted to them, and its slope extrapolated to the frame at
//! hand. The uncertainty of that slope enters the covariance. Poses themselves are not filtered:
//! each rests on its own frame.

use heapless::{Deque, Vec};

use glam::DVec3;

use crate::pose::{Pose, Twist};
use crate::scalar::Scalar;

use super::{Estimate, MotionPrior, Outcome, Photocurrents, Solution, Solver, Weakness};

/// Poses the parabola is fitted to: at 4 kHz 1.25 ms. More would average the noise of the slope,
/// which enters the covariance, but miss the bends of a fast motion, which does not.
const MEMORY: usize = 5;

/// Twist of a tool nothing is known about, standard deviation per axis: a fast hand.
const UNKNOWN_LINEAR_M_PER_S: f64 = 0.5;
const UNKNOWN_ANGULAR_RAD_PER_S: f64 = 5.0;

/// Acceleration allowed for where only a straight line can be fitted: a fast hand reverses
/// 0.5 m/s within some 5 ms.
const ACCELERATION_M_PER_S2: f64 = 100.0;
const ANGULAR_ACCELERATION_RAD_PER_S2: f64 = 1000.0;

/// Fits with fewer poses are straight lines.
const PARABOLA_FROM: usize = 5;

/// Solves consecutive frames.
#[derive(Clone, Debug)]
pub struct Tracker<S: Scalar> {
    solver: Solver<S>,
    period_s: f64,
    /// Estimates of consecutive frames, latest first.
    recent: Deque<Estimate, MEMORY>,
    next_frame: u64,
    /// For each number of poses, the weights (latest first) of value and slope, per frame, at the
    /// frame to come.
    fits: [Fit; MEMORY + 1],
}

/// Weights of a polynomial fit to equally spaced values, extrapolated by one step.
#[derive(Clone, Debug, Default)]
struct Fit {
    value: Vec<f64, MEMORY>,
    slope: Vec<f64, MEMORY>,
}

impl<S: Scalar> Tracker<S> {
    /// For frames `period_s` seconds apart.
    pub fn new(solver: Solver<S>, period_s: f64) -> Self {
        Self { solver, period_s, recent: Deque::new(), next_frame: 0, fits: core::array::from_fn(Fit::new) }
    }

    /// The pose of frame `frame`. Frames are numbered without gaps by the device; a gap in the
    /// numbers makes the tracker forget how the tool moved.
    pub fn track(&mut self, frame: u64, readings: &Photocurrents) -> Solution {
        if frame != self.next_frame {
            self.recent.clear();
        }
        self.next_frame = frame.wrapping_add(1);

        let solution = match self.predict() {
            Some((pose, motion)) => {
                let solution = self.solver.solve_near(readings, &pose, &motion);
                if matches!(solution.outcome, Outcome::Degraded(Weakness::Misfit) | Outcome::Diverged) {
                    // The tool did not go on as before.
                    self.recent.clear();
                    self.solver.solve_near(readings, &pose, &unknown_motion())
                } else {
                    solution
                }
            }
            None => self.solver.solve_moving(readings, &unknown_motion()),
        };
        match solution.estimate {
            Some(estimate) if solution.outcome != Outcome::Degraded(Weakness::Misfit) => {
                if self.recent.is_full() {
                    self.recent.pop_back();
                }
                // Just made room.
                let _ = self.recent.push_front(estimate);
            }
            _ => self.recent.clear(),
        }
        solution
    }

    /// Pose and motion expected of the next frame.
    fn predict(&self) -> Option<(Pose, MotionPrior)> {
        let latest = self.recent.front()?;
        let count = self.recent.len();
        if count == 1 {
            return Some((latest.pose, unknown_motion()));
        }
        let fit = &self.fits[count];
        let (mut step_t, mut step_r, mut slope_t, mut slope_r) = (DVec3::ZERO, DVec3::ZERO, DVec3::ZERO, DVec3::ZERO);
        let mut noise = 0.0;
        for (estimate, (value, slope)) in self.recent.iter().zip(fit.value.iter().zip(&fit.slope)) {
            let (dt, dr) = estimate.pose.displacement_from(&latest.pose);
            step_t += dt * *value;
            step_r += dr * *value;
            slope_t += dt * *slope;
            slope_r += dr * *slope;
            noise += slope * slope;
        }
        let per_second = self.period_s.recip();
        let mean_variance = |axes: core::ops::Range<usize>| axes.map(|i| latest.covariance[i][i]).sum::<f64>() / 3.0;
        let curvature = if count < PARABOLA_FROM { 0.5 * (count as f64 + 1.0) * self.period_s } else { 0.0 };
        let sigma = |variance: f64, acceleration: f64| {
            let bend = acceleration * curvature;
            libm::sqrt(noise * variance * per_second * per_second + bend * bend)
        };
        let motion = MotionPrior {
            twist: Twist { linear_m_per_s: slope_t * per_second, angular_rad_per_s: slope_r * per_second },
            linear_sigma_m_per_s: sigma(mean_variance(0..3), ACCELERATION_M_PER_S2),
            angular_sigma_rad_per_s: sigma(mean_variance(3..6), ANGULAR_ACCELERATION_RAD_PER_S2),
        };
        Some((latest.pose.perturbed(step_t, step_r), motion))
    }
}

fn unknown_motion() -> MotionPrior {
    MotionPrior {
        twist: Twist::default(),
        linear_sigma_m_per_s: UNKNOWN_LINEAR_M_PER_S,
        angular_sigma_rad_per_s: UNKNOWN_ANGULAR_RAD_PER_S,
    }
}

impl Fit {
    /// Least squares through `count` values at times −1, −2, …, −count, evaluated at 0.
    fn new(count: usize) -> Self {
        let degree = match count {
            0 => return Self::default(),
            1 => 0,
            count if count < PARABOLA_FROM => 1,
            _ => 2,
        };
        let times = (1..=count).map(|i| -(i as f64));
        // Orthogonal polynomials (Forsythe 1957) on these times: p₀ = 1, p₁ = t − t̄,
        // p₂ = (t − t̄)² − mean of (t − t̄)²; at 0 their values and slopes.
        let mean = times.clone().sum::<f64>() / count as f64;
        let spread = times.clone().map(|t| (t - mean) * (t - mean)).sum::<f64>() / count as f64;
        let basis = |t: f64| [1.0, t - mean, (t - mean) * (t - mean) - spread];
        let at_zero = basis(0.0);
        let slope_at_zero = [0.0, 1.0, -2.0 * mean];
        let norms: [f64; 3] = core::array::from_fn(|k| times.clone().map(|t| basis(t)[k] * basis(t)[k]).sum());
        let weights = |of_basis: [f64; 3]| {
            times.clone().map(|t| (0..=degree).map(|k| of_basis[k] * basis(t)[k] / norms[k]).sum()).collect()
        };
        Self { value: weights(at_zero), slope: weights(slope_at_zero) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fits_reproduce_polynomials_of_their_degree() {
        for count in 1..=MEMORY {
            let fit = Fit::new(count);
            let degree = if count == 1 {
                0
            } else if count < PARABOLA_FROM {
                1
            } else {
                2
            };
            for power in 0..=degree {
                let apply = |weights: &Vec<f64, MEMORY>| -> f64 {
                    weights.iter().enumerate().map(|(i, w)| w * (2.0 - (i as f64 + 1.0)).powi(power)).sum()
                };
                // f(t) = (t + 2)^power
                assert!((apply(&fit.value) - 2f64.powi(power)).abs() < 1e-11, "{count} {power}");
                let slope = if power == 0 { 0.0 } else { f64::from(power) * 2f64.powi(power - 1) };
                assert!((apply(&fit.slope) - slope).abs() < 1e-11, "{count} {power}");
            }
        }
    }
}
