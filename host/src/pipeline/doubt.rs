//! Poses whose predecessors contradicted the scene.
//!
//! One scan has six data more than unknowns, and an error of one cell hides from them at some poses. The tool moves on, and
//! the same error shows: so a pose is in doubt while several scans shortly before it contradicted the scene, even if its own
//! residuals are small.

use slitpose_model::{DegradedReason, Outcome};

/// So many contradictions are no chance: of a sound head's scans one in 10⁵ has one, and three come within a thousand scans
/// once in 2·10⁹, which is once in six days at 4 kHz.
const CONTRADICTIONS: usize = 3;

/// Within this time: a hand moves the tool by centimetres meanwhile, and the error to where it shows.
const WITHIN_S: f64 = 0.25;

/// From so many cells on their light has one pose, or contradicts the scene.
const CELLS: usize = 6;

/// Least number of scans that this time stands for.
const LEAST_SCANS: u64 = 8;

/// Follows the scans of a session in the order of their numbers.
#[derive(Clone, Debug)]
pub(super) struct Doubt {
    /// Scans in the time.
    within: u64,
    /// Numbers of the latest contradictions, the oldest first.
    latest: [Option<u64>; CONTRADICTIONS],
}

impl Doubt {
    /// Of a board that takes a scan each `frame_s`.
    pub(super) fn new(frame_s: f64) -> Self {
        Self { within: ((WITHIN_S / frame_s) as u64).max(LEAST_SCANS), latest: [None; CONTRADICTIONS] }
    }

    /// Counts the scan `sequence`, which came to `outcome` by so many `cells`.
    pub(super) fn count(&mut self, sequence: u64, outcome: &Outcome, cells: usize) {
        // What counts no more leaves no trace: the state is that of a session which has not seen it.
        for latest in &mut self.latest {
            *latest = latest.filter(|latest| sequence.abs_diff(*latest) <= self.within);
        }
        if contradicts(outcome, cells) {
            self.latest.rotate_left(1);
            self.latest[CONTRADICTIONS - 1] = Some(sequence);
        }
    }

    /// Degrades a pose that seems sound and is in doubt.
    pub(super) fn apply(&self, sequence: u64, outcome: &mut Outcome) {
        let is_doubted = self.latest[0].is_some_and(|oldest| sequence.abs_diff(oldest) <= self.within);
        if is_doubted && *outcome == Outcome::Converged {
            *outcome = Outcome::Degraded(DegradedReason::Doubted);
        }
    }
}

/// Whether the scene does not explain a scan: it has outliers, identified or not. Of few cells none is found because they
/// leave too much open.
fn contradicts(outcome: &Outcome, cells: usize) -> bool {
    match outcome {
        Outcome::Diverged => cells >= CELLS,
        outcome => matches!(outcome, Outcome::Degraded(DegradedReason::Misfit | DegradedReason::CellExcluded)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Scans that are doubted of 0 to `count`, at 100 Hz, where those of `contradictions` contradict.
    fn doubted(contradictions: &[u64], count: u64) -> Vec<u64> {
        let mut doubt = Doubt::new(0.01);
        let is_doubted = |&sequence: &u64| {
            let contradicts = contradictions.contains(&sequence);
            let mut outcome = if contradicts { Outcome::Degraded(DegradedReason::Misfit) } else { Outcome::Converged };
            doubt.count(sequence, &outcome, CELLS);
            doubt.apply(sequence, &mut outcome);
            outcome == Outcome::Degraded(DegradedReason::Doubted)
        };
        (0..count).filter(is_doubted).collect()
    }

    #[test]
    fn three_contradictions_within_a_quarter_second_put_what_follows_in_doubt() {
        assert_eq!(doubted(&[10, 20], 100), [0; 0]);
        // 25 scans from the first of the latest three on; their own status stays.
        assert_eq!(doubted(&[10, 20, 30], 100), (31..=35).collect::<Vec<_>>());
        assert_eq!(doubted(&[10, 11, 12, 40, 41], 100), (13..=35).collect::<Vec<_>>(), "two are forgotten");
        assert_eq!(doubted(&[10, 22, 36], 100), [0; 0], "too far apart");
    }

    #[test]
    fn only_poses_that_seem_sound_are_put_in_doubt() {
        let mut doubt = Doubt::new(1.0);
        (0..3).for_each(|sequence| doubt.count(sequence, &Outcome::Diverged, CELLS - 1));
        let mut outcome = Outcome::Converged;
        doubt.apply(3, &mut outcome);
        assert_eq!(outcome, Outcome::Converged, "five cells leave a pose open");
        (3..6).for_each(|sequence| doubt.count(sequence, &Outcome::Diverged, CELLS));
        for kept in [Outcome::Ambiguous, Outcome::TooDark, Outcome::Degraded(DegradedReason::FewerCells)] {
            let mut outcome = kept;
            doubt.apply(8, &mut outcome);
            assert_eq!(outcome, kept);
        }
        let mut outcome = Outcome::Converged;
        doubt.apply(8, &mut outcome);
        assert_ne!(outcome, Outcome::Converged, "a slow board has eight scans");
    }
}
