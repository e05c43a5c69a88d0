//! Turns a board's bytes into poses and hands them to its outputs.
//!
//! Segments are decoded, recorded and counted at once. [`Backlog`] chooses the scan that is solved next, so that
//! control loops get new poses even if the solver is too slow or standard output is not read. The solver runs on its
//! own thread and, while it is quick, on the reading thread: see [`super::handoff`].

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use crossbeam_channel::{Sender, TryRecvError};

use super::backlog::{Backlog, Next};
use super::board::BoardSlot;
use super::handoff::{SolverEnd, Worker};
use super::link::{ScanWatch, StreamEvent};
use super::outputs::Outputs;
use super::tap::Tap;
use crate::terminal::say;
use slitpose_head::threads::lock;
use slitpose_tracking::clock::HostInstant;
use slitpose_tracking::link::Segment;
use slitpose_tracking::pipeline::{Counts, Item, Pipeline};
use slitpose_tracking::telemetry::{HostLosses, LagReport};

const IDLE: Duration = Duration::from_millis(100);

/// Interval of checks for room at the printer.
const ROOM_EVERY: Duration = Duration::from_millis(1);

const ACCOUNT_EVERY_NS: u64 = 200_000_000;

/// A solver that was behind counts as keeping up again after this many reports without a scan out of turn: 3 s.
const CALM: u32 = 15;

/// After an interrupt, waiting scans are solved for at most this long.
const GIVES_UP_AFTER_NS: u64 = 500_000_000;

/// Longest time that the reading thread solves at a stretch; the bytes of a board at 4 kHz meanwhile wait in the
/// operating system.
const PROCESSES_FOR_NS: u64 = 500_000;

pub(super) struct Solver {
    pub(super) name: String,
    pub(super) pipeline: Pipeline,
    pub(super) events: Sender<(u64, StreamEvent)>,
    pub(super) scan_watch: ScanWatch,
    pub(super) outputs: Outputs,
    pub(super) backlog: Backlog,
    pub(super) slot: Arc<BoardSlot>,
    pub(super) stop: Arc<AtomicBool>,
    pub(super) state: State,
}

#[derive(Default)]
pub(super) struct State {
    connection: u64,
    is_unusable: bool,
    is_complete: bool,
    /// The tick of the last status of a board that does not sample.
    idle_tick: Option<u64>,
    is_over: bool,
    gives_up_at_ns: Option<u64>,
    now: HostInstant,
    accounted_ns: u64,
    /// Whether the solver was behind at any time since the last account.
    was_behind: bool,
    behind_since_ns: Option<u64>,
    was_blocked: bool,
    /// Reports since the solver was last behind; `None` if that was not reported to the user.
    told: Option<u32>,
}

impl Worker for Solver {
    type Chunk = Segment;

    fn has_room(&self) -> bool {
        self.pipeline.queue().has_room()
    }

    fn process(&mut self, segment: &mut Segment) -> bool {
        self.state.now = HostInstant::now();
        let since_ns = self.state.now.monotonic_ns;
        self.receive(segment);
        while self.step() {
            if self.state.now.monotonic_ns.saturating_sub(since_ns) > PROCESSES_FOR_NS {
                return false;
            }
        }
        self.pause();
        self.pipeline.queue().waiting == 0
    }
}

impl Solver {
    /// Solves the chunks left to this thread until the reading thread has ended; returns the final counts.
    pub(super) fn run(handoff: &SolverEnd<Self>) -> Counts {
        loop {
            let mut solver = handoff.worker();
            solver.state.now = HostInstant::now();
            solver.receive_queued(handoff);
            while solver.step() {
                solver.receive_queued(handoff);
            }
            solver.pause();
            solver.outputs.capture.iter_mut().for_each(Tap::hand_over_old);
            let queue = solver.pipeline.queue();
            if queue.waiting == 0 && solver.state.is_over {
                return solver.end();
            }
            if queue.waiting > 0 && (solver.state.is_over || queue.oldest_ns.is_none()) {
                // Nothing to do until the printer has room.
                solver.outputs.await_room(IDLE);
            } else {
                drop(solver);
                handoff.chunks.wait(if queue.waiting > 0 { ROOM_EVERY } else { IDLE });
            }
        }
    }

    fn end(&mut self) -> Counts {
        self.outputs.capture.iter_mut().for_each(Tap::hand_over);
        // What a board took while it was missed is told otherwise, and not counted.
        if !self.stop.load(Ordering::Relaxed) && self.state.connection <= 1 {
            self.pipeline.end();
        }
        self.account();
        self.pipeline.counts()
    }

    /// Receives the chunks in the queue as long as scans have room to wait.
    fn receive_queued(&mut self, handoff: &SolverEnd<Self>) {
        loop {
            if !self.has_room() {
                return;
            }
            match handoff.chunks.next_now() {
                Ok(mut segment) => {
                    self.receive(&mut segment);
                    handoff.chunks.give_back(segment);
                }
                Err(TryRecvError::Empty) => return,
                Err(TryRecvError::Disconnected) => {
                    self.state.is_over = true;
                    return;
                }
            }
        }
    }

