//! What a case came to, and the table of all of them.

use std::collections::BTreeMap;

use slitpose_model::{DegradedReason, Outcome, Tier, Verified};

use super::{Conditions, Motion, Scan, Sight, WRONG_SIGMAS, most_lag_s};
use crate::monte_carlo::layout::Table;

/// What a case came to.
#[derive(Clone, Debug)]
pub struct Report {
    conditions: Conditions,
    runs: Vec<Vec<Scan>>,
    period_s: f64,
    besides_us: f64,
}

impl Report {
    pub(super) fn of(conditions: &Conditions, period_s: f64, runs: Vec<Vec<Scan>>) -> Self {
        Self { conditions: conditions.clone(), runs, period_s, besides_us: 0.0 }
    }

    /// With what each scan costs besides its tracker, µs.
    #[must_use]
    pub fn with_besides(self, besides_us: f64) -> Self {
        Self { besides_us, ..self }
    }

    fn scans(&self) -> impl Iterator<Item = &Scan> {
        self.runs.iter().flatten()
    }

    /// All scans but the first of each run, whose search may take as long as a cold solve.
    fn later(run: &[Scan]) -> &[Scan] {
        &run[1..]
    }

    /// Evaluations that the first scan of any run took at most.
    pub fn first_evaluations(&self) -> usize {
        self.runs.iter().map(|run| run[0].evaluations).max().unwrap_or(0)
    }

    /// Mean evaluations of the others.
    pub fn mean_evaluations(&self) -> f64 {
        let later = || self.runs.iter().flat_map(|run| Self::later(run));
        later().map(|scan| scan.evaluations as f64).sum::<f64>() / later().count() as f64
    }

    fn quantile(&self, share: f64, of: impl Fn(&Scan) -> u64) -> u64 {
        let mut values: Vec<u64> = self.runs.iter().flat_map(|run| Self::later(run)).map(of).collect();
        values.sort_unstable();
        values[((values.len() - 1) as f64 * share) as usize]
    }

    /// Evaluations that `share` of the scans after the first do not exceed.
    pub fn evaluations(&self, share: f64) -> usize {
        self.quantile(share, |scan| scan.evaluations as u64) as usize
    }

    /// Time that `share` of the scans after the first do not exceed, µs.
    pub fn cost_us(&self, share: f64) -> f64 {
        self.quantile(share, |scan| scan.cost_ns) as f64 * 1e-3 + self.besides_us
    }

    /// The longest time from a scan's arrival to its pose after the first, were this computer's solver fed
    /// at the head's rate, µs.
    pub fn most_lag_us(&self) -> f64 {
        let cost_s = |scan: &Scan| scan.cost_ns as f64 * 1e-9 + self.besides_us * 1e-6;
        let costs = |run: &Vec<Scan>| Self::later(run).iter().map(cost_s).collect::<Vec<_>>();
        self.runs.iter().map(|run| most_lag_s(self.period_s, costs(run))).fold(0.0, f64::max) * 1e6
    }

    /// Share of scans of which `is` is true.
    pub fn share(&self, is: impl Fn(&Scan) -> bool) -> f64 {
        self.scans().filter(|scan| is(scan)).count() as f64 / self.scans().count() as f64
    }

    /// Share of scans with a pose.
    pub fn with_pose(&self) -> f64 {
        self.share(|scan| scan.worst_sigmas.is_some())
    }

    /// Poses beyond [`WRONG_SIGMAS`] whose outcome does not call them a misfit.
    pub fn wrong(&self) -> usize {
        self.scans().filter(|scan| scan.is_wrong()).count()
    }

    /// Those of them of which more is said than `verified: not`.
    pub fn wrong_and_verified(&self) -> usize {
        self.scans().filter(|scan| scan.is_wrong() && scan.verified != Verified::Not).count()
    }

    /// The two most frequent outcomes and their shares.
    fn outcomes(&self) -> String {
        let mut counts: BTreeMap<String, usize> = BTreeMap::new();
        for scan in self.scans() {
            *counts.entry(word(&scan.outcome).to_owned()).or_default() += 1;
        }
        let mut counts: Vec<_> = counts.into_iter().collect();
        counts.sort_by_key(|(_, count)| std::cmp::Reverse(*count));
        let total = self.scans().count() as f64;
        let part = |(word, count): &(String, usize)| format!("{word} {:.1} %", 100.0 * *count as f64 / total);
        counts.iter().take(2).map(part).collect::<Vec<_>>().join(", ")
    }

    fn row(&self) -> [String; 15] {
        let Conditions { file, tier, light, sight, motion, healthy_scans, .. } = &self.conditions;
        [
            file.name.clone(),
            match sight {
                Sight::Lit(lit) => format!("{lit} lit"),
                Sight::Faulty(fault) => format!("{fault:?}"),
            },
            format!("{} on {}", name(*tier), name(*light)),
            match motion {
                Motion::Rest => "rest",
                Motion::Smooth => "smooth",
            }
            .to_owned(),
            if *healthy_scans > 0 { "tracked" } else { "cold" }.to_owned(),
            self.first_evaluations().to_string(),
            self.evaluations(0.5).to_string(),
            self.evaluations(0.99).to_string(),
            self.evaluations(1.0).to_string(),
            format!("{:.1}", self.cost_us(0.5)),
            format!("{:.1}", self.cost_us(0.99)),
            format!("{:.1}", self.cost_us(1.0)),
            format!("{:.0}", self.most_lag_us()),
            format!("{}/{}", self.wrong_and_verified(), self.wrong()),
            self.outcomes(),
        ]
    }
}

impl Scan {
    fn is_wrong(&self) -> bool {
        let is_doubted = matches!(self.outcome, Outcome::Degraded(DegradedReason::Misfit | DegradedReason::Unfinished));
        !is_doubted && self.worst_sigmas.is_some_and(|sigmas| sigmas > WRONG_SIGMAS)
    }
}

fn name(tier: Tier) -> &'static str {
    match tier {
        Tier::Paper => "paper",
        Tier::Exact { .. } => "exact",
    }
}

fn word(outcome: &Outcome) -> &'static str {
    match outcome {
        Outcome::Degraded(weakness) => weakness.as_str(),
        other => other.as_str(),
    }
}

/// One line per report.
pub fn table(reports: &[Report]) -> Table {
    let mut table = Table::new(&[
        "head",
        "cells",
        "tier on light",
        "tool",
        "start",
        "evaluations",
        "99 %",
        "most",
        "us",
        "99 %",
        "most",
        "lag us",
        "wrong",
        "outcomes",
    ]);
    for report in reports {
        table.row(report.row());
    }
    table
}
