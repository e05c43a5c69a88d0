//! Why a board is followed no longer.

use slitpose_head::board_head::BoardHeadError;
use slitpose_protocol::Rejection;
use thiserror::Error;

use crate::device::DeviceError;
use slitpose_tracking::link::DeviceId;
use slitpose_tracking::pipeline::PipelineError;

#[derive(Debug, Error)]
pub(crate) enum BoardError {
    #[error(transparent)]
    Device(#[from] DeviceError),
    #[error(transparent)]
    Pipeline(#[from] PipelineError),
    #[error("the board cannot solve poses of this head, and this program can: give --stream raw")]
    Head(#[from] BoardHeadError),
    #[error("the board refused a command")]
    Refused(#[source] Rejection),
    #[error(
        "{name} and {other} have one number, {device}: give only one of them if they are two ports of one board; two \
         boards whose poses shall be told apart need different numbers"
    )]
    Twice {
        device: DeviceId,
        /// The second reader's name for the board.
        name: String,
        /// The first reader's name for the board.
        other: String,
    },
    #[error("cannot start a thread; close other programs, or raise the limit of threads")]
    Thread(#[source] std::io::Error),
}

impl BoardError {
    /// Whether the error may pass once the user plugs the board in and switches it on.
    pub(super) fn is_passing(&self) -> bool {
        matches!(self, Self::Device(error) if error.is_passing())
    }

    /// Time since the last usable scan when the error was noticed, seconds.
    pub(super) fn missed_s(&self) -> f64 {
        match self {
            Self::Device(DeviceError::Quiet { seconds, .. } | DeviceError::NoScans { seconds, .. }) => *seconds,
            _ => 0.0,
        }
    }

    /// Whether the user most likely has to act, so that trying again is not urgent.
    pub(super) fn needs_user(&self) -> bool {
        let is_silent = matches!(self, Self::Device(DeviceError::NoScans { .. }));
        is_silent || !self.is_passing() && !self.is_away()
    }

    /// Whether the board is not there, or its port is in use: another program may probe a port that has just appeared.
    /// Both may end at any moment.
    pub(super) fn is_away(&self) -> bool {
        let Self::Device(error) = self else { return false };
        matches!(error, DeviceError::Missing { .. } | DeviceError::Gone { .. } | DeviceError::Busy { .. })
    }
}