    /// Solves or skips the next scans; `false` if it must wait for more bytes, or until poses are printed.
    fn step(&mut self) -> bool {
        let queue = self.pipeline.queue();
        let can_print = self.outputs.can_print();
        let next = self.backlog.next(&queue, can_print, self.state.now.monotonic_ns);
        self.state.was_behind |= self.backlog.is_behind();
        self.state.was_blocked |= !can_print;
        let solved = match next {
            Next::Oldest => self.pipeline.solve_next(),
            Next::Newest => self.pipeline.solve_newest(),
            Next::Skip(count) => {
                self.pipeline.skip(count);
                self.outputs.skip(count);
                None
            }
            Next::Wait => return false,
        };
        if let Some(mut record) = solved {
            self.state.now = HostInstant::now();
            let is_newest = next == Next::Newest;
            let is_published = is_newest || queue.passed == 0;
            if is_published {
                // Captures stay in the frame of the head.
                self.outputs.capture.iter_mut().for_each(|tap| tap.pose(&record));
            }
            self.pipeline.see(&mut record);
            // The most urgent first.
            if is_published {
                let is_behind = is_newest || self.backlog.is_behind();
                self.outputs.publish(&record, self.pipeline.last_photocurrents(), self.state.now, is_behind);
            }
            if !is_newest {
                self.outputs.print(&record);
            }
        }
        self.give_up_in_time();
        self.account_in_time();
        true
    }

    fn pause(&mut self) {
        self.outputs.send();
        self.outputs.hand_over_outbox();
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
        // Segments after the end are dropped; a stream that cannot be solved is still recorded.
        if self.state.is_unusable && !self.state.is_complete {
            self.outputs.capture.iter_mut().for_each(|tap| tap.begin(opened));
            self.outputs.capture.iter_mut().for_each(|tap| tap.keep(segment));
        } else if !self.state.is_complete {
            if let Err(error) = self.decode(segment) {
                self.state.is_unusable = true;
                self.tell(StreamEvent::Unusable(error));
            }
            let read_at = segment.reads.last().and_then(|read| read.at);
            if let Some(event) = self.scan_watch.update(opened, &self.pipeline.counts(), read_at) {
                self.tell(event);
            }
            let status = self.pipeline.board_status();
            if opened {
                // A status from before the start does not count.
                self.state.idle_tick = status.map(|status| status.tick);
            } else if status.is_some_and(|status| !status.acquiring && Some(status.tick) != self.state.idle_tick) {
                self.state.idle_tick = status.map(|status| status.tick);
                let complaint = self.outputs.pending.complaint.take();
                self.tell(StreamEvent::Stopped(complaint));
            }
            if self.pipeline.is_complete() {
                self.state.is_complete = true;
                self.tell(StreamEvent::Complete);
            }
        }
    }

    fn decode(&mut self, segment: &mut Segment) -> anyhow::Result<()> {
        let Self { pipeline, outputs, name, .. } = self;
        outputs.capture.iter_mut().for_each(|tap| tap.begin(segment.opened));
        let fed = pipeline.receive(segment, |item| {
            if let Item::Oddity { oddity, .. } = &item {
                say(format_args!("{name}: {oddity}"));
            }
            outputs.accept(&item);
            Ok::<_, anyhow::Error>(())
        });
        segment.truncate(*fed.as_ref().unwrap_or(&segment.bytes.len()));
        outputs.capture.iter_mut().for_each(|tap| tap.keep(segment));
        match outputs.pending.refused.take() {
            Some(rejection) => fed.and(Err(anyhow::Error::new(rejection).context("the board refused a command"))),
            None => fed.map(drop),
        }
    }

    /// After an interrupt the program does not wait for scans that are not solved yet.
    fn give_up_in_time(&mut self) {
        if !self.stop.load(Ordering::Relaxed) {
            return;
        }
        let now_ns = self.state.now.monotonic_ns;
        let gives_up_at_ns = *self.state.gives_up_at_ns.get_or_insert(now_ns + GIVES_UP_AFTER_NS);
        if now_ns >= gives_up_at_ns {
            let count = self.pipeline.give_up();
            self.outputs.skip(count);
        }
    }

    fn tell(&self, event: StreamEvent) {
        // Dropped if the reader has ended; a reader with a full queue acts on the first event.
        let _ = self.events.try_send((self.state.connection, event));
    }

    fn account(&mut self) {
        let now_ns = self.state.now.monotonic_ns;
        self.state.accounted_ns = now_ns;
        if let Some(order) = lock(&self.slot.zero).take() {
            self.pipeline.zero(order);
        }
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
        let Outputs { statistics, capture, publisher, .. } = &mut self.outputs;
        statistics.report.lag = lag;
        statistics.report.losses.host = HostLosses {
            bytes_unrecorded: capture.as_ref().map_or(0, |tap| tap.bytes_dropped),
            poses_unsent: publisher.as_ref().map_or(0, |publisher| publisher.missed),
        };
        self.slot.account(&self.pipeline, statistics);
    }

    /// Reports once that the solver is behind, and once that it keeps up again.
    fn say_lag(&mut self, lag: &LagReport) {
        let Self { name, state, .. } = self;
        match (lag.finding(), state.told) {
            (Some(finding), None) => {
                say(format_args!("{}", finding.within(name)));
                state.told = Some(0);
            }
            (Some(_), Some(_)) => state.told = Some(0),
            (None, Some(calm)) if calm >= CALM => {
                say(format_args!("{name}: each scan is solved in time again"));
                state.told = None;
            }
            (None, told) => state.told = told.map(|calm| calm + 1),
        }
    }
}
