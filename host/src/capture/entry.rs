//! The entries of a capture.

use super::Setup;
use crate::link::DeviceId;

/// An entry of a capture.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Entry {
    /// A board, ahead of its data.
    Setup(Box<Setup>),
    /// The last hello of a board before the following data; the segment holds its packet.
    Hello {
        /// Which board.
        device: DeviceId,
        /// When it was written.
        log_ns: u64,
    },
    /// The segment holds bytes of the link of a board.
    Link {
        /// Which board; `None` if the file is a plain byte stream.
        device: Option<DeviceId>,
        /// When: UTC of the first read, or what the recorder gave for it, in nanoseconds. 0 in a
        /// plain byte stream.
        log_ns: u64,
    },
}
