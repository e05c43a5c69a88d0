//! Poses that a board has found itself: taken as they are, or compared with those found here in the same scans.

use glam::{DQuat, DVec3};
use schemars::JsonSchema;
use serde::Serialize;
use slitpose_model::{Cells, CompiledScene, DegradedReason, Directions, Estimate, MIN_CELLS, Outcome, Pose, Solution};
use slitpose_protocol::poses::TRIANGLE;
use slitpose_protocol::{PoseRecord, PoseStatus};
use thiserror::Error;

/// Scans that wait for the other pose: more than lie between a batch and the poses of its scans.
const REMEMBERED: usize = 256;

/// Consecutive scans after which a tracker knows how the tool moves, whatever it knew before.
const SETTLED: u32 = 16;

/// Greatest error of the squared length of a quaternion: some hundred times what `f32` rounds.
const MAX_NORM2_ERROR: f32 = 1e-4;

/// Weight of the latest pose in the recent mean square.
const RECENT: f64 = 1.0 / 64.0;

/// How a board's poses compare with those that this program finds in the same scans.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, JsonSchema)]
pub struct Agreement {
    /// Poses of the board of which this program has found the other.
    pub compared: u64,
    /// Scans in which one has found a pose and the other has not.
    pub one_sided: u64,
    /// Largest difference, in standard deviations of the coordinate that differs most.
    pub worst_sigmas: f64,
    /// Root mean square of that difference, over some hundred poses.
    pub recent_rms_sigmas: f64,
    /// Scans of this configuration that the board could not solve in time.
    pub missed: u64,
    /// Poses of the board that cannot be right, left out.
    pub refused: u64,
    /// Whether the board's poses have not been compared for as long as its sample of scans should take, and half as long
    /// again. Of a board whose poses are taken as they are.
    pub is_unchecked: bool,
}

/// Why a pose of a board cannot be right.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
#[allow(missing_docs, reason = "the texts say what each is")]
pub enum PoseFault {
    #[error("one of its numbers is not finite, or its χ² is negative")]
    Number,
    #[error("its quaternion is not of length 1")]
    Rotation,
    #[error("no covariance has come with it or before")]
    NoCovariance,
    #[error("its covariance is not positive definite")]
    Covariance,
    #[error("it is said to come from fewer than {MIN_CELLS} cells, or from cells that the head lacks")]
    Cells,
    #[error("fewer than {MIN_CELLS} of its cells see the tool there")]
    Unseen,
}

/// A pose as a board tells it.
#[derive(Clone, Copy, Debug)]
pub(super) struct BoardPose {
    pub(super) record: PoseRecord,
    /// The latest that the board has told.
    pub(super) covariance: [f32; TRIANGLE],
}

impl BoardPose {
    /// Why it cannot be right, by the optics of the head: if it is a pose, it must be one that a solver could find.
    pub(super) fn fault(&self, plan: &CompiledScene<f64>) -> Option<PoseFault> {
        let Self { record, covariance } = self;
        if !record.status.has_pose() {
            return None;
        }
        let numbers = record.translation_m.iter().chain(&record.rotation_xyzw).chain([&record.chi2]).chain(covariance);
        let norm2: f32 = record.rotation_xyzw.iter().map(|number| number * number).sum();
        let (used, excluded) = (Cells::from_bits(record.cells_used), Cells::from_bits(record.excluded));
        let has = |cell: usize| cell < plan.cell_count();
        let sees = |pose: &Pose| used.iter().filter(|&cell| !plan.spot_outline_m(cell, pose).is_empty()).count();
        if !numbers.clone().all(|number| number.is_finite()) || record.chi2 < 0.0 {
            Some(PoseFault::Number)
        } else if (norm2 - 1.0).abs() > MAX_NORM2_ERROR {
            Some(PoseFault::Rotation)
        } else if *covariance == [0.0; TRIANGLE] {
            Some(PoseFault::NoCovariance)
        } else if !is_positive_definite(full(covariance)) {
            Some(PoseFault::Covariance)
        } else if used.count() < MIN_CELLS || !used.iter().chain(excluded.iter()).all(has) {
            Some(PoseFault::Cells)
        } else if pose_of(record).is_none_or(|pose| sees(&pose) < MIN_CELLS) {
            Some(PoseFault::Unseen)
        } else {
            None
        }
    }

