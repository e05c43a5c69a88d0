//! Poses for other programs by their own protocols: Foxglove, ROS 2 by Zenoh, and 6-DoF mice. The first two are in builds
//! with the features `foxglove` and `zenoh` only; without, the options that ask for them say which build has them.

#[cfg(feature = "foxglove")]
mod foxglove;
mod spacenav;
#[cfg(feature = "zenoh")]
mod zenoh;

use std::net::SocketAddr;

use anyhow::Result;

#[cfg(feature = "foxglove")]
pub(crate) use foxglove::serve_foxglove;
pub(crate) use spacenav::{Axes, Feel, SpacenavInput, SpacenavServer};
#[cfg(feature = "zenoh")]
pub(crate) use zenoh::publish_by_zenoh;

use crate::address::{Address, ServeError, tcp_address};
#[cfg(not(all(feature = "foxglove", feature = "zenoh")))]
use crate::live::LiveBoard;
use slitpose_tracking::telemetry::DaemonReport;

pub(crate) const DEFAULT_FOXGLOVE_ADDRESS: &str = "127.0.0.1:8765";

/// The port of this host that `text` names: the protocol has no secret by which others could be refused.
pub(crate) fn foxglove_address(text: &str) -> Result<SocketAddr, String> {
    let hint = || format!("`{text}` is no address; give one such as {DEFAULT_FOXGLOVE_ADDRESS} or [::1]:8765");
    let address = tcp_address(text).ok_or_else(hint)?;
    let reason = "Foxglove's protocol knows no secret: give an address such as 127.0.0.1:8765, and reach it by \
                  `ssh -L 8765:127.0.0.1:8765 HOST`";
    let refused = || ServeError::NotLoopback { address: Address::Tcp(address), reason }.to_string();
    address.ip().is_loopback().then_some(address).ok_or_else(refused)
}

/// A build without the server starts none.
#[cfg(not(feature = "foxglove"))]
pub(crate) fn serve_foxglove(
    _: SocketAddr,
    _: Vec<LiveBoard>,
    _: impl Fn() -> DaemonReport + Send + 'static,
) -> Result<(String, crate::live::LiveInput, crate::http::Serving)> {
    anyhow::bail!(
        "this build has no server for Foxglove; build with `cargo build --release -p slitpose --features foxglove`, or record \
         a capture, which Foxglove opens"
    )
}

/// Where the router of ROS 2 listens.
pub(crate) const DEFAULT_ROUTER: &str = "tcp/localhost:7447";

/// A build without Zenoh publishes nothing.
#[cfg(not(feature = "zenoh"))]
pub(crate) fn publish_by_zenoh(
    _: &str,
    _: Vec<LiveBoard>,
    _: f64,
    _: impl Fn() -> DaemonReport + Send + 'static,
) -> Result<crate::daemon::StreamPlan> {
    anyhow::bail!("this build has no Zenoh; build with `cargo build --release -p slitpose --features zenoh`")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn foxglove_is_served_to_this_host_only() {
        for text in [DEFAULT_FOXGLOVE_ADDRESS, "[::1]:8765", "localhost:0", "127.8.9.1:80"] {
            assert!(foxglove_address(text).is_ok(), "{text}");
        }
        for text in ["0.0.0.0:8765", "[::]:8765", "192.0.2.1:80"] {
            let refused = foxglove_address(text).unwrap_err();
            assert!(refused.contains("from other hosts") && refused.contains("ssh -L"), "{text}: {refused}");
        }
        for text in ["", "8765", "example.org:80"] {
            assert!(foxglove_address(text).unwrap_err().contains("is no address"), "{text}");
        }
    }
}
