//! What turns a board's bytes into poses and hands them to everybody who wants them.
//!
//! What comes is taken in at once: decoded, recorded, counted. What is solved next [`Backlog`] decides, so
//! that control loops get new poses from a solver that is too slow, and while standard output is not read.
//! A thread of its own works with it, and the thread that reads, while that is quick: see [`super::desk`].

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use crossbeam_channel::Sender;

use super::BoardSlot;
use super::backlog::{Backlog, Next};
use super::circuit::Dry;
use super::consumers::Consumers;
use super::desk::{Bench, Worker};
use super::error::BoardError;
use super::inlet::CaptureInlet;
use super::progress::{News, Progress};
use super::verdict::Verdict;
use crate::clock::HostInstant;
use crate::datagram::Publisher;
use crate::link::Segment;
use crate::pipeline::{Counts, Item, Pipeline, Queue};
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

/// The thread that reads goes on with that after so long: what a board at 4 kHz sends in half a millisecond
/// waits in the operating system.
const SERVES_FOR_NS: u64 = 500_000;

/// Solves one board.
pub(super) struct Solver {
    pub(super) name: String,
    pub(super) pipeline: Pipeline,
    pub(super) verdicts: Sender<(u64, Verdict)>,
    pub(super) progress: Progress,
    pub(super) consumers: Consumers,
    pub(super) backlog: Backlog,
    pub(super) slot: Arc<BoardSlot>,
    pub(super) stop: Arc<AtomicBool>,
    pub(super) state: State,
}

/// What a solver knows besides.
#[derive(Default)]
pub(super) struct State {
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

impl Worker for Solver {
    type Piece = Segment;

    fn serve(&mut self, segment: &mut Segment) -> bool {
        self.state.now = HostInstant::now();
        let since_ns = self.state.now.monotonic_ns;
        self.receive(segment);
        while self.step() {
            if self.state.now.monotonic_ns.saturating_sub(since_ns) > SERVES_FOR_NS {
                return false;
            }
        }
        self.pause();
        self.pipeline.queue().waiting == 0
    }
}

impl Solver {
    /// Solves what is left to it until the thread that reads has ended, and gives the last account.
    pub(super) fn run(bench: &Bench<Self>) -> Counts {
        loop {
            let mut solver = bench.worker();
            solver.state.now = HostInstant::now();
            solver.take_in(bench);
            while solver.step() {
                solver.take_in(bench);
            }
            solver.pause();
            solver.consumers.hand_over_old_capture();
            let queue = solver.pipeline.queue();
            if queue.waiting == 0 && solver.state.is_over {
                return solver.end();
            }
            if queue.waiting > 0 && (solver.state.is_over || queue.oldest_ns.is_none()) {
                // Nothing else is to be done before there is room.
                solver.consumers.await_room(IDLE);
            } else {
                drop(solver);
                bench.pieces.wait(if queue.waiting > 0 { ROOM_EVERY } else { IDLE });
            }
        }
    }

    fn end(&mut self) -> Counts {
        self.consumers.hand_over_capture();
        self.account();
        self.pipeline.counts()
    }

    /// Takes in all that was left, as far as there is room.
    fn take_in(&mut self, bench: &Bench<Self>) {
        loop {
            let queue = self.pipeline.queue();
            // Without times nobody is late, and one piece after the other will do.
            let has_room = queue.waiting == 0 || (queue.oldest_ns.is_some() && queue.waiting < MOST_WAITING);
            if !has_room {
                return;
            }
            match bench.pieces.next_now() {
                Ok(mut segment) => {
                    self.receive(&mut segment);
                    bench.pieces.give_back(segment);
                }
                Err(Dry::Yet) => return,
                Err(Dry::Forever) => {
                    self.state.is_over = true;
                    return;
                }
            }
        }
    }

    /// Does what is next; `false` if nothing can be done before something comes, or is printed.
    fn step(&mut self) -> bool {
        let queue = self.pipeline.queue();
        let can_print = self.consumers.can_print();
        let next = self.backlog.next(&queue, can_print, self.state.now.monotonic_ns);
        self.state.was_behind |= self.backlog.is_behind();
        self.state.was_blocked |= !can_print;
        match next {
            Next::Oldest => self.solve_oldest(&queue),
            Next::Newest => self.solve_newest(),
            Next::Skip(count) => self.skip(count),
            Next::Wait => return false,
        }
        self.give_up_in_time();
        self.account_in_time();
        true
    }

    /// Hands on what was kept to go out together.
    fn pause(&mut self) {
        self.consumers.send();
        self.consumers.hand_over_outbox();
        self.give_up_in_time();
        self.account_in_time();
    }