    pub(super) fn solution(&self) -> Solution {
        let Self { record, covariance } = self;
        let outcome = match record.status {
            PoseStatus::Converged => Outcome::Converged,
            PoseStatus::FewerCells => Outcome::Degraded(DegradedReason::FewerCells),
            PoseStatus::CellExcluded => Outcome::Degraded(DegradedReason::CellExcluded),
            PoseStatus::Misfit => Outcome::Degraded(DegradedReason::Misfit),
            PoseStatus::Ambiguous => Outcome::Ambiguous,
            // It does not tell which.
            PoseStatus::Unobservable => Outcome::Unobservable(Directions::default()),
            PoseStatus::TooDark => Outcome::TooDark,
            PoseStatus::Diverged | PoseStatus::Unknown => Outcome::Diverged,
        };
        let pose = pose_of(record).filter(|_| record.status.has_pose());
        let estimate = pose.map(|pose| Estimate { pose, covariance: full(covariance) });
        let [used, excluded] = [record.cells_used, record.excluded].map(Cells::from_bits);
        Solution::reported(outcome, estimate, record.chi2.into(), used, excluded)
    }
}

/// The symmetric matrix of a lower triangle.
fn full(triangle: &[f32; TRIANGLE]) -> [[f64; 6]; 6] {
    std::array::from_fn(|i| {
        std::array::from_fn(|j| {
            let (row, column) = (i.max(j), i.min(j));
            triangle[row * (row + 1) / 2 + column].into()
        })
    })
}

/// Whether Cholesky's method finds a factor: all pivots are positive.
fn is_positive_definite(mut matrix: [[f64; 6]; 6]) -> bool {
    (0..6).all(|k| {
        let pivots = matrix[k];
        for i in k + 1..6 {
            for j in k + 1..6 {
                matrix[i][j] -= pivots[i] * pivots[j] / pivots[k];
            }
        }
        pivots[k] > 0.0
    })
}

fn pose_of(record: &PoseRecord) -> Option<Pose> {
    let rotation = DQuat::from_array(record.rotation_xyzw.map(f64::from)).normalize();
    let pose = Pose { rotation, translation_m: DVec3::from_array(record.translation_m.map(f64::from)) };
    pose.is_finite().then_some(pose)
}

#[derive(Debug)]
pub(super) struct Comparison {
    by_board: Vec<Option<(u64, PoseRecord)>>,
    by_host: Vec<Option<(u64, Option<Estimate>)>>,
    board: Run,
    host: Run,
    pub(super) agreement: Agreement,
    /// A scan in which both have looked for a pose has come since this was last taken.
    pub(super) is_checked: bool,
}

#[derive(Clone, Copy, Debug, Default)]
struct Run {
    next: u64,
    length: u32,
}

impl Run {
    /// Whether scan `sequence` is behind enough others.
    fn is_settled(&mut self, sequence: u64) -> bool {
        self.length = if sequence == self.next { self.length.saturating_add(1) } else { 0 };
        self.next = sequence.wrapping_add(1);
        self.length >= SETTLED
    }
}

impl Default for Comparison {
    fn default() -> Self {
        Self {
            by_board: vec![None; REMEMBERED],
            by_host: vec![None; REMEMBERED],
            board: Run::default(),
            host: Run::default(),
            agreement: Agreement::default(),
            is_checked: false,
        }
    }
}

impl Comparison {
    /// Takes the board's pose of scan `sequence`.
    pub(super) fn take_board(&mut self, sequence: u64, record: &PoseRecord) {
        if !self.board.is_settled(sequence) {
            return;
        }
        match take(&mut self.by_host, sequence) {
            Some(found) => self.compare(record, found.as_ref()),
            None => self.by_board[place(sequence)] = Some((sequence, *record)),
        }
    }

    /// Takes this program's pose of scan `sequence`, from the light alone.
    pub(super) fn take_host(&mut self, sequence: u64, found: Option<&Estimate>) {
        if !self.host.is_settled(sequence) {
            return;
        }
        match take(&mut self.by_board, sequence) {
            Some(record) => self.compare(&record, found),
            None => self.by_host[place(sequence)] = Some((sequence, found.copied())),
        }
    }

    fn compare(&mut self, record: &PoseRecord, found: Option<&Estimate>) {
        self.is_checked = true;
        let Agreement { compared, one_sided, worst_sigmas, recent_rms_sigmas, .. } = &mut self.agreement;
        let by_board = pose_of(record).filter(|_| record.status.has_pose());
        let (by_board, found) = match (by_board, found) {
            (Some(by_board), Some(found)) => (by_board, found),
            (None, None) => return,
            _ => {
                *one_sided += 1;
                return;
            }
        };
        let (translation, rotation) = by_board.displacement_from(&found.pose);
        let off = translation.to_array().into_iter().chain(rotation.to_array());
        let off = off.zip(found.sigma()).fold(0.0, |most: f64, (off, sigma)| most.max((off / sigma).abs()));
        let weight = RECENT.max(1.0 / (*compared + 1) as f64);
        let mean = recent_rms_sigmas.powi(2);
        *recent_rms_sigmas = (mean + weight * (off * off - mean)).sqrt();
        *worst_sigmas = worst_sigmas.max(off);
        *compared += 1;
    }
}

