//! Boards followed live: what `slitpose run` does.
//!
//! ```text
//!            ┌────────┐ segments ┌────────┐──▶ datagrams        at once; a slow reader misses some
//!  board ──▶ │ reader │ ───────▶ │ solver │──▶ printer          waits: standard output never drops
//!            └────────┘          └────────┘──▶ recorder         drops, counts, and says so in the capture
//!                 ▲  verdicts        │    └──▶ account          a few times a second
//!                 └──────────────────┘
//! ```
//!
//! Each board has two threads, all share one recorder and one printer, which have one each. What goes
//! between threads goes in containers of which there is a fixed number (see `circuit`), so that nothing is
//! allocated per scan and no queue grows. A board's solver takes in what comes at once, on the thread that
//! has read it as long as that is quick, else on the other one (see `desk`). If it cannot solve as fast, or
//! hand on to the printer, scans wait with it, or are skipped where nobody wants them; control loops get the
//! newest in any case (see `backlog`). Only if a minute of scans waits the reader does, then bytes wait in the
//! operating system, and at last on the board, which gives up its oldest scans; their numbers show it.

mod backlog;
mod board;
mod circuit;
mod claims;
mod consumers;
mod desk;
mod error;
mod inlet;
mod link;
mod opener;
mod printer;
mod progress;
mod reader;
mod real_time;
mod recorder;
mod slot;
mod solver;
mod verdict;

use std::io;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;

pub(crate) use board::BoardPlan;
pub(crate) use error::BoardError;
pub(crate) use link::Talk;
pub(crate) use opener::{Admit, Opener, PortOpener, SimulatedOpener};
pub(crate) use recorder::CapturePlan;

use crate::clock::HostInstant;
use crate::datagram::DatagramServer;
use crate::pipeline::Counts;
use crate::sink::{Account, Sink};
use crate::telemetry::{BoardReport, DaemonReport, LinkState, RecorderReport};
use board::BoardThreads;
use circuit::circuit;
use claims::Claims;
use consumers::{OUTBOX_POSES, Outbox};
use printer::PrinterThread;
use recorder::RecorderThread;
use slitpose_head::threads::lock;
use slot::BoardSlot;

/// Pieces of poses on their way to the printer: a tenth of a second of one board at 4 kHz.
const OUTBOXES: usize = 128;

/// A solver gives an account five times a second.
const HANGS_AFTER_S: f64 = 5.0;

/// What a daemon does.
pub(crate) struct Plan {
    /// The boards it follows.
    pub boards: Vec<BoardPlan>,
    /// Where poses are printed.
    pub sink: Option<Box<dyn Sink + Send>>,
    /// Where all is recorded.
    pub capture: Option<CapturePlan>,
    /// Who is sent poses.
    pub datagrams: Option<DatagramServer>,
    /// Real-time priority of readers and solvers.
    pub real_time: Option<u8>,
}

/// Boards being followed.
pub(crate) struct Daemon {
    started: HostInstant,
    slots: Vec<Arc<BoardSlot>>,
    boards: Mutex<Vec<BoardThreads>>,
    printer: Mutex<Option<PrinterThread>>,
    recorder: Option<RecorderThread>,
    datagrams: Option<Arc<DatagramServer>>,
    stop: Arc<AtomicBool>,
}

/// How it ended.
#[derive(Debug)]
pub(crate) struct Ended {
    /// For each board: what the user calls it, what came, and what went wrong.
    pub boards: Vec<(String, Counts, Result<(), BoardError>)>,
    /// Whether all could be printed.
    pub printed: io::Result<()>,
    /// What was recorded.
    pub capture: RecorderReport,
}

