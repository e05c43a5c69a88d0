//! Text files that users name: TOML is read as a whole, CSV as a stream.

use std::fs::{self, File};
use std::io::{self, Read};
use std::path::Path;

use thiserror::Error;

use crate::platform::special_kind;

/// Longest text that is read as a whole, bytes: the calibration of a head of 16 cells has 10 MB.
pub const MAX_TEXT_BYTES: usize = 1 << 24;

/// Why a text file is not read.
#[derive(Debug, Error)]
#[allow(missing_docs, reason = "the texts say what each is")]
pub enum TextFileError {
    #[error(transparent)]
    System(#[from] io::Error),
    #[error("it is a {0}; copy the text to a regular file")]
    Kind(&'static str),
    #[error("it has more than the {MAX_TEXT_BYTES} bytes of the longest text that is read")]
    TooLong,
    #[error("it is not UTF-8 text; save it as UTF-8")]
    NotText,
}

/// Reads a regular file of at most [`MAX_TEXT_BYTES`].
pub fn read(path: &Path) -> Result<Vec<u8>, TextFileError> {
    let mut bytes = Vec::new();
    let file = open_kind(path, false)?;
    file.take(MAX_TEXT_BYTES as u64 + 1).read_to_end(&mut bytes)?;
    if bytes.len() > MAX_TEXT_BYTES { Err(TextFileError::TooLong) } else { Ok(bytes) }
}

/// Opens a regular file, or a pipe such as a shell's `<(…)`, to be read as a stream.
pub fn open(path: &Path) -> Result<File, TextFileError> {
    open_kind(path, true)
}

fn open_kind(path: &Path, pipes: bool) -> Result<File, TextFileError> {
    // Opening a pipe waits for its writer.
    let kind = fs::metadata(path)?.file_type();
    match special_kind(kind) {
        _ if kind.is_file() => Ok(File::open(path)?),
        "pipe" if pipes => Ok(File::open(path)?),
        _ if kind.is_dir() => Err(TextFileError::Kind("folder")),
        special => Err(TextFileError::Kind(special)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn texts_are_regular_files_of_limited_length_and_streams_may_be_pipes() {
        let folder = tempfile::tempdir().unwrap();
        let path = |name: &str| folder.path().join(name);
        for (name, length) in
            [("longest", MAX_TEXT_BYTES as u64), ("longer", MAX_TEXT_BYTES as u64 + 1), ("huge", 10 << 30)]
        {
            File::create(path(name)).unwrap().set_len(length).unwrap();
        }
        nix::unistd::mkfifo(&path("pipe"), nix::sys::stat::Mode::S_IRWXU).unwrap();
        let _socket = std::os::unix::net::UnixListener::bind(path("socket")).unwrap();
        let kind = |kind| format!("it is a {kind}; copy the text to a regular file");
        let too_long = TextFileError::TooLong.to_string();
        for (path, refused) in [
            (path("longest"), None),
            (path("longer"), Some(too_long.clone())),
            (path("huge"), Some(too_long)),
            (path("pipe"), Some(kind("pipe"))),
            (path("socket"), Some(kind("socket"))),
            ("/dev/zero".into(), Some(kind("device"))),
            (folder.path().to_owned(), Some(kind("folder"))),
        ] {
            assert_eq!(read(&path).map_err(|error| error.to_string()).err(), refused, "{}", path.display());
        }
        let writer = std::thread::spawn({
            let pipe = path("pipe");
            move || fs::write(pipe, "a,b")
        });
        assert_eq!(io::read_to_string(open(&path("pipe")).unwrap()).unwrap(), "a,b");
        writer.join().unwrap().unwrap();
        for path in ["/dev/zero".into(), path("socket"), folder.path().to_owned()] {
            assert!(matches!(open(&path), Err(TextFileError::Kind(_))), "{}", path.display());
        }
    }
}
