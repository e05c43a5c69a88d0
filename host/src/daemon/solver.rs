//! The thread that turns a board's bytes into poses and hands them to everybody who wants them.
//!
//! What comes is taken in at once: decoded, recorded, counted. What is solved next [`Backlog`] decides, so
//! that control loops get new poses from a solver that is too slow, and while standard output is not read.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use crossbeam_channel::Sender;

use super::BoardSlot;
use super::backlog::{Backlog, Next};
use super::circuit::{Drainer, Dry};
use super::consumers::Consumers;
use super::error::BoardError;
use super::inlet::CaptureInlet;
use super::progress::{News, Progress};
use super::reader::Verdict;
use crate::clock::HostInstant;
use crate::datagram::Publisher;
use crate::pipeline::{Counts, Item, Pipeline, Queue, Segment};
use crate::telemetry::{HostLosses, LagReport};

/// Without anything to solve it looks about so often.
const IDLE: Duration = Duration::from_millis(100);

/// While nothing can be printed it looks so often whether something can.
const ROOM_EVERY: Duration = Duration::from_millis(1);

/// The account of a board is renewed so often.
const ACCOUNT_EVERY_NS: u64 = 200_000_000;

/// Accounts without a scan out of its turn after which a solver that was behind keeps up again: 3 s.
const CALM: u32 = 15;

/// Scans that may wait: a minute of a board at 4 kHz, 80 MB. With more the link waits, and then the board.
const MOST_WAITING: usize = 1 << 18;

/// Interrupted, it solves what waits for no longer than this.
const GIVES_UP_AFTER_NS: u64 = 500_000_000;

/// Solves one board.
pub(super) struct SolverThread {
    pub(super) name: String,
    pub(super) pipeline: Pipeline,
    pub(super) segments: Drainer<Segment>,
    pub(super) verdicts: Sender<(u64, Verdict)>,
    pub(super) progress: Progress,
    pub(super) consumers: Consumers,
    pub(super) backlog: Backlog,
    pub(super) slot: Arc<BoardSlot>,
    pub(super) stop: Arc<AtomicBool>,
}

/// What the thread knows besides.
#[derive(Default)]
struct State {
    /// Number of the connection, from 1.
    connection: u64,
    is_unusable: bool,
    is_complete: bool,
    /// The tick of the last status of a board that does not sample.
    idle_tick: Option<u64>,
    /// The reader has ended.
    is_over: bool,
    gives_up_at_ns: Option<u64>,
    now: HostInstant,
    accounted_ns: u64,
    /// What was so at some moment since the last account.
    was_behind: bool,
    behind_since_ns: Option<u64>,
    was_blocked: bool,
    /// The user knows that it is behind; accounts since it was.
    told: Option<u32>,
}

impl SolverThread {
    /// Solves until the reader has ended, and gives the last account.
    pub(super) fn run(mut self) -> Counts {
        let mut state = State { now: HostInstant::now(), ..State::default() };
        loop {
            let queue = self.take_in(&mut state);
            let can_print = self.consumers.can_print();
            let next = self.backlog.next(&queue, can_print, state.now.monotonic_ns);
            state.was_behind |= self.backlog.is_behind();
            state.was_blocked |= !can_print;
            match next {
                Next::Oldest => self.solve_oldest(&queue, &mut state),
                Next::Newest => self.solve_newest(&mut state),
                Next::Skip(count) => self.skip(count),
                Next::Wait if state.is_over && queue.waiting == 0 => break,
                Next::Wait => self.wait(&queue, &mut state),
            }
            self.give_up_in_time(&mut state);
            if state.now.monotonic_ns.saturating_sub(state.accounted_ns) >= ACCOUNT_EVERY_NS {
                self.account(&mut state);
            }
        }
        self.consumers.hand_over_outbox();
        self.consumers.hand_over_capture();
        self.account(&mut state);
        self.pipeline.counts()
    }

    /// Takes in all that has come, as far as there is room, and gives what waits then.
    fn take_in(&mut self, state: &mut State) -> Queue {
        loop {
            let queue = self.pipeline.queue();
            // Without times nobody is late, and one piece after the other will do.
            let has_room = queue.waiting == 0 || (queue.oldest_ns.is_some() && queue.waiting < MOST_WAITING);
            if !has_room {
                return queue;
            }
            match self.segments.next_now() {
                Ok(segment) => self.receive(segment, state),
                Err(Dry::Yet) => return queue,
                Err(Dry::Forever) => {
                    state.is_over = true;
                    return queue;
                }
            }
        }
    }

    fn receive(&mut self, mut segment: Segment, state: &mut State) {
        let opened = segment.opened;
        state.connection += u64::from(opened);
        state.is_unusable &= !opened;
        // What is queued behind the end belongs to nobody; what cannot be solved is recorded.
        if state.is_unusable && !state.is_complete {
            self.consumers.begin(opened);
            self.consumers.keep(&segment);
        } else if !state.is_complete {
            if let Err(error) = self.decode(&mut segment) {
                state.is_unusable = true;
                self.tell(state.connection, Verdict::Unusable(error));
            }
            let read_at = segment.reads.last().and_then(|read| read.at);
            match self.progress.take(opened, &self.pipeline.counts(), read_at) {
                Some(News::Begun) => self.tell(state.connection, Verdict::Scans),
                Some(News::Missing(seconds, cause)) => self.tell(state.connection, Verdict::Scanless(seconds, cause)),
                None => {}
            }
            let status = self.pipeline.board_status();
            if opened {
                // A status from before the start tells nothing.
                state.idle_tick = status.map(|status| status.tick);
            } else if status.is_some_and(|status| !status.acquiring && Some(status.tick) != state.idle_tick) {
                state.idle_tick = status.map(|status| status.tick);
                let complaint = self.consumers.complaint.take();
                self.tell(state.connection, Verdict::Stopped(complaint));
            }
            if self.pipeline.is_complete() {
                state.is_complete = true;
                self.tell(state.connection, Verdict::Complete);
            }
        }
        self.segments.give_back(segment);
    }

