//! What the HTTP servers of the daemon share: limits of connections, and whose requests are answered.

mod connection;
mod origin;

use std::io;
use std::net::{Ipv4Addr, SocketAddr, TcpListener};

pub(crate) use connection::{Door, Leash, Socket};
#[cfg(test)]
pub(crate) use connection::{LIFETIME, MOST};
pub(crate) use origin::is_own;

/// The hosts that may connect over TCP.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Reach {
    /// Programs of this host.
    Loopback,
    /// Every host that can reach the address, as permitted by the user.
    Anywhere,
}

/// The address and port that `text` names, if any.
pub(crate) fn tcp_address(text: &str) -> Option<SocketAddr> {
    // The only name that has the same meaning on every host.
    match text.strip_prefix("localhost:") {
        Some(port) => Some((Ipv4Addr::LOCALHOST, port.parse().ok()?).into()),
        None => text.parse().ok(),
    }
}

/// Listens on `address`; returns the address with the port that the system chose for port 0. To be called within the
/// runtime that serves the socket.
///
/// # Errors
/// Those of the system.
pub(crate) fn listen(address: SocketAddr) -> io::Result<(Socket, SocketAddr)> {
    let listener = TcpListener::bind(address)?;
    let bound = listener.local_addr()?;
    listener.set_nonblocking(true)?;
    Ok((Socket::Tcp(tokio::net::TcpListener::from_std(listener)?), bound))
}
