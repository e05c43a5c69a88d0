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
//! end with each request, and the daemon sends from that end. Clients that pass none are answered by their names, from
//! the daemon's socket: they share its buffer among themselves, and with nobody else. On UDP a datagram waits in the
//! receiver's buffer.
//!
//! The sending thread never waits: sockets do not block, requests come through a bounded queue, and the
//! newest datagram is stored for answers in a slot whose writer waits for no reader. The datagrams that a client misses
//! are counted and reported to it; one that misses some for over a second is a finding.

mod layout;
mod publisher;
mod server;
mod slot;
mod socket;
mod subscription;

use std::net::{AddrParseError, SocketAddr};
use std::path::PathBuf;
use std::str::FromStr;
use std::sync::atomic;
use std::{fmt, io};

use thiserror::Error;

pub use layout::{Answer, Mode, PoseDatagram, Request};
pub use publisher::Publisher;
pub use server::{DatagramCounts, DatagramServer};
pub use subscription::SlowClient;

/// Attempts to copy the newest datagram undisturbed. A copy takes a ten-thousandth of the time between two scans.
const ATTEMPTS: usize = 100;

/// An address at which clients request datagrams.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Address {
    /// A Unix socket at a path, for users with write permission on it.
    Unix(PathBuf),
    /// A UDP port of this host, for all users of the host.
    Udp(SocketAddr),
}

/// A text that is not a permitted [`Address`].
#[derive(Clone, Debug, PartialEq, Eq, Error)]
#[allow(missing_docs, reason = "the texts say what each is")]
pub enum AddressError {
    #[error("`{text}` is no address for poses; give unix:PATH or udp:127.0.0.1:PORT")]
    Kind { text: String },
    #[error("`unix:` lacks the path of the socket; give unix:PATH")]
    NoPath,
    #[error("`{text}` is no address and port; give udp:127.0.0.1:PORT")]
    Udp { text: String, source: AddrParseError },
    #[error(
        "{address} can be reached from other hosts, and poses carry no proof of their origin; give udp:127.0.0.1:PORT"
    )]
    NotLoopback { address: SocketAddr },
}

impl AddressError {
    /// Refuses addresses that other hosts can reach.
    fn check(address: SocketAddr) -> Result<(), Self> {
        if address.ip().is_loopback() { Ok(()) } else { Err(Self::NotLoopback { address }) }
    }
}

impl FromStr for Address {
    type Err = AddressError;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        match text.split_once(':') {
            Some(("unix", "")) => Err(AddressError::NoPath),
            Some(("unix", path)) => Ok(Self::Unix(path.into())),
            Some(("udp", address)) => {
                let error = |source| AddressError::Udp { text: address.to_owned(), source };
                let address: SocketAddr = address.parse().map_err(error)?;
                AddressError::check(address)?;
                Ok(Self::Udp(address))
            }
            _ => Err(AddressError::Kind { text: text.to_owned() }),
        }
    }
}

impl fmt::Display for Address {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Unix(path) => write!(f, "unix:{}", path.display()),
            Self::Udp(address) => write!(f, "udp:{address}"),
        }
    }
}

#[derive(Debug, Error)]
#[allow(missing_docs, reason = "the texts say what each is")]
pub enum DatagramError {
    #[error("{} is in use by another program that runs; give another path, or stop that program", path.display())]
    InUse { path: PathBuf },
    #[error("{} exists and is no socket; give another path", path.display())]
    NotASocket { path: PathBuf },
    #[error("cannot listen on {address}; check that its folder exists and may be written to, or that the port is free")]
    Bind { address: Address, source: io::Error },
    #[error(transparent)]
    Address(#[from] AddressError),
    #[error("cannot start a thread for requests")]
    Thread(#[source] io::Error),
}

#[cfg(test)]
mod tests;
