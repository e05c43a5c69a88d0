//! The outputs of a board: control loops, live page, statistics, capture, printer.

use std::collections::VecDeque;
use std::io;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use anyhow::Context;
use crossbeam_channel::TryRecvError;
use slitpose_head::threads::join;
use slitpose_model::Photocurrents;
use slitpose_protocol::{Rejection, Reply, Severity};

use super::handoff::{Consumer, Producer};
use super::tap::Tap;
use crate::background::{NO_THREAD, spawn};
use crate::datagram::{DatagramServer, Publisher};
use crate::live::LiveInput;
use crate::sink::{Note, Reports, Sink};
use slitpose_tracking::clock::HostInstant;
use slitpose_tracking::link::DeviceId;
use slitpose_tracking::page::Sampler;
use slitpose_tracking::pipeline::{Item, Record};
use slitpose_tracking::telemetry::{BoardStatistics, DaemonReport};

#[derive(Clone, Debug)]
#[expect(clippy::large_enum_variant, reason = "a box would be allocated for each pose")]
pub(super) enum Outgoing {
    Pose(Record),
    Note(Note),
}

/// Most poses sent together, and how long the first may wait for the others: waking a client for each pose costs more
/// than solving it.
const TOGETHER: usize = 8;
const TOGETHER_NS: u64 = 50_000;

/// Poses in a full outbox: some milliseconds of a board at 4 kHz.
pub(super) const OUTBOX_POSES: usize = 16;

pub(super) type Outbox = Vec<Outgoing>;

pub(super) struct Outputs {
    pub(super) datagrams: Option<Arc<DatagramServer>>,
    pub(super) publisher: Option<Publisher>,
    pub(super) statistics: BoardStatistics,
    pub(super) printer: Option<Producer<Outbox>>,
    /// Whether each pose must be printed, however late.
    pub(super) prints_all: bool,
    pub(super) capture: Option<Tap>,
    /// The live page, the number of the board there, and what makes its samples.
    pub(super) live: Option<(LiveInput, usize, Sampler)>,
    pub(super) pending: Pending,
}

/// What has come and is not passed on yet.
#[derive(Default)]
pub(super) struct Pending {
    outbox: Option<Outbox>,
    /// Poses about to be published, and the time when the first was solved.
    fresh: Vec<Record>,
    fresh_since_ns: u64,
    /// Notes to be printed after the scans that came before them, each with the number of these scans.
    notes: VecDeque<(u64, Note)>,
    arrived: u64,
    taken: u64,
    device: Option<DeviceId>,
    /// The last warning or error of the board.
    pub(super) complaint: Option<String>,
    pub(super) refused: Option<Rejection>,
}

impl Outputs {
    /// Passes on one item of a segment.
    pub(super) fn accept(&mut self, item: &Item<'_>) {
        let mut read_at = None;
        match item {
            Item::Scan(scan) => {
                self.pending.arrived += 1;
                read_at = scan.arrival;
            }
            Item::Hello(hello) => {
                let device = DeviceId(hello.device_id);
                if self.pending.device.replace(device) != Some(device) {
                    self.send();
                    // First the old one, whose ring in shared memory the new one may need.
                    self.publisher = None;
                    self.publisher = self.datagrams.as_ref().map(|datagrams| datagrams.publisher(device));
                }
                self.capture.iter_mut().for_each(|tap| tap.hello(hello));
            }
            Item::Event { severity, text, .. } if *severity != Severity::Info => {
                self.pending.complaint = Some((*text).to_owned());
            }
            // Reported after the whole segment is processed, so that its scans are not lost.
            Item::Reply(Reply { outcome: Err(rejection), .. }) => self.pending.refused = Some(*rejection),
            _ => {}
        }
        if self.printer.is_some()
            && let Some(note) = Note::of(self.pending.device, item)
        {
            self.pending.notes.push_back((self.pending.arrived, note));
        }
        self.statistics.update(item, read_at, None);
    }

    /// Publishes a pose that is newer than all before, at once or together with the next few; and shows it with its
    /// photocurrents.
    pub(super) fn publish(
        &mut self,
        record: &Record,
        photocurrents: Option<&Photocurrents>,
        now: HostInstant,
        is_behind: bool,
    ) {
        if self.pending.fresh.is_empty() {
            self.pending.fresh_since_ns = now.monotonic_ns;
        }
        self.pending.fresh.push(*record);
        if let Some(publisher) = &mut self.publisher {
            publisher.is_behind = is_behind;
        }
        if self.pending.fresh.len() >= TOGETHER
            || now.monotonic_ns.saturating_sub(self.pending.fresh_since_ns) >= TOGETHER_NS
        {
            self.send();
        }
        if let Some((live, board, sampler)) = &mut self.live {
            sampler.add(record);
            sampler.send(photocurrents, now, |sample| live.sample(*board, sample));
        }
    }

    /// Sends the poses that [`publish`](Self::publish) has kept.
    pub(super) fn send(&mut self) {
        if self.pending.fresh.is_empty() {
            return;
        }
        let now = HostInstant::now();
        if let Some(publisher) = &mut self.publisher {
            self.pending.fresh.iter().for_each(|record| publisher.publish(record, now));
        }
        for record in &self.pending.fresh {
            self.statistics.update(&Item::Pose(record), record.arrival, record.arrival.map(|_| now));
        }
        self.pending.fresh.clear();
    }

