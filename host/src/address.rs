//! Where servers listen, why they do not, and their sockets in the file system.

use std::fmt;
use std::io::{self, ErrorKind};
use std::net::{Ipv4Addr, SocketAddr};
use std::path::PathBuf;

use thiserror::Error;

/// Where a server listens, and its clients connect.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Address {
    /// A Unix socket at a path, for users with write permission on it.
    Unix(PathBuf),
    /// A TCP port.
    Tcp(SocketAddr),
    /// A UDP port.
    Udp(SocketAddr),
}

/// Prefix that distinguishes a path from a host.
const UNIX: &str = "unix:";

impl Address {
    /// The address that `text` names, if any: a host and a port for TCP, or `unix:` and a path.
    pub(crate) fn of_stream(text: &str) -> Option<Self> {
        match text.strip_prefix(UNIX) {
            Some("") => None,
            Some(path) => Some(Self::Unix(path.into())),
            None => tcp_address(text).map(Self::Tcp),
        }
    }
}

impl fmt::Display for Address {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Unix(path) => write!(f, "{UNIX}{}", path.display()),
            Self::Tcp(address) => address.fmt(f),
            Self::Udp(address) => write!(f, "udp:{address}"),
        }
    }
}

/// The address and port that `text` names, if any.
pub(crate) fn tcp_address(text: &str) -> Option<SocketAddr> {
    // The only name that has the same meaning on every host.
    match text.strip_prefix("localhost:") {
        Some(port) => Some((Ipv4Addr::LOCALHOST, port.parse().ok()?).into()),
        None => text.parse().ok(),
    }
}

/// Why a server does not start.
#[derive(Debug, Error)]
#[allow(missing_docs, reason = "the texts say what each is")]
pub enum ServeError {
    #[error("another program serves {address}; give another address, or end that program")]
    InUse { address: Address },
    #[error("{address} is a Unix socket, and this program has none on this system; give {instead}")]
    NoUnixSockets { address: Address, instead: &'static str },
    #[error("{} is no socket and is left alone; give another path", path.display())]
    NotASocket { path: PathBuf },
    #[error("{address} can be reached from other hosts, and {reason}")]
    NotLoopback { address: Address, reason: &'static str },
    #[error("cannot listen on {address}; check that its folder exists and may be written to, or that the port is free")]
    Listen { address: Address, source: io::Error },
    #[error("cannot start a thread; close other programs, or raise the limit of threads")]
    Thread { source: io::Error },
}

impl ServeError {
    pub(crate) fn of(address: &Address, source: io::Error) -> Self {
        let address = address.clone();
        if source.kind() == ErrorKind::AddrInUse { Self::InUse { address } } else { Self::Listen { address, source } }
    }
}
