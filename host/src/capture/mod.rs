//! Captures: the bytes of boards with their instants, in files that describe themselves.
//!
//! A capture is an MCAP file (<https://mcap.dev/spec>) with the bytes of every link, scene and
//! settings of every board, some poses, and reports; CAPTURES.md describes it for others who read or
//! write such files. [`CaptureSeries`] writes, [`CaptureReader`] reads; neither looks at a clock for
//! what it writes down.
//!
//! Promises, and how they are kept:
//! * *All that was flushed can be read*, wherever the file is cut: each chunk reaches the file whole,
//!   and a record says how long it is.
//! * *Damage costs the chunk it is in*: settings, scenes and hellos are written again and again, and
//!   behind bytes that are no record the next one is looked for.
//! * *Each file stands alone*: it begins with scenes, settings and the last hello of each board, and
//!   a packet is never split between two, since one that has not ended is held back.
//! * *A full disk ends the recording, not the program*: the file is cut back to its last flush.

mod cdr;
mod entry;
mod error;
mod file;
mod geometry;
mod index;
mod link_bytes;
mod medium;
mod naming;
mod packets;
mod place;
mod reader;
mod records;
mod schemas;
mod series;
mod setup;
#[cfg(test)]
mod tests;
mod window;

pub(crate) use entry::Entry;
pub(crate) use error::CaptureError;
pub(crate) use naming::Existing;
pub(crate) use reader::{CaptureReader, End};
pub(crate) use series::{CaptureSeries, Limits};
pub(crate) use setup::{Settings, Setup, SetupError};

/// What a capture says of the program that writes it.
#[derive(Clone, Debug, Default)]
pub(crate) struct About {
    /// JSON schema of all reports.
    pub report_schema: String,
}
