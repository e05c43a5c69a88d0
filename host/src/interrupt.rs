//! What the user asks for with Ctrl-C, known to all that wait or take long.

use std::io;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, OnceLock};

use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM};

static STOP: OnceLock<Arc<AtomicBool>> = OnceLock::new();

/// What is set when the user interrupts, the service manager ends the program, or its terminal is closed. After
/// that a SIGINT or SIGTERM ends the program at once, with exit code 1. Another SIGHUP does not: whoever closes a
/// terminal sends one from the kernel and one from the shell. A SIGHUP that is ignored, as under `nohup`, stays so. Until
/// this is asked for the first time, each of them ends the program.
pub(crate) fn flag() -> io::Result<Arc<AtomicBool>> {
    if let Some(stop) = STOP.get() {
        return Ok(Arc::clone(stop));
    }
    let stop = Arc::new(AtomicBool::new(false));
    for signal in [SIGINT, SIGTERM] {
        signal_hook::flag::register_conditional_shutdown(signal, 1, Arc::clone(&stop))?;
    }
    let hang_up = [SIGHUP].into_iter().filter(|signal| !is_ignored(*signal));
    for signal in [SIGINT, SIGTERM].into_iter().chain(hang_up) {
        signal_hook::flag::register(signal, Arc::clone(&stop))?;
    }
    Ok(Arc::clone(STOP.get_or_init(|| stop)))
}

/// Whether the user has interrupted.
pub(crate) fn is_asked() -> bool {
    STOP.get().is_some_and(|stop| stop.load(Ordering::Relaxed))
}

/// Whether the program was started with `signal` ignored, where the system says so (`proc_pid_status(5)`, SigIgn).
fn is_ignored(signal: i32) -> bool {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let ignored = status.lines().find_map(|line| line.strip_prefix("SigIgn:"));
    ignored.and_then(|mask| u64::from_str_radix(mask.trim(), 16).ok()).is_some_and(|mask| mask >> (signal - 1) & 1 == 1)
}
