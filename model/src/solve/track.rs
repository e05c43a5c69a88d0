//! Following the tool from frame to frame.
//!
//! The cells of a frame are exposed one after another; a pose belongs to one instant. The tracker
//! carries each exposure to that instant with the tool's twist, which it takes from the frames
//! before; the uncertainty of that twist enters the covariance. Poses themselves are not filtered:
//! each rests on its own frame. A pose from many frames stands beside them, for those who ask for it.
//!
//! No pose is refused for being elsewhere than expected: a tool may hit a wall. What the currents of
//! its own frame confirm is believed, and the motion before is forgotten.

use crate::pose::Twist;
use crate::scalar::Scalar;

use super::search::{COLD_WORK, Search};
use super::smooth::{Prediction, Smoothed, Smoother, TwistEstimate};
use super::{MotionPrior, Outcome, Photocurrents, Solution, Solver, Weakness};

/// Memory of the motion that carries exposures, in frames: long enough that the noise of the twist
/// adds next to nothing to a pose's, short enough for the bends of a fast hand.
const MEMORY_FRAMES: f64 = 2.0;

/// Frames without a pose that the motion is trusted across.
const MAX_COAST: u32 = 8;

/// Twist of a tool nothing is known about, standard deviation per axis: a fast hand.
const UNKNOWN_LINEAR_M_PER_S: f64 = 0.5;
const UNKNOWN_ANGULAR_RAD_PER_S: f64 = 5.0;

/// Acceleration allowed for while only a straight line can be fitted: a fast hand reverses
/// 0.5 m/s within some 2 ms.
const ACCELERATION_M_PER_S2: f64 = 300.0;
const ANGULAR_ACCELERATION_RAD_PER_S2: f64 = 3000.0;

/// Frames from which on a bend is followed.
const BEND_FROM: u32 = 5;

/// Squared error of a prediction, six axes together and in units of what noise explains, beyond
/// which the tool did not go on as before: 1e-6 of honest frames (χ² with six degrees of freedom).
const MANOEUVRE: f64 = 38.3;

/// Most that bent motion may widen this bound: beyond, it is not followed but forgotten.
const MOST_STRAIN: f64 = 10.0;

/// Evaluations of all cells that the search for a lost tool may take in one frame.
const SEARCH_WORK: usize = 150;

/// What one frame tells.
#[derive(Clone, Copy, Debug)]
pub struct Tracked<S: Scalar = f64> {
    /// From this frame alone, but for the twist.
    pub solution: Solution<S>,
    /// Velocity at the reference instant, from this frame and a few before.
    pub twist: Option<TwistEstimate>,
    /// From many frames, if asked for.
    pub smoothed: Option<Smoothed>,
}

/// Solves consecutive frames.
#[derive(Clone, Debug)]
pub struct Tracker<S: Scalar> {
    solver: Solver<S>,
    period_s: f64,
    motion: Smoother,
    filter: Option<Smoother>,
    next_frame: u64,
    /// Of the tool before it was lost sight of: it may still be as fast.
    last_twist: Twist,
    /// σ of the last pose, mean of the axes: metres and radians.
    sigmas: [f64; 2],
    /// Frames since the last pose.
    coasted: u32,
    /// For a lost tool.
    search: Search<S>,
}

impl<S: Scalar> Tracker<S> {
    /// For frames `period_s` seconds apart.
    pub fn new(solver: Solver<S>, period_s: f64) -> Self {
        Self {
            solver,
            period_s,
            motion: Smoother::new(period_s, MEMORY_FRAMES * period_s),
            filter: None,
            next_frame: 0,
            last_twist: Twist::default(),
            sigmas: [0.0; 2],
            coasted: 0,
            search: Search::in_pieces(),
        }
    }

    /// Tells a pose from many frames, too, with a memory of `memory_s` seconds: see [`Smoothed`].
    #[must_use]
    pub fn with_filter(mut self, memory_s: f64) -> Self {
        self.filter = Some(Smoother::new(self.period_s, memory_s));
        self
    }

