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

mod entry;
mod error;
mod file;
mod index;
mod link_bytes;
mod medium;
mod naming;
mod packets;
mod place;
mod reader;
mod readings;
mod records;
mod schemas;
mod series;
mod setup;
#[cfg(test)]
mod tests;
mod window;

pub(crate) use entry::Entry;
pub use error::CaptureError;
#[cfg(feature = "zenoh")]
pub(crate) use link_bytes::{decode as decode_link_bytes, encode as encode_link_bytes};
pub(crate) use naming::Existing;
pub(crate) use reader::{CaptureReader, End};
pub use readings::ReadingsError;
pub(crate) use readings::{Readings, read as readings};
#[cfg(feature = "zenoh")]
pub(crate) use schemas::LINK_BYTES;
pub(crate) use series::{CaptureSeries, Limits};
pub(crate) use setup::{CapturedBasis, Settings, Setup, SetupError};

/// Information in a capture about the program that writes it.
#[derive(Clone, Debug, Default)]
pub(crate) struct About {
    /// JSON schema of all reports.
    pub report_schema: String,
}
