//! Windows.

use std::fs::{File, FileType, Permissions};
use std::io;
use std::os::windows::fs::OpenOptionsExt;
use std::os::windows::io::AsHandle;
use std::path::{Path, PathBuf};
use std::sync::OnceLock;
use std::time::Instant;

use same_file::Handle;

use super::folder;

/// Other programs may read the file (FILE_SHARE_READ), rename it and delete it (FILE_SHARE_DELETE), but not write it.
const SHARED: u32 = 1 | 4;

/// ERROR_SHARING_VIOLATION: another program has the file open, and does not share it.
const SHARING_VIOLATION: i32 = 32;

/// From now on calls `handle` on a thread of its own for each Ctrl-C and Ctrl-Break, which then do not end the program,
/// and once when its window is closed, after which Windows ends it.
pub fn on_interrupt(handle: impl Fn(bool) + Send + 'static) -> io::Result<()> {
    ctrlc::set_handler(move || handle(false)).map_err(io::Error::other)
}

/// A clock that is never set, ns: since this program first asked for it.
pub fn monotonic_ns() -> u64 {
    static BEGAN: OnceLock<Instant> = OnceLock::new();
    u64::try_from(BEGAN.get_or_init(Instant::now).elapsed().as_nanos()).unwrap_or(u64::MAX)
}

/// The folder of this user's settings.
pub fn user_folder() -> Option<PathBuf> {
    folder("APPDATA")
}

/// The folder of the settings of all users.
pub fn machine_folder() -> Option<PathBuf> {
    folder("ProgramData")
}

/// Permissions of a new file: those that its folder gives it.
pub fn default_permissions() -> Option<Permissions> {
    None
}

/// Whether `path` names a device or a named pipe.
pub fn is_special(path: &Path) -> bool {
    let name = path.to_string_lossy();
    name.eq_ignore_ascii_case("NUL") || name.starts_with(r"\\.\")
}

/// What a file is that is neither a regular file nor a folder.
pub fn special_kind(_: FileType) -> &'static str {
    "device"
}

/// Opens a special file for writing.
pub fn open_special(path: &Path) -> io::Result<Option<File>> {
    File::options().write(true).open(path).map(Some)
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

/// Whether `file`, once at `path`, was deleted, moved or replaced.
pub fn is_gone(file: &File, path: &Path) -> bool {
    let same = || Ok::<_, io::Error>(Handle::from_file(file.try_clone()?)? == Handle::from_path(path)?);
    !same().unwrap_or(false)
}
