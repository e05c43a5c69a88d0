//! What Windows and a browser share: files without kinds, and no clock that other programs read, too.

use std::fs::{File, FileType, Permissions};
use std::io;
use std::path::{Path, PathBuf};
use std::sync::OnceLock;

use web_time::Instant;

use super::folder;

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

/// Whether the file at `path` was deleted or moved; while it is open, no other takes its place.
pub fn is_gone(_: &File, path: &Path) -> bool {
    !path.exists()
}
