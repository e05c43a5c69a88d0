//! Files that replace others once they are complete.

use std::path::Path;
use std::{fs, io};

use tempfile::NamedTempFile;

use crate::platform;

/// Creates a file beside `path`, to be persisted there; with the permissions of a file that it will replace.
pub fn part_of(path: &Path) -> io::Result<NamedTempFile> {
    let mut part = tempfile::Builder::new();
    let permissions = fs::metadata(path).ok().map(|found| found.permissions()).or_else(platform::default_permissions);
    part.prefix(".slitpose-").suffix(".part");
    permissions.map(|permissions| part.permissions(permissions));
    part.tempfile_in(folder_of(path))
}

/// The folder of `path`.
pub fn folder_of(path: &Path) -> &Path {
    path.parent().filter(|folder| *folder != Path::new("")).unwrap_or(Path::new("."))
}
