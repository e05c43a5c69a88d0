//! What a solver tells the thread that reads.

use super::error::BoardError;
use crate::device::Scanless;

/// What the solver has found out.
#[derive(Debug)]
pub(super) enum Verdict {
    /// The first scan of the connection has come.
    Scans,
    /// No scan has come for so many seconds; what came instead.
    Scanless(f64, Scanless),
    /// All scans asked for have come.
    Complete,
    /// The board has stopped by itself; what it said last.
    Stopped(Option<String>),
    /// What it sends cannot be used.
    Unusable(BoardError),
}
