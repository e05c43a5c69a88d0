//! Files that are no regular files: devices and named pipes, which are written and never replaced.

use std::fs::File;
use std::io;
use std::path::Path;
use std::time::Duration;

pub use crate::platform::is_special;
use crate::{interrupt, platform};

/// A pipe without a reader is tried this often.
const AGAIN: Duration = Duration::from_millis(20);

/// Opens a special file for writing. Waits until a named pipe has a reader.
///
/// # Errors
/// Those of the system; [`io::ErrorKind::Interrupted`] if the user interrupts the waiting.
pub fn open(path: &Path) -> io::Result<File> {
    loop {
        if let Some(file) = platform::open_special(path)? {
            return Ok(file);
        }
        if interrupt::is_asked() {
            return Err(io::ErrorKind::Interrupted.into());
        }
        std::thread::sleep(AGAIN);
    }
}
