//! The thread that prints poses. Standard output never drops poses: if its reader is slow, the solvers wait.

use std::io;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use super::buffer_pool::{Consumer, Empty};
use super::error::BoardError;
use super::outputs::{OUTBOX_POSES, Outbox, Outgoing};
use super::spawn;
use crate::sink::{Account, Sink};
use slitpose_head::threads::join;

/// Longest wait without a pose to print.
const IDLE: Duration = Duration::from_millis(50);

/// Longest time without a flush or redraw for a stream that is always behind.
const TICK_AFTER: Duration = Duration::from_millis(200);

/// Returns the state of boards and recorder.
pub(super) type Accounts = dyn Fn() -> Account + Send;

/// After an interrupt, the longest wait for a reader that reads nothing.
const PATIENCE: Duration = Duration::from_millis(500);

/// Pause between checks whether the thread has ended.
const MOMENT: Duration = Duration::from_millis(5);

/// The printer's thread.
pub(super) struct PrinterThread {
    thread: JoinHandle<io::Result<()>>,
    /// Outboxes printed so far.
    printed: Arc<AtomicU64>,
}

impl PrinterThread {
    /// Starts the thread. If the sink fails, it sets `stop`.
    pub(super) fn start(
        outboxes: Consumer<Outbox>,
        sink: Box<dyn Sink + Send>,
        accounts: Box<Accounts>,
        stop: Arc<AtomicBool>,
    ) -> Result<Self, BoardError> {
        let printed = Arc::<AtomicU64>::default();
        let progress = Arc::clone(&printed);
        let run = move || print(&outboxes, sink, &*accounts, &stop, &progress);
        Ok(Self { thread: spawn("printer".to_owned(), run)?, printed })
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
    accounts: &Accounts,
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
            Err(Empty::ForNow) => (Ok(()), false),
            Err(Empty::Closed) => (Ok(()), true),
        };
        let ticked = match (&failed, is_over) {
            (Some(_), _) => Ok(()),
            (None, true) => sink.finish(accounts),
            // Printing goes first.
            (None, false) if !outboxes.is_empty() && ticked_at.elapsed() < TICK_AFTER => Ok(()),
            (None, false) => {
                ticked_at = Instant::now();
                sink.tick(accounts)
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
