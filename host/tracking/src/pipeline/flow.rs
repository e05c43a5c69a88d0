//! From messages to poses: all stages after the decoder.

use std::cmp::Ordering;
use std::collections::VecDeque;

use glam::{DQuat, DVec3};
use slitpose_calibration::Head;
use slitpose_model::{Pose, Tier, Tracked};
use slitpose_protocol::poses::READY_TICKS;
use slitpose_protocol::{Batch, BoardKind, Edges, Hello, Message, Poses, Stream, Truth};

use super::board_clock::{BoardClock, Span};
use super::board_poses::BoardPose;
use super::item::ClockWatch;
use super::session::Session;
use super::waiting::{Content, Waiting};
use super::{Counts, EdgeRecord, Item, Oddity, PipelineError, PipelineOptions, PoseSource, Record, Scan, SceneMatch};
use crate::link::DeviceId;

/// True poses that may wait for their scans: more than a board queues.
const MAX_TRUTHS: usize = 1024;

/// A board's poses that are taken as they are must be compared within this device time.
const MAX_UNCHECKED_S: f64 = 1.5;

#[derive(Debug)]
pub(super) struct Flow {
    head: Head,
    tier: Tier,
    scene_match: SceneMatch,
    pub(super) following: PipelineOptions,
    pub(super) watched: bool,
    pub(super) session: Option<Box<Session>>,
    /// Ended sessions with waiting scans, the oldest first.
    pub(super) earlier: VecDeque<Box<Session>>,
    pub(super) sessions: u64,
    pub(super) waiting: Waiting,
    pub(super) clock: BoardClock,
    pub(super) span: Span,
    truths: VecDeque<Truth>,
    pub(super) clock_watch: ClockWatch,
    /// No hello has come over the link yet.
    pub(super) is_opened: bool,
    /// Whether a board that is not simulated has sent true poses.
    has_false_truth: bool,
    /// Whether the board has sent poses of another head.
    has_other_head: bool,
    pub(super) counts: Counts,
    /// Device time of the last pose before which one had been compared; NaN before the first.
    checked_s: f64,
    pub(super) is_unchecked: bool,
}

impl Flow {
    pub(super) fn new(head: Head, tier: Tier, scene_match: SceneMatch) -> Self {
        Self {
            head,
            tier,
            scene_match,
            following: PipelineOptions::default(),
            watched: false,
            session: None,
            earlier: VecDeque::new(),
            sessions: 0,
            waiting: Waiting::default(),
            clock: BoardClock::default(),
            span: Span::default(),
            truths: VecDeque::with_capacity(MAX_TRUTHS),
            clock_watch: ClockWatch::default(),
            is_opened: true,
            has_false_truth: false,
            has_other_head: false,
            counts: Counts::default(),
            checked_s: f64::NAN,
            is_unchecked: false,
        }
    }

