//! slitpose itself.

use slitpose_model::{MotionPrior, Scene, SceneError, Solver, Start, Tier};

use crate::contender::{Answer, Contender};
use crate::problems::{Kind, Problem};

/// slitpose's solver, everything included: χ² gates, rank, covariance.
pub struct Ours {
    solver: Solver<f64>,
    cold: bool,
}

impl Ours {
    /// For problems of `kind`.
    pub fn new(scene: &Scene, kind: Kind) -> Result<Self, SceneError> {
        Ok(Self { solver: Solver::new(scene, Tier::Paper)?, cold: kind.is_cold() })
    }
}

impl Contender for Ours {
    fn name(&self) -> &'static str {
        "slitpose"
    }

    fn solve(&self, problem: &Problem) -> Answer {
        let start = if self.cold { Start::Cold } else { Start::Near(&problem.start) };
        let solution = self.solver.solve(&problem.readings, start, &MotionPrior::AT_REST);
        // A solve without a pose counts as one that stayed where it was.
        let (pose, covariance) = match &solution.estimate {
            Some(estimate) => (estimate.pose, estimate.covariance),
            None => (problem.start, [[f64::NAN; 6]; 6]),
        };
        Answer { pose, covariance, steps: solution.iterations }
    }
}
