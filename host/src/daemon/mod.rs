//! Boards followed live, by `slitpose run`.
//!
//! ```text
//!            ┌────────┐ segments ┌────────┐──▶ datagrams        at once; a slow reader misses some
//!  board ──▶ │ reader │ ───────▶ │ solver │──▶ printer          waits: standard output never drops
//!            └────────┘          └────────┘──▶ recorder         drops, counts, and notes it in the capture
//!                 ▲     events       │    └──▶ account          a few times a second
//!                 └──────────────────┘
//! ```
//!
//! Each board has two threads; all boards share recorder and printer, with one thread each. Threads pass
//! buffers of fixed pools to each other (see `handoff`), so that nothing is allocated per scan and no queue
//! grows. Segments are decoded at once: on the reading thread while that is quick, else on the solving thread (see
//! `handoff`). If the solver is too slow, or the printer does not accept poses, scans wait, or are skipped where no
//! output needs each of them; control loops get the newest in any case (see `backlog`). If a minute of scans waits,
//! reading waits too: bytes then wait in the operating system and finally on the board, which drops its oldest scans
//! and so leaves gaps in their numbers.

mod backlog;
mod board;
mod handoff;
mod link;
mod outputs;
mod reader;
mod recorder;
mod solver;
mod tap;

use std::io;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;

pub(crate) use board::BoardPlan;
pub(crate) use reader::{Admit, Opener};
pub(crate) use recorder::CapturePlan;

use crate::datagram::DatagramServer;
use crate::live::LiveInput;
use crate::sink::Sink;
use board::{BoardSlot, BoardThreads, Claims};
use handoff::buffer_pool;
use outputs::{OUTBOX_POSES, Outbox, PrinterThread};
use recorder::RecorderControl;
use slitpose_head::threads::{join, lock};
use slitpose_tracking::clock::HostInstant;
use slitpose_tracking::pipeline::Counts;
use slitpose_tracking::telemetry::{DaemonReport, LinkState, RecorderReport};

/// Most outboxes on their way to the printer: half a second of one board at 4 kHz.
const OUTBOXES: usize = 128;

/// A solver without a report for this long hangs: it makes five per second.
const HANGS_AFTER_S: f64 = 5.0;

pub(crate) struct Plan {
    pub boards: Vec<BoardPlan>,
    pub sink: Option<Box<dyn Sink + Send>>,
    /// The captures to record, now or later.
    pub capture: Option<CapturePlan>,
    /// The server that sends poses to control loops.
    pub datagrams: Option<DatagramServer>,
    /// The live page, which takes samples.
    pub live: Option<LiveInput>,
    pub real_time: Option<u8>,
}

pub(crate) struct Daemon {
    reporter: Arc<Reporter>,
    boards: Mutex<Vec<BoardThreads>>,
    printer: Mutex<Option<PrinterThread>>,
    pub(crate) recorder: Option<RecorderControl>,
    recording: Mutex<Option<JoinHandle<()>>>,
    stop: Arc<AtomicBool>,
}

/// What reports are made of.
struct Reporter {
    started: HostInstant,
    slots: Vec<Arc<BoardSlot>>,
    recorder: Option<Arc<Mutex<RecorderReport>>>,
    datagrams: Option<Arc<DatagramServer>>,
}

impl Reporter {
    fn report(&self) -> DaemonReport {
        let boards: Vec<_> = self.slots.iter().map(|slot| slot.report()).collect();
        let mut recorder = self.recorder.as_ref().map(|report| lock(report).clone()).unwrap_or_default();
        // And what boards could not hand to it.
        recorder.bytes_dropped += boards.iter().map(|board| board.losses.host.bytes_unrecorded).sum::<u64>();
        let datagrams = self.datagrams.as_ref().map(|datagrams| datagrams.counts());
        DaemonReport { datagrams, ..DaemonReport::of(self.started, HostInstant::now(), boards, recorder) }
    }
}

