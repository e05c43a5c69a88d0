//! Files that are no regular files: devices and named pipes, which are written and never replaced.

use std::fs;
use std::path::Path;

#[cfg(unix)]
pub use opening::open;

/// Whether there is something at `path` that is neither a regular file nor a folder.
pub fn is_special(path: &Path) -> bool {
    fs::metadata(path).is_ok_and(|metadata| !metadata.is_file() && !metadata.is_dir())
}

#[cfg(unix)]
mod opening {
    use std::fs::{self, File};
    use std::io;
    use std::os::unix::fs::{FileTypeExt, OpenOptionsExt};
    use std::path::Path;
    use std::time::Duration;

    use nix::errno::Errno;
    use nix::fcntl::{FcntlArg, OFlag, fcntl};

    use crate::interrupt;

    /// A pipe without a reader is tried this often.
    const AGAIN: Duration = Duration::from_millis(20);

    /// Opens a special file for writing. Waits until a named pipe has a reader.
    ///
    /// # Errors
    /// Those of the system; [`io::ErrorKind::Interrupted`] if the user interrupts the waiting.
    pub fn open(path: &Path) -> io::Result<File> {
        let is_pipe = fs::metadata(path)?.file_type().is_fifo();
        // A pipe that is opened the ordinary way waits where no signal ends it.
        let mut options = File::options();
        options.write(true).custom_flags(OFlag::O_NONBLOCK.bits());
        loop {
            match options.open(path) {
                Err(error) if is_pipe && error.raw_os_error() == Some(Errno::ENXIO as i32) => {
                    if interrupt::is_asked() {
                        return Err(io::ErrorKind::Interrupted.into());
                    }
                    std::thread::sleep(AGAIN);
                }
                opened => {
                    let file = opened?;
                    let flags = OFlag::from_bits_retain(fcntl(&file, FcntlArg::F_GETFL)?);
                    fcntl(&file, FcntlArg::F_SETFL(flags - OFlag::O_NONBLOCK))?;
                    return Ok(file);
                }
            }
        }
    }
}
