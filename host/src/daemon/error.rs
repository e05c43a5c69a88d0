//! Why a board is followed no longer.

use slitpose_protocol::Rejection;
use thiserror::Error;

use crate::device::DeviceError;
use crate::pipeline::PipelineError;

/// Why a board is followed no longer.
#[derive(Debug, Error)]
pub enum BoardError {
    /// The device.
    #[error(transparent)]
    Device(#[from] DeviceError),
    /// It does not suit the scene.
    #[error(transparent)]
    Pipeline(#[from] PipelineError),
    /// It does not do what it is asked.
    #[error("the board refused a command")]
    Refused(#[source] Rejection),
    /// The system gives no more threads.
    #[error("cannot start a thread; close other programs, or raise the limit of threads")]
    Thread(#[source] std::io::Error),
}

impl BoardError {
    /// Whether waiting may mend it, without anybody doing anything but plug and switch on.
    pub(super) fn is_passing(&self) -> bool {
        match self {
            Self::Device(error) => error.is_passing(),
            Self::Pipeline(_) | Self::Refused(_) | Self::Thread(_) => false,
        }
    }

    /// Whether the board is simply not there.
    pub(super) fn is_absence(&self) -> bool {
        matches!(self, Self::Device(DeviceError::Missing { .. } | DeviceError::Gone { .. }))
    }
}

/// An error with all its causes.
pub(super) fn with_causes(error: &dyn std::error::Error) -> String {
    let mut text = error.to_string();
    let mut cause = error.source();
    while let Some(source) = cause {
        let source_text = source.to_string();
        // Transparent errors tell their cause already.
        if !text.ends_with(&source_text) {
            text = format!("{text}: {source_text}");
        }
        cause = source.source();
    }
    text
}
