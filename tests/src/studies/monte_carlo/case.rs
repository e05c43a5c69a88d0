//! What came of the solves: outcomes counted, right poses told from wrong ones, failures shown.

use std::collections::BTreeMap;
use std::fmt;

use slitpose_model::{Outcome, Solution};

use crate::consistency::{error, worst_axis};
use crate::poses::{self, PoseRow};
use crate::studies::Table;

/// A noisy pose this many of its σ from the truth, on any axis, is another pose.
const WRONG_SIGMAS: f64 = 10.0;

/// One solve, with all that is needed to repeat it.
#[derive(Clone, Copy, Debug)]
pub struct Case {
    /// The trial's number under its seed.
    pub trial: usize,
    pub truth: PoseRow,
    pub solution: Solution,
    /// Error of the pose, m and rad, if there is one.
    pub error: Option<[f64; 6]>,
}

impl Case {
    pub fn new(trial: usize, truth: PoseRow, solution: Solution) -> Self {
        let error = solution.estimate.map(|estimate| error(&estimate.pose, &poses::pose(truth)));
        Self { trial, truth, solution, error }
    }

    /// Largest error of a translation, mm, and of a rotation, rad; infinite without pose.
    pub fn largest(&self) -> (f64, f64) {
        let largest = |values: &[f64]| values.iter().fold(0.0, |largest, value| f64::max(largest, value.abs()));
        self.error.map_or((f64::INFINITY, f64::INFINITY), |error| (largest(&error[..3]) * 1e3, largest(&error[3..])))
    }

    /// Largest error in units of the reported σ; `None` without pose.
    pub fn worst_sigmas(&self) -> Option<f64> {
        self.solution.estimate.map(|estimate| worst_axis(&estimate, &poses::pose(self.truth)))
    }

    /// For noisy data: a pose beyond [`WRONG_SIGMAS`] is wrong, and so is none.
    pub fn by_sigmas(&self) -> Kind {
        match self.worst_sigmas() {
            Some(sigmas) if sigmas < WRONG_SIGMAS => Kind::Right,
            _ => Kind::Wrong,
        }
    }

    /// The outcome in words, weakness included.
    fn outcome(&self) -> String {
        match self.solution.outcome {
            Outcome::Degraded(weakness) => format!("degraded: {weakness:?}"),
            outcome => outcome.as_str().to_owned(),
        }
    }
}

impl fmt::Display for Case {
    /// The pose in full digits, and what came out.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Solution { chi2, redundancy, iterations, cells_used, .. } = self.solution;
        writeln!(f, "    trial {} at {:?} (mm, rad)", self.trial, self.truth)?;
        let (outcome, cells) = (self.outcome(), cells_used.count());
        write!(f, "      {outcome}: {cells} cells, χ² {chi2:.3e} of {redundancy}, {iterations} steps")?;
        let (mm, rad) = self.largest();
        self.worst_sigmas().map_or(Ok(()), |worst| write!(f, "; error {mm:.1e} mm {rad:.1e} rad, {worst:.3} σ"))
    }
}

/// What a pose is worth.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    Right,
    /// Off, but by no more than the data leave open.
    Near,
    /// Another pose.
    Wrong,
}

/// How many solves ended with one outcome: with the right pose, one nearby, a wrong one, and none.
#[derive(Clone, Copy, Debug, Default)]
pub struct Count {
    pub right: usize,
    pub near: usize,
    pub wrong: usize,
    pub without: usize,
}

/// Outcomes counted by their words and the number of cells used.
#[derive(Clone, Debug, Default)]
pub struct Tally(BTreeMap<(String, usize), Count>);

impl Tally {
    /// Counts `cases`; `judge` is asked of those with a pose.
    pub fn of<'a>(cases: impl IntoIterator<Item = &'a Case>, judge: impl Fn(&Case) -> Kind) -> Self {
        let mut tally = Self::default();
        for case in cases {
            let count = tally.0.entry((case.outcome(), case.solution.cells_used.count())).or_default();
            match case.error.map(|_| judge(case)) {
                None => count.without += 1,
                Some(Kind::Right) => count.right += 1,
                Some(Kind::Near) => count.near += 1,
                Some(Kind::Wrong) => count.wrong += 1,
            }
        }
        tally
    }

    /// What ended with `outcome`, from any number of cells.
    pub fn count(&self, outcome: &str) -> Count {
        let mut sum = Count::default();
        for (_, count) in self.0.iter().filter(|((of, _), _)| of == outcome) {
            sum.right += count.right;
            sum.near += count.near;
            sum.wrong += count.wrong;
            sum.without += count.without;
        }
        sum
    }
}

impl fmt::Display for Tally {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let mut table = Table::new(&["outcome", "cells", "right", "near", "wrong", "no pose"]);
        for ((outcome, cells), count) in &self.0 {
            let numbers = [*cells, count.right, count.near, count.wrong, count.without];
            table.row([outcome.clone()].into_iter().chain(numbers.map(|number| number.to_string())));
        }
        table.fmt(f)
    }
}

/// How many failures are shown: the rest is the same again.
const SHOWN: usize = 40;

pub fn print_failures(what: &str, cases: &[&Case]) {
    if !cases.is_empty() {
        println!("  {what}: {}, of which", cases.len());
        cases.iter().take(SHOWN).for_each(|case| println!("{case}"));
    }
}
