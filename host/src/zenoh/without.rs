//! Builds without Zenoh.

use std::sync::Arc;

use super::ZenohError;
use crate::daemon::{Opener, StreamPlan, Talk};
use crate::live::LiveBoard;
use crate::telemetry::DaemonReport;

/// There is none.
pub(crate) enum ZenohSession {}

impl ZenohSession {
    /// Opens none.
    pub(crate) fn open(_: &str) -> Result<Self, ZenohError> {
        Err(ZenohError::NotBuilt)
    }

    pub(crate) fn publisher(
        &self,
        _: Vec<LiveBoard>,
        _: f64,
        _: impl Fn() -> DaemonReport + Send + 'static,
        _: Arc<Talk>,
    ) -> StreamPlan {
        match *self {}
    }

    /// What would open a board.
    pub(crate) fn opener(&self, _: &str) -> Result<Box<dyn Opener>, ZenohError> {
        match *self {}
    }
}
