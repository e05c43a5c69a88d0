//! slitpose itself.

use slitpose_model::{MotionPrior, Scene, SceneError, Solution, Solver, Start, Tier};

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
        let solution = if self.cold {
            self.solver.solve(&problem.readings, Start::Cold, &MotionPrior::AT_REST)
        } else {
            self.solver.solve(&problem.readings, Start::Near(&problem.start), &MotionPrior::AT_REST)
        };
        answer(&solution, problem)
    }
}

/// slitpose's solver, stopped at the pose on the planes: what the peers' better start costs.
pub struct Planes {
    solver: Solver<f64>,
}

impl Planes {
    /// For cold problems.
    pub fn new(scene: &Scene) -> Result<Self, SceneError> {
        Ok(Self { solver: Solver::new(scene, Tier::Paper)? })
    }
}

impl Contender for Planes {
    fn name(&self) -> &'static str {
        "slitpose-planes"
    }

    fn solve(&self, problem: &Problem) -> Answer {
        answer(&self.solver.solve(&problem.readings, Start::PlanesOnly, &MotionPrior::AT_REST), problem)
    }
}

/// A solve without a pose counts as one that stayed where it was.
fn answer(solution: &Solution, problem: &Problem) -> Answer {
    match &solution.estimate {
        Some(estimate) => Answer { pose: estimate.pose, covariance: estimate.covariance, steps: solution.iterations },
        None => Answer { pose: problem.start, covariance: [[f64::NAN; 6]; 6], steps: solution.iterations },
    }
}
