//! Builds without the server.

use super::{FoxgloveAddress, FoxgloveError};
use crate::live::{LiveBoard, LiveInput};
use crate::telemetry::DaemonReport;

/// There is none.
pub(crate) enum FoxgloveServer {}

impl FoxgloveServer {
    /// Starts none.
    pub(crate) fn start(
        FoxgloveAddress(_): FoxgloveAddress,
        _: Vec<LiveBoard>,
        _: impl Fn() -> DaemonReport + Send + 'static,
    ) -> Result<Self, FoxgloveError> {
        Err(FoxgloveError::NotBuilt)
    }

    pub(crate) fn url(&self) -> &str {
        match *self {}
    }

    pub(crate) fn input(&self) -> LiveInput {
        match *self {}
    }
}
