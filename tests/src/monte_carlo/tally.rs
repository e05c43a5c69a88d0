//! What came of the solves: outcomes counted, right poses told from wrong ones, failures kept.

use std::collections::BTreeMap;
use std::fmt;

use slitpose_model::{Outcome, Solution};

use super::layout::Table;
use crate::consistency::{error, sigma};
use crate::poses::{self, PoseRow};

/// One solve, with all that is needed to repeat it.
#[derive(Clone, Copy, Debug)]
pub struct Case {
    /// The trial's number under its seed.
    pub trial: usize,
    /// The true pose.
    pub truth: PoseRow,
    /// What the solver said.
    pub solution: Solution,
    /// Error of the pose, m and rad, if there is one.
    pub error: Option<[f64; 6]>,
    /// What was done to the data, in σ; 0: nothing.
    pub lie_sigmas: f64,
    /// The χ² that is left at the pose that suits the lie best, were the optics linear.
    pub least_chi2: f64,
}

impl Case {
    /// Of an honest solve.
    pub fn new(trial: usize, truth: PoseRow, solution: Solution) -> Self {
        let error = solution.estimate.map(|estimate| error(&estimate.pose, &poses::pose(truth)));
        Self { trial, truth, solution, error, lie_sigmas: 0.0, least_chi2: 0.0 }
    }

    /// Largest error of a translation, mm, and of a rotation, rad; infinite without pose.
    pub fn largest(&self) -> (f64, f64) {
        let largest = |values: &[f64]| values.iter().fold(0.0, |largest, value| f64::max(largest, value.abs()));
        self.error.map_or((f64::INFINITY, f64::INFINITY), |error| (largest(&error[..3]) * 1e3, largest(&error[3..])))
    }

    /// Errors in units of the reported σ.
    pub fn sigmas(&self) -> Option<[f64; 6]> {
        let sigma = sigma(&self.solution.estimate?.covariance);
        self.error.map(|error| std::array::from_fn(|axis| error[axis] / sigma[axis]))
    }

    /// The largest of them; `None` without pose.
    pub fn worst_sigmas(&self) -> Option<f64> {
        self.sigmas().map(|sigmas| sigmas.iter().fold(0.0, |worst, value| f64::max(worst, value.abs())))
    }

    /// The outcome in words, weakness included.
    pub fn outcome(&self) -> String {
        match self.solution.outcome {
            Outcome::Degraded(weakness) => format!("degraded: {weakness:?}"),
            outcome => outcome.as_str().to_owned(),
        }
    }
}

impl fmt::Display for Case {
    /// Two lines: the pose in full digits, and what came out.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Solution { chi2, redundancy, iterations, cells_used, .. } = self.solution;
        writeln!(f, "    trial {} at {:?} (mm, rad)", self.trial, self.truth)?;
        write!(
            f,
            "      {}: {} cells, χ² {chi2:.3e} of {redundancy}, {iterations} steps",
            self.outcome(),
            cells_used.count()
        )?;
        if self.lie_sigmas > 0.0 {
            write!(f, ", lie {:.1} σ, least χ² {:.1}", self.lie_sigmas, self.least_chi2)?;
        }
        if let (Some(error), Some(sigmas)) = (self.error, self.sigmas()) {
            write!(f, "; error {:.1e} mm {:.1e} rad", self.largest().0, self.largest().1)?;
            if error.iter().any(|&value| value != 0.0) {
                write!(f, ", in σ [")?;
                for (axis, value) in sigmas.iter().enumerate() {
                    write!(f, "{}{value:.3}", if axis == 0 { "" } else { ", " })?;
                }
                write!(f, "]")?;
            }
        }
        Ok(())
    }
}

/// How many solves ended with one outcome.
#[derive(Clone, Copy, Debug, Default)]
pub struct Count {
    /// With the right pose.
    pub right: usize,
    /// With a wrong one.
    pub wrong: usize,
    /// With none.
    pub without: usize,
}

/// Outcomes counted by their words.
#[derive(Clone, Debug, Default)]
pub struct Tally(BTreeMap<String, Count>);

impl Tally {
    /// Counts `cases`; `is_right` judges those with a pose.
    pub fn of<'a>(cases: impl IntoIterator<Item = &'a Case>, is_right: impl Fn(&Case) -> bool) -> Self {
        let mut tally = Self::default();
        for case in cases {
            let count = tally.0.entry(case.outcome()).or_default();
            match case.error {
                None => count.without += 1,
                Some(_) if is_right(case) => count.right += 1,
                Some(_) => count.wrong += 1,
            }
        }
        tally
    }

    /// What ended with `outcome`.
    pub fn count(&self, outcome: &str) -> Count {
        self.0.get(outcome).copied().unwrap_or_default()
    }

    /// All outcomes together.
    pub fn total(&self) -> Count {
        self.0.values().fold(Count::default(), |sum, count| Count {
            right: sum.right + count.right,
            wrong: sum.wrong + count.wrong,
            without: sum.without + count.without,
        })
    }
}

impl fmt::Display for Tally {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let mut table = Table::new(&["outcome", "right", "wrong", "no pose"]);
        for (outcome, count) in &self.0 {
            table.row([outcome.clone(), count.right.to_string(), count.wrong.to_string(), count.without.to_string()]);
        }
        table.fmt(f)
    }
}

/// How many failures a report prints: the rest is the same again.
const SHOWN: usize = 40;

/// Prints `cases` one by one, up to a number that can be read.
pub fn list(f: &mut fmt::Formatter<'_>, what: &str, cases: &[Case]) -> fmt::Result {
    if !cases.is_empty() {
        writeln!(f, "  {what}: {}", cases.len())?;
    }
    for case in cases.iter().take(SHOWN) {
        writeln!(f, "{case}")?;
    }
    if cases.len() > SHOWN {
        writeln!(f, "    … and {} more", cases.len() - SHOWN)?;
    }
    Ok(())
}
