//! Where servers listen, why they do not, and their sockets in the file system.

use std::fmt;
use std::io::{self, ErrorKind};
use std::net::{Ipv4Addr, SocketAddr};
use std::path::{Path, PathBuf};

use anyhow::{Error, Result, anyhow, ensure};

/// Where a server listens, and its clients connect.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Address {
    /// A Unix socket at a path, for users with write permission on it.
    Unix(PathBuf),
    /// A TCP port.
    Tcp(SocketAddr),
    /// A UDP port.
    Udp(SocketAddr),
    /// A file of shared memory, for users with read permission on it. Only poses have one.
    Memory(PathBuf),
}

/// Prefix that distinguishes a path from a host.
const UNIX: &str = "unix:";

/// Prefix of shared memory, and the folder of memory that is named without one.
const MEMORY: &str = "shm:";
const MEMORY_FOLDER: &str = "/dev/shm";

impl Address {
    /// The address that `text` names, if any: a host and a port for TCP, or `unix:` and a path.
    pub(crate) fn of_stream(text: &str) -> Option<Self> {
        match text.strip_prefix(UNIX) {
            Some("") => None,
            Some(path) => Some(Self::Unix(path.into())),
            None => tcp_address(text).map(Self::Tcp),
        }
    }

    /// The memory called `name`: a path, if it has a slash.
    pub(crate) fn of_memory(name: &str) -> Self {
        Self::Memory(if name.contains('/') { name.into() } else { Path::new(MEMORY_FOLDER).join(name) })
    }
}

impl fmt::Display for Address {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Unix(path) => write!(f, "{UNIX}{}", path.display()),
            Self::Tcp(address) => address.fmt(f),
            Self::Udp(address) => write!(f, "udp:{address}"),
            Self::Memory(path) => {
                let is_plain = path.parent() == Some(Path::new(MEMORY_FOLDER));
                let name = path.file_name().filter(|_| is_plain).map_or(path.as_path(), Path::new);
                write!(f, "{MEMORY}{}", name.display())
            }
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

/// Why a server does not listen at `address`.
pub(crate) fn cannot_listen(address: &Address, source: io::Error) -> Error {
    if source.kind() == ErrorKind::AddrInUse {
        return in_use(address);
    }
    Error::new(source).context(format!(
        "cannot listen on {address}; check that its folder exists and may be written to, or that the port is free"
    ))
}

pub(crate) fn in_use(address: &Address) -> Error {
    anyhow!("another program serves {address}; give another address, or end that program")
}

/// Refuses an address that other hosts can reach, for `reason`.
pub(crate) fn require_loopback(address: &Address, reason: &str) -> Result<()> {
    if let Address::Tcp(at) | Address::Udp(at) = address {
        ensure!(at.ip().is_loopback(), "{address} can be reached from other hosts, and {reason}");
    }
    Ok(())
}
