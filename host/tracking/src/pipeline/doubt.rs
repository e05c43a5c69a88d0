//! Poses that may hide an error which other scans show.
//!
//! One scan has six data more than unknowns, and an error of one cell hides from them at some poses. The tool moves on, and
//! the same error shows: so a pose is in doubt while several scans shortly before it contradicted the scene, even if its own
//! residuals are small. An error too small to contradict in any scan shows in the mean of their residuals.

use slitpose_model::{DegradedReason, MAX_MEAN_MISFIT, MAX_MISFIT, Outcome, Solution, Tracked};

/// So many contradictions are no chance: of a sound head's scans one in 10⁵ has one, and three come within a thousand scans
/// once in 2·10⁹, which is once in six days at 4 kHz.
const CONTRADICTIONS: usize = 3;

/// Within this time: a hand moves the tool by centimetres meanwhile, and the error to where it shows.
const WITHIN_S: f64 = 0.25;

/// Standard deviations by which the mean χ² may exceed [`MAX_MEAN_MISFIT`] by chance, as it does once in 10⁹; with a smaller
/// redundancy of all scans its distribution is too far from normal to say so.
const CHANCE: f64 = 6.0;
const MIN_REDUNDANCY: f64 = 40.0;

/// From so many cells on their light has one pose, or contradicts the scene.
const CELLS: usize = 6;

/// Least number of scans that this time stands for.
const MIN_SCANS: u64 = 8;

/// Follows the scans of a session in the order of their numbers.
#[derive(Clone, Debug)]
pub(super) struct Doubt {
    within: u64,
    /// Numbers of the latest contradictions, the oldest first.
    latest: [Option<u64>; CONTRADICTIONS],
    /// Of the half of this time under way, and of the one before.
    residuals: [Residuals; 2],
}

/// χ² and redundancy of the scans of one half of the time within which contradictions count.
#[derive(Clone, Copy, Debug, Default)]
struct Residuals {
    half: u64,
    chi2: f64,
    redundancy: f64,
}

impl Residuals {
    fn contradict(&self) -> bool {
        self.redundancy >= MIN_REDUNDANCY
            && self.chi2 > MAX_MEAN_MISFIT * self.redundancy + CHANCE * (2.0 * self.redundancy).sqrt()
    }
}

impl Doubt {
    /// Of a board that takes a scan each `frame_s`.
    pub(super) fn new(frame_s: f64) -> Self {
        Self {
            within: ((WITHIN_S / frame_s) as u64).max(MIN_SCANS),
            latest: [None; CONTRADICTIONS],
            residuals: Default::default(),
        }
    }

    /// In which half of this time, counted from scan 0, a scan is.
    fn half(&self, sequence: u64) -> u64 {
        sequence / (self.within / 2)
    }

    /// Counts the scan `sequence`, which has this solution.
    pub(super) fn count(&mut self, sequence: u64, solution: &Solution) {
        // What counts no more leaves no trace, nor residuals after the end of the half that follows theirs: the state is that of a
        // session which has not seen them.
        for latest in &mut self.latest {
            *latest = latest.filter(|latest| sequence.abs_diff(*latest) <= self.within);
        }
        if contradicts(&solution.outcome, solution.cells_used.count()) {
            self.latest.rotate_left(1);
            self.latest[CONTRADICTIONS - 1] = Some(sequence);
        }
        let half = self.half(sequence);
        let now = self.residuals[0];
        if now.half != half {
            let before = if now.half + 1 == half { now } else { Residuals::default() };
            self.residuals = [Residuals { half, ..Residuals::default() }, before];
        }
        if has_residuals(&solution.outcome) {
            let redundancy = solution.redundancy as f64;
            self.residuals[0].redundancy += redundancy;
            self.residuals[0].chi2 += solution.chi2.min(MAX_MISFIT * redundancy);
        }
    }

