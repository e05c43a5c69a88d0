//! Fewer cells than the scene has: the others are missing, not dark.

use std::fmt;

use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use slitpose_model::{MotionPrior, Photocurrents, Reading, Scene, Solver, Start, Tier};

use super::data::{Disturbance, lit_count, measured, pairs};
use super::tally::{Case, Tally, Verdict, WRONG_SIGMAS, list};
use super::trials::Trials;
use super::{HALF_DEG, HALF_MM};
use crate::poses::{one_in_box, pose};

/// What came out.
#[derive(Clone, Debug)]
pub struct Report {
    cells: usize,
    trials: Trials,
    tier: Tier,
    /// Outcomes.
    pub tally: Tally,
    /// Wrong poses.
    pub failures: Vec<Case>,
}

/// Takes random cells away until `left` remain.
pub fn thin_out(readings: &mut Photocurrents, left: usize, rng: &mut ChaCha8Rng) {
    let mut present: Vec<usize> = (0..readings.cells.len()).collect();
    while present.len() > left {
        let missing = present.swap_remove(rng.random_range(0..present.len()));
        readings.cells[missing] = Reading::Missing;
    }
}

/// Solves for random poses of the box at which no cell is faint, from `cells` random cells with
/// the scene's noise.
///
/// # Panics
/// If the scene cannot be compiled.
pub fn study(scene: &Scene, tier: Tier, cells: usize, trials: Trials) -> Report {
    let solver = Solver::<f64>::new(scene, tier).unwrap_or_else(|error| panic!("{error}"));
    let disturbance = Disturbance::of(scene);
    let cases = trials.run(|trial, rng| {
        loop {
            let row = one_in_box(rng, HALF_MM, HALF_DEG);
            let pairs = pairs(solver.plan(), &pose(row));
            if lit_count(scene, &pairs) == scene.cells.len() {
                let mut readings = measured(&disturbance, &pairs, rng);
                thin_out(&mut readings, cells, rng);
                return Case::new(trial, row, solver.solve(&readings, Start::Cold, &MotionPrior::AT_REST));
            }
        }
    });
    Report {
        cells,
        trials,
        tier,
        tally: Tally::of(&cases, Case::by_sigmas),
        failures: cases
            .iter()
            .copied()
            .filter(|case| case.error.is_some() && case.by_sigmas() == Verdict::Wrong)
            .collect(),
    }
}

impl fmt::Display for Report {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { cells, trials: Trials { count, seed }, tier, .. } = self;
        writeln!(f, "subsets, {cells} random cells of six, {tier:?}, ±{HALF_MM} mm ±{HALF_DEG}°, noise of the scene")?;
        writeln!(f, "  {count} poses, seed {seed}; wrong: beyond {WRONG_SIGMAS} σ")?;
        write!(f, "{}", self.tally)?;
        list(f, "wrong poses", &self.failures)
    }
}
