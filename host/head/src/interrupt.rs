//! Interrupts by Ctrl-C and other signals.

use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, OnceLock};
use std::{fs, io, process};

use tempfile::NamedTempFile;

use crate::platform::{self, Interrupt};
use crate::table::OutputError;
use crate::threads::lock;

static STOP: OnceLock<Arc<AtomicBool>> = OnceLock::new();

/// Incomplete results and their final names.
static PARTS: Mutex<Vec<(PathBuf, PathBuf)>> = Mutex::new(Vec::new());

/// Reports results that an interrupt leaves incomplete.
static FAREWELL: OnceLock<fn(&OutputError)> = OnceLock::new();

/// Reports results that an interrupt leaves incomplete to `farewell` instead of standard error, before the program
/// ends. Only the first call counts.
pub fn say_by(farewell: fn(&OutputError)) {
    let _ = FAREWELL.set(farewell);
}

/// The flag that is set when the user interrupts, the service manager ends the program, or its terminal is closed.
/// After that another interrupt ends the program at once, with exit code 1. Another notice of a closed terminal does not:
/// one comes from the kernel and one from the shell. Until this is asked for the first time, each of them ends the program.
pub fn flag() -> io::Result<Arc<AtomicBool>> {
    // Made before the first interrupt is taken, which would find none and end the program.
    let stop = Arc::clone(STOP.get_or_init(Arc::default));
    listen()?;
    Ok(stop)
}

/// Takes interrupts, from the first call on.
fn listen() -> io::Result<()> {
    static LISTENS: Mutex<bool> = Mutex::new(false);
    let mut listens = lock(&LISTENS);
    if !*listens {
        platform::on_interrupt(interrupted)?;
        *listens = true;
    }
    Ok(())
}

fn interrupted(interrupt: Interrupt) {
    match STOP.get() {
        None if interrupt == Interrupt::Unheeded => {}
        None => remove_parts(),
        Some(stop) if stop.swap(true, Ordering::Relaxed) && interrupt != Interrupt::TerminalClosed => process::exit(1),
        Some(_) => {}
    }
}

pub(crate) fn is_asked() -> bool {
    STOP.get().is_some_and(|stop| stop.load(Ordering::Relaxed))
}

/// Makes a part of a result for `target`. An interrupt removes it and ends the program with exit code 1, unless the
/// command itself handles interrupts (see [`flag`]). The part may be gone by then.
pub(crate) fn removing(target: &Path, make: impl FnOnce() -> io::Result<NamedTempFile>) -> io::Result<NamedTempFile> {
    listen()?;
    // Held until the part is known: an interrupt waits.
    let mut parts = lock(&PARTS);
    let part = make()?;
    parts.push((part.path().to_owned(), target.to_owned()));
    Ok(part)
}

/// Removes and reports incomplete results, and ends the program.
fn remove_parts() -> ! {
    let parts = lock(&PARTS);
    let say = FAREWELL.get_or_init(|| |error| eprintln!("{error}"));
    for (part, target) in parts.iter() {
        if fs::remove_file(part).is_ok() {
            say(&OutputError::Interrupted { target: target.display().to_string() });
        }
    }
    process::exit(1)
}
