//! Between a command and the person who gave it.

use std::fmt;
use std::io::{self, Write};
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use super::CommandError;
use crate::foreign::printable;

/// No message of ours is longer, however long the texts of others in it.
const LONGEST_MESSAGE: usize = 4000;

/// Says something on standard error, in one line.
pub fn talk(text: fmt::Arguments<'_>) {
    // Nobody is left to tell if even standard error is closed.
    let _ = writeln!(io::stderr(), "slitpose: {}", printable(&text.to_string()).at_most(LONGEST_MESSAGE));
}

/// What is set when the user interrupts; a second time ends the program the ordinary way.
pub(super) fn interrupt() -> Result<Arc<AtomicBool>, CommandError> {
    let stop = Arc::new(AtomicBool::new(false));
    for signal in [signal_hook::consts::SIGINT, signal_hook::consts::SIGTERM] {
        signal_hook::flag::register_conditional_shutdown(signal, 1, Arc::clone(&stop))
            .and_then(|_| signal_hook::flag::register(signal, Arc::clone(&stop)))
            .map_err(CommandError::Interrupt)?;
    }
    Ok(stop)
}

/// Lets a file that must not grow any more be an error of writing to it, as a full disk is, and not the
/// end of the program: whatever else it does goes on.
pub(super) fn outlive_file_limits() -> Result<(), CommandError> {
    // A signal that is taken notice of is not fatal.
    signal_hook::flag::register(signal_hook::consts::SIGXFSZ, Arc::default()).map(drop).map_err(CommandError::Interrupt)
}
