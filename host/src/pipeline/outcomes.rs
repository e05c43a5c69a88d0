//! Counts of solutions by outcome.

use std::mem::discriminant;

use schemars::JsonSchema;
use serde::Serialize;
use slitpose_model::{DegradedReason, Directions, Outcome};

/// Why a pose is degraded, or which coordinates are unobservable.
pub(crate) fn reason(outcome: &Outcome) -> Option<String> {
    match outcome {
        Outcome::Degraded(reason) => Some(reason.as_str().to_owned()),
        Outcome::Unobservable(directions) => Some(directions.to_string()),
        Outcome::Converged | Outcome::Ambiguous | Outcome::TooDark | Outcome::Diverged => None,
    }
}

/// Counts of solutions by outcome.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, JsonSchema)]
pub struct Outcomes {
    /// A pose from all cells.
    pub converged: u64,
    /// A less trustworthy pose.
    pub degraded: u64,
    /// Several poses fit.
    pub ambiguous: u64,
    /// The data leave directions undetermined.
    pub unobservable: u64,
    /// Too little light.
    pub too_dark: u64,
    /// No pose fits.
    pub diverged: u64,
}

impl Outcomes {
    /// One outcome of each kind, in the order of their numbers in datagrams.
    fn kinds() -> [Outcome; 6] {
        [
            Outcome::Converged,
            Outcome::Degraded(DegradedReason::FewerCells),
            Outcome::Ambiguous,
            Outcome::Unobservable(Directions::default()),
            Outcome::TooDark,
            Outcome::Diverged,
        ]
    }

    fn of_kind(&mut self, outcome: &Outcome) -> &mut u64 {
        match outcome {
            Outcome::Converged => &mut self.converged,
            Outcome::Degraded(_) => &mut self.degraded,
            Outcome::Ambiguous => &mut self.ambiguous,
            Outcome::Unobservable(_) => &mut self.unobservable,
            Outcome::TooDark => &mut self.too_dark,
            Outcome::Diverged => &mut self.diverged,
        }
    }

    /// The number of an outcome in datagrams.
    pub fn number_of(outcome: &Outcome) -> u16 {
        let is_other = |kind: &Outcome| discriminant(kind) != discriminant(outcome);
        Self::kinds().into_iter().take_while(is_other).count() as u16
    }

    /// Counts one solution.
    pub(crate) fn count(&mut self, outcome: &Outcome) {
        *self.of_kind(outcome) += 1;
    }

    /// The word for each outcome and its count, in the order of their numbers in datagrams.
    pub fn by_name(mut self) -> [(&'static str, u64); 6] {
        Self::kinds().map(|kind| (kind.as_str(), *self.of_kind(&kind)))
    }

    /// The counts since `before`.
    #[must_use]
    pub fn since(&self, before: &Self) -> Self {
        Self {
            converged: self.converged.saturating_sub(before.converged),
            degraded: self.degraded.saturating_sub(before.degraded),
            ambiguous: self.ambiguous.saturating_sub(before.ambiguous),
            unobservable: self.unobservable.saturating_sub(before.unobservable),
            too_dark: self.too_dark.saturating_sub(before.too_dark),
            diverged: self.diverged.saturating_sub(before.diverged),
        }
    }

    /// Solutions with a pose.
    pub fn poses(&self) -> u64 {
        self.converged + self.degraded
    }

    /// All solutions.
    pub fn all(&self) -> u64 {
        self.by_name().iter().map(|(_, count)| count).sum()
    }

    /// The outcomes that occurred, as text.
    pub fn words(&self) -> String {
        let there = self.by_name().into_iter().filter(|(_, count)| *count > 0);
        there.map(|(name, count)| format!("{name} {count}")).collect::<Vec<_>>().join(", ")
    }
}
