//! Why a capture cannot be written or read.

use std::io;
use std::path::PathBuf;

use thiserror::Error;

use crate::link::DeviceId;

/// Why a capture cannot be written or read.
#[derive(Debug, Error)]
pub enum CaptureError {
    /// A capture of an earlier run would be lost.
    #[error("{} is there already; give another name, or --overwrite to replace it", path.display())]
    Exists {
        /// The file.
        path: PathBuf,
    },
    /// Another program records to this file.
    #[error("{} is being recorded by another program; give another name, or end that program", path.display())]
    InUse {
        /// The file.
        path: PathBuf,
    },
    /// The file was removed or replaced while it was written.
    #[error(
        "recording to {} has ended: the file was deleted, or replaced by another one, while it was recorded; what was \
         in it is lost; record to another file",
        path.display()
    )]
    Lost {
        /// The file.
        path: PathBuf,
    },
    /// The file cannot be created.
    #[error("cannot write to {}; give a file in a folder that exists and may be written", path.display())]
    Create {
        /// The requested file.
        path: PathBuf,
        /// The system's error.
        source: io::Error,
    },
    /// The user interrupted the waiting for a reader of a pipe.
    #[error("interrupted: nobody reads {} yet; start its reader first", path.display())]
    Interrupted {
        /// The pipe.
        path: PathBuf,
    },
    /// Writing failed during the recording.
    #[error(
        "recording to {} has ended: writing failed; its first {kept_bytes} bytes are whole and can be replayed; \
         make room there, then record to another file",
        path.display()
    )]
    Write {
        /// The file.
        path: PathBuf,
        /// Number of its bytes that are whole.
        kept_bytes: u64,
        /// The system's error.
        source: io::Error,
    },
    /// A report that is not JSON.
    #[error("a report cannot be written as JSON")]
    Report(#[from] serde_json::Error),
    /// A board without a scene.
    #[error("board {device} is not part of this capture; its scene must be given first")]
    UnknownDevice {
        /// The board.
        device: DeviceId,
    },
    /// The file cannot be opened.
    #[error("cannot read {}; give a capture written by `run --record` or `simulate`", path.display())]
    Open {
        /// The file.
        path: PathBuf,
        /// The system's error.
        source: io::Error,
    },
    /// Another kind of file.
    #[error("{} is not a capture but {what}; {next_step}", path.display())]
    Foreign {
        /// The file.
        path: PathBuf,
        /// Its kind.
        what: &'static str,
        /// How to go on.
        next_step: &'static str,
    },
    /// Reading failed before the end.
    #[error("reading {} failed after {bytes} bytes; copy it from that medium if you can, and read the copy", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// Number of bytes read.
        bytes: u64,
        /// The system's error.
        source: io::Error,
    },
}
