//! Where a command's result goes: standard output, or a file that appears only when complete.

use std::fs::{self, File, Permissions};
use std::io::{self, BufWriter, IsTerminal, Stdout, Write};
use std::path::{Path, PathBuf};

use tempfile::NamedTempFile;
use thiserror::Error;

use crate::foreign::printable_lines;

/// Why a result cannot be written.
#[derive(Debug, Error)]
pub enum OutputError {
    /// The file cannot be made.
    #[error("cannot write to {}; give a file in a folder that exists and may be written", path.display())]
    Create {
        /// The file asked for.
        path: PathBuf,
        /// What the system said.
        source: io::Error,
    },
    /// Writing failed on the way.
    #[error("writing to {target} failed; make room there, or choose another --output")]
    Write {
        /// The file, or standard output.
        target: String,
        /// What the system said.
        source: io::Error,
    },
}

impl OutputError {
    /// Whether the reader of a pipe has gone: an ordinary end, not a failure.
    pub fn is_broken_pipe(&self) -> bool {
        let (Self::Create { source, .. } | Self::Write { source, .. }) = self;
        source.kind() == io::ErrorKind::BrokenPipe
    }
}

/// A buffered destination. Call [`Self::finish`], or a file will not appear.
#[derive(Debug)]
pub struct Output {
    sink: Sink,
    target: String,
}

#[derive(Debug)]
enum Sink {
    Stdout(BufWriter<Stdout>),
    /// A file that is written beside its final name and renamed at the end.
    Pending(BufWriter<NamedTempFile>, PathBuf),
    /// Something that is no regular file, such as a device or a named pipe.
    Device(BufWriter<File>),
}

impl Output {
    /// Standard output for `None` and `-`, else the file of that name.
    pub fn open(path: Option<&Path>) -> Result<Self, OutputError> {
        match path {
            Some(path) if path != Path::new("-") => Self::file(path),
            _ => Ok(Self { sink: Sink::Stdout(BufWriter::new(io::stdout())), target: "standard output".to_owned() }),
        }
    }

    /// The file of that name. It may exist; it is replaced as a whole at the end.
    pub fn file(path: &Path) -> Result<Self, OutputError> {
        let sink = Self::file_sink(path).map_err(|source| OutputError::Create { path: path.to_owned(), source })?;
        let target = path.display().to_string();
        Ok(Self { sink, target })
    }

    fn file_sink(path: &Path) -> io::Result<Sink> {
        // A link keeps pointing where it did: its target is replaced, not the link.
        let path = fs::canonicalize(path).unwrap_or_else(|_| path.to_owned());
        let existing = fs::metadata(&path).ok();
        if existing.as_ref().is_some_and(fs::Metadata::is_dir) {
            return Err(io::ErrorKind::IsADirectory.into());
        }
        if existing.as_ref().is_some_and(|metadata| !metadata.is_file()) {
            return Ok(Sink::Device(BufWriter::new(File::options().write(true).open(&path)?)));
        }
        let folder = match path.parent() {
            Some(folder) if folder != Path::new("") => folder,
            _ => Path::new("."),
        };
        let mut builder = tempfile::Builder::new();
        builder.prefix(".slitpose-").suffix(".part");
        #[cfg(unix)]
        builder.permissions(ordinary_permissions(existing.as_ref()));
        let file = builder.tempfile_in(folder)?;
        Ok(Sink::Pending(BufWriter::new(file), path))
    }

    /// Writes what is buffered and gives a file its final name.
    pub fn finish(self) -> Result<(), OutputError> {
        let Self { sink, target } = self;
        let done = match sink {
            Sink::Stdout(mut stdout) => stdout.flush(),
            Sink::Device(mut file) => file.flush(),
            Sink::Pending(file, path) => file
                .into_inner()
                .map_err(io::IntoInnerError::into_error)
                .and_then(|file| file.persist(path).map_err(io::Error::from))
                .map(drop),
        };
        done.map_err(|source| OutputError::Write { target, source })
    }

    /// Writes a whole text and finishes.
    pub fn write_text(mut self, text: &str) -> Result<(), OutputError> {
        let text = if self.is_terminal() { printable_lines(text) } else { text.into() };
        match self.write_all(text.as_bytes()) {
            Ok(()) => self.finish(),
            Err(source) => Err(self.error(source)),
        }
    }

    /// Whether somebody looks at it as it comes.
    pub fn is_terminal(&self) -> bool {
        matches!(&self.sink, Sink::Stdout(stdout) if stdout.get_ref().is_terminal())
    }

    /// The file's name, or `standard output`.
    pub fn target(&self) -> &str {
        &self.target
    }

    /// The error of a failed write to this destination.
    pub fn error(&self, source: io::Error) -> OutputError {
        OutputError::Write { target: self.target.clone(), source }
    }
}

impl Write for Output {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        match &mut self.sink {
            Sink::Stdout(stdout) => stdout.write(bytes),
            Sink::Pending(file, _) => file.write(bytes),
            Sink::Device(file) => file.write(bytes),
        }
    }

    fn flush(&mut self) -> io::Result<()> {
        match &mut self.sink {
            Sink::Stdout(stdout) => stdout.flush(),
            Sink::Pending(file, _) => file.flush(),
            Sink::Device(file) => file.flush(),
        }
    }
}

/// Those of the file that is replaced; for a new one what the user's mask leaves of 0666.
/// Temporary files are private by default, results are not.
#[cfg(unix)]
fn ordinary_permissions(existing: Option<&fs::Metadata>) -> Permissions {
    use std::os::unix::fs::PermissionsExt;
    existing.map_or_else(|| Permissions::from_mode(0o666), fs::Metadata::permissions)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_appears_only_when_finished() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("table.csv");
        let mut output = Output::file(&path).unwrap();
        output.write_all(b"half").unwrap();
        output.flush().unwrap();
        assert!(!path.exists(), "unfinished output stands under its final name");
        drop(output);
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 0, "a part was left behind");

        Output::file(&path).unwrap().write_text("whole").unwrap();
        assert_eq!(fs::read_to_string(&path).unwrap(), "whole");
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1);
    }

    #[test]
    fn an_unfinished_file_leaves_the_old_one_alone() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("table.csv");
        fs::write(&path, "old").unwrap();
        let mut output = Output::file(&path).unwrap();
        output.write_all(b"new").unwrap();
        drop(output);
        assert_eq!(fs::read_to_string(&path).unwrap(), "old");
    }

    #[test]
    fn an_impossible_place_is_refused_before_any_work() {
        let folder = tempfile::tempdir().unwrap();
        for path in [folder.path().to_owned(), folder.path().join("no/such/folder.csv")] {
            let error = Output::file(&path).unwrap_err();
            let message = error.to_string();
            assert!(message.contains(&*path.to_string_lossy()) && message.contains("folder that exists"), "{message}");
        }
    }

    #[cfg(unix)]
    #[test]
    fn a_device_is_written_not_replaced() {
        Output::file(Path::new("/dev/null")).unwrap().write_text("gone").unwrap();
        assert!(!fs::metadata("/dev/null").unwrap().is_file());
    }
}
