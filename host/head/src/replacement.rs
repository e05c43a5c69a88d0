//! Files that replace others once they are complete.

use std::fs::{self, Permissions};
use std::io;
use std::os::unix::fs::PermissionsExt;
use std::path::Path;

use tempfile::NamedTempFile;

/// Permissions of a new file, before the user's umask. Temporary files are private by default, results are not.
const MODE: u32 = 0o666;

/// Creates a file beside `path`, to be persisted there; with the permissions of a file that it will replace.
pub fn part_of(path: &Path) -> io::Result<NamedTempFile> {
    let permissions = fs::metadata(path).map_or_else(|_| Permissions::from_mode(MODE), |found| found.permissions());
    tempfile::Builder::new().prefix(".slitpose-").suffix(".part").permissions(permissions).tempfile_in(folder_of(path))
}

/// The folder of `path`.
pub fn folder_of(path: &Path) -> &Path {
    path.parent().filter(|folder| *folder != Path::new("")).unwrap_or(Path::new("."))
}
