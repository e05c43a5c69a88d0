//! Noise-free data, and no idea where the tool is: the true pose, to the digits the tier gives.

use std::fmt;

use slitpose_model::{MotionPrior, Outcome, Photocurrents, Scene, Solver, Start, Tier};

use super::data::{lit_count, pairs};
use super::tally::{Case, Tally, Verdict, list};
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
    /// A pose is right to so many mm and rad per axis.
    pub tolerance: f64,
}

/// Where data may be few, a pose is right, too, to this share of its σ: directions that are held
/// loosely magnify rounding. (A minimum next to another is flat, so rounding enters by its root.)
const RIGHT_SIGMAS: f64 = 1e-3;

/// Two solutions that the data tell apart by less than this are one to any solver. Where nothing is
/// redundant such twins do exist, and either may come out.
const NEAR_SIGMAS: f64 = 6.0;

impl Conditions {
    fn judge(&self, case: &Case) -> Verdict {
        let (mm, rad) = case.largest();
        let sigmas = if self.light == Light::Any { case.worst_sigmas() } else { None }.unwrap_or(f64::INFINITY);
        if mm.max(rad) <= self.tolerance || sigmas <= RIGHT_SIGMAS {
            Verdict::Right
        } else if sigmas <= NEAR_SIGMAS {
            Verdict::Near
        } else {
            Verdict::Wrong
        }
    }

    /// Where cells may be dark, no pose is an honest answer, except that nothing fits at all.
    fn is_failure(&self, case: &Case) -> bool {
        match self.judge(case) {
            Verdict::Right => false,
            _ if self.light == Light::All => true,
            _ if case.error.is_none() => case.solution.outcome == Outcome::Diverged,
            Verdict::Near => case.solution.redundancy > 0,
            Verdict::Wrong => true,
        }
    }
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
    let Conditions { scene, tier, half_mm, half_deg, light, .. } = &conditions;
    let solver = Solver::<f64>::new(scene, *tier).unwrap_or_else(|error| panic!("{error}"));
    let cases = trials.run(|trial, rng| {
        loop {
            let row = one_in_box(rng, *half_mm, *half_deg);
            let pairs = pairs(solver.plan(), &pose(row));
            if *light == Light::Any || lit_count(scene, &pairs) == scene.cells.len() {
                return Case::new(
                    trial,
                    row,
                    solver.solve(&Photocurrents::of_pairs(pairs), Start::Cold, &MotionPrior::AT_REST),
                );
            }
        }
    });
    let right = cases.iter().filter(|case| conditions.judge(case) == Verdict::Right).map(Case::largest);
    Report {
        tally: Tally::of(&cases, |case| conditions.judge(case)),
        failures: cases.iter().copied().filter(|case| conditions.is_failure(case)).collect(),
        worst: right.fold((0.0, 0.0), |worst, (mm, rad)| (worst.0.max(mm), worst.1.max(rad))),
        steps: cases.iter().map(|case| case.solution.iterations as f64).sum::<f64>() / trials.count as f64,
        conditions,
        trials,
    }
}

impl fmt::Display for Report {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Conditions { name, tier, half_mm, half_deg, light, tolerance, .. } = &self.conditions;
        let Trials { count, seed } = self.trials;
        let (lit, or) = match light {
            Light::All => ("all cells lit", String::new()),
            Light::Any => ("whatever is lit", format!(" or {RIGHT_SIGMAS} σ; near: within {NEAR_SIGMAS} σ")),
        };
        writeln!(f, "cold start, {name}, {tier:?}, ±{half_mm} mm ±{half_deg}°, {lit}, noise-free")?;
        writeln!(f, "  {count} poses, seed {seed}; right: within {tolerance:e} mm and rad{or}")?;
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
