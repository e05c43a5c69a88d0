//! Between a command and the person who gave it.

use std::fmt;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use anyhow::Context;
use slitpose_design::report::{Folder, Report};
use slitpose_head::table::Output;

use super::{CommandError, Outcome};
use crate::pipeline::Counts;
use crate::terminal;

pub(super) fn talk(text: fmt::Arguments<'_>) {
    terminal::say(text);
}

/// The flag that is set when the user interrupts: see [`flag`](slitpose_head::interrupt::flag).
pub(super) fn interrupt() -> Result<Arc<AtomicBool>, CommandError> {
    slitpose_head::interrupt::flag().context("cannot listen to signals")
}

/// Lets a file that must not grow any more be an error of writing to it, as a full disk is, and not the
/// end of the program: its other work goes on.
pub(super) fn outlive_file_limits() -> Result<(), CommandError> {
    // A signal that is taken notice of is not fatal.
    signal_hook::flag::register(signal_hook::consts::SIGXFSZ, Arc::default())
        .map(drop)
        .context("cannot listen to signals")
}

/// Reports the losses of a stream on standard error, if there are any. A packet under way when the
/// end was `wanted` is not lost: it was not waited for.
pub(super) fn tell(name: &str, counts: &Counts, wanted: bool) -> Outcome {
    match counts.losses(wanted) {
        None => Outcome::Done,
        Some(losses) => {
            talk(format_args!("{name}: {losses}"));
            Outcome::DataLost
        }
    }
}

/// Writes `report` to `folder`; without one, prints it in short.
pub(super) fn publish(report: &Report, folder: Option<&Folder>) -> Result<(), CommandError> {
    match folder {
        Some(folder) => store(report, folder),
        None => {
            warn(report);
            Ok(Output::open(None)?.write_text(&report.in_short())?)
        }
    }
}

/// Writes `report` to `folder`, and says where.
pub(super) fn store(report: &Report, folder: &Folder) -> Result<(), CommandError> {
    warn(report);
    for path in folder.write(report)? {
        talk(format_args!("wrote {}", path.display()));
    }
    Ok(())
}

fn warn(report: &Report) {
    for warning in &report.warnings {
        talk(format_args!("{warning}"));
    }
}
