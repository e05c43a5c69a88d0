//! Why a board is followed no longer.

use slitpose_head::board_head::BoardHeadError;
use slitpose_protocol::Rejection;
use thiserror::Error;

use crate::device::DeviceError;
use crate::link::DeviceId;
use crate::pipeline::PipelineError;

/// Why a board is followed no longer.
#[derive(Debug, Error)]
pub(crate) enum BoardError {
    /// The device failed.
    #[error(transparent)]
    Device(#[from] DeviceError),
    /// The board does not suit the scene.
    #[error(transparent)]
    Pipeline(#[from] PipelineError),
    /// The board cannot solve poses of its head.
    #[error("the board cannot solve poses of this head, and this program can: give --stream raw")]
    Head(#[from] BoardHeadError),
    /// The board refused a command.
    #[error("the board refused a command")]
    Refused(#[source] Rejection),
    /// Another thread follows the board already.
    #[error(
        "{name} and {other} have one number, {device}: give only one of them if they are two ports of one board; two \
         boards whose poses shall be told apart need different numbers"
    )]
    Twice {
        /// The board.
        device: DeviceId,
        /// The second reader's name for the board.
        name: String,
        /// The first reader's name for the board.
        other: String,
    },
    /// The system does not start another thread.
    #[error("cannot start a thread; close other programs, or raise the limit of threads")]
    Thread(#[source] std::io::Error),
}

impl BoardError {
    /// Whether the error may pass once the user plugs the board in and switches it on.
    pub(super) fn is_passing(&self) -> bool {
        match self {
            Self::Device(error) => error.is_passing(),
            Self::Pipeline(_) | Self::Head(_) | Self::Refused(_) | Self::Twice { .. } | Self::Thread(_) => false,
        }
    }

    /// Time since the last usable scan when the error was noticed, seconds.
    pub(super) fn missed_s(&self) -> f64 {
        match self {
            Self::Device(
                DeviceError::Quiet { seconds, .. }
                | DeviceError::NoScans { seconds, .. }
                | DeviceError::NotPublished { seconds, .. },
            ) => *seconds,
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
