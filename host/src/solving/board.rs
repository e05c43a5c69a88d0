//! Heads for boards that solve poses themselves.

use slitpose_calibration::{Calibration, Head};
use slitpose_head::board_head::{self, BoardHeadError};
use slitpose_protocol::{AdcScaling, Hashes, Schedule};

/// The hashes of what `head` is made from.
pub(crate) fn hashes(head: &Head) -> Hashes {
    Hashes { scene: Some(head.file.hash), calibration: head.calibration().map(Calibration::hash) }
}

/// The bytes of `head` for a board that runs `schedule` with `scaling`.
///
/// # Errors
/// If the board does not compute what the head has.
pub(crate) fn compile(head: &Head, schedule: &Schedule, scaling: &AdcScaling) -> Result<Vec<u8>, BoardHeadError> {
    board_head::encode(&head.file, schedule, scaling, hashes(head))
}
