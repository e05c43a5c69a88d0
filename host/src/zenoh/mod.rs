//! Boards over Zenoh: poses and more for ROS 2, as rmw_zenoh sees it, and all bytes for daemons on other machines. In builds
//! with the feature `zenoh` only.

#[cfg(feature = "zenoh")]
mod far_board;
#[cfg(feature = "zenoh")]
mod publisher;
#[cfg(feature = "zenoh")]
mod session;

#[cfg(not(feature = "zenoh"))]
use std::sync::Arc;
use thiserror::Error;

#[cfg(feature = "zenoh")]
pub(crate) use session::ZenohSession;

#[cfg(not(feature = "zenoh"))]
use crate::daemon::{Opener, StreamPlan, Talk};
#[cfg(not(feature = "zenoh"))]
use crate::live::LiveBoard;
#[cfg(not(feature = "zenoh"))]
use crate::telemetry::DaemonReport;

/// Where the router of ROS 2 listens.
pub(crate) const DEFAULT_ROUTER: &str = "tcp/localhost:7447";

/// Why there is no session, or no board in it.
#[derive(Debug, Error)]
pub(crate) enum ZenohError {
    #[cfg(not(feature = "zenoh"))]
    #[error("this build has no Zenoh; build with `cargo build --release -p slitpose --features zenoh`")]
    NotBuilt,
    /// The number of the ROS 2 graph.
    #[cfg(feature = "zenoh")]
    #[error("ROS_DOMAIN_ID is `{text}`; give a number from 0 to 232")]
    Domain { text: String },
    /// A name that no board can have.
    #[cfg(feature = "zenoh")]
    #[error("`zenoh:{key}` names no board; give zenoh:slitpose/board_SERIAL, with the serial number of the board")]
    Key { key: String },
    #[cfg(feature = "zenoh")]
    #[error(
        "Zenoh refuses {what} ({reason}); give an endpoint such as {DEFAULT_ROUTER}, or a file of Zenoh's own settings"
    )]
    Settings { what: String, reason: String },
    /// The session does not begin.
    #[cfg(feature = "zenoh")]
    #[error("no router of Zenoh by {what} ({reason}); start one, or give its endpoint with --zenoh-router")]
    Open { what: String, reason: String },
}

/// Builds without it have none.
#[cfg(not(feature = "zenoh"))]
pub(crate) enum ZenohSession {}

#[cfg(not(feature = "zenoh"))]
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

    pub(crate) fn opener(&self, _: &str) -> Result<Box<dyn Opener>, ZenohError> {
        match *self {}
    }
}