    fn decode(&mut self, segment: &mut Segment) -> Result<(), BoardError> {
        let Self { pipeline, consumers, slot, name, .. } = self;
        consumers.begin(segment.opened);
        let fed = pipeline.receive(segment, |item| {
            if let Item::Oddity { oddity, .. } = &item {
                slot.link.say(format_args!("{name}: {oddity}"));
            }
            consumers.take(&item);
            Ok(())
        });
        segment.truncate(*fed.as_ref().unwrap_or(&segment.bytes.len()));
        consumers.keep(segment);
        match consumers.refused.take() {
            Some(rejection) => fed.and(Err(BoardError::Refused(rejection))),
            None => fed.map(drop),
        }
    }

    fn solve_oldest(&mut self, queue: &Queue, state: &mut State) {
        let Some(record) = self.pipeline.solve_next() else {
            return;
        };
        state.now = HostInstant::now();
        // The most urgent first.
        if queue.passed == 0 {
            self.consumers.publish(&record, state.now, self.backlog.is_behind());
        }
        self.consumers.print(&record);
    }

    fn solve_newest(&mut self, state: &mut State) {
        let Some(record) = self.pipeline.solve_newest() else {
            return;
        };
        state.now = HostInstant::now();
        self.consumers.publish(&record, state.now, true);
    }

    fn skip(&mut self, count: usize) {
        self.pipeline.skip(count);
        self.consumers.skip(count);
    }

    /// Waits until something comes, or can be printed.
    fn wait(&mut self, queue: &Queue, state: &mut State) {
        self.consumers.hand_over_outbox();
        if queue.waiting > 0 && (state.is_over || queue.oldest_ns.is_none()) {
            self.consumers.await_room(IDLE);
        } else {
            let timeout = if queue.waiting > 0 { ROOM_EVERY } else { IDLE };
            match self.segments.next(timeout) {
                Ok(segment) => self.receive(segment, state),
                Err(Dry::Yet) => self.consumers.hand_over_capture(),
                Err(Dry::Forever) => state.is_over = true,
            }
        }
        state.now = HostInstant::now();
    }

    /// After an interrupt the program does not wait for scans that are still to be solved.
    fn give_up_in_time(&mut self, state: &mut State) {
        if !self.stop.load(Ordering::Relaxed) {
            return;
        }
        let now_ns = state.now.monotonic_ns;
        let gives_up_at_ns = *state.gives_up_at_ns.get_or_insert(now_ns + GIVES_UP_AFTER_NS);
        if now_ns >= gives_up_at_ns {
            self.skip(self.pipeline.queue().waiting);
        }
    }

    fn tell(&self, connection: u64, verdict: Verdict) {
        // A reader that has ended needs no verdict, and one that has had many will look at the first.
        let _ = self.verdicts.try_send((connection, verdict));
    }

    fn account(&mut self, state: &mut State) {
        let now_ns = state.now.monotonic_ns;
        state.accounted_ns = now_ns;
        let queue = self.pipeline.queue();
        let is_behind = std::mem::take(&mut state.was_behind);
        state.behind_since_ns = is_behind.then(|| state.behind_since_ns.unwrap_or(now_ns));
        let lag = LagReport {
            is_behind,
            behind_s: state.behind_since_ns.map_or(0.0, |since_ns| now_ns.saturating_sub(since_ns) as f64 * 1e-9),
            is_output_blocked: std::mem::take(&mut state.was_blocked),
            waiting_scans: queue.waiting as u64,
            waiting_s: queue.oldest_ns.map_or(0.0, |oldest_ns| now_ns.saturating_sub(oldest_ns) as f64 * 1e-9),
            skipped_scans: self.pipeline.counts().scans_skipped,
        };
        self.say_lag(&lag, state);
        let Consumers { statistics, capture, publisher, .. } = &mut self.consumers;
        statistics.set_lag(lag);
        statistics.set_host_losses(HostLosses {
            bytes_unrecorded: capture.as_ref().map_or(0, CaptureInlet::bytes_dropped),
            poses_unsent: publisher.as_ref().map_or(0, Publisher::missed),
        });
        self.slot.account(&self.pipeline, statistics);
    }

    /// Says once that it is behind, and once that it keeps up again.
    fn say_lag(&self, lag: &LagReport, state: &mut State) {
        let name = &self.name;
        match (lag.complaint(), state.told) {
            (Some(complaint), None) => {
                self.slot.link.say(format_args!("{name}: {complaint}"));
                state.told = Some(0);
            }
            (Some(_), Some(_)) => state.told = Some(0),
            (None, Some(calm)) if calm >= CALM => {
                self.slot.link.say(format_args!("{name}: each scan is solved in time again"));
                state.told = None;
            }
            (None, told) => state.told = told.map(|calm| calm + 1),
        }
    }
}