    /// Degrades a pose that seems sound and is in doubt. By as much as the residuals are larger than they should be, its
    /// covariance is, too, and those of twist and filtered pose.
    pub(super) fn apply(&self, sequence: u64, tracked: &mut Tracked) {
        let half = self.half(sequence);
        let recent = self.residuals.map(|residuals| {
            let is_recent = half.checked_sub(residuals.half).is_some_and(|halves| halves <= 1);
            if is_recent { residuals } else { Residuals::default() }
        });
        let [now, before] = recent;
        let both = Residuals { half, chi2: now.chi2 + before.chi2, redundancy: now.redundancy + before.redundancy };
        let contradicting = [now, before, both].into_iter().filter(Residuals::contradict);
        let misfit = contradicting.map(|residuals| residuals.chi2 / residuals.redundancy).reduce(f64::max);
        let is_doubted = self.latest[0].is_some_and(|oldest| sequence.abs_diff(oldest) <= self.within);
        let solution = &mut tracked.solution;
        if !has_residuals(&solution.outcome) || !(is_doubted || misfit.is_some()) {
            return;
        }
        if solution.outcome == Outcome::Converged {
            solution.outcome = Outcome::Degraded(DegradedReason::Doubted);
        }
        let Some(misfit) = misfit else { return };
        let scale = |covariance: &mut [[f64; 6]; 6]| {
            covariance.as_flattened_mut().iter_mut().for_each(|element| *element *= misfit);
        };
        solution.estimate.iter_mut().for_each(|estimate| scale(&mut estimate.covariance));
        tracked.twist.iter_mut().for_each(|twist| scale(&mut twist.covariance));
        if let Some(filtered) = &mut tracked.filtered {
            scale(&mut filtered.estimate.covariance);
            filtered.twist.iter_mut().for_each(|twist| scale(&mut twist.covariance));
        }
    }
}

/// Whether the residuals of a scan are those of all cells with light, and passed the gate of χ².
fn has_residuals(outcome: &Outcome) -> bool {
    matches!(outcome, Outcome::Converged | Outcome::Degraded(DegradedReason::FewerCells))
}

/// Whether the scene does not explain a scan: it has outliers, identified or not. Of few cells none is found because they
/// leave too much open.
fn contradicts(outcome: &Outcome, cells: usize) -> bool {
    outcome.is_contradiction() || *outcome == Outcome::Diverged && cells >= CELLS
}

#[cfg(test)]
mod tests {
    use slitpose_model::{Cells, Estimate, Filtered, NoTwist, Pose, Twist, TwistEstimate};

    use super::*;

    fn solution(outcome: Outcome, cells: u16, chi2: f64) -> Solution {
        let pose = Pose { translation_m: Default::default(), rotation: Default::default() };
        let estimate = outcome.has_pose().then_some(Estimate { pose, covariance: [[1.0; 6]; 6] });
        Solution::reported(outcome, estimate, chi2, Cells::from_bits((1 << cells) - 1), Cells::default())
    }

    fn applied(doubt: &Doubt, sequence: u64, solution: Solution) -> Solution {
        let mut tracked = Tracked { solution, twist: Err(NoTwist::NoPose), filtered: None, light_level: None };
        doubt.apply(sequence, &mut tracked);
        tracked.solution
    }

    /// Covariance of each scan of these solutions, at 100 Hz, that is doubted.
    fn doubted(solutions: impl Iterator<Item = Solution>) -> Vec<(u64, f64)> {
        let mut doubt = Doubt::new(0.01);
        let doubted = |(sequence, solution): (u64, Solution)| {
            doubt.count(sequence, &solution);
            let solution = applied(&doubt, sequence, solution);
            let is_doubted = solution.outcome == Outcome::Degraded(DegradedReason::Doubted);
            solution.estimate.filter(|_| is_doubted).map(|estimate| (sequence, estimate.covariance[0][0]))
        };
        (0..).zip(solutions).filter_map(doubted).collect()
    }

    #[test]
    fn three_contradictions_within_a_quarter_second_put_what_follows_in_doubt() {
        let doubted = |contradictions: &[u64]| {
            doubted((0..100).map(|sequence| match contradictions.contains(&sequence) {
                true => solution(Outcome::Degraded(DegradedReason::Misfit), 6, 60.0),
                false => solution(Outcome::Converged, 6, 6.0),
            }))
        };
        let follow = |scans: std::ops::RangeInclusive<u64>| scans.map(|scan| (scan, 1.0)).collect::<Vec<_>>();
        assert_eq!(doubted(&[10, 20]), []);
        // 25 scans from the first of the latest three on; their own status stays.
        assert_eq!(doubted(&[10, 20, 30]), follow(31..=35));
        assert_eq!(doubted(&[10, 11, 12, 40, 41]), follow(13..=35), "two are forgotten");
        assert_eq!(doubted(&[10, 22, 36]), [], "too far apart");
    }