    /// Whether a pose can be handed to the printer now.
    pub(super) fn can_print(&mut self) -> bool {
        if self.pending.outbox.is_none()
            && let Some(printer) = &self.printer
        {
            self.pending.outbox = printer.spare_now();
            return self.pending.outbox.is_some() || !self.prints_all;
        }
        true
    }

    /// Waits until a pose can be handed to the printer, or for `timeout`.
    pub(super) fn await_room(&mut self, timeout: Duration) {
        if let Some(printer) = &self.printer {
            self.pending.outbox = self.pending.outbox.take().or_else(|| printer.spare_within(timeout));
        }
    }

    /// Prints the next pose in turn, after the notes that came before it.
    pub(super) fn print(&mut self, record: &Record) {
        self.print_notes();
        self.pending.taken += 1;
        if let Some(outbox) = &mut self.pending.outbox {
            outbox.push(Outgoing::Pose(*record));
            if outbox.len() >= OUTBOX_POSES {
                self.hand_over_outbox();
            }
        }
    }

    pub(super) fn skip(&mut self, count: usize) {
        self.pending.taken += count as u64;
    }

    fn print_notes(&mut self) {
        while let Some(outbox) = &mut self.pending.outbox
            && self.pending.notes.front().is_some_and(|(arrived, _)| *arrived <= self.pending.taken)
            && let Some((_, note)) = self.pending.notes.pop_front()
        {
            outbox.push(Outgoing::Note(note));
        }
    }

    pub(super) fn hand_over_outbox(&mut self) {
        if !self.pending.notes.is_empty() && self.can_print() {
            self.print_notes();
        }
        if let (Some(printer), Some(outbox)) = (&self.printer, self.pending.outbox.take_if(|outbox| !outbox.is_empty()))
        {
            printer.hand_over(outbox);
        }
    }
}

/// Longest wait without a pose to print.
const IDLE: Duration = Duration::from_millis(50);

/// Longest time without a flush or redraw for a stream that is always behind.
const TICK_AFTER: Duration = Duration::from_millis(200);

/// After an interrupt, the longest wait for a reader that reads nothing.
const PATIENCE: Duration = Duration::from_millis(500);

/// Pause between checks whether the thread has ended.
const MOMENT: Duration = Duration::from_millis(5);

pub(super) struct PrinterThread {
    thread: JoinHandle<io::Result<()>>,
    printed: Arc<AtomicU64>,
}

impl PrinterThread {
    /// Starts the thread. If the sink fails, it sets `stop`.
    pub(super) fn start(
        outboxes: Consumer<Outbox>,
        sink: Box<dyn Sink + Send>,
        reports: Box<dyn Fn() -> DaemonReport + Send>,
        stop: Arc<AtomicBool>,
    ) -> anyhow::Result<Self> {
        let printed = Arc::<AtomicU64>::default();
        let progress = Arc::clone(&printed);
        let run = move || print(&outboxes, sink, &*reports, &stop, &progress);
        Ok(Self { thread: spawn("printer".to_owned(), run).context(NO_THREAD)?, printed })
    }

    /// Waits until all is printed; all solvers must have ended. If `stop` is set and the output is not read, the rest
    /// is dropped.
    pub(super) fn end(self, stop: &AtomicBool) -> io::Result<()> {
        let (mut before, mut since) = (0, Instant::now());
        while !self.thread.is_finished() {
            let printed = self.printed.load(Ordering::Relaxed);
            if printed != before || !stop.load(Ordering::Relaxed) {
                (before, since) = (printed, Instant::now());
            } else if since.elapsed() >= PATIENCE {
                return Err(io::Error::new(io::ErrorKind::TimedOut, "nobody reads what is printed"));
            }
            std::thread::sleep(MOMENT);
        }
        join(self.thread)
    }
}

/// Prints the solvers' outboxes until the solvers have ended. If the sink fails, sets `stop` and drops later outboxes.
fn print(
    outboxes: &Consumer<Outbox>,
    mut sink: Box<dyn Sink + Send>,
    reports: &Reports<'_>,
    stop: &AtomicBool,
    printed: &AtomicU64,
) -> io::Result<()> {
    let mut failed = None;
    let mut ticked_at = Instant::now();
    loop {
        let (written, is_over) = match outboxes.next(IDLE) {
            Ok(mut outbox) => {
                let written = if failed.is_none() { write_outbox(&mut *sink, &outbox) } else { Ok(()) };
                outbox.clear();
                // A stall may have enlarged it, and there are many outboxes.
                outbox.shrink_to(OUTBOX_POSES);
                outboxes.give_back(outbox);
                printed.fetch_add(1, Ordering::Relaxed);
                (written, false)
            }
            Err(TryRecvError::Empty) => (Ok(()), false),
            Err(TryRecvError::Disconnected) => (Ok(()), true),
        };
        let ticked = match (&failed, is_over) {
            (Some(_), _) => Ok(()),
            (None, true) => sink.finish(reports),
            // Printing goes first.
            (None, false) if !outboxes.is_empty() && ticked_at.elapsed() < TICK_AFTER => Ok(()),
            (None, false) => {
                ticked_at = Instant::now();
                sink.tick(reports)
            }
        };
        if let Err(error) = written.and(ticked) {
            failed = Some(error);
            stop.store(true, Ordering::Relaxed);
        }
        if is_over {
            return failed.map_or(Ok(()), Err);
        }
    }
}

fn write_outbox(sink: &mut dyn Sink, outbox: &Outbox) -> io::Result<()> {
    outbox.iter().try_for_each(|outgoing| match outgoing {
        Outgoing::Pose(record) => sink.pose(record),
        Outgoing::Note(note) => sink.note(note),
    })
}
