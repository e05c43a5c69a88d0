//! From bytes to poses: bytes → packets → scans → photocurrents → poses.
//!
//! One pipeline serves boards, simulated boards and captures. It does no I/O: bytes are pushed in, [`Item`]s come out
//! in order. After the first hello nothing is allocated per scan.
//!
//! [`push`](Pipeline::push) and [`feed`](Pipeline::feed) solve every scan. A caller that must keep up with a board uses
//! [`receive`](Pipeline::receive), which only decodes, and chooses the scan that is solved next.

mod board_clock;
mod board_poses;
mod counts;
mod doubt;
mod error;
mod oddity;
mod outcomes;
mod session;
mod span;
#[cfg(test)]
mod tests;
mod waiting;

use std::collections::VecDeque;

use glam::{DQuat, DVec3};
use slitpose_calibration::Head;
use slitpose_head::scene_file::fnv1a_64;
use slitpose_model::{Filtered, Photocurrents, Pose, Solution, Tier, Tracked, TwistEstimate};
use slitpose_protocol::poses::READY_TICKS;
use slitpose_protocol::{
    Batch, BoardKind, DELIMITER, Decoder, Hello, MAX_MESSAGE_BYTES, Message, Poses, Severity, Status, Truth,
};

pub use board_poses::Agreement;
pub use counts::Counts;
pub use error::PipelineError;
pub use oddity::Oddity;
pub use outcomes::Outcomes;
pub(crate) use outcomes::reason;
pub use session::{check, check_calibration, head_of};
pub use waiting::{Queue, Scan};

use crate::clock::{HostInstant, HostTime};
use crate::health::HeadHealth;
use crate::link::{DeviceId, Segment};
use board_clock::BoardClock;
use oddity::ClockWatch;
use session::Session;
use span::Span;
use waiting::{Content, Waiting};

/// True poses that may wait for their scans: more than a board queues.
const MAX_TRUTHS: usize = 1024;

/// The pose of one scan.
#[derive(Clone, Copy, Debug)]
pub struct Record {
    /// The board.
    pub device: DeviceId,
    /// Number of the scan, counted by the board.
    pub sequence: u64,
    /// The instant of the pose by the board's clock, seconds.
    pub device_time_s: f64,
    /// The same instant by the host's clocks; `None` while unknown.
    pub host_time: Option<HostTime>,
    /// The time at which the last byte of the scan's batch had been read.
    pub arrival: Option<HostInstant>,
    /// The solution from this scan alone.
    pub solution: Solution,
    /// Velocity at that instant, from this scan and a few before.
    pub twist: Option<TwistEstimate>,
    /// Pose and velocity filtered over many scans, if requested.
    pub filtered: Option<Filtered>,
    /// Whether the photocurrents were computed, not measured.
    pub simulated: bool,
    /// The true pose at that instant, from simulated boards only.
    pub truth: Option<Pose>,
}

/// An output of the pipeline.
#[derive(Debug)]
pub enum Item<'a> {
    /// A board introduced itself.
    Hello(&'a Hello<'a>),
    /// A scan arrived. It will be solved, or skipped.
    Scan(&'a Scan),
    /// A scan was solved: its pose, or the reason for none.
    Pose(&'a Record),
    /// The board's own counters.
    Status(&'a Status),
    /// Something happened on the board.
    Event {
        /// Its severity.
        severity: Severity,
        /// Its time by the board's clock, seconds.
        device_time_s: f64,
        /// Its description.
        text: &'a str,
    },
    /// A fault in the stream that a sound board never shows.
    Oddity {
        /// Its time by the board's clock, seconds; NaN if unknown.
        device_time_s: f64,
        /// The fault.
        oddity: Oddity,
    },
    /// The board answered a command.
    Reply(&'a slitpose_protocol::Reply),
}

/// How the pipeline treats a board whose stored scene differs from the one in use.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SceneMatch {
    /// A different hash is an error.
    Required,
    /// The user chose this scene knowingly.
    Waived,
}

/// Who finds the poses.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum PoseSource {
    /// This program, in the words of each scan.
    #[default]
    Host,
    /// The board; what words it sends besides are a sample to check its poses by.
    Board,
}

/// Options of the tracker.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Following {
    /// Who finds the poses. The options that follow are for poses found here.
    pub source: PoseSource,
    /// Memory of a filter over many scans, seconds; `None` for no filter.
    pub filter_s: Option<f64>,
    /// Whether cells whose light falls on an end of the detector are left out.
    pub without_clipped: bool,
}

