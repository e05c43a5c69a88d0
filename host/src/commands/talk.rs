//! Between a command and the person who gave it.

use std::fmt;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM};

use super::CommandError;
use crate::terminal;

/// Says something on standard error.
pub(super) fn talk(text: fmt::Arguments<'_>) {
    terminal::say(text);
}

/// What is set when the user interrupts, the service manager ends the program, or its terminal is closed. After
/// that a SIGINT or SIGTERM ends the program at once, with exit code 1. Another SIGHUP does not: whoever closes a
/// terminal sends one from the kernel and one from the shell. A SIGHUP that is ignored, as under `nohup`, stays so.
pub(super) fn interrupt() -> Result<Arc<AtomicBool>, CommandError> {
    let stop = Arc::new(AtomicBool::new(false));
    for signal in [SIGINT, SIGTERM] {
        signal_hook::flag::register_conditional_shutdown(signal, 1, Arc::clone(&stop))
            .map_err(CommandError::Interrupt)?;
    }
    let hang_up = [SIGHUP].into_iter().filter(|signal| !is_ignored(*signal));
    for signal in [SIGINT, SIGTERM].into_iter().chain(hang_up) {
        signal_hook::flag::register(signal, Arc::clone(&stop)).map_err(CommandError::Interrupt)?;
    }
    Ok(stop)
}

/// Whether the program was started with `signal` ignored, where the system says so (`proc_pid_status(5)`, SigIgn).
fn is_ignored(signal: i32) -> bool {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let ignored = status.lines().find_map(|line| line.strip_prefix("SigIgn:"));
    ignored.and_then(|mask| u64::from_str_radix(mask.trim(), 16).ok()).is_some_and(|mask| mask >> (signal - 1) & 1 == 1)
}

/// Lets a file that must not grow any more be an error of writing to it, as a full disk is, and not the
/// end of the program: whatever else it does goes on.
pub(super) fn outlive_file_limits() -> Result<(), CommandError> {
    // A signal that is taken notice of is not fatal.
    signal_hook::flag::register(signal_hook::consts::SIGXFSZ, Arc::default()).map(drop).map_err(CommandError::Interrupt)
}
