//! Windows.

use std::fs::File;
use std::io;
use std::os::windows::fs::OpenOptionsExt;
use std::os::windows::io::AsHandle;
use std::path::Path;

use super::Interrupt;

/// Other programs may read the file (FILE_SHARE_READ), rename it and delete it (FILE_SHARE_DELETE), but not write it.
const SHARED: u32 = 1 | 4;

/// ERROR_SHARING_VIOLATION: another program has the file open, and does not share it.
const SHARING_VIOLATION: i32 = 32;

/// From now on calls `handle` on a thread of its own for each Ctrl-C and Ctrl-Break, which then do not end the program,
/// and once when its window is closed, after which Windows ends it.
pub fn on_interrupt(handle: impl Fn(Interrupt) + Send + 'static) -> io::Result<()> {
    ctrlc::set_handler(move || handle(Interrupt::Asked)).map_err(io::Error::other)
}

/// Standard output as a file.
pub fn standard_output() -> io::Result<File> {
    io::stdout().as_handle().try_clone_to_owned().map(File::from)
}

/// Keeps other programs from writing `file`, which is at `path`, until it is closed; fails with
/// [`io::ErrorKind::WouldBlock`] if another one does. A lock of the file would keep them from reading, too.
pub fn hold(file: File, path: &Path) -> io::Result<File> {
    drop(file);
    File::options().write(true).share_mode(SHARED).open(path).map_err(|error| match error.raw_os_error() {
        Some(SHARING_VIOLATION) => io::ErrorKind::WouldBlock.into(),
        _ => error,
    })
}
