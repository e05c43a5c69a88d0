//! Scans that have arrived but are not solved yet.

use std::collections::VecDeque;

use slitpose_model::Pose;
use slitpose_protocol::RawScan;

use crate::clock::{HostInstant, HostTime};

/// Most scans that may wait: a minute of a board at 4 kHz, 80 MB. Then reading waits, and finally the board.
const MAX_WAITING: usize = 1 << 18;

/// Most earlier sessions that may wait. A board that changes its configuration all the time is read no faster than it is
/// solved.
const MAX_SESSIONS: usize = 4;

/// Initial capacity: 30 ms of a board at 4 kHz.
const USUAL: usize = 128;

#[derive(Clone, Copy, Debug)]
pub(super) enum Content {
    /// The words of its converters: to be solved here.
    Words(RawScan),
    /// The pose that the board has found.
    Pose(super::board_poses::BoardPose),
}

/// A scan that is not solved yet.
#[derive(Clone, Copy, Debug)]
pub struct Scan {
    /// Number of the scan, counted by the board.
    pub sequence: u64,
    /// Scans before it that the board says not to have solved: they are missing, and yet not lost.
    pub unsolved: u64,
    pub(super) content: Content,
    pub(super) session: u64,
    /// The instant of its pose by the board's clock, seconds.
    pub device_time_s: f64,
    /// The same instant by the host's clocks; `None` while unknown.
    pub host_time: Option<HostTime>,
    /// The time at which the last byte of its batch had been read.
    pub arrival: Option<HostInstant>,
    /// The true pose at that instant, from simulated boards only.
    pub truth: Option<Pose>,
}

/// The state of the queue of waiting scans.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Queue {
    /// Number of waiting scans.
    pub waiting: usize,
    /// Number of waiting scans older than one that was solved ahead of its turn.
    pub passed: usize,
    /// Arrival of the oldest, CLOCK_MONOTONIC, ns; `None` if nothing waits, or if the stream does not run in real
    /// time.
    pub oldest_ns: Option<u64>,
    /// Number of earlier sessions of which scans wait: each keeps a compiled head of some hundred kilobytes.
    pub sessions: usize,
}

impl Queue {
    /// Whether more scans may arrive. Without read times no pose can be late, and chunks are received one at a time.
    pub fn has_room(&self) -> bool {
        let is_full = self.oldest_ns.is_none() || self.waiting >= MAX_WAITING || self.sessions >= MAX_SESSIONS;
        self.waiting == 0 || !is_full
    }
}

/// Scans in the order of their arrival.
#[derive(Debug)]
pub(super) struct Waiting {
    pub(super) scans: VecDeque<Scan>,
    passed: usize,
}

impl Default for Waiting {
    fn default() -> Self {
        Self { scans: VecDeque::with_capacity(USUAL), passed: 0 }
    }
}

impl Waiting {
    /// Removes the oldest scan; also returns whether a newer one was solved ahead of it.
    pub(super) fn pop(&mut self) -> Option<(Scan, bool)> {
        let scan = self.scans.pop_front()?;
        let is_passed = self.passed > 0;
        self.passed = self.passed.saturating_sub(1);
        Some((scan, is_passed))
    }

    /// The newest scan, to be solved ahead of its turn; `None` if it already was.
    pub(super) fn pass(&mut self) -> Option<Scan> {
        if self.passed == self.scans.len() {
            return None;
        }
        self.passed = self.scans.len();
        self.scans.back().copied()
    }

    pub(super) fn queue(&self) -> Queue {
        let oldest = self.scans.front().and_then(|scan| scan.arrival);
        Queue {
            waiting: self.scans.len(),
            passed: self.passed,
            oldest_ns: oldest.map(|arrival| arrival.monotonic_ns),
            sessions: 0,
        }
    }
}

#[cfg(test)]
mod tests {
    use crate::link::Segment;
    use crate::pipeline::tests::{SimulatedLink, feed};
    use crate::pipeline::{Item, Pipeline, PipelineError, Record};

    fn receive(pipeline: &mut Pipeline, segment: &Segment) -> Vec<u64> {
        let mut arrived = Vec::new();
        let taken = pipeline.receive(segment, |item| {
            assert!(!matches!(item, Item::Pose(_)), "nobody has asked for a pose");
            if let Item::Scan(scan) = item {
                arrived.push(scan.sequence);
            }
            Ok::<_, PipelineError>(())
        });
        assert_eq!(taken.unwrap(), segment.bytes.len());
        arrived
    }

    fn assert_same(late: &Record, in_time: &Record) {
        assert_eq!((late.sequence, late.device_time_s), (in_time.sequence, in_time.device_time_s));
        assert_eq!((late.host_time, late.arrival, late.truth), (in_time.host_time, in_time.arrival, in_time.truth));
        assert_eq!(late.solution.estimate, in_time.solution.estimate);
        assert_eq!(late.solution.outcome, in_time.solution.outcome);
    }

