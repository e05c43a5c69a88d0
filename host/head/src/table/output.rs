//! The result of a command: on standard output, or in a file that appears only when complete.

use std::fs::{self, File};
use std::io::{self, BufWriter, IsTerminal, Read, Stdout, Write};
use std::path::{Path, PathBuf};

use tempfile::NamedTempFile;
use thiserror::Error;

use crate::foreign::printable_lines;
use crate::replacement::part_of;
use crate::{interrupt, platform, special_file, text_file};

/// The magic of captures: MCAP, <https://mcap.dev/spec#magic>.
pub const CAPTURE_MAGIC: &[u8] = b"\x89MCAP0\r\n";

/// Which files a result may replace.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Replace {
    /// Any file.
    Anything,
    /// Any file but a capture: a mistyped name must not destroy measurements.
    NoCapture,
    /// No file.
    Nothing,
}

/// Why a result cannot be written.
#[derive(Debug, Error)]
#[allow(missing_docs, reason = "the texts say what each is")]
pub enum OutputError {
    #[error("{} is there already; give another name, or --overwrite to replace it", .0.display())]
    Exists(PathBuf),
    #[error("{} is a capture, which a result would replace; give another name, or delete it first", .0.display())]
    Capture(PathBuf),
    #[error("{} is named twice, and would be replaced; give another name", .0.display())]
    Twice(PathBuf),
    #[error("interrupted: {target} is not written")]
    Interrupted { target: String },
    #[error("cannot write to {}; give a file in a folder that exists and may be written", path.display())]
    Create { path: PathBuf, source: io::Error },
    #[error("{} is to be a folder, of a page with its tables and pictures; give a name that is not a file's", .0.display())]
    Folder(PathBuf),
    #[error("writing to {target} failed; make room there, or choose another --output")]
    Write { target: String, source: io::Error },
}

impl OutputError {
    /// Whether the reader of a pipe has gone: an ordinary end, not a failure.
    pub fn is_broken_pipe(&self) -> bool {
        match self {
            Self::Create { source, .. } | Self::Write { source, .. } => source.kind() == io::ErrorKind::BrokenPipe,
            _ => false,
        }
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
    Pending(BufWriter<NamedTempFile>, PathBuf, Replace),
    /// Something that is no regular file, such as a device or a named pipe.
    Device(BufWriter<File>),
}

impl Sink {
    fn buffer(&mut self) -> &mut dyn Write {
        match self {
            Self::Stdout(stdout) => stdout,
            Self::Pending(file, ..) => file,
            Self::Device(file) => file,
        }
    }
}

impl Output {
    /// Standard output for `None` and `-`, else the file of that name.
    pub fn open(path: Option<&Path>) -> Result<Self, OutputError> {
        match path {
            Some(path) => Self::replacing(path, Replace::NoCapture),
            None => Ok(Self { sink: Sink::Stdout(BufWriter::new(io::stdout())), target: "standard output".to_owned() }),
        }
    }

    /// Standard output for `-`, else the file of that name, in the place of what it may replace.
    pub fn replacing(path: &Path, replace: Replace) -> Result<Self, OutputError> {
        if path == Path::new("-") { Self::open(None) } else { Self::at(path, replace) }
    }

    /// The file of that name. It may exist, unless it is a capture; it is replaced as a whole at the end.
    pub fn file(path: &Path) -> Result<Self, OutputError> {
        Self::at(path, Replace::NoCapture)
    }

    fn at(path: &Path, replace: Replace) -> Result<Self, OutputError> {
        let sink = Self::file_sink(path, replace).map_err(|source| match source.kind() {
            io::ErrorKind::AlreadyExists if replace == Replace::Nothing => OutputError::Exists(path.to_owned()),
            io::ErrorKind::AlreadyExists => OutputError::Capture(path.to_owned()),
            io::ErrorKind::Interrupted => OutputError::Interrupted { target: path.display().to_string() },
            _ => OutputError::Create { path: path.to_owned(), source },
        })?;
        let target = path.display().to_string();
        Ok(Self { sink, target })
    }

