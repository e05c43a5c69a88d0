//! Poses on the board: every scan solved by the host's own tracker in `f32`.
//!
//! Scans wait in a short queue and are solved one at a time, so that packets and commands have their turn in
//! between. Following a tool takes a part of a frame. Looking for a lost one takes several frames, during which
//! scans are passed over: the queue keeps the newest, and what it drops is counted.

pub mod frame;
mod head;

use heapless::{Deque, Vec};
use slitpose_model::{BoardTracker, DegradedReason, Outcome, Solution};
use slitpose_protocol::poses::{POSE_BYTES, READY_TICKS, TRIANGLE};
use slitpose_protocol::{HeadPart, PoseRecord, PoseStatus, PosesBuilder, RawScan, Rejection, Schedule, Stream};

pub use head::{CellStage, HEAD_BYTES, Head, HeadError, HeadSolver, Readout};

use crate::HEAD_KIND;
use crate::collector::BATCH_SCANS;
use crate::hardware::{SolvedPose, System};
use crate::outbox::Outbox;

/// Scans that wait for their turn: of a frame that takes longer than its share the next ones catch up.
const WAITING: usize = 4;

/// Solves the scans of one board, one after the other: on the board, and bit for bit alike on a host.
#[derive(Debug)]
pub struct PoseSolver {
    /// Stays where it is: heads are read into its solver.
    tracker: BoardTracker,
    loaded: Option<Loaded>,
}

/// Of a head that is in force.
#[derive(Debug)]
struct Loaded {
    readout: Readout,
    /// Tells it apart from others.
    number: u32,
    /// Whether the schedule is the one it was compiled for.
    fits: bool,
}

impl Default for PoseSolver {
    #[inline(always)]
    fn default() -> Self {
        Self { tracker: BoardTracker::without_cells(), loaded: None }
    }
}

impl PoseSolver {
    /// Puts the head in `bytes` in force: [`Self::begin`] then. Of bytes that are damaged the head before stays.
    ///
    /// # Errors
    /// If there is none that this firmware reads.
    // Apart, to leave its stack to others.
    #[cold]
    #[inline(never)]
    pub fn load(&mut self, bytes: &[u8]) -> Result<(), HeadError> {
        let payload = head::payload(bytes)?;
        self.loaded = None;
        let readout = head::read(payload, self.tracker.solver_mut())?;
        let number = readout.hashes.number();
        self.loaded = Some(Loaded { readout, number, fits: false });
        Ok(())
    }

    /// Scans of `schedule` follow, and the tool may be anywhere. A head that was compiled for another one solves none.
    pub fn begin(&mut self, schedule: &Schedule) {
        if let Some(Loaded { readout, fits, .. }) = &mut self.loaded {
            *fits = readout.fits(schedule);
            self.tracker.restart(f64::from(schedule.frame_ticks) / f64::from(schedule.tick_hz));
        }
    }

    /// Solves a scan; `None` without a head for its schedule. The record's `ready` is zero.
    pub fn solve(&mut self, scan: &RawScan) -> Option<SolvedPose> {
        let readout = self.loaded.as_ref().filter(|loaded| loaded.fits).map(|loaded| &loaded.readout)?;
        let solution = self.tracker.track_on_board(scan.sequence, &readout.photocurrents(scan));
        Some(SolvedPose {
            sequence: scan.sequence,
            tick: scan.tick,
            record: record(&solution),
            covariance: solution.estimate.as_ref().map(|estimate| triangle(&estimate.covariance)),
        })
    }
}

/// Solves the scans of a board, and makes packets of its poses.
#[derive(Debug)]
pub struct Poser {
    /// Parts of a head, or a whole one.
    receiving: Vec<u8, HEAD_BYTES>,
    /// Whether it is that in force.
    is_whole: bool,
    solver: PoseSolver,
    waiting: Deque<RawScan, WAITING>,
    batch: PosesBuilder<{ BATCH_SCANS * POSE_BYTES }>,
    configuration: u16,
    missed: u32,
    stream: Stream,
}

impl Default for Poser {
    /// Without a head.
    #[inline(always)]
    fn default() -> Self {
        Self {
            receiving: Vec::new(),
            is_whole: false,
            solver: PoseSolver::default(),
            waiting: Deque::new(),
            batch: PosesBuilder::default(),
            configuration: 0,
            missed: 0,
            stream: Stream::SCANS,
        }
    }
}