    #[test]
    fn poses_in_turn_do_not_depend_on_scans_solved_ahead() {
        let mut link = SimulatedLink::new();
        let segments: Vec<Segment> = (0..10).map(|token| link.segment(20, token)).collect();
        let mut in_time = link.pipeline().watched();
        let expected: Vec<Record> = segments.iter().flat_map(|segment| feed(&mut in_time, segment).1).collect();
        assert_eq!(expected.len(), 200);

        let mut pipeline = link.pipeline().watched();
        let (mut printed, mut ahead) = (Vec::new(), Vec::new());
        for (number, segment) in (1..).zip(&segments) {
            assert_eq!(receive(&mut pipeline, segment).len(), 20);
            ahead.extend(pipeline.solve_newest());
            assert!(pipeline.solve_newest().is_none(), "it has been solved");
            printed.extend((0..3).filter_map(|_| pipeline.solve_next()));
            let queue = pipeline.queue();
            assert_eq!((queue.waiting, queue.passed), (17 * number, 17 * number));
            assert_eq!(queue.oldest_ns, expected[printed.len()].arrival.map(|at| at.monotonic_ns));
        }
        printed.extend(std::iter::from_fn(|| pipeline.solve_next()));
        assert_eq!((printed.len(), ahead.len(), pipeline.queue().waiting), (200, 10, 0));
        printed.iter().zip(&expected).for_each(|(late, in_time)| assert_same(late, in_time));
        // The newest scan of each segment: another prediction, an equally accurate pose.
        for (ahead, expected) in ahead.iter().zip(expected.iter().skip(19).step_by(20)) {
            assert_eq!((ahead.sequence, ahead.arrival), (expected.sequence, expected.arrival));
            let found = ahead.solution.estimate.unwrap();
            let (dt, dr) = found.pose.displacement_from(&ahead.truth.unwrap());
            let off = [dt.x, dt.y, dt.z, dr.x, dr.y, dr.z];
            // Of 60 normal numbers 3e-5 lie beyond 5 σ; this σ includes that the motion was unknown.
            assert!(off.iter().zip(found.sigma()).all(|(off, sigma)| off.abs() < 5.0 * sigma), "{off:?}");
        }
        let counts = pipeline.counts();
        assert_eq!((counts.scans, counts.scans_skipped), (200, 0));
        assert_eq!(counts.outcomes, in_time.counts().outcomes, "each scan has one outcome");
        // Scans solved after a newer one do not count for the health of the head: only the ten newest do.
        assert_eq!(pipeline.health().unwrap().cells[0].totals.scans, 10);
    }

    #[test]
    fn skipped_scans_are_counted_and_the_rest_is_followed() {
        let mut link = SimulatedLink::new();
        let mut pipeline = link.pipeline();
        for token in 0..5 {
            let arrived = receive(&mut pipeline, &link.segment(20, token));
            pipeline.skip(19);
            let record = pipeline.solve_next().unwrap();
            assert_eq!((Some(&record.sequence), pipeline.queue().waiting), (arrived.last(), 0));
            assert!(record.solution.estimate.is_some());
        }
        pipeline.skip(1);
        let counts = pipeline.counts();
        assert_eq!((counts.scans, counts.scans_skipped, counts.scans_lost), (100, 95, 0));
        assert_eq!(counts.outcomes.all(), 5);
    }

    #[test]
    fn a_board_that_changes_its_configuration_all_the_time_costs_few_sessions() {
        let mut link = SimulatedLink::new();
        let mut pipeline = link.pipeline();
        let (mut arrived, mut solved) = (0, 0);
        for round in 0..60 {
            if round > 0 {
                link.reconfigure();
            }
            while !pipeline.queue().has_room() {
                solved += u64::from(pipeline.solve_next().is_some());
            }
            arrived += receive(&mut pipeline, &link.segment(6, round)).len() as u64;
            assert!(pipeline.queue().sessions <= super::MAX_SESSIONS, "{round}: {:?}", pipeline.queue());
        }
        assert_eq!(pipeline.sessions(), 60);
        solved += std::iter::from_fn(|| pipeline.solve_next()).count() as u64;
        assert_eq!((solved, pipeline.counts().scans_skipped, pipeline.queue().sessions), (arrived, 0, 0));
        assert!(arrived >= 60, "{arrived}");
    }

    #[test]
    fn scans_of_an_earlier_configuration_are_solved_by_it() {
        let (mut first, mut second) = (SimulatedLink::new(), SimulatedLink::new());
        let mut in_time = first.pipeline();
        let mut early = first.segment(20, 0);
        // The second board counts configurations from there.
        second.reconfigure();
        let late = second.segment(20, 1);
        early.append(&late);
        let (_, expected) = feed(&mut in_time, &early);
        let mut pipeline = first.pipeline();
        assert_eq!(receive(&mut pipeline, &early).len(), 40);
        let newest = pipeline.solve_newest().unwrap();
        assert_eq!(newest.arrival, expected[39].arrival);
        assert!(newest.solution.estimate.is_some(), "solved by its own session");
        for expected in &expected {
            assert_same(&pipeline.solve_next().unwrap(), expected);
        }
        assert!(pipeline.solve_next().is_none());
    }
}
