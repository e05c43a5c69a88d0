//! Who solves.

use std::hint::black_box;

use slitpose_model::{Photocurrents, Pose, Scene, SceneError};

use crate::levenberg_marquardt;
use crate::ours::Ours;
use crate::problems::{Kind, Problem};
use crate::tiny_solver::TinySolver;

#[derive(Clone, Copy, Debug)]
pub struct Answer {
    pub pose: Pose,
    /// Covariance of its perturbation (δt, δθ): m², m·rad, rad².
    pub covariance: [[f64; 6]; 6],
    pub steps: usize,
}

/// Problems that one contender solves before it is the next one's turn.
pub struct Stretch<'a> {
    pub problems: &'a [Problem],
    /// Their currents alone.
    pub readings: Vec<Photocurrents>,
    pub starts: Vec<Pose>,
}

impl<'a> Stretch<'a> {
    pub fn of(problems: &'a [Problem]) -> Self {
        let readings = problems.iter().map(|problem| problem.readings.clone()).collect();
        Self { problems, readings, starts: problems.iter().map(|problem| problem.start).collect() }
    }
}

/// A way to find a pose.
pub trait Contender {
    /// What it is called in tables and on the command line.
    fn name(&self) -> &'static str;
    fn solve(&self, problem: &Problem) -> Answer;
    fn solve_all(&self, stretch: &Stretch<'_>) {
        for problem in stretch.problems {
            black_box(self.solve(black_box(problem)));
        }
    }
}

/// All that take part in problems of `kind`; the first is the measure of the others.
pub fn all(scene: &Scene, kind: Kind) -> Result<Vec<Box<dyn Contender>>, SceneError> {
    Ok(vec![
        Box::new(Ours::new(scene, kind)?),
        Box::new(TinySolver::new(scene)),
        Box::new(levenberg_marquardt::Crate::new(scene)?),
    ])
}
