//! Interrupts by Ctrl-C and other signals.

use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, OnceLock};
use std::{fs, io, process};

use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM};
use signal_hook::iterator::Signals;
use tempfile::NamedTempFile;

use crate::table::OutputError;
use crate::threads::lock;

static STOP: OnceLock<Arc<AtomicBool>> = OnceLock::new();

/// Incomplete results and their final names; `None` until there is one.
static PARTS: Mutex<Option<Vec<(PathBuf, PathBuf)>>> = Mutex::new(None);

/// Reports results that an interrupt leaves incomplete.
static FAREWELL: OnceLock<fn(&OutputError)> = OnceLock::new();

/// Reports results that an interrupt leaves incomplete to `farewell` instead of standard error, before the program
/// ends. Only the first call counts.
pub fn say_by(farewell: fn(&OutputError)) {
    let _ = FAREWELL.set(farewell);
}

/// The flag that is set when the user interrupts, the service manager ends the program, or its terminal is closed.
/// After that a SIGINT or SIGTERM ends the program at once, with exit code 1. Another SIGHUP does not: a closed terminal
/// sends one from the kernel and one from the shell. A SIGHUP that is ignored, as under `nohup`, stays so. Until
/// this is asked for the first time, each of them ends the program.
pub fn flag() -> io::Result<Arc<AtomicBool>> {
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

pub(crate) fn is_asked() -> bool {
    STOP.get().is_some_and(|stop| stop.load(Ordering::Relaxed))
}

/// Makes a part of a result for `target`. An interrupt removes it and ends the program with exit code 1, unless the
/// command itself handles interrupts (see [`flag`]). The part may be gone by then.
pub(crate) fn removing(target: &Path, make: impl FnOnce() -> io::Result<NamedTempFile>) -> io::Result<NamedTempFile> {
    // Held until the part is known: an interrupt waits.
    let mut parts = lock(&PARTS);
    if parts.is_none() {
        let mut signals = Signals::new([SIGINT, SIGTERM, SIGHUP].into_iter().filter(|signal| !is_ignored(*signal)))?;
        std::thread::Builder::new().name("interrupt".to_owned()).spawn(move || {
            for _ in signals.forever() {
                if STOP.get().is_none() {
                    remove_parts();
                }
            }
        })?;
    }
    let part = make()?;
    parts.get_or_insert_default().push((part.path().to_owned(), target.to_owned()));
    Ok(part)
}

/// Removes and reports incomplete results, and ends the program.
fn remove_parts() -> ! {
    let parts = lock(&PARTS);
    let say = FAREWELL.get_or_init(|| |error| eprintln!("{error}"));
    for (part, target) in parts.iter().flatten() {
        if fs::remove_file(part).is_ok() {
            say(&OutputError::Interrupted { target: target.display().to_string() });
        }
    }
    process::exit(1)
}

/// Whether the program was started with `signal` ignored, where the system says so (`proc_pid_status(5)`, SigIgn).
fn is_ignored(signal: i32) -> bool {
    let status = fs::read_to_string("/proc/self/status").unwrap_or_default();
    let ignored = status.lines().find_map(|line| line.strip_prefix("SigIgn:"));
    ignored.and_then(|mask| u64::from_str_radix(mask.trim(), 16).ok()).is_some_and(|mask| mask >> (signal - 1) & 1 == 1)
}