    fn file_sink(path: &Path, replace: Replace) -> io::Result<Sink> {
        // A link keeps pointing where it did: its target is replaced, not the link.
        let given = path;
        let path = fs::canonicalize(path).unwrap_or_else(|_| path.to_owned());
        let existing = fs::metadata(&path).ok();
        if existing.as_ref().is_some_and(fs::Metadata::is_dir) {
            return Err(io::ErrorKind::IsADirectory.into());
        }
        if special_file::is_special(&path) {
            return Ok(Sink::Device(BufWriter::new(special_file::open(&path)?)));
        }
        let is_kept = match replace {
            Replace::Anything => false,
            Replace::NoCapture => is_capture(&path),
            Replace::Nothing => existing.is_some(),
        };
        if is_kept {
            return Err(io::ErrorKind::AlreadyExists.into());
        }
        let file = interrupt::removing(given, || part_of(&path))?;
        Ok(Sink::Pending(BufWriter::new(file), path, replace))
    }

    /// The file itself, for something that writes it without this buffer.
    pub fn as_file(&self) -> io::Result<File> {
        match &self.sink {
            Sink::Stdout(_) => platform::standard_output(),
            Sink::Pending(file, ..) => file.get_ref().as_file().try_clone(),
            Sink::Device(file) => file.get_ref().try_clone(),
        }
    }

    /// Writes what is buffered and gives a file its final name.
    pub fn finish(self) -> Result<(), OutputError> {
        let Self { sink, target } = self;
        let done = match sink {
            Sink::Pending(file, path, replace) => file
                .into_inner()
                .map_err(io::IntoInnerError::into_error)
                .and_then(|file| match replace {
                    Replace::Nothing => file.persist_noclobber(path).map_err(io::Error::from),
                    Replace::Anything | Replace::NoCapture => file.persist(path).map_err(io::Error::from),
                })
                .map(drop),
            mut other => other.buffer().flush(),
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

    /// Whether it is standard output on a terminal.
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
        self.sink.buffer().write(bytes)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.sink.buffer().flush()
    }
}

/// Whether a file begins as captures do.
pub fn is_capture(path: &Path) -> bool {
    let mut begin = Vec::new();
    // What is taken from a pipe is gone.
    let file = text_file::open(path).ok().filter(|file| file.metadata().is_ok_and(|metadata| metadata.is_file()));
    let read = file.map(|file| file.take(CAPTURE_MAGIC.len() as u64).read_to_end(&mut begin));
    read.is_some_and(|read| read.is_ok()) && begin == CAPTURE_MAGIC
}

/// Refuses a result in the place of something the same command reads, or of another result.
///
/// # Errors
/// If `output` and one of `others` are one file.
pub fn refuse_twice<'a>(output: &Path, others: impl IntoIterator<Item = &'a Path>) -> Result<(), OutputError> {
    let is_same = |other: &Path| match (fs::metadata(output), fs::metadata(other)) {
        (Ok(a), Ok(_)) => a.is_file() && same_file::is_same_file(output, other).unwrap_or(false),
        (Err(_), Err(_)) => is_one_name(output, other),
        _ => false,
    };
    if others.into_iter().any(is_same) { Err(OutputError::Twice(output.to_owned())) } else { Ok(()) }
}

/// Whether two files that are not there yet have one name in one folder.
fn is_one_name(a: &Path, b: &Path) -> bool {
    let folder = |path: &Path| path.parent().and_then(|folder| fs::canonicalize(Path::new(".").join(folder)).ok());
    a.file_name() == b.file_name() && folder(a).is_some_and(|of_a| folder(b) == Some(of_a))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_that_appears_meanwhile_is_kept() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("new.mcap");
        let output = Output::replacing(&path, Replace::Nothing).unwrap();
        fs::write(&path, "of another").unwrap();
        assert!(output.write_text("ours").is_err());
        assert_eq!(fs::read_to_string(&path).unwrap(), "of another");
    }

    #[test]
    fn one_file_under_two_names_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let path = |name: &str| folder.path().join(name);
        fs::write(path("old"), "old").unwrap();
        std::os::unix::fs::symlink(path("old"), path("link")).unwrap();
        fs::create_dir(path("in")).unwrap();
        for (a, b, is_same) in [
            ("old", "link", true),
            ("old", "in/../old", true),
            ("new", "in/../new", true),
            ("new", "in/new", false),
            ("old", "new", false),
        ] {
            assert_eq!(refuse_twice(&path(a), [&*path(b)]).is_err(), is_same, "{a} and {b}");
        }
        assert!(refuse_twice(Path::new("/dev/null"), [Path::new("/dev/null")]).is_ok());
    }

    #[test]
    fn a_device_is_written_not_replaced() {
        Output::file(Path::new("/dev/null")).unwrap().write_text("gone").unwrap();
        assert!(!fs::metadata("/dev/null").unwrap().is_file());
    }
}