/// Turns bytes into poses.
#[derive(Debug)]
pub struct Pipeline {
    decoder: Decoder<MAX_MESSAGE_BYTES>,
    flow: Flow,
}

/// All stages after the decoder.
#[derive(Debug)]
struct Flow {
    head: Head,
    tier: Tier,
    scene_match: SceneMatch,
    following: Following,
    watched: bool,
    session: Option<Box<Session>>,
    /// Ended sessions with waiting scans, the oldest first.
    earlier: VecDeque<Box<Session>>,
    sessions: u64,
    waiting: Waiting,
    clock: BoardClock,
    span: Span,
    truths: VecDeque<Truth>,
    clock_watch: ClockWatch,
    /// No hello has come over the link yet.
    is_opened: bool,
    /// Whether a board that is not simulated has sent true poses.
    has_false_truth: bool,
    /// Whether the board has sent poses of another head.
    has_other_head: bool,
    counts: Counts,
}

/// Whether scans are solved as they come.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Solve {
    AtOnce,
    Later,
}

impl Pipeline {
    /// A pipeline for boards with `head`, solved in `tier`. That of a scene alone is taken to be as the scene says.
    pub fn new(head: impl Into<Head>, tier: Tier, scene_match: SceneMatch) -> Self {
        Self {
            decoder: Decoder::new(),
            flow: Flow {
                head: head.into(),
                tier,
                scene_match,
                following: Following::default(),
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
            },
        }
    }

    /// Ends the stream `until_s` seconds of device time after the first scan, if given.
    #[must_use]
    pub fn until(mut self, until_s: Option<f64>) -> Self {
        self.flow.span = Span::until(until_s);
        self
    }

    /// Sets the options of the tracker.
    #[must_use]
    pub fn following(mut self, following: Following) -> Self {
        self.flow.following = following;
        self
    }

    /// Also monitors the cells of the head: see [`health`](Self::health).
    #[must_use]
    pub fn watched(mut self) -> Self {
        self.flow.watched = true;
        self
    }

