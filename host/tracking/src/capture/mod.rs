//! Captures: the bytes of boards with their instants, in files that describe themselves.
//!
//! A capture is an MCAP file (<https://mcap.dev/spec>) with the bytes of every link, scene and
//! settings of every board, some poses, and reports; CAPTURES.md describes it for other programs that
//! read or write such files. [`CaptureSeries`] writes, [`CaptureReader`] reads; the times they record
//! are arguments.
//!
//! Guarantees:
//! * *All flushed data can be read*, wherever the file is cut: each chunk reaches the file whole,
//!   and each record begins with its length.
//! * *Damage affects only the chunk it is in*: settings, scenes and hellos are repeated, and after bytes
//!   that are not a record the reader searches for the next one.
//! * *Each file stands alone*: it begins with scenes, settings and the last hello of each board, and
//!   a packet is never split between two files, because incomplete packets are held back.
//! * *A full disk ends the recording, not the program*: the file is cut back to its last flush.

mod contents;
mod file;
mod index;
mod link_bytes;
mod place;
mod reader;
mod records;
mod series;
mod setup;

use std::io;
use std::path::PathBuf;

use thiserror::Error;

pub use contents::{Contents, contents};
pub use file::Medium;
pub use place::Existing;
pub use reader::{CaptureReader, End};
pub use series::{CaptureSeries, Limits, PoseRate};
pub use setup::{CapturedBasis, Settings, Setup, SetupError};

use crate::link::DeviceId;
use crate::ros::RosType;

/// Why a capture cannot be written or read.
#[derive(Debug, Error)]
#[allow(missing_docs, reason = "the texts say what each is, and no other crate can name them")]
pub enum CaptureError {
    #[error("{} is there already; give another name, or --overwrite to replace it", path.display())]
    Exists { path: PathBuf },
    #[error("{} is being recorded by another program; give another name, or end that program", path.display())]
    InUse { path: PathBuf },
    #[error(
        "recording to {} has ended: the file was deleted, or replaced by another one, while it was recorded; what was \
         in it is lost; record to another file",
        path.display()
    )]
    Lost { path: PathBuf },
    #[error("cannot write to {}; give a file in a folder that exists and may be written", path.display())]
    Create { path: PathBuf, source: io::Error },
    #[error("interrupted: nobody reads {} yet; start its reader first", path.display())]
    Interrupted { path: PathBuf },
    #[error(
        "recording to {} has ended: writing failed; its first {kept_bytes} bytes are whole and can be replayed; \
         make room there, then record to another file",
        path.display()
    )]
    Write { path: PathBuf, kept_bytes: u64, source: io::Error },
    #[error("a report cannot be written as JSON")]
    Report(#[from] serde_json::Error),
    #[error("board {device} is not part of this capture; its scene must be given first")]
    UnknownDevice { device: DeviceId },
    #[error("cannot read {}; give a capture written by `run --record` or `simulate`", path.display())]
    Open { path: PathBuf, source: io::Error },
    #[error("{} is not a capture but {what}; {next_step}", path.display())]
    Foreign { path: PathBuf, what: &'static str, next_step: &'static str },
    #[error("reading {} failed after {bytes} bytes; copy it from that medium if you can, and read the copy", path.display())]
    Read { path: PathBuf, bytes: u64, source: io::Error },
}

/// What a capture has next.
#[derive(Clone, Debug, PartialEq)]
#[allow(missing_docs, reason = "fields are named by what they are")]
pub enum Entry {
    /// The setup of a board, before its data.
    Setup(Box<Setup>),
    /// The last hello of a board before the following data; the segment holds its packet.
    Hello { device: DeviceId, log_ns: u64 },
    /// The segment holds bytes of the link of a board, first read at `log_ns` (UTC, or the time given by the recorder). In a
    /// plain byte stream there is neither.
    Link { device: Option<DeviceId>, log_ns: u64 },
    /// What a person noted of the instant `stamp_ns`, recorded at `log_ns`.
    Note { stamp_ns: u64, text: String, log_ns: u64 },
}

/// The bytes of a link: a type of this project, as no standard type keeps the time of each read.
const LINK_BYTES: RosType =
    RosType { name: "slitpose_msgs/msg/LinkBytes", definition: include_str!("../ros/msg/LinkBytes.msg") };

/// Name of the attachment with the JSON schema of reports.
const REPORT_SCHEMA: &str = "report.schema.json";

#[cfg(test)]
mod tests;
