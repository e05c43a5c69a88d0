//! What is solved: currents of random poses of the scene `wide`, paper tier.

use clap::ValueEnum;
use glam::DVec3;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use slitpose_model::{
    CompiledScene, MotionPrior, Pair, Photocurrents, Pose, Scene, SceneError, Solver, Start, Status, Tier,
};

use crate::common;
use crate::levenberg_marquardt;
use crate::weights::{CELLS, CellNoise};

/// Poses lie within ± this of home, on every axis.
pub const BOX_MM: f64 = 4.0;
/// See [`BOX_MM`].
pub const BOX_DEG: f64 = 15.0;

/// A prior is off by this on every axis, up or down.
pub const PRIOR_M: f64 = 3e-6;
/// See [`PRIOR_M`].
pub const PRIOR_RAD: f64 = 0.3e-3;

/// What is known beforehand, and what is measured.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Kind {
    /// Nothing known, no noise; peers start at home.
    Cold,
    /// As cold, but peers start, for nothing, from the pose on slitpose's planes.
    Planes,
    /// As planes, with the noise of the scene.
    ColdNoisy,
    /// As cold, with the noise of the scene.
    HomeNoisy,
    /// A pose nearby known, no noise.
    Warm,
    /// As warm, with the noise of the scene.
    WarmNoisy,
}

#[derive(Clone, Debug)]
pub struct Problem {
    /// The currents, amperes.
    pub pairs: [Pair<f64>; CELLS],
    pub readings: Photocurrents,
    pub start: Pose,
    /// The pose of the least χ²: without noise the true one.
    pub minimum: Pose,
}

impl Kind {
    /// Every kind, in the order of the tables.
    pub const ALL: [Self; 6] =
        [Self::Cold, Self::Planes, Self::ColdNoisy, Self::HomeNoisy, Self::Warm, Self::WarmNoisy];

    /// Whether slitpose is told nothing of the pose.
    pub fn is_cold(self) -> bool {
        matches!(self, Self::Cold | Self::Planes | Self::ColdNoisy | Self::HomeNoisy)
    }

    fn is_noisy(self) -> bool {
        matches!(self, Self::ColdNoisy | Self::HomeNoisy | Self::WarmNoisy)
    }

    /// What stands above the table.
    pub fn heading(self) -> String {
        let planes = "cold: peers start, for nothing, from the pose on slitpose's planes";
        let warm = format!("warm: start off by {} um and {} mrad on each axis", PRIOR_M * 1e6, PRIOR_RAD * 1e3);
        match self {
            Self::Cold => "cold: nothing known, peers start at home; no noise".into(),
            Self::Planes => format!("{planes}; no noise"),
            Self::ColdNoisy => format!("{planes}; noise of the scene"),
            Self::HomeNoisy => "cold: nothing known, peers start at home; noise of the scene".into(),
            Self::Warm => format!("{warm}; no noise"),
            Self::WarmNoisy => format!("{warm}; noise of the scene"),
        }
    }

    /// The first `count` problems of this kind; the same for the same `seed`.
    pub fn problems(self, scene: &Scene, seed: u64, count: usize) -> Result<Vec<Problem>, SceneError> {
        let plan = CompiledScene::<f64>::compile(scene, Tier::Paper)?;
        let solver = Solver::<f64>::new(scene, Tier::Paper)?;
        let noise = CellNoise::of(scene);
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let problems = (0..count).map(|_| {
            let truth = lit_pose(&mut rng, &plan);
            let mut sign = |size: f64| size.copysign(common::uniform(&mut rng, -1.0, 1.0));
            let shift = DVec3::from([0; 3].map(|_| sign(PRIOR_M)));
            let turn = DVec3::from([0; 3].map(|_| sign(PRIOR_RAD)));
            let mut pairs = core::array::from_fn(|cell| plan.photocurrents(cell, &truth));
            let mut minimum = truth;
            if self.is_noisy() {
                for (pair, noise) in pairs.iter_mut().zip(&noise) {
                    add_noise(&mut rng, pair, noise);
                }
                minimum = levenberg_marquardt::strict(&plan, &noise, &pairs, &truth);
            }
            let readings = Photocurrents::of_pairs(pairs);
            let start = match self {
                Self::Cold | Self::HomeNoisy => Pose::HOME,
                Self::Planes | Self::ColdNoisy => solver
                    .solve(&readings, Start::PlanesOnly, &MotionPrior::AT_REST)
                    .estimate
                    .map_or(Pose::HOME, |estimate| estimate.pose),
                Self::Warm | Self::WarmNoisy => truth.perturbed(shift, turn),
            };
            Problem { pairs, readings, start, minimum }
        });
        Ok(problems.collect())
    }
}

/// A pose in the box with the whole spot of every cell on its detector.
fn lit_pose(rng: &mut ChaCha8Rng, plan: &CompiledScene<f64>) -> Pose {
    loop {
        let pose = common::pose_in_box(rng, BOX_MM, BOX_DEG);
        if (0..CELLS).all(|cell| plan.respond(cell, &pose).status == Status::Lit) {
            return pose;
        }
    }
}

fn add_noise(rng: &mut ChaCha8Rng, pair: &mut Pair<f64>, noise: &CellNoise) {
    let [a, b, c] = noise.factor(pair);
    let (first, second): (f64, f64) = (StandardNormal.sample(rng), StandardNormal.sample(rng));
    pair.i_x1_a += a * first;
    pair.i_x2_a += b * first + c * second;
}
