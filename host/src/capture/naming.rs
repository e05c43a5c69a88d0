//! The names of the files of a capture.

use std::ffi::OsStr;
use std::fs::{self, File};
use std::io;
use std::os::fd::AsFd;
use std::path::{Path, PathBuf};

use slitpose_head::replacement::folder_of;
use slitpose_head::special_file;

/// How to treat an existing file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Existing {
    /// It is kept, and recording refused.
    Kept,
    /// It is replaced.
    Replaced,
}

/// Stands for standard output.
const STANDARD_OUTPUT: &str = "-";

/// Creates a file whose name, too, survives a power cut.
pub(super) fn create(path: &Path, existing: Existing) -> io::Result<File> {
    if path.is_dir() {
        return Err(io::ErrorKind::IsADirectory.into());
    }
    if path == Path::new(STANDARD_OUTPUT) {
        return io::stdout().as_fd().try_clone_to_owned().map(File::from);
    }
    // A special file, such as a device or a named pipe, is opened as it is.
    if special_file::is_special(path) {
        return special_file::open(path);
    }
    let file = match existing {
        Existing::Kept => File::create_new(path),
        Existing::Replaced => File::create(path),
    }?;
    sync_folder(path);
    Ok(file)
}

/// Syncs the folder of `path`, so that the names in it survive a power cut.
pub(super) fn sync_folder(path: &Path) {
    // Some file systems cannot; the file itself is synced.
    let _ = File::open(folder_of(path)).and_then(|folder| folder.sync_all());
}

/// Stem and extension that the names of a series share.
fn parts(path: &Path) -> (String, String) {
    let text = |part: Option<&OsStr>| part.map(|part| part.to_string_lossy().into_owned());
    (text(path.file_stem()).unwrap_or_default(), text(path.extension()).unwrap_or_else(|| "mcap".to_owned()))
}

/// The file of this number in a series.
pub(super) fn numbered(path: &Path, number: u64) -> PathBuf {
    let (stem, extension) = parts(path);
    path.with_file_name(format!("{stem}-{number:04}.{extension}"))
}

/// The number after the existing ones.
pub(super) fn next_number(path: &Path) -> io::Result<u64> {
    let (stem, extension) = parts(path);
    let mut last = 0;
    for entry in fs::read_dir(folder_of(path))? {
        let name = entry?.file_name();
        let number = name.to_str().and_then(|name| {
            name.strip_prefix(&stem)?.strip_prefix('-')?.strip_suffix(&extension)?.strip_suffix('.')?.parse().ok()
        });
        last = last.max(number.unwrap_or(0));
    }
    Ok(last + 1)
}
