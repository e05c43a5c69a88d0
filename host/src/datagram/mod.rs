//! The newest pose, as a datagram, for control loops.
//!
//! A client sends a [`Request`] to one of the daemon's sockets, on a Unix socket or on UDP, for the newest
//! datagram of each board once, or for all datagrams of some seconds. All datagrams have one size:
//! [`PoseDatagram`] has their layout, and `include/slitpose_pose.h` defines it in C, with functions to
//! receive them.
//!
//! A datagram is sent by the thread that solved it, with no queue between solver and socket. The permissions
//! of a Unix socket decide which users may connect. On UDP every user of the host may, and can forge its
//! address: there a client is served once it has echoed a cookie. Places of followers are few; users share
//! them evenly, and a client without a place is notified.
//!
//! Each client has a queue of its own. On a Unix socket a datagram waits in the send buffer of the socket that sent it:
//! from one socket for all, a client that does not read would fill that buffer for the others (unix(7); in Linux,
//! `unix_dgram_sendmsg` charges the sender until the receiver has read). So a client makes a socket pair and passes one
//! end with each request, and the daemon sends from that end. On UDP a datagram waits in the receiver's buffer.
//!
//! The sending thread never waits: sockets do not block, requests come through a bounded queue, and the
//! newest datagram is stored for answers in a slot whose writer waits for no reader. The datagrams that a client misses
//! are counted and reported to it; one that misses some for over a second is a finding.

mod layout;
mod server;
mod slot;
mod socket;
mod subscription;

use std::net::SocketAddr;
use std::sync::atomic;

use crate::http::ServeError;

pub use crate::http::Address;
pub use layout::{Answer, Mode, PoseDatagram, Request};
pub use server::{DatagramCounts, DatagramServer, Publisher};
pub use socket::UnixClient;
pub use subscription::SlowClient;

/// Attempts to copy the newest datagram undisturbed. A copy takes a ten-thousandth of the time between two scans.
const ATTEMPTS: usize = 100;

/// The address at which clients request datagrams that `text` names.
pub(crate) fn address(text: &str) -> Result<Address, String> {
    match text.split_once(':') {
        Some(("unix", "")) => Err("`unix:` lacks the path of the socket; give unix:PATH".to_owned()),
        Some(("unix", path)) => Ok(Address::Unix(path.into())),
        Some(("udp", udp)) => {
            let error = |error| format!("`{udp}` is no address and port ({error}); give udp:127.0.0.1:PORT");
            let udp = udp.parse().map_err(error)?;
            require_loopback(udp).map(|()| Address::Udp(udp)).map_err(|error| error.to_string())
        }
        _ => Err(format!("`{text}` is no address for poses; give unix:PATH or udp:127.0.0.1:PORT")),
    }
}

/// Refuses addresses that other hosts can reach.
fn require_loopback(address: SocketAddr) -> Result<(), ServeError> {
    let reason = "poses carry no proof of their origin; give udp:127.0.0.1:PORT";
    let refused = || ServeError::NotLoopback { address: Address::Udp(address), reason };
    address.ip().is_loopback().then_some(()).ok_or_else(refused)
}

#[cfg(test)]
mod tests;
