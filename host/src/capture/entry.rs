//! What a capture holds, piece by piece.

use super::Setup;
use crate::link::DeviceId;

/// What comes next in a capture.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Entry {
    /// A board, ahead of what it says.
    Setup(Box<Setup>),
    /// The last hello of a board, said before what follows; the segment holds its packet.
    Hello {
        /// Which board.
        device: DeviceId,
        /// When it was written.
        log_ns: u64,
    },
    /// The segment holds what the link of a board delivered.
    Link {
        /// Which board; `None` if the file is a plain byte stream.
        device: Option<DeviceId>,
        /// When: UTC of the first read, or what the recorder gave for it, in nanoseconds. 0 in a
        /// plain byte stream.
        log_ns: u64,
    },
}