fn place(sequence: u64) -> usize {
    (sequence % REMEMBERED as u64) as usize
}

fn take<T: Copy>(remembered: &mut [Option<(u64, T)>], sequence: u64) -> Option<T> {
    let place = &mut remembered[place(sequence)];
    let (_, value) = place.filter(|(of, _)| *of == sequence)?;
    *place = None;
    Some(value)
}

#[cfg(test)]
mod tests {
    use super::*;

    const SIGMA: f64 = 1e-6;

    fn record(status: PoseStatus, x: f32) -> PoseRecord {
        PoseRecord {
            status,
            cells_used: 0x3f,
            excluded: 0,
            ready: 0,
            translation_m: [x, 0.0, 0.0],
            rotation_xyzw: [0.0, 0.0, 0.0, 1.0],
            chi2: 6.0,
        }
    }

    fn estimate(x: f64) -> Estimate {
        let mut covariance = [[0.0; 6]; 6];
        (0..6).for_each(|i| covariance[i][i] = SIGMA * SIGMA);
        Estimate { pose: Pose { translation_m: DVec3::new(x, 0.0, 0.0), ..Pose::HOME }, covariance }
    }

    #[test]
    fn poses_of_one_scan_are_compared_whichever_comes_first() {
        let mut comparison = Comparison::default();
        for sequence in 100..140 {
            comparison.take_host(sequence, Some(&estimate(1e-3)));
        }
        // f32 rounds a millimetre by 1e-10 at most.
        let board = |x: f32| record(PoseStatus::Converged, x);
        (90..120).for_each(|sequence| comparison.take_board(sequence, &board(1e-3 + 0.5e-6)));
        let agreement = comparison.agreement;
        // Both are settled from 116 on.
        assert_eq!((agreement.compared, agreement.one_sided), (4, 0));
        assert!((agreement.worst_sigmas - 0.5).abs() < 1e-3, "{agreement:?}");
        assert!((agreement.recent_rms_sigmas - 0.5).abs() < 1e-3, "{agreement:?}");
        (120..139).for_each(|sequence| comparison.take_board(sequence, &board(1e-3)));
        comparison.take_board(139, &record(PoseStatus::TooDark, f32::NAN));
        comparison.take_board(140, &board(1e-3 + 2e-6));
        comparison.take_host(140, Some(&estimate(1e-3)));
        let agreement = comparison.agreement;
        assert_eq!((agreement.compared, agreement.one_sided), (24, 1));
        assert!((agreement.worst_sigmas - 2.0).abs() < 1e-3, "{agreement:?}");
    }

    #[test]
    fn poses_behind_a_gap_are_not_compared_yet() {
        let mut comparison = Comparison::default();
        (0..100).for_each(|sequence| comparison.take_board(sequence, &record(PoseStatus::Converged, 0.0)));
        (50..66).for_each(|sequence| comparison.take_host(sequence, Some(&estimate(0.0))));
        assert_eq!(comparison.agreement.compared, 0);
        comparison.take_host(66, Some(&estimate(0.0)));
        assert_eq!(comparison.agreement.compared, 1);
        // Of another scan than the one remembered in its place.
        let far = 99 + REMEMBERED as u64;
        (far - 20..=far).for_each(|sequence| comparison.take_host(sequence, Some(&estimate(0.0))));
        assert_eq!(comparison.agreement.compared, 1);
    }

    #[test]
    fn a_reported_pose_says_what_the_board_said_and_no_more() {
        let mut covariance = [0.0; TRIANGLE];
        (covariance[0], covariance[1], covariance[20]) = (4.0, 1.0, 9.0);
        let pose = BoardPose { record: record(PoseStatus::CellExcluded, 2.0), covariance };
        let solution = pose.solution();
        assert_eq!(solution.outcome, Outcome::Degraded(DegradedReason::CellExcluded));
        let found = solution.estimate.expect("a pose");
        assert_eq!(found.pose.translation_m, DVec3::new(2.0, 0.0, 0.0));
        let told = &found.covariance;
        assert_eq!((told[0][0], told[0][1], told[1][0], told[5][5]), (4.0, 1.0, 1.0, 9.0));
        assert_eq!((solution.chi2, solution.redundancy, solution.cells_used.bits()), (6.0, 6, 0x3f));
        let status = |status, x| BoardPose { record: record(status, x), covariance }.solution();
        assert!(status(PoseStatus::TooDark, 0.0).estimate.is_none());
    }
}
