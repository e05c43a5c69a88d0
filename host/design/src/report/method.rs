//! One way to solve, out of many.

use slitpose_model::{
    self as model, MotionPrior, Outcome, Photocurrents, Pose, Scalar, Scene, SceneError, Solution, Solver, Tier,
};

/// The number type that is computed with: `f64`, or `f32` as on the board.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Precision {
    Double,
    Single,
}

impl Precision {
    pub(super) const BOTH: [Self; 2] = [Self::Double, Self::Single];

    pub(super) fn name(self) -> &'static str {
        match self {
            Self::Double => "f64",
            Self::Single => "f32",
        }
    }

    /// The exact tier at the tightest tolerance that is of use: a solver weighs by it, and stops when
    /// it has come so near. Asked for more, `f32` divides spots for ever without coming nearer.
    pub(super) fn tightest_tier(self) -> Tier {
        match self {
            Self::Double => Tier::Exact { tolerance: 1e-15 },
            Self::Single => Tier::Exact { tolerance: 1e-6 },
        }
    }

    pub(super) fn unit_roundoff(self) -> f64 {
        match self {
            Self::Double => 0.5 * f64::EPSILON,
            Self::Single => 0.5 * f64::from(f32::EPSILON),
        }
    }
}

/// What a solve starts from: nothing, or a pose near the truth, as from the frame before.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Start {
    Cold,
    Warm,
}

impl Start {
    pub(super) const BOTH: [Self; 2] = [Self::Cold, Self::Warm];

    pub(super) fn name(self) -> &'static str {
        match self {
            Self::Cold => "cold",
            Self::Warm => "warm",
        }
    }
}

/// How far a solve goes: to the pose on the planes, at most so many steps, or to the end.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Effort {
    Planes,
    Steps(usize),
    Full,
}

impl Effort {
    pub(super) fn name(self) -> String {
        match self {
            Self::Planes => "planes".to_owned(),
            Self::Steps(1) => "1 step".to_owned(),
            Self::Steps(steps) => format!("{steps} steps"),
            Self::Full => "full".to_owned(),
        }
    }
}

#[derive(Clone, Copy, Debug)]
pub(super) struct Method {
    pub(super) tier: Tier,
    pub(super) precision: Precision,
    pub(super) start: Start,
    pub(super) effort: Effort,
}

/// A solution without its number type.
#[derive(Clone, Copy, Debug)]
pub(super) struct Solved {
    pub(super) outcome: Outcome,
    pub(super) pose: Option<Pose>,
    pub(super) iterations: usize,
}

impl<S: Scalar> From<Solution<S>> for Solved {
    fn from(solution: Solution<S>) -> Self {
        let Solution { outcome, estimate, iterations, .. } = solution;
        Self { outcome, pose: estimate.map(|estimate| estimate.pose), iterations }
    }
}

/// A method compiled for a scene: photocurrents and a pose to start from in, a pose out.
pub(super) type Compiled = Box<dyn Fn(&Photocurrents, &Pose) -> Solved>;

impl Method {
    /// For the cells of `scene`, all exposed at one instant.
    pub(super) fn compile(&self, scene: &Scene) -> Result<Compiled, SceneError> {
        match self.precision {
            Precision::Double => self.compile_for::<f64>(scene),
            Precision::Single => self.compile_for::<f32>(scene),
        }
    }

    fn compile_for<S: Scalar>(&self, scene: &Scene) -> Result<Compiled, SceneError> {
        let mut solver = Solver::<S>::new(scene, self.tier)?;
        if let Effort::Steps(steps) = self.effort {
            solver = solver.with_max_steps(steps);
        }
        let Self { start, effort, .. } = *self;
        Ok(Box::new(move |readings, prior| {
            let start = match (start, effort) {
                (_, Effort::Planes) => model::Start::PlanesOnly,
                (Start::Cold, _) => model::Start::Cold,
                (Start::Warm, _) => model::Start::Near(prior),
            };
            solver.solve(&readings.rounded(), start, &MotionPrior::AT_REST).into()
        }))
    }
}

/// The word for a tier in tables.
pub(super) fn tier_name(tier: Tier) -> String {
    match tier {
        Tier::Paper => "paper".to_owned(),
        Tier::Exact { tolerance } => format!("exact {tolerance:e}"),
    }
}