#[derive(Debug)]
pub(crate) struct Ended {
    /// For each board: the user's name for it, the counts of its data, and its error.
    pub boards: Vec<(String, Counts, anyhow::Result<()>)>,
    pub printed: io::Result<()>,
    pub capture: RecorderReport,
}

impl Daemon {
    /// Starts all threads. They end when their boards do, when `stop` is set, or when the sink fails.
    pub(crate) fn start(plan: Plan, stop: Arc<AtomicBool>) -> anyhow::Result<Self> {
        let Plan { boards, sink, capture, datagrams, live, real_time } = plan;
        let datagrams = datagrams.map(Arc::new);
        let slots: Vec<_> = boards.iter().map(BoardPlan::slot).collect();
        let prints_each = sink.as_ref().is_some_and(|sink| sink.needs_each());
        let (recorder, recording, recorder_ends) = match capture {
            Some(capture) => {
                let (recorder, thread, ends) = RecorderControl::start(capture, &boards)?;
                (Some(recorder), Some(thread), Some(ends))
            }
            None => (None, None, None),
        };
        let reporter = Arc::new(Reporter {
            started: HostInstant::now(),
            slots: slots.clone(),
            recorder: recorder.as_ref().map(|recorder| Arc::clone(&recorder.report)),
            datagrams: datagrams.clone(),
        });
        let (printer, outboxes) = match sink {
            Some(sink) => {
                let (producer, consumer) =
                    buffer_pool(OUTBOXES * boards.len().max(1), || Outbox::with_capacity(OUTBOX_POSES));
                let (reporter, stop) = (Arc::clone(&reporter), Arc::clone(&stop));
                let printer = PrinterThread::start(consumer, sink, Box::new(move || reporter.report()), stop)?;
                (Some(printer), Some(producer))
            }
            None => (None, None),
        };
        let shared = board::Shared {
            outboxes,
            prints_each,
            recorder: recorder_ends,
            datagrams,
            live,
            real_time,
            claims: Claims::default(),
        };
        let start = |(number, board)| BoardThreads::start(number, board, shared.clone(), &slots[number], &stop);
        let threads = boards.into_iter().enumerate().map(start).collect::<Result<_, _>>()?;
        Ok(Self {
            reporter,
            boards: Mutex::new(threads),
            printer: Mutex::new(printer),
            recorder,
            recording: Mutex::new(recording),
            stop,
        })
    }

    pub(crate) fn report(&self) -> DaemonReport {
        self.reporter.report()
    }

    pub(crate) fn record_report(&self) {
        self.recorder.iter().for_each(|recorder| recorder.account(self.report()));
    }

    /// Sets the zero of the frame of board `number` to the mean pose of so many seconds, or takes it back; `false`: there is
    /// none of this number.
    pub(crate) fn zero(&self, number: usize, order: Option<f64>) -> bool {
        self.reporter.slots.get(number).map(|slot| *lock(&slot.zero) = Some(order)).is_some()
    }

    /// Whether no thread hangs: each solver has made a recent report, even if no bytes came.
    pub(crate) fn is_alive(&self) -> bool {
        let now = HostInstant::now();
        let reports = self.report().boards.into_iter();
        reports.filter(|report| report.link.state != LinkState::Ended).all(|report| report.age_s(now) < HANGS_AFTER_S)
    }

    /// Whether all boards have ended. If one had to be given up, the others are stopped.
    pub(crate) fn is_over(&self) -> bool {
        let boards = lock(&self.boards);
        if boards.iter().any(BoardThreads::is_given_up) {
            self.stop.store(true, Ordering::Relaxed);
        }
        boards.iter().all(BoardThreads::is_finished)
    }

    pub(crate) fn end(&self) -> Ended {
        let threads = std::mem::take(&mut *lock(&self.boards));
        let boards = threads.into_iter().map(BoardThreads::end).collect();
        self.recorder.iter().for_each(|recorder| recorder.close(self.report()));
        let printer = lock(&self.printer).take();
        let printed = printer.map_or(Ok(()), |printer| printer.end(&self.stop));
        lock(&self.recording).take().into_iter().for_each(join);
        Ended { boards, printed, capture: self.report().recorder }
    }
}