    /// Decodes and solves `bytes`, cut anywhere, and passes the items that they complete to `sink`. Returns the number
    /// of bytes used: all, or those before the first scan after the [end](Self::until). Poses get no host times; for
    /// these see [`feed`](Self::feed).
    ///
    /// # Errors
    /// If the board cannot be used with this scene, or `sink` fails. Damaged bytes are no error:
    /// they are counted and skipped.
    pub fn push<E: From<PipelineError>>(
        &mut self,
        bytes: &[u8],
        mut sink: impl FnMut(Item<'_>) -> Result<(), E>,
    ) -> Result<usize, E> {
        self.flow.clock.read(None);
        self.decode(bytes, Solve::AtOnce, &mut sink)
    }

    /// Decodes and solves a segment as [`push`](Self::push) does. Where reads have instants, and after the first
    /// answered ping, it also finds the host's time of each scan.
    ///
    /// # Errors
    /// As for [`push`](Self::push).
    pub fn feed<E: From<PipelineError>>(
        &mut self,
        segment: &Segment,
        mut sink: impl FnMut(Item<'_>) -> Result<(), E>,
    ) -> Result<usize, E> {
        self.process(segment, Solve::AtOnce, &mut sink)
    }

    /// Decodes a segment as [`feed`](Self::feed) does, but lets the scans wait for
    /// `solve_next`, `solve_newest` or `skip`.
    ///
    /// # Errors
    /// As for [`push`](Self::push).
    pub fn receive<E: From<PipelineError>>(
        &mut self,
        segment: &Segment,
        mut sink: impl FnMut(Item<'_>) -> Result<(), E>,
    ) -> Result<usize, E> {
        self.process(segment, Solve::Later, &mut sink)
    }

    /// The state of the queue of waiting scans.
    pub fn queue(&self) -> Queue {
        self.flow.waiting.queue()
    }

    /// Solves the oldest waiting scan. Poses solved in this order do not depend on the delay.
    pub(crate) fn solve_next(&mut self) -> Option<Record> {
        self.flow.solve_next()
    }

    /// Solves the newest waiting scan ahead of its turn; it keeps its place in the queue. `None` if it has already
    /// been solved ahead.
    pub(crate) fn solve_newest(&mut self) -> Option<Record> {
        self.flow.solve_newest()
    }

    /// Takes the oldest waiting scan that has photocurrents unsolved, with these, and counts it and those before as
    /// skipped.
    pub fn take_currents(&mut self) -> Option<(Scan, Photocurrents)> {
        loop {
            let (scan, _) = self.flow.waiting.pop()?;
            self.flow.counts.scans_skipped += 1;
            let session = session_of(&mut self.flow.earlier, &mut self.flow.session, scan.session)?;
            if let Content::Words(words) = &scan.content {
                let photocurrents = session.photocurrents(words);
                return Some((scan, photocurrents));
            }
        }
    }

    /// How many sessions have begun: a board introduced itself for the first time, or with another configuration. Each
    /// begins with a new tracker.
    pub fn sessions(&self) -> u64 {
        self.flow.sessions
    }

    /// Digest of the state that later poses depend on besides later bytes and what scans say of themselves: that of the
    /// tracker, and recent contradictions. Of two pipelines that have decoded the same bytes and have the same digest, all later poses are the same,
    /// bit for bit, whichever scans each has solved before (but for a chance of 2⁻⁶⁴). `None` before the first hello.
    pub fn state(&self) -> Option<u64> {
        let session = self.flow.session.as_ref()?;
        // The text of a float says all its bits, and a field that is added to the tracker is in it.
        Some(fnv1a_64(format!("{} {:?}", session.number(), session.state()).as_bytes()))
    }

    /// Drops the `count` oldest waiting scans unsolved, and counts them.
    pub fn skip(&mut self, count: usize) {
        let skipped = (0..count).map_while(|_| self.flow.waiting.pop()).count();
        self.flow.counts.scans_skipped += skipped as u64;
    }

    fn process<E: From<PipelineError>>(
        &mut self,
        segment: &Segment,
        solve: Solve,
        sink: &mut impl FnMut(Item<'_>) -> Result<(), E>,
    ) -> Result<usize, E> {
        if segment.opened {
            self.decoder.reset();
            self.flow.clock.reopen();
            self.flow.clock_watch.begin_anew();
            self.flow.is_opened = true;
        }
        for asked in &segment.asked {
            self.flow.clock.ask(*asked);
        }
        let mut taken = 0;
        for (bytes, at) in segment.chunks() {
            self.flow.clock.read(at);
            let count = self.decode(bytes, solve, sink)?;
            taken += count;
            if count < bytes.len() {
                break;
            }
        }
        Ok(taken)
    }

    fn decode<E: From<PipelineError>>(
        &mut self,
        mut bytes: &[u8],
        solve: Solve,
        sink: &mut impl FnMut(Item<'_>) -> Result<(), E>,
    ) -> Result<usize, E> {
        let length = bytes.len();
        // After the end only whole packets are taken: the rest of a cut one may lie beyond the end.
        while !self.is_complete() || bytes.contains(&DELIMITER) {
            let ahead = bytes.len();
            let Some(result) = self.decoder.next::<Message<'_>>(&mut bytes) else {
                break;
            };
            // Damage is counted by the decoder.
            let Ok(message) = result else {
                continue;
            };
            if self.flow.span.is_complete()
                && matches!(message, Message::Batch(_) | Message::Poses(_) | Message::Truth(_))
            {
                return Ok(length - ahead);
            }
            self.flow.accept(&message, sink)?;
            while solve == Solve::AtOnce
                && let Some(record) = self.flow.solve_next()
            {
                sink(Item::Pose(&record))?;
            }
        }
        Ok(length - bytes.len())
    }

    /// The photocurrents of the scan that was solved last; `None` before the first hello.
    pub(crate) fn last_photocurrents(&self) -> Option<&Photocurrents> {
        self.flow.session.as_ref().map(|session| session.last_photocurrents())
    }

    /// The health of the head, if it is [monitored](Self::watched).
    pub fn health(&self) -> Option<HeadHealth> {
        self.flow.session.as_ref()?.health()
    }

    /// How the board's poses compare with those found here; `None` if it has sent none.
    pub fn agreement(&self) -> Option<Agreement> {
        self.flow.session.as_ref()?.agreement()
    }

    /// Rate error of the board's clock, ppm, positive if fast; `None` while unknown.
    pub fn drift_ppm(&self) -> Option<f64> {
        self.flow.clock.drift_ppm()
    }

    /// Whether the board reports a crystal and its rate has broken the bounds of one.
    pub(crate) fn contradicts_crystal(&self) -> bool {
        self.flow.clock.contradicts_crystal()
    }

    /// Device time between the first scan and the last, seconds.
    pub fn elapsed_s(&self) -> f64 {
        self.flow.span.elapsed_s()
    }

    /// Whether the [end](Self::until) is reached.
    pub(crate) fn is_complete(&self) -> bool {
        self.flow.span.is_complete()
    }

    /// The board's latest status.
    pub(crate) fn board_status(&self) -> Option<&Status> {
        self.flow.counts.board_status.as_ref()
    }

    /// The counts so far.
    pub fn counts(&self) -> Counts {
        let mut counts = self.flow.counts;
        counts.decoder = self.decoder.counters();
        counts.pending_bytes = self.decoder.pending_bytes();
        counts
    }
}

impl Flow {
    fn accept<E: From<PipelineError>>(
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
                self.counts.board_status = Some(*status);
                self.clock.set_source(status.clock);
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
                if self.session.as_ref().is_some_and(|session| session.kind() != BoardKind::Simulated) {
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
        }
    }

    /// Opens a session, unless the present one continues; returns an oddity if the board's number has changed.
    fn greet(&mut self, hello: &Hello<'_>) -> Result<Option<Oddity>, PipelineError> {
        let is_opened = std::mem::take(&mut self.is_opened);
        self.counts.greet();
        if self.session.as_ref().is_some_and(|session| session.is_of(hello)) {
            return Ok(None);
        }
        let now = DeviceId(hello.device_id);
        let before_now = self.session.as_ref().map(|session| session.device()).filter(|before| *before != now);
        if before_now.is_some() {
            self.counts.begin_numbering();
        }
        self.clock_watch.begin_anew();
        (self.has_false_truth, self.has_other_head) = (false, false);
        let number = self.sessions;
        let session =
            Session::open(&self.head, self.tier, self.scene_match, self.following, self.watched, hello, number)?;
        self.sessions += 1;
        self.clock.meet(session.device(), hello.schedule.tick_hz);
        let before = self.session.replace(Box::new(session));
        if !self.waiting.is_empty() {
            self.earlier.extend(before);
        }
        Ok(before_now.filter(|_| !is_opened).map(|before| Oddity::Renamed { before, now }))
    }

    fn arrive<E: From<PipelineError>>(
        &mut self,
        batch: &Batch<'_>,
        sink: &mut impl FnMut(Item<'_>) -> Result<(), E>,
    ) -> Result<(), E> {
        let Some(session) = self.session.as_mut().filter(|session| session.configuration() == batch.configuration)
        else {
            self.counts.batches_without_hello += 1;
            return Ok(());
        };
        let Ok(scans) = batch.scans(session.schedule()) else {
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

    /// Takes poses of the board.
    fn take_poses<E: From<PipelineError>>(
        &mut self,
        poses: &Poses<'_>,
        sink: &mut impl FnMut(Item<'_>) -> Result<(), E>,
    ) -> Result<(), E> {
        let is_source = self.following.source == PoseSource::Board;
        let Some(session) = self.session.as_mut().filter(|session| session.configuration() == poses.configuration)
        else {
            self.counts.batches_without_hello += u64::from(is_source);
            return Ok(());
        };
        if let Some((_, tick, record)) = poses.iter(session.schedule().frame_ticks).last() {
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
            for (sequence, tick, pose) in known {
                if !self.queue(sequence, tick, Content::Pose(pose), sink)? {
                    break;
                }
            }
        }
        Ok(())
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
        let device_time_s = session.time_s(tick);
        if !self.span.admits(device_time_s, session.frame_s()) {
            return Ok(false);
        }
        // Scans are solved in the order of their numbers.
        if self.counts.count_repeat(sequence) {
            return Ok(true);
        }
        let unsolved = match content {
            Content::Words(_) => 0,
            Content::Pose(_) => session.place_unsolved(self.counts.missing_before(sequence)),
        };
        self.counts.count_scan(sequence, unsolved);
        let frame_ticks = session.schedule().frame_ticks;
        if let Some(oddity) = self.clock_watch.check(sequence, tick, frame_ticks, session.tick_hz()) {
            sink(Item::Oddity { device_time_s, oddity })?;
        }
        let scan = Scan {
            sequence,
            unsolved,
            content,
            session: session.number(),
            device_time_s,
            host_time: self.clock.time_of(tick, session.reference_ticks()),
            arrival: self.clock.at(),
            truth: truth_of(&mut self.truths, sequence),
        };
        self.waiting.push(scan);
        sink(Item::Scan(&scan))?;
        Ok(true)
    }

    fn solve_next(&mut self) -> Option<Record> {
        let (scan, is_passed) = self.waiting.pop()?;
        while self.earlier.front().is_some_and(|session| session.number() < scan.session) {
            self.earlier.pop_front();
        }
        // A newer scan has already been counted for the health of the head.
        let session = session_of(&mut self.earlier, &mut self.session, scan.session)?;
        let tracked = session.solve(&scan, !is_passed);
        self.counts.outcomes.count(&tracked.solution.outcome);
        Some(record(session, &scan, tracked))
    }

    fn solve_newest(&mut self) -> Option<Record> {
        let is_first = self.waiting.queue().passed == 0;
        let scan = self.waiting.pass()?;
        let session = session_of(&mut self.earlier, &mut self.session, scan.session)?;
        let tracked = session.solve_ahead(&scan, is_first);
        Some(record(session, &scan, tracked))
    }
}

fn session_of<'a>(
    earlier: &'a mut VecDeque<Box<Session>>,
    current: &'a mut Option<Box<Session>>,
    number: u64,
) -> Option<&'a mut Session> {
    earlier.iter_mut().chain(current).map(|session| &mut **session).find(|session| session.number() == number)
}

fn record(session: &Session, scan: &Scan, Tracked { solution, twist, filtered }: Tracked) -> Record {
    Record {
        device: session.device(),
        sequence: scan.sequence(),
        device_time_s: scan.device_time_s,
        host_time: scan.host_time,
        arrival: scan.arrival,
        solution,
        twist,
        filtered,
        simulated: session.kind() == BoardKind::Simulated,
        truth: scan.truth,
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
