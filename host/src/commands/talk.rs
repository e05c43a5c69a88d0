//! Between a command and the person who gave it.

use std::fmt;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use super::CommandError;
use crate::terminal;

/// Says something on standard error.
pub(super) fn talk(text: fmt::Arguments<'_>) {
    terminal::say(text);
}

/// The flag that is set when the user interrupts: see [`flag`](slitpose_head::interrupt::flag).
pub(super) fn interrupt() -> Result<Arc<AtomicBool>, CommandError> {
    slitpose_head::interrupt::flag().map_err(CommandError::Interrupt)
}

/// Lets a file that must not grow any more be an error of writing to it, as a full disk is, and not the
/// end of the program: its other work goes on.
pub(super) fn outlive_file_limits() -> Result<(), CommandError> {
    // A signal that is taken notice of is not fatal.
    signal_hook::flag::register(signal_hook::consts::SIGXFSZ, Arc::default()).map(drop).map_err(CommandError::Interrupt)
}
