//! Errors against the Cramér–Rao bound, and against the covariance that comes with each pose.

use std::fmt;

use slitpose_model::{AXES, MotionPrior, Scene, Solver, Start, Tier, Uncertainty};

use super::data::{Disturbance, displaced_pairs, lit_count, measured, pairs};
use super::layout::Table;
use super::tally::{Case, Tally, Verdict, list};
use super::trials::Trials;
use super::{HALF_DEG, HALF_MM};
use crate::consistency::{nees, sigma};
use crate::poses::{one_in_box, pose};
use crate::statistics::median;

/// What is studied.
#[derive(Clone, Debug)]
pub struct Conditions {
    /// What is unknown besides noise.
    pub name: &'static str,
    /// The scene, its noise and its uncertainty: data are drawn by it, and the solver is told.
    pub scene: Scene,
    /// For data and solver.
    pub tier: Tier,
    /// Half sides of the box of poses.
    pub half_mm: f64,
    /// See `half_mm`.
    pub half_deg: f64,
}

impl Conditions {
    /// `scene` with `uncertainty`, in the paper tier, over the usual workspace.
    pub fn new(name: &'static str, scene: &Scene, uncertainty: Uncertainty) -> Self {
        let scene = Scene { uncertainty, ..scene.clone() };
        Self { name, scene, tier: Tier::Paper, half_mm: HALF_MM, half_deg: HALF_DEG }
    }
}

/// What came out.
#[derive(Clone, Debug)]
pub struct Report {
    conditions: Conditions,
    trials: Trials,
    /// Outcomes.
    pub tally: Tally,
    /// Solves without pose or with a wrong one.
    pub failures: Vec<Case>,
    /// Root mean square of error/bound, per axis.
    pub ratio: [f64; 6],
    /// Mean of eᵀC⁻¹e; 6 for an honest covariance.
    pub nees: f64,
    /// Median σ by the bound, per axis: m and rad.
    pub bound: [f64; 6],
}

/// One solve: its case, and what the bound says there.
struct Trial {
    case: Case,
    bound: Option<[f64; 6]>,
}

/// Solves for random poses of the box at which no cell is faint.
///
/// # Panics
/// If the scene cannot be compiled.
pub fn study(conditions: Conditions, trials: Trials) -> Report {
    let Conditions { scene, tier, half_mm, half_deg, .. } = &conditions;
    let solver = Solver::<f64>::new(scene, *tier).unwrap_or_else(|error| panic!("{error}"));
    let disturbance = Disturbance::of(scene);
    let solved = trials.run(|trial, rng| {
        loop {
            let row = one_in_box(rng, *half_mm, *half_deg);
            let pairs = pairs(solver.plan(), &pose(row));
            if lit_count(scene, &pairs) == scene.cells.len() {
                let position_m = scene.uncertainty.position_m;
                let pairs =
                    if position_m > 0.0 { displaced_pairs(solver.plan(), &pose(row), position_m, rng) } else { pairs };
                let case = Case::new(
                    trial,
                    row,
                    solver.solve(&measured(&disturbance, &pairs, rng), Start::Cold, &MotionPrior::AT_REST),
                );
                return Trial { case, bound: solver.bound(&pose(row)).map(|bound| sigma(&bound)) };
            }
        }
    });
    let right: Vec<(&Case, [f64; 6])> = solved
        .iter()
        .filter(|trial| trial.case.by_sigmas() == Verdict::Right)
        .filter_map(|trial| Some((&trial.case, trial.bound?)))
        .collect();
    let mean_over = |value: &dyn Fn(&Case, &[f64; 6]) -> f64| {
        right.iter().map(|(case, bound)| value(case, bound)).sum::<f64>() / right.len() as f64
    };
    let in_bounds = |axis: usize| {
        mean_over(&|case, bound| case.error.map_or(0.0, |error| (error[axis] / bound[axis]).powi(2))).sqrt()
    };
    let own_nees = |case: &Case, _: &[f64; 6]| match (case.error, case.solution.estimate) {
        (Some(error), Some(estimate)) => nees(&error, &estimate.covariance),
        _ => 0.0,
    };
    Report {
        tally: Tally::of(solved.iter().map(|trial| &trial.case), Case::by_sigmas),
        failures: solved.iter().map(|trial| trial.case).filter(|case| case.by_sigmas() == Verdict::Wrong).collect(),
        ratio: std::array::from_fn(in_bounds),
        nees: mean_over(&own_nees),
        bound: std::array::from_fn(|axis| median(right.iter().map(|(_, bound)| bound[axis]))),
        conditions,
        trials,
    }
}

impl fmt::Display for Report {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Conditions { name, tier, half_mm, half_deg, .. } = &self.conditions;
        let Trials { count, seed } = self.trials;
        let n = count as f64;
        writeln!(f, "efficiency, {name}, {tier:?}, ±{half_mm} mm ±{half_deg}°, all cells lit, noise of the scene")?;
        writeln!(f, "  {count} poses, seed {seed}")?;
        let mut table = Table::new(&["axis", "median bound", "RMSE/bound"]);
        for axis in 0..6 {
            let unit = if axis < 3 { "µm" } else { "µrad" };
            let bound = format!("{:.3} {unit}", self.bound[axis] * 1e6);
            table.row([AXES[axis].to_owned(), bound, format!("{:.4}", self.ratio[axis])]);
        }
        write!(f, "{table}{}", self.tally)?;
        let (of_ratio, of_nees) = ((2.0 * n).sqrt().recip(), (12.0 / n).sqrt());
        writeln!(f, "  σ of a ratio by chance {of_ratio:.4}; NEES mean {:.3}, σ by chance {of_nees:.3}", self.nees)?;
        list(f, "failures", &self.failures)
    }
}
