//! Foxglove shows boards live, by its own protocol. The server is in builds with the feature `foxglove` only.

#[cfg(feature = "foxglove")]
mod server;

#[cfg(feature = "foxglove")]
use std::io;
use std::net::SocketAddr;
use std::str::FromStr;

use thiserror::Error;

#[cfg(feature = "foxglove")]
pub(crate) use server::FoxgloveServer;

use super::control::LiveAddress;
#[cfg(not(feature = "foxglove"))]
use super::{LiveBoard, LiveInput};
#[cfg(not(feature = "foxglove"))]
use crate::telemetry::DaemonReport;

pub(crate) const DEFAULT_FOXGLOVE_ADDRESS: &str = "127.0.0.1:8765";

/// A port of this host: the protocol has no secret by which others could be refused.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct FoxgloveAddress(pub(super) SocketAddr);

#[derive(Debug, Error)]
pub(crate) enum FoxgloveError {
    #[error("`{text}` is no address; give one such as {DEFAULT_FOXGLOVE_ADDRESS} or [::1]:8765")]
    Address { text: String },
    #[error(
        "{address} can be reached from other hosts, and Foxglove's protocol knows no secret: give an address such as \
         {DEFAULT_FOXGLOVE_ADDRESS}, and reach it by `ssh -L 8765:127.0.0.1:8765 HOST`"
    )]
    NotLoopback { address: SocketAddr },
    #[cfg(not(feature = "foxglove"))]
    #[error(
        "this build has no server for Foxglove; build with `cargo build --release -p slitpose --features foxglove`, \
         or record a capture, which Foxglove opens"
    )]
    NotBuilt,
    #[cfg(feature = "foxglove")]
    #[error("cannot serve Foxglove at {address}; give another address with --foxglove")]
    Listen { address: SocketAddr, source: io::Error },
    /// The server does not start.
    #[cfg(feature = "foxglove")]
    #[error("cannot serve Foxglove at {address}")]
    Start { address: SocketAddr, source: Box<::foxglove::FoxgloveError> },
}

impl FromStr for FoxgloveAddress {
    type Err = FoxgloveError;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        let LiveAddress(address) = text.parse().map_err(|_| FoxgloveError::Address { text: text.to_owned() })?;
        if address.ip().is_loopback() { Ok(Self(address)) } else { Err(FoxgloveError::NotLoopback { address }) }
    }
}

/// Builds without it have none.
#[cfg(not(feature = "foxglove"))]
pub(crate) enum FoxgloveServer {}

#[cfg(not(feature = "foxglove"))]
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_this_host_is_served() {
        for text in [DEFAULT_FOXGLOVE_ADDRESS, "[::1]:8765", "localhost:0", "127.8.9.1:80"] {
            assert!(text.parse::<FoxgloveAddress>().is_ok(), "{text}");
        }
        for text in ["0.0.0.0:8765", "[::]:8765", "192.0.2.1:80"] {
            let found = text.parse::<FoxgloveAddress>();
            assert!(matches!(found, Err(FoxgloveError::NotLoopback { .. })), "{text}: {found:?}");
        }
        for text in ["", "8765", "example.org:80"] {
            assert!(matches!(text.parse::<FoxgloveAddress>(), Err(FoxgloveError::Address { .. })), "{text}");
        }
    }
}
