//! The place of a file during recording. The file is locked against other programs, one to be
//! replaced is kept until the new one has content, and a loss of the file is detected.

use std::ffi::OsStr;
use std::fs::{self, File};
use std::io;
use std::path::{Path, PathBuf};

use slitpose_head::platform;
use slitpose_head::replacement::{folder_of, part_of};
use slitpose_head::special_file;
use tempfile::TempPath;

/// The place of a file that is being recorded.
#[derive(Debug)]
pub(super) struct Place {
    path: PathBuf,
    /// Temporary name of the file until it has content and is [moved](Self::settle) to its place; removed when dropped.
    pending: Option<TempPath>,
    /// Keeps other programs from recording there; `None` for standard output and special files.
    held: Option<File>,
}

impl Place {
    pub(super) fn create(path: &Path, existing: Existing) -> io::Result<(File, Self)> {
        let replaces = existing == Existing::Replaced && fs::metadata(path).is_ok_and(|found| found.is_file());
        let (file, path, pending) = if replaces {
            // The target of a link is replaced, not the link.
            let path = fs::canonicalize(path)?;
            platform::hold(File::open(&path)?, &path)?;
            let (file, pending) = part_of(&path)?.into_parts();
            (file, path, Some(pending))
        } else {
            (create(path, existing)?, path.to_owned(), None)
        };
        if path == Path::new(STANDARD_OUTPUT) || special_file::is_special(&path) {
            return Ok((file, Self { path, pending, held: None }));
        }
        let file = platform::hold(file, pending.as_deref().unwrap_or(&path))?;
        let held = Some(file.try_clone()?);
        Ok((file, Self { path, pending, held }))
    }

    /// Moves the file to its place, over the one it replaces. To be called once it has content.
    pub(super) fn settle(&mut self) -> io::Result<()> {
        if self.pending.is_none() {
            return Ok(());
        }
        // Another program may have begun to record there since.
        if let Ok(found) = File::open(&self.path) {
            platform::hold(found, &self.path)?;
        }
        if let Some(pending) = self.pending.take() {
            pending.persist(&self.path).map_err(|error| error.error)?;
            sync_folder(&self.path);
        }
        Ok(())
    }

    /// Whether the file was deleted or replaced: further writing is lost.
    pub(super) fn is_lost(&self) -> bool {
        let path = self.pending.as_deref().unwrap_or(&self.path);
        self.held.as_ref().is_some_and(|file| platform::is_gone(file, path))
    }
}

/// What happens to a file of the same name.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Existing {
    /// It stays, and recording fails.
    Kept,
    /// It is replaced.
    Replaced,
}

const STANDARD_OUTPUT: &str = "-";

/// Creates a file whose name, too, survives a power cut.
pub(super) fn create(path: &Path, existing: Existing) -> io::Result<File> {
    if path.is_dir() {
        return Err(io::ErrorKind::IsADirectory.into());
    }
    if path == Path::new(STANDARD_OUTPUT) {
        return platform::standard_output();
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_recorded_file_is_locked_and_its_loss_is_noticed() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("d.mcap");
        let (_file, place) = Place::create(&path, Existing::Kept).unwrap();
        let refused = Place::create(&path, Existing::Replaced).unwrap_err();
        assert_eq!(refused.kind(), io::ErrorKind::WouldBlock);
        // Moved away it is still whole.
        let elsewhere = folder.path().join("elsewhere");
        fs::rename(&path, &elsewhere).unwrap();
        assert!(!place.is_lost());
        // Two programs that replace one file: the second finds the first in its place.
        fs::write(&path, "older").unwrap();
        let [(_, mut one), (_, mut other)] = [0, 1].map(|_| Place::create(&path, Existing::Replaced).unwrap());
        other.settle().unwrap();
        assert_eq!(one.settle().unwrap_err().kind(), io::ErrorKind::WouldBlock);
        assert!(!other.is_lost());
        fs::rename(&elsewhere, &path).unwrap();
        assert!(other.is_lost() && !place.is_lost(), "another file has taken its place");
        fs::remove_file(&path).unwrap();
        assert!(place.is_lost());
    }
}
