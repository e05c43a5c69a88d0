//! Events of a stream that the solving thread reports to the reading thread.

use super::error::BoardError;
use crate::device::Scanless;

/// An event of the stream of a board.
#[derive(Debug)]
pub(super) enum StreamEvent {
    /// The first scan of the connection has come.
    Scans,
    /// No scan has come for this many seconds; the second field says what came instead.
    Scanless(f64, Scanless),
    /// All requested scans have come.
    Complete,
    /// The board has stopped by itself, with its last warning or error.
    Stopped(Option<String>),
    /// The stream cannot be used.
    Unusable(BoardError),
}
