//! The entries of a capture.

use super::Setup;
use crate::link::DeviceId;

/// An entry of a capture.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Entry {
    /// The setup of a board, before its data.
    Setup(Box<Setup>),
    /// The last hello of a board before the following data; the segment holds its packet.
    Hello {
        /// The board.
        device: DeviceId,
        /// Time at which it was written.
        log_ns: u64,
    },
    /// The segment holds bytes of the link of a board.
    Link {
        /// The board; `None` if the file is a plain byte stream.
        device: Option<DeviceId>,
        /// UTC of the first read, or the time given by the recorder, nanoseconds; 0 in a plain byte
        /// stream.
        log_ns: u64,
    },
}