    #[test]
    fn residuals_that_are_too_large_on_average_put_poses_in_doubt_and_their_covariance_grows() {
        let with = |misfit: f64| move |_| solution(Outcome::Converged, 6, misfit * 6.0);
        assert_eq!(doubted((0..1000).map(with(1.5))), []);
        // Seven scans have a redundancy of 42.
        let doubtful = doubted((0..36).map(with(3.0)).chain((36..100).map(with(1.0))));
        assert_eq!(
            doubtful,
            (6..=47).map(|scan| (scan, 3.0)).collect::<Vec<_>>(),
            "and until the half after them is over"
        );
        // One bad scan does not outweigh all.
        let one_in = |length: u64| (0..240).map(move |scan| with(if scan % length == 0 { 1e9 } else { 1.0 })(scan));
        assert_eq!(doubted(one_in(12)), []);
        assert_ne!(doubted(one_in(4)), []);
        // A slow board has four scans a half, of which two halves are enough; and what was long ago counts no more.
        let mut slow = Doubt::new(1.0);
        (0..8).for_each(|scan| slow.count(scan, &with(9.0)(scan)));
        let misfit = |scan: u64, cells| applied(&slow, scan, solution(Outcome::Converged, cells, 6.0)).outcome;
        assert_eq!([7, 8, 500].map(|scan| misfit(scan, 6) == Outcome::Converged), [false, true, true]);
        // With a dark cell the status stays, and the covariance grows.
        let fewer = Outcome::Degraded(DegradedReason::FewerCells);
        let estimate = applied(&slow, 7, solution(fewer, 5, 4.0)).estimate.expect("a pose");
        assert_eq!((misfit(7, 5), estimate.covariance[0][0]), (Outcome::Degraded(DegradedReason::Doubted), 9.0));
    }

    #[test]
    fn all_covariances_of_a_doubted_scan_grow_alike() {
        let mut doubt = Doubt::new(0.01);
        let converged = solution(Outcome::Converged, 6, 18.0);
        (0..12).for_each(|scan| doubt.count(scan, &converged));
        let twist = Ok(TwistEstimate { twist: Twist::default(), covariance: [[1.0; 6]; 6] });
        let estimate = converged.estimate.expect("a pose");
        let filtered = Some(Filtered { estimate, twist, lag_s: 0.0, frames: 12 });
        let mut tracked = Tracked { solution: converged, twist, filtered, light_level: None };
        doubt.apply(12, &mut tracked);
        let filtered = tracked.filtered.expect("a filtered pose");
        let twists = [tracked.twist, filtered.twist].map(|twist| twist.expect("a twist").covariance);
        let poses = [tracked.solution.estimate.expect("a pose"), filtered.estimate].map(|estimate| estimate.covariance);
        assert_eq!((poses, twists), ([[[3.0; 6]; 6]; 2], [[[3.0; 6]; 6]; 2]));
    }

    #[test]
    fn only_poses_that_seem_sound_are_put_in_doubt() {
        let after_three = |first: Solution, outcome: Outcome| {
            doubted([first, first, first, solution(outcome, 6, 6.0)].into_iter()).len()
        };
        assert_eq!(
            after_three(solution(Outcome::Diverged, 5, 0.0), Outcome::Converged),
            0,
            "five cells leave a pose open"
        );
        let diverged = solution(Outcome::Diverged, 6, 0.0);
        assert_eq!(after_three(diverged, Outcome::Converged), 1);
        for kept in [Outcome::Ambiguous, Outcome::TooDark, Outcome::Degraded(DegradedReason::FewerCells)] {
            assert_eq!(after_three(diverged, kept), 0, "{kept:?}");
        }
        let mut slow = Doubt::new(1.0);
        (3..6).for_each(|sequence| slow.count(sequence, &diverged));
        let last = applied(&slow, 8, solution(Outcome::Converged, 6, 6.0));
        assert_ne!(last.outcome, Outcome::Converged, "a slow board has eight scans");
    }
}
