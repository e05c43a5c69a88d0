//! slitpose itself.

use std::hint::black_box;
use std::slice::from_ref;
use std::time::Instant;

use slitpose_model::{Batch, MotionPrior, Scene, SceneError, Solution, Solver, Start, Starts, Tier};

use crate::contender::{Answer, Contender, Stretch};
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

/// slitpose's solver for many problems at once, in the widest lanes of the processor.
pub struct AtOnce {
    solver: Solver<f64>,
    cold: bool,
}

impl AtOnce {
    /// For problems of `kind`.
    pub fn new(scene: &Scene, kind: Kind) -> Result<Self, SceneError> {
        Ok(Self { solver: Solver::new(scene, Tier::Paper)?, cold: kind.is_cold() })
    }

    /// Microseconds per solve, over all threads, with `threads` of them that solve all of `problems` each: the least of
    /// `rounds`.
    pub fn time_us(&self, problems: &[Problem], threads: usize, rounds: usize) -> f64 {
        let stretch = Stretch::of(problems);
        let round = || {
            let since = Instant::now();
            std::thread::scope(|scope| {
                for _ in 0..threads {
                    scope.spawn(|| self.solve_all(&stretch));
                }
            });
            since.elapsed().as_secs_f64() * 1e6 / (threads * problems.len()) as f64
        };
        (0..rounds).map(|_| round()).fold(f64::INFINITY, f64::min)
    }
}

impl Contender for AtOnce {
    fn name(&self) -> &'static str {
        "slitpose-batch"
    }

    fn solve(&self, problem: &Problem) -> Answer {
        let start = if self.cold { Starts::Cold } else { Starts::Near(from_ref(&problem.start)) };
        let mut found = None;
        let readings = from_ref(&problem.readings);
        Batch::new(&self.solver).solve(readings, start, &MotionPrior::AT_REST, |_, solution| found = Some(solution));
        answer(&found.expect("a solution of one frame"), problem)
    }

    fn solve_all(&self, stretch: &Stretch<'_>) {
        let starts = if self.cold { Starts::Cold } else { Starts::Near(&stretch.starts) };
        Batch::new(&self.solver).solve(black_box(&stretch.readings), starts, &MotionPrior::AT_REST, |_, solution| {
            black_box(solution);
        });
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
