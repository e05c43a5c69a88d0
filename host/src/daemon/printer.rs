//! The thread that prints poses. Standard output never drops: if whoever reads it is slow, everything
//! ahead of it waits.

use std::io;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use super::circuit::{Drainer, Dry};
use super::consumers::{OUTBOX_POSES, Outbox, Outgoing};
use crate::sink::{Account, Sink};

/// Without a pose to print it looks about so often.
const IDLE: Duration = Duration::from_millis(50);

/// A stream that is always behind is flushed and shown at least so often.
const TICK_AFTER: Duration = Duration::from_millis(200);

/// Gives the account of boards and recorder.
pub(super) type Accounts = dyn Fn() -> Account + Send;

/// Prints what the solvers hand over until they have ended. When the sink fails it tells everybody to
/// `stop`, and what still comes is dropped.
pub(super) fn print(
    outboxes: &Drainer<Outbox>,
    mut sink: Box<dyn Sink + Send>,
    accounts: &Accounts,
    stop: &Arc<AtomicBool>,
) -> io::Result<()> {
    let mut failed = None;
    let mut ticked_at = Instant::now();
    loop {
        let (taken, is_over) = match outboxes.next(IDLE) {
            Ok(mut outbox) => {
                let taken = if failed.is_none() { take(&mut *sink, &outbox) } else { Ok(()) };
                outbox.clear();
                // A stall has made it longer, and there are many.
                outbox.shrink_to(OUTBOX_POSES);
                outboxes.give_back(outbox);
                (taken, false)
            }
            Err(Dry::Yet) => (Ok(()), false),
            Err(Dry::Forever) => (Ok(()), true),
        };
        let ticked = match (&failed, is_over) {
            (Some(_), _) => Ok(()),
            (None, true) => sink.finish(accounts),
            // More waits to be printed than to be shown.
            (None, false) if !outboxes.is_empty() && ticked_at.elapsed() < TICK_AFTER => Ok(()),
            (None, false) => {
                ticked_at = Instant::now();
                sink.tick(accounts)
            }
        };
        if let Err(error) = taken.and(ticked) {
            failed = Some(error);
            stop.store(true, Ordering::Relaxed);
        }
        if is_over {
            return failed.map_or(Ok(()), Err);
        }
    }
}

fn take(sink: &mut dyn Sink, outbox: &Outbox) -> io::Result<()> {
    outbox.iter().try_for_each(|outgoing| match outgoing {
        Outgoing::Pose(record) => sink.pose(record),
        Outgoing::Note(note) => sink.note(note),
    })
}