    pub(super) fn accept<E: From<PipelineError>>(
        &mut self,
        message: &Message<'_>,
        sink: &mut impl FnMut(Item<'_>) -> Result<(), E>,
    ) -> Result<(), E> {
        match message {
            Message::Hello(hello) => {
                if let Some(oddity) = self.greet(hello)? {
                    sink(Item::Oddity { device_time_s: f64::NAN, oddity })?;
                }
                sink(Item::Hello(hello))
            }
            Message::Batch(batch) => self.arrive(batch, sink),
            Message::Status(status) => {
                self.counts.take_status(status);
                if let Some(fit) = &mut self.clock.fit {
                    fit.set_source(status.clock);
                }
                sink(Item::Status(status))
            }
            Message::Event(event) => {
                let tick_hz = self.session.as_ref().map_or(f64::NAN, |session| session.tick_hz());
                sink(Item::Event {
                    severity: event.severity,
                    device_time_s: event.tick as f64 / tick_hz,
                    text: event.text,
                })
            }
            Message::Reply(reply) => sink(Item::Reply(reply)),
            Message::Pong(pong) => {
                self.clock.answer(pong);
                Ok(())
            }
            Message::Truth(truth) => {
                if self.session.as_ref().is_some_and(|session| session.kind != BoardKind::Simulated) {
                    return match std::mem::replace(&mut self.has_false_truth, true) {
                        true => Ok(()),
                        false => sink(Item::Oddity { device_time_s: f64::NAN, oddity: Oddity::Truth }),
                    };
                }
                if self.truths.len() == MAX_TRUTHS {
                    self.truths.pop_front();
                }
                self.truths.push_back(*truth);
                Ok(())
            }
            Message::Poses(poses) => self.take_poses(poses, sink),
            Message::Edges(edges) => self.take_edges(edges, sink),
        }
    }

    fn take_edges<E: From<PipelineError>>(
        &mut self,
        edges: &Edges,
        sink: &mut impl FnMut(Item<'_>) -> Result<(), E>,
    ) -> Result<(), E> {
        // Without a hello the ticks have no rate.
        let Some(session) = &self.session else { return Ok(()) };
        for (number, edge) in (edges.number..).zip(&edges.edges) {
            sink(Item::Edge(EdgeRecord {
                device: session.device,
                number,
                device_time_s: edge.tick() as f64 / session.tick_hz(),
                host_time: self.clock.time_of(edge.tick(), 0.0),
                is_high: edge.is_high(),
                missed: edges.missed,
            }))?;
        }
        Ok(())
    }

    /// Opens a session, unless the present one continues; returns an oddity if the board's number has changed.
    fn greet(&mut self, hello: &Hello<'_>) -> Result<Option<Oddity>, PipelineError> {
        let is_opened = std::mem::take(&mut self.is_opened);
        self.counts.greet();
        if self.session.as_ref().is_some_and(|session| session.is_of(hello)) {
            return Ok(None);
        }
        let now = DeviceId(hello.device_id);
        let before_now = self.session.as_ref().map(|session| session.device).filter(|before| *before != now);
        if before_now.is_some() {
            self.counts.begin_numbering();
        }
        self.clock_watch.begin_anew();
        (self.has_false_truth, self.has_other_head) = (false, false);
        let number = self.sessions;
        let session =
            Session::open(&self.head, self.tier, self.scene_match, self.following, self.watched, hello, number)?;
        self.sessions += 1;
        self.clock.meet(session.device, hello.schedule.tick_hz);
        let before = self.session.replace(Box::new(session));
        let newest = self.waiting.scans.back().map(|scan| scan.session);
        self.earlier.extend(before.filter(|before| Some(before.number) == newest));
        Ok(before_now.filter(|_| !is_opened).map(|before| Oddity::Renamed { before, now }))
    }

    fn arrive<E: From<PipelineError>>(
        &mut self,
        batch: &Batch<'_>,
        sink: &mut impl FnMut(Item<'_>) -> Result<(), E>,
    ) -> Result<(), E> {
        let Some(session) = self.session.as_mut().filter(|session| session.configuration == batch.configuration) else {
            self.counts.batches_without_hello += 1;
            return Ok(());
        };
        let Ok(scans) = batch.scans(&session.schedule) else {
            self.counts.batches_unreadable += 1;
            return Ok(());
        };
        self.clock.arrive(session.last_tick(batch.tick, scans.len()));
        if self.following.source == PoseSource::Board {
            // A sample of those whose poses the board sends.
            for scan in scans {
                session.solve_words(&scan, true);
            }
            return Ok(());
        }
        for scan in scans {
            if !self.queue(scan.sequence, scan.tick, Content::Words(scan), sink)? {
                break;
            }
        }
        Ok(())
    }

    fn take_poses<E: From<PipelineError>>(
        &mut self,
        poses: &Poses<'_>,
        sink: &mut impl FnMut(Item<'_>) -> Result<(), E>,
    ) -> Result<(), E> {
        let is_source = self.following.source == PoseSource::Board;
        let Some(session) = self.session.as_mut().filter(|session| session.configuration == poses.configuration) else {
            self.counts.batches_without_hello += u64::from(is_source);
            return Ok(());
        };
        if let Some((_, tick, record)) = poses.iter(session.schedule.frame_ticks).last() {
            // Not sent before it was solved.
            self.clock.arrive(tick.saturating_add(u64::from(record.ready) * u64::from(READY_TICKS)));
        }
        let Some(known) = session.take_poses(poses) else {
            return match std::mem::replace(&mut self.has_other_head, true) || !is_source {
                true => Ok(()),
                false => sink(Item::Oddity { device_time_s: f64::NAN, oddity: Oddity::OtherHead }),
            };
        };
        if is_source {
            for (sequence, tick, mut pose) in known {
                self.check(sequence, tick, &mut pose, sink)?;
                if !self.queue(sequence, tick, Content::Pose(pose), sink)? {
                    break;
                }
            }
        }
        Ok(())
    }

    /// Checks a pose of the board, and how long none has been compared.
    fn check<E: From<PipelineError>>(
        &mut self,
        sequence: u64,
        tick: u64,
        pose: &mut BoardPose,
        sink: &mut impl FnMut(Item<'_>) -> Result<(), E>,
    ) -> Result<(), E> {
        let Some(session) = &mut self.session else { return Ok(()) };
        let device_time_s = session.time_s(tick);
        // Device time may restart.
        let is_checked = session.comparison.as_mut().is_some_and(|it| std::mem::take(&mut it.is_checked));
        if is_checked || device_time_s.partial_cmp(&self.checked_s).is_none_or(Ordering::is_lt) {
            self.checked_s = device_time_s;
        }
        let limit_s = MAX_UNCHECKED_S.max(1.5 * f64::from(Stream::POSES.scans) * session.frame_s());
        self.is_unchecked = device_time_s - self.checked_s > limit_s;
        let Some(fault) = session.refuse(pose) else { return Ok(()) };
        self.counts.poses_refused += 1;
        match self.counts.poses_refused {
            count if count.is_power_of_two() => {
                sink(Item::Oddity { device_time_s, oddity: Oddity::Pose { sequence, fault, count } })
            }
            _ => Ok(()),
        }
    }

    /// Lets a scan wait for its turn; `false` if it lies behind the end.
    fn queue<E: From<PipelineError>>(
        &mut self,
        sequence: u64,
        tick: u64,
        content: Content,
        sink: &mut impl FnMut(Item<'_>) -> Result<(), E>,
    ) -> Result<bool, E> {
        let Some(session) = &mut self.session else { return Ok(false) };
        // Scans are solved in the order of their numbers, and take device time once.
        if self.counts.count_repeat(sequence) {
            return Ok(true);
        }
        let (device_time_s, frame_s) = (session.time_s(tick), session.frame_s());
        let left = self.span.left(frame_s);
        if !self.span.admits(device_time_s, frame_s) {
            self.counts.count_lost_before_end(sequence, left);
            return Ok(false);
        }
        let unsolved = match content {
            Content::Words(_) => 0,
            Content::Pose(_) => session.place_unsolved(self.counts.missing_before(sequence)),
        };
        self.counts.count_scan(sequence, unsolved);
        let frame_ticks = session.schedule.frame_ticks;
        if let Some(oddity) = self.clock_watch.check(sequence, tick, frame_ticks, session.tick_hz()) {
            sink(Item::Oddity { device_time_s, oddity })?;
        }
        let scan = Scan {
            sequence,
            unsolved,
            content,
            session: session.number,
            device_time_s,
            host_time: self.clock.time_of(tick, session.reference_ticks),
            arrival: self.clock.at,
            truth: truth_of(&mut self.truths, sequence),
        };
        self.waiting.scans.push_back(scan);
        sink(Item::Scan(&scan))?;
        Ok(true)
    }

    /// The stream has ended, and what it has not brought of the span is lost.
    pub(super) fn end(&mut self) {
        if let Some(session) = &self.session {
            self.counts.scans_lost += self.span.left(session.frame_s());
        }
    }

    /// Takes the oldest waiting scan, and drops the sessions before its own.
    pub(super) fn pop(&mut self) -> Option<(Scan, bool)> {
        let (scan, is_passed) = self.waiting.pop()?;
        while self.earlier.front().is_some_and(|session| session.number < scan.session) {
            self.earlier.pop_front();
        }
        Some((scan, is_passed))
    }

    pub(super) fn solve_next(&mut self) -> Option<Record> {
        let (scan, is_passed) = self.pop()?;
        // A newer scan has already been counted for the health of the head.
        let session = session_of(&mut self.earlier, &mut self.session, scan.session)?;
        let tracked = session.solve(&scan, !is_passed);
        self.counts.outcomes.count(&tracked.solution.outcome);
        Some(record(session, &scan, tracked))
    }

    pub(super) fn solve_newest(&mut self) -> Option<Record> {
        let is_first = self.waiting.queue().passed == 0;
        let scan = self.waiting.pass()?;
        let session = session_of(&mut self.earlier, &mut self.session, scan.session)?;
        let tracked = session.solve_ahead(&scan, is_first);
        Some(record(session, &scan, tracked))
    }
}

pub(super) fn session_of<'a>(
    earlier: &'a mut VecDeque<Box<Session>>,
    current: &'a mut Option<Box<Session>>,
    number: u64,
) -> Option<&'a mut Session> {
    earlier.iter_mut().chain(current).map(|session| &mut **session).find(|session| session.number == number)
}

fn record(session: &Session, scan: &Scan, Tracked { solution, twist, filtered, light_level }: Tracked) -> Record {
    Record {
        device: session.device,
        sequence: scan.sequence,
        device_time_s: scan.device_time_s,
        host_time: scan.host_time,
        arrival: scan.arrival,
        solution,
        twist,
        filtered,
        light_level,
        simulated: session.kind == BoardKind::Simulated,
        truth: scan.truth,
        view: None,
    }
}

/// The truth sent for a scan; older ones are dropped.
fn truth_of(truths: &mut VecDeque<Truth>, sequence: u64) -> Option<Pose> {
    while truths.front().is_some_and(|truth| truth.sequence < sequence) {
        truths.pop_front();
    }
    if truths.front()?.sequence != sequence {
        return None;
    }
    let truth = truths.pop_front()?;
    let pose = Pose {
        rotation: DQuat::from_array(truth.rotation_xyzw),
        translation_m: DVec3::from_array(truth.translation_m),
    };
    pose.is_finite().then_some(pose)
}
