//! Between a command and the person who gave it.

use std::fmt;
use std::io::{self, Write};
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use super::CommandError;

/// Says something on standard error.
pub(super) fn talk(text: fmt::Arguments<'_>) {
    // Nobody is left to tell if even standard error is closed.
    let _ = writeln!(io::stderr(), "slitpose: {text}");
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