impl Daemon {
    /// Starts all threads. They end when their boards do, when `stop` is set, or when nobody can
    /// be printed to any more.
    ///
    /// # Errors
    /// If the system gives no more threads.
    pub(crate) fn start(plan: Plan, stop: Arc<AtomicBool>) -> Result<Self, BoardError> {
        let Plan { boards, sink, capture, datagrams, real_time } = plan;
        let datagrams = datagrams.map(Arc::new);
        let slots: Vec<_> = boards.iter().map(BoardPlan::slot).collect();
        let prints_each = sink.as_ref().is_some_and(|sink| sink.needs_each());
        let (recorder, parcels) = match capture {
            Some(capture) => {
                let (thread, filler) = RecorderThread::start(capture, &boards)?;
                (Some(thread), Some(filler))
            }
            None => (None, None),
        };
        let (printer, outboxes) = match sink {
            Some(sink) => {
                let (filler, drainer) = circuit(OUTBOXES * boards.len().max(1), || Outbox::with_capacity(OUTBOX_POSES));
                let (slots, stop) = (slots.clone(), Arc::clone(&stop));
                let recorder = recorder.as_ref().map(RecorderThread::reports);
                let accounts = move || {
                    let boards: Vec<_> = slots.iter().map(|slot| slot.report()).collect();
                    let recorder = recorder.as_ref().map(|report| report()).unwrap_or_default();
                    Account { recorder: with_unrecorded(recorder, &boards), boards }
                };
                let printer = PrinterThread::start(drainer, sink, Box::new(accounts), stop)?;
                (Some(printer), Some(filler))
            }
            None => (None, None),
        };
        let mut threads = Vec::new();
        let claims = Claims::default();
        for (number, board) in boards.into_iter().enumerate() {
            let outlets = board::Outlets {
                outboxes: outboxes.clone(),
                prints_each,
                parcels: parcels.clone(),
                datagrams: datagrams.clone(),
                real_time,
                claims: claims.clone(),
            };
            threads.push(BoardThreads::start(number, board, outlets, &slots[number], &stop)?);
        }
        Ok(Self {
            started: HostInstant::now(),
            slots,
            boards: Mutex::new(threads),
            printer: Mutex::new(printer),
            recorder,
            datagrams,
            stop,
        })
    }

    /// How it goes.
    pub(crate) fn report(&self) -> DaemonReport {
        let boards = self.boards_report();
        let recorder = self.recorder.as_ref().map(RecorderThread::report);
        let recorder = with_unrecorded(recorder.unwrap_or_default(), &boards);
        let datagrams = self.datagrams.as_ref().map(|datagrams| datagrams.counts());
        DaemonReport { datagrams, ..DaemonReport::of_now(self.started, boards, recorder) }
    }

    fn boards_report(&self) -> Vec<BoardReport> {
        self.slots.iter().map(|slot| slot.report()).collect()
    }

    /// Puts how it goes into the capture.
    pub(crate) fn record_report(&self) {
        if let Some(recorder) = &self.recorder {
            recorder.account(self.report());
        }
    }

    /// Whether no thread hangs: each solver has given an account of late, also when nothing came.
    pub(crate) fn is_alive(&self) -> bool {
        let now = HostInstant::now();
        let reports = self.boards_report().into_iter();
        reports.filter(|report| report.link.state != LinkState::Ended).all(|report| report.age_s(now) < HANGS_AFTER_S)
    }

    /// Whether nothing will ever come again. If a board had to be given up the others are told to end.
    pub(crate) fn is_over(&self) -> bool {
        let boards = lock(&self.boards);
        if boards.iter().any(BoardThreads::is_given_up) {
            self.stop.store(true, Ordering::Relaxed);
        }
        boards.iter().all(BoardThreads::is_finished)
    }

    /// Waits for the end of all threads.
    pub(crate) fn end(&self) -> Ended {
        let threads = std::mem::take(&mut *lock(&self.boards));
        let boards = threads.into_iter().map(BoardThreads::end).collect();
        self.record_report();
        let printer = lock(&self.printer).take();
        let printed = printer.map_or(Ok(()), |printer| printer.end(&self.stop));
        let recorder = self.recorder.as_ref().map(RecorderThread::end);
        Ended { boards, printed, capture: with_unrecorded(recorder.unwrap_or_default(), &self.boards_report()) }
    }
}

/// What the recorder says, with what never came to it.
fn with_unrecorded(recorder: RecorderReport, boards: &[BoardReport]) -> RecorderReport {
    let unrecorded = boards.iter().map(|board| board.losses.host.bytes_unrecorded).sum::<u64>();
    RecorderReport { bytes_dropped: recorder.bytes_dropped + unrecorded, ..recorder }
}

/// As much as the main thread has: a solver is 100 KB, and moved about while it is made.
const STACK_BYTES: usize = 8 << 20;

/// A thread with a name.
fn spawn<T: Send + 'static>(
    name: String,
    run: impl FnOnce() -> T + Send + 'static,
) -> Result<JoinHandle<T>, BoardError> {
    std::thread::Builder::new().name(name).stack_size(STACK_BYTES).spawn(run).map_err(BoardError::Thread)
}