impl Poser {
    /// Takes a part of a head. The head before it stays in force until the last part has come and is right: then it is
    /// `true`.
    ///
    /// # Errors
    /// If the part does not follow the one before, or the whole is no head.
    pub(crate) fn take_part(&mut self, part: &HeadPart, schedule: &Schedule) -> Result<bool, Rejection> {
        if part.offset == 0 {
            self.receiving.clear();
            self.is_whole = false;
        }
        let is_next = usize::from(part.offset) == self.receiving.len();
        let end = usize::from(part.offset) + part.bytes.len();
        if !is_next || end > usize::from(part.total) || self.receiving.extend_from_slice(&part.bytes).is_err() {
            self.receiving.clear();
            return Err(Rejection::Malformed { kind: HEAD_KIND });
        }
        if end < usize::from(part.total) {
            return Ok(false);
        }
        if part.total == 0 {
            self.solver.loaded = None;
        } else {
            self.solver.load(&self.receiving).map_err(|_| Rejection::Malformed { kind: HEAD_KIND })?;
            self.is_whole = true;
        }
        self.begin(schedule);
        Ok(true)
    }

    /// Puts a whole head in force.
    ///
    /// # Errors
    /// If it is none that this firmware reads.
    pub(crate) fn restore(&mut self, bytes: &[u8], schedule: &Schedule) -> Result<(), HeadError> {
        self.receiving.clear();
        let taken = self.receiving.extend_from_slice(bytes).map_err(|_| HeadError::TooLong);
        let restored = taken.and_then(|()| self.solver.load(bytes));
        self.is_whole = restored.is_ok();
        self.begin(schedule);
        restored
    }

    /// The head in force as it was sent; empty without one.
    ///
    /// # Errors
    /// If parts of the next one have come in its place.
    pub(crate) fn bytes(&self) -> Result<&[u8], Rejection> {
        match (self.solver.loaded.is_some(), self.is_whole) {
            (true, true) => Ok(&self.receiving),
            (true, false) => Err(Rejection::Malformed { kind: HEAD_KIND }),
            (false, _) => Ok(&[]),
        }
    }

    /// Scans of `schedule`, configuration number `configuration`, follow.
    pub(crate) fn configure(&mut self, configuration: u16, schedule: &Schedule) {
        self.configuration = configuration;
        self.begin(schedule);
        self.missed = 0;
    }

    fn begin(&mut self, schedule: &Schedule) {
        self.missed = self.missed.saturating_add(self.waiting.len() as u32);
        self.waiting.clear();
        self.solver.begin(schedule);
    }

    /// Whether scans are solved; a head for another schedule solves none.
    pub(crate) fn is_at_work(&self) -> bool {
        self.solver.loaded.as_ref().is_some_and(|loaded| loaded.fits)
    }

    /// Whether there is a head, and it is for another schedule.
    pub(crate) fn is_unfit(&self) -> bool {
        self.solver.loaded.as_ref().is_some_and(|loaded| !loaded.fits)
    }

    pub(crate) fn is_behind(&self) -> bool {
        !self.waiting.is_empty()
    }

    /// Queues a scan; the oldest goes if there is no room.
    pub(crate) fn take(&mut self, scan: &RawScan) {
        if !self.is_at_work() {
            return;
        }
        if self.waiting.is_full() {
            self.waiting.pop_front();
            self.missed = self.missed.saturating_add(1);
        }
        // There is room.
        let _ = self.waiting.push_back(*scan);
    }

    /// Solves the oldest scan that waits, tells `hardware` of it, and queues it for the link, with `batch_scans` poses in a
    /// packet; `false` if none waits.
    pub(crate) fn work<M: AsRef<[u8]> + AsMut<[u8]>>(
        &mut self,
        hardware: &mut impl System,
        outbox: &mut Outbox<M>,
        batch_scans: usize,
    ) -> bool {
        let Some(scan) = self.waiting.pop_front() else { return false };
        let Some(mut pose) = self.solver.solve(&scan) else { return false };
        let ready = hardware.now_ticks().saturating_sub(scan.tick) / u64::from(READY_TICKS);
        pose.record.ready = u16::try_from(ready).unwrap_or(u16::MAX);
        hardware.pose_solved(&pose);
        if self.stream.has_pose(pose.sequence) {
            if !self.pack(&pose) {
                self.flush(outbox);
                // An empty packet takes any pose.
                let _ = self.pack(&pose);
            }
            if self.batch.len() >= batch_scans {
                self.flush(outbox);
            }
        }
        true
    }

