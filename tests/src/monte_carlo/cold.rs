//! Noise-free data, and no idea where the tool is: the true pose, to the digits the tier gives.

use std::fmt;

use slitpose_model::{Photocurrents, Scene, Solver, Tier};

use super::data::{lit_count, pairs};
use super::tally::{Case, Tally, list};
use super::trials::Trials;
use crate::poses::{one_in_box, pose};

/// Which poses are drawn.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Light {
    /// Those at which no cell is faint; clipped spots are not.
    All,
    /// Any.
    Any,
}

/// What is studied.
#[derive(Clone, Debug)]
pub struct Conditions {
    /// Name of the scene.
    pub name: &'static str,
    /// The scene.
    pub scene: Scene,
    /// For data and solver.
    pub tier: Tier,
    /// Half sides of the box of poses.
    pub half_mm: f64,
    /// See `half_mm`.
    pub half_deg: f64,
    /// Which of the box.
    pub light: Light,
    /// A pose is right to so many mm and rad per axis…
    pub tolerance: f64,
    /// …or to so many of its own σ, for poses that the data hold loosely.
    pub tolerance_sigmas: f64,
}

/// What came out.
#[derive(Clone, Debug)]
pub struct Report {
    conditions: Conditions,
    trials: Trials,
    /// Outcomes.
    pub tally: Tally,
    /// Solves that did not end with the right pose, or with less light a word for it.
    pub failures: Vec<Case>,
    /// Largest error of the right poses, mm and rad.
    pub worst: (f64, f64),
    /// Mean number of refinement steps.
    pub steps: f64,
}

impl Report {
    /// Share of poses that were found.
    pub fn share(&self) -> f64 {
        self.tally.total().right as f64 / self.trials.count as f64
    }
}

/// Solves for random poses.
///
/// # Panics
/// If the scene cannot be compiled.
pub fn study(conditions: Conditions, trials: Trials) -> Report {
    let Conditions { scene, tier, half_mm, half_deg, light, tolerance, tolerance_sigmas, .. } = &conditions;
    let solver = Solver::<f64>::new(scene, *tier).unwrap_or_else(|error| panic!("{error}"));
    let cases = trials.run(|trial, rng| {
        loop {
            let row = one_in_box(rng, *half_mm, *half_deg);
            let pairs = pairs(solver.plan(), &pose(row));
            if *light == Light::Any || lit_count(scene, &pairs) == scene.cells.len() {
                return Case::new(trial, row, solver.solve(&Photocurrents::of_pairs(pairs)));
            }
        }
    });
    let is_right = |case: &Case| {
        let (mm, rad) = case.largest();
        mm.max(rad) <= *tolerance || case.worst_sigmas().is_some_and(|sigmas| sigmas <= *tolerance_sigmas)
    };
    let (right, other): (Vec<Case>, Vec<Case>) = cases.iter().copied().partition(is_right);
    // Where cells may be dark, no pose is an honest answer, except that nothing fits at all.
    let failures = other.into_iter().filter(|case| {
        *light == Light::All || case.error.is_some() || case.outcome() == slitpose_model::Outcome::Diverged.as_str()
    });
    Report {
        tally: Tally::of(&cases, is_right),
        failures: failures.collect(),
        worst: right.iter().map(Case::largest).fold((0.0, 0.0), |worst, (mm, rad)| (worst.0.max(mm), worst.1.max(rad))),
        steps: cases.iter().map(|case| case.solution.iterations as f64).sum::<f64>() / trials.count as f64,
        conditions,
        trials,
    }
}

impl fmt::Display for Report {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Conditions { name, tier, half_mm, half_deg, light, tolerance, tolerance_sigmas, .. } = &self.conditions;
        let Trials { count, seed } = self.trials;
        let light = if *light == Light::All { "all cells lit" } else { "whatever is lit" };
        writeln!(f, "cold start, {name}, {tier:?}, ±{half_mm} mm ±{half_deg}°, {light}, noise-free")?;
        writeln!(f, "  {count} poses, seed {seed}; right: within {tolerance:e} mm and rad, or {tolerance_sigmas} σ")?;
        write!(f, "{}", self.tally)?;
        let (mm, rad) = self.worst;
        writeln!(
            f,
            "  found {:.4} %, worst {mm:.1e} mm {rad:.1e} rad, {:.2} steps on average",
            100.0 * self.share(),
            self.steps
        )?;
        list(f, "failures", &self.failures)
    }
}