    fn account_in_time(&mut self) {
        if self.state.now.monotonic_ns.saturating_sub(self.state.accounted_ns) >= ACCOUNT_EVERY_NS {
            self.account();
        }
    }

    fn receive(&mut self, segment: &mut Segment) {
        let opened = segment.opened;
        self.state.connection += u64::from(opened);
        self.state.is_unusable &= !opened;
        // What is queued behind the end belongs to nobody; what cannot be solved is recorded.
        if self.state.is_unusable && !self.state.is_complete {
            self.consumers.begin(opened);
            self.consumers.keep(segment);
        } else if !self.state.is_complete {
            if let Err(error) = self.decode(segment) {
                self.state.is_unusable = true;
                self.tell(self.state.connection, Verdict::Unusable(error));
            }
            let read_at = segment.reads.last().and_then(|read| read.at);
            match self.progress.take(opened, &self.pipeline.counts(), read_at) {
                Some(News::Begun) => self.tell(self.state.connection, Verdict::Scans),
                Some(News::Missing(seconds, cause)) => {
                    self.tell(self.state.connection, Verdict::Scanless(seconds, cause));
                }
                None => {}
            }
            let status = self.pipeline.board_status();
            if opened {
                // A status from before the start tells nothing.
                self.state.idle_tick = status.map(|status| status.tick);
            } else if status.is_some_and(|status| !status.acquiring && Some(status.tick) != self.state.idle_tick) {
                self.state.idle_tick = status.map(|status| status.tick);
                let complaint = self.consumers.complaint.take();
                self.tell(self.state.connection, Verdict::Stopped(complaint));
            }
            if self.pipeline.is_complete() {
                self.state.is_complete = true;
                self.tell(self.state.connection, Verdict::Complete);
            }
        }
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

    fn solve_oldest(&mut self, queue: &Queue) {
        let Some(record) = self.pipeline.solve_next() else {
            return;
        };
        self.state.now = HostInstant::now();
        // The most urgent first.
        if queue.passed == 0 {
            self.consumers.publish(&record, self.state.now, self.backlog.is_behind());
        }
        self.consumers.print(&record);
    }

    fn solve_newest(&mut self) {
        let Some(record) = self.pipeline.solve_newest() else {
            return;
        };
        self.state.now = HostInstant::now();
        self.consumers.publish(&record, self.state.now, true);
    }

    fn skip(&mut self, count: usize) {
        self.pipeline.skip(count);
        self.consumers.skip(count);
    }

    /// After an interrupt the program does not wait for scans that are still to be solved.
    fn give_up_in_time(&mut self) {
        if !self.stop.load(Ordering::Relaxed) {
            return;
        }
        let now_ns = self.state.now.monotonic_ns;
        let gives_up_at_ns = *self.state.gives_up_at_ns.get_or_insert(now_ns + GIVES_UP_AFTER_NS);
        if now_ns >= gives_up_at_ns {
            self.skip(self.pipeline.queue().waiting);
        }
    }

    fn tell(&self, connection: u64, verdict: Verdict) {
        // A reader that has ended needs no verdict, and one that has had many will look at the first.
        let _ = self.verdicts.try_send((connection, verdict));
    }

    fn account(&mut self) {
        let now_ns = self.state.now.monotonic_ns;
        self.state.accounted_ns = now_ns;
        let queue = self.pipeline.queue();
        let is_behind = std::mem::take(&mut self.state.was_behind);
        self.state.behind_since_ns = is_behind.then(|| self.state.behind_since_ns.unwrap_or(now_ns));
        let lag = LagReport {
            is_behind,
            behind_s: self.state.behind_since_ns.map_or(0.0, |since_ns| now_ns.saturating_sub(since_ns) as f64 * 1e-9),
            is_output_blocked: std::mem::take(&mut self.state.was_blocked),
            waiting_scans: queue.waiting as u64,
            waiting_s: queue.oldest_ns.map_or(0.0, |oldest_ns| now_ns.saturating_sub(oldest_ns) as f64 * 1e-9),
            skipped_scans: self.pipeline.counts().scans_skipped,
        };
        self.say_lag(&lag);
        let Consumers { statistics, capture, publisher, .. } = &mut self.consumers;
        statistics.set_lag(lag);
        statistics.set_host_losses(HostLosses {
            bytes_unrecorded: capture.as_ref().map_or(0, CaptureInlet::bytes_dropped),
            poses_unsent: publisher.as_ref().map_or(0, Publisher::missed),
        });
        self.slot.account(&self.pipeline, statistics);
    }

    /// Says once that it is behind, and once that it keeps up again.
    fn say_lag(&mut self, lag: &LagReport) {
        let Self { name, state, .. } = self;
        match (lag.finding(), state.told) {
            (Some(finding), None) => {
                self.slot.link.say(format_args!("{}", finding.within(name)));
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