    fn pack(&mut self, pose: &SolvedPose) -> bool {
        self.batch.push((pose.sequence, pose.tick), &pose.record, pose.covariance.as_ref())
    }

    /// Sends the packet under way, full or not.
    pub(crate) fn flush<M: AsRef<[u8]> + AsMut<[u8]>>(&mut self, outbox: &mut Outbox<M>) {
        let head = self.solver.loaded.as_ref().map_or(0, |loaded| loaded.number);
        if let Some(poses) = self.batch.poses(self.configuration, self.missed, head) {
            outbox.push_poses(poses, self.waiting.len() > 1);
            self.batch.clear();
        }
    }

    /// Which poses are sent; the packet under way must have been flushed.
    pub(crate) fn set_stream(&mut self, stream: Stream) {
        self.stream = stream;
        self.batch.set_every(stream.poses);
    }
}

fn record(solution: &Solution<f32>) -> PoseRecord {
    let status = match solution.outcome {
        Outcome::Converged => PoseStatus::Converged,
        Outcome::Degraded(DegradedReason::CellExcluded) => PoseStatus::CellExcluded,
        Outcome::Degraded(DegradedReason::Misfit | DegradedReason::Unfinished) => PoseStatus::Misfit,
        Outcome::Degraded(DegradedReason::FewerCells | DegradedReason::Uncalibrated | DegradedReason::Doubted) => {
            PoseStatus::FewerCells
        }
        Outcome::Ambiguous => PoseStatus::Ambiguous,
        Outcome::Unobservable(_) => PoseStatus::Unobservable,
        Outcome::TooDark => PoseStatus::TooDark,
        Outcome::Diverged => PoseStatus::Diverged,
    };
    let (translation_m, rotation_xyzw) = solution.pose_numbers().unwrap_or(([f32::NAN; 3], [f32::NAN; 4]));
    PoseRecord {
        status,
        cells_used: solution.cells_used.bits(),
        excluded: solution.excluded.bits(),
        ready: 0,
        translation_m,
        rotation_xyzw,
        chi2: solution.chi2,
    }
}

/// The lower triangle of a symmetric matrix, row by row.
fn triangle(matrix: &[[f32; 6]; 6]) -> [f32; TRIANGLE] {
    let mut triangle = [0.0; TRIANGLE];
    let elements = matrix.iter().enumerate().flat_map(|(i, row)| &row[..=i]);
    triangle.iter_mut().zip(elements).for_each(|(place, &element)| *place = element);
    triangle
}

#[cfg(test)]
mod tests {
    use glam::DVec3;
    use slitpose_model::Pose;

    use super::head::tests::{head, scan};
    use super::*;
    use crate::pcb::default_configuration;

    fn poser() -> (Poser, std::vec::Vec<u8>) {
        let schedule = default_configuration().schedule;
        let mut poser = Poser::default();
        let bytes = head().encode(&mut [0; HEAD_BYTES]).expect("room").to_vec();
        let taken: std::vec::Vec<_> = HeadPart::all(&bytes).map(|part| poser.take_part(&part, &schedule)).collect();
        assert!(taken[..taken.len() - 1].iter().all(|part| *part == Ok(false)), "{taken:?}");
        assert_eq!(taken.last(), Some(&Ok(true)));
        assert!(poser.is_at_work());
        (poser, bytes)
    }

    #[test]
    fn parts_out_of_order_and_damaged_heads_leave_the_head_before_in_force() {
        let schedule = default_configuration().schedule;
        let (mut poser, mut bytes) = poser();
        let malformed = Err(Rejection::Malformed { kind: HEAD_KIND });
        assert_eq!(slitpose_protocol::schema::COMMANDS[HEAD_KIND as usize].name, "Head");
        let mut all = HeadPart::all(&bytes);
        assert_eq!(all.nth(1).map(|part| poser.take_part(&part, &schedule)), Some(malformed));
        drop(all);
        bytes[99] ^= 4;
        assert_eq!(HeadPart::all(&bytes).map(|part| poser.take_part(&part, &schedule)).last(), Some(malformed));
        assert!(poser.is_at_work());
        // More than it may be.
        let long = HeadPart { offset: 0, total: 2, bytes: [0; 3].into_iter().collect() };
        assert_eq!(poser.take_part(&long, &schedule), malformed);
        let none = HeadPart { offset: 0, total: 0, bytes: [].into_iter().collect() };
        assert_eq!(poser.take_part(&none, &schedule), Ok(true));
        assert!(!poser.is_at_work() && !poser.is_unfit());
    }

