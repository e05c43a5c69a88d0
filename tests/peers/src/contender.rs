//! Who solves.

use std::hint::black_box;

use slitpose_model::Pose;

use crate::problems::Problem;

#[derive(Clone, Copy, Debug)]
pub struct Answer {
    pub pose: Pose,
    /// Covariance of its perturbation (δt, δθ): m², m·rad, rad².
    pub covariance: [[f64; 6]; 6],
    pub steps: usize,
}

/// A way to find a pose.
pub trait Contender {
    /// What it is called in tables and on the command line.
    fn name(&self) -> &'static str;
    fn solve(&self, problem: &Problem) -> Answer;
    /// Solves some before it is the next one's turn.
    fn solve_all(&self, problems: &[Problem]) {
        for problem in problems {
            black_box(self.solve(black_box(problem)));
        }
    }
}