    /// The pose of frame `frame`. Frames are numbered without gaps by the device; across a longer
    /// gap in the numbers the tracker forgets how the tool moved.
    pub fn track(&mut self, frame: u64, readings: &Photocurrents) -> Tracked<S> {
        match frame.checked_sub(self.next_frame) {
            Some(missed) if missed <= u64::from(MAX_COAST) => (0..missed).for_each(|_| self.coast()),
            _ => self.forget(),
        }
        self.next_frame = frame.wrapping_add(1);
        let solution = self.solve(readings);
        match solution.estimate.map(|estimate| estimate.widened()) {
            Some(estimate) if solution.outcome != Outcome::Degraded(Weakness::Misfit) => {
                let solver = &self.solver;
                let squared_sigmas = |dt, dr| solver.squared_sigmas(&solution, dt, dr);
                self.motion.update(&estimate.pose, squared_sigmas);
                if let Some(filter) = &mut self.filter {
                    filter.update(&estimate.pose, squared_sigmas);
                }
                let mean = |axes: core::ops::Range<usize>| axes.map(|i| estimate.covariance[i][i]).sum::<f64>() / 3.0;
                self.sigmas = [mean(0..3), mean(3..6)].map(libm::sqrt);
                self.coasted = 0;
                self.search = Search::in_pieces();
                Tracked {
                    solution,
                    twist: self.motion.smoothed(&estimate.covariance).map(|state| state.twist),
                    smoothed: self.filter.as_ref().and_then(|filter| filter.smoothed(&estimate.covariance)),
                }
            }
            _ => {
                self.coast();
                Tracked { solution, twist: None, smoothed: None }
            }
        }
    }

    fn forget(&mut self) {
        self.motion.forget();
        if let Some(filter) = &mut self.filter {
            filter.forget();
        }
        self.coasted = 0;
    }

    fn coast(&mut self) {
        self.coasted += 1;
        if self.coasted > MAX_COAST {
            return self.forget();
        }
        self.motion.coast();
        if let Some(filter) = &mut self.filter {
            filter.coast();
        }
    }

    fn solve(&mut self, readings: &Photocurrents) -> Solution<S> {
        let Some(expected) = self.motion.predict() else {
            return self.find(readings, &unknown_motion(&self.last_twist));
        };
        let motion = self.motion_prior(&expected);
        let solution = self.solver.solve_next(readings, &expected.pose, &motion);
        if let Some(estimate) = solution.estimate
            && solution.outcome != Outcome::Degraded(Weakness::Misfit)
        {
            let (dt, dr) = estimate.pose.displacement_from(&expected.pose);
            let squared = self.solver.squared_sigmas(&solution, dt, dr) / (1.0 + expected.pose_variance);
            // While the motion is not known yet, any is as expected.
            if expected.frames < BEND_FROM || squared <= MANOEUVRE * expected.strain.min(MOST_STRAIN) {
                return solution;
            }
        }
        // The tool did not go on as before: what it did within this frame is unknown.
        self.forget();
        self.last_twist = expected.twist;
        let unknown = unknown_motion(&expected.twist);
        let solution = self.solver.solve_next(readings, &expected.pose, &unknown);
        if matches!(solution.outcome, Outcome::Degraded(Weakness::Misfit) | Outcome::Diverged) {
            return self.find(readings, &unknown);
        }
        solution
    }

    /// Looks for the tool everywhere, a piece of the search a frame.
    fn find(&mut self, readings: &Photocurrents, motion: &MotionPrior) -> Solution<S> {
        // A tool that was seen in the frame before is worth a longer look.
        let work = if self.coasted == 0 { COLD_WORK } else { SEARCH_WORK };
        let solution = self.solver.search_on(readings, motion, &mut self.search, work);
        if self.search.is_over() {
            self.search = Search::in_pieces();
        }
        solution
    }

    /// How the tool is expected to move within the next frame.
    fn motion_prior(&self, expected: &Prediction) -> MotionPrior {
        if expected.frames < 2 {
            return unknown_motion(&self.last_twist);
        }
        let [linear, angular] = self.sigmas;
        let per_second = self.period_s.recip();
        // A line through n frames lags half of them behind a bend.
        let behind_s =
            if expected.frames < BEND_FROM { 0.5 * (f64::from(expected.frames) + 1.0) * self.period_s } else { 0.0 };
        let sigma = |pose: f64, acceleration: f64| {
            let noise = libm::sqrt(expected.step_variance) * pose * per_second;
            libm::hypot(noise, acceleration * behind_s)
        };
        MotionPrior {
            twist: expected.twist,
            linear_sigma_m_per_s: sigma(linear, ACCELERATION_M_PER_S2),
            angular_sigma_rad_per_s: sigma(angular, ANGULAR_ACCELERATION_RAD_PER_S2),
        }
    }
}

/// Of a tool that moved with `twist` and may do anything now.
fn unknown_motion(twist: &Twist) -> MotionPrior {
    MotionPrior {
        twist: Twist::default(),
        linear_sigma_m_per_s: UNKNOWN_LINEAR_M_PER_S.max(twist.linear_m_per_s.length()),
        angular_sigma_rad_per_s: UNKNOWN_ANGULAR_RAD_PER_S.max(twist.angular_rad_per_s.length()),
    }
}