    #[test]
    fn scans_that_come_too_fast_cost_the_oldest_and_are_counted() {
        let (mut poser, _) = poser();
        let home = scan(&Pose::HOME, 0);
        for sequence in 0..WAITING as u64 + 2 {
            let mut next = home;
            next.sequence = sequence;
            poser.take(&next);
        }
        assert_eq!((poser.missed, poser.waiting.front().map(|scan| scan.sequence)), (2, Some(2)));
    }

    /// Poses all over the workspace, the same ones every time: multiples of powers of the root of x⁷ = x + 1 (Roberts 2018).
    fn pose_of_many(index: u32) -> Pose {
        let power = |k: i32| 1.112_775_684_278_706_f64.powi(-k);
        let [x, y, z, a, b, c] = [1, 2, 3, 4, 5, 6].map(|k| 2.0 * (f64::from(index + 1) * power(k)).fract() - 1.0);
        Pose::from_vectors(DVec3::new(x, y, z) * 3.5e-3, DVec3::new(a, b, c) * 0.22)
    }

    /// Poses in which a cell's words are those of another pose, in turn: what came of up to `most` frames, until the cell
    /// was excluded, if `known` frames were honest before.
    fn lies(known: u64, most: u64) -> impl Iterator<Item = std::vec::Vec<PoseRecord>> {
        (0..120).map(move |index| {
            let cell = index as usize % 6;
            let pose = pose_of_many(2 * index);
            let (honest, other) = (scan(&pose, 0), scan(&pose_of_many(2 * index + 1), 0));
            let (mut poser, _) = poser();
            let mut records = std::vec::Vec::new();
            for sequence in 0..known + most {
                let mut next = honest;
                next.sequence = sequence;
                if sequence >= known {
                    next.lit_mut()[cell] = other.lit()[cell];
                }
                let record = poser.solver.solve(&next).expect("a head").record;
                if sequence >= known {
                    records.push(record);
                }
                let off = (0..3).map(|i| (f64::from(record.translation_m[i]) - pose.translation_m[i]).abs());
                // Of the first frame the motion is unknown. A pose that is none is not far off.
                let is_right = off.fold(0.0, f64::max) < 50e-6 || record.status == PoseStatus::Misfit;
                assert!(is_right, "pose {index}, cell {cell}, frame {sequence}: {record:?}");
                if record.status == PoseStatus::CellExcluded && record.excluded == 1 << cell {
                    break;
                }
            }
            records
        })
    }

    #[test]
    fn a_cell_that_begins_to_lie_is_excluded_within_the_frame() {
        for (index, records) in lies(30, 1).enumerate() {
            assert_eq!(records[0].status, PoseStatus::CellExcluded, "pose {index}");
        }
    }

    /// A board that is switched on with a faulty cell: the search goes on over scans.
    #[test]
    fn a_cell_that_has_always_lied_is_found_out() {
        let mut frames: std::vec::Vec<_> = lies(0, 400)
            .enumerate()
            .map(|(index, records)| {
                let status = records.last().map(|record| record.status);
                assert_eq!(status, Some(PoseStatus::CellExcluded), "pose {index} after {} frames", records.len());
                records.len()
            })
            .collect();
        frames.sort_unstable();
        std::println!("found out after {} frames in the median, {} at most", frames[60], frames[119]);
    }

    #[test]
    fn a_saturated_cell_is_missing_and_comes_back() {
        let (mut poser, _) = poser();
        let honest = scan(&Pose::HOME, 0);
        let mut sequence = 0;
        let mut next = |saturated: Option<usize>| {
            let mut scan = honest;
            scan.sequence = sequence;
            sequence += 1;
            // Code 0 is full scale.
            saturated.into_iter().for_each(|cell| scan.lit_mut()[cell] = [0; 2]);
            poser.solver.solve(&scan).expect("a head").record
        };
        for cell in 0..6 {
            assert_eq!(next(None).status, PoseStatus::Converged);
            let fewer = next(Some(cell));
            assert_eq!((fewer.status, fewer.cells_used), (PoseStatus::FewerCells, 0b11_1111 & !(1 << cell)));
        }
    }
}
