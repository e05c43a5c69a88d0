//! Where servers listen, why they do not, and their sockets in the file system.

use std::fmt;
use std::fs::{self, Permissions};
use std::io::{self, ErrorKind};
use std::net::{Ipv4Addr, SocketAddr};
use std::os::unix::fs::{FileTypeExt, MetadataExt, PermissionsExt};
use std::path::{Path, PathBuf};

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

/// A bound socket; its file is removed when this is dropped, unless it has been replaced.
#[derive(Debug)]
pub(crate) struct SocketFile {
    path: PathBuf,
    file: [u64; 2],
}

impl SocketFile {
    /// Binds a socket at `path` by `bind`, for the user and the group of this program; one that a killed program has left
    /// behind is replaced. `connect` finds out whether anybody serves it.
    pub(crate) fn bind<T>(
        path: &Path,
        connect: impl FnOnce(&Path) -> io::Result<()>,
        bind: impl FnOnce(&Path) -> io::Result<T>,
    ) -> Result<(T, Self), ServeError> {
        let address = || Address::Unix(path.to_owned());
        let failed = |source| ServeError::of(&address(), source);
        match fs::symlink_metadata(path) {
            Err(error) if error.kind() == ErrorKind::NotFound => {}
            Err(source) => return Err(failed(source)),
            Ok(found) if !found.file_type().is_socket() => {
                return Err(ServeError::NotASocket { path: path.to_owned() });
            }
            Ok(_) => match connect(path) {
                Err(error) if error.kind() == ErrorKind::ConnectionRefused => fs::remove_file(path).map_err(failed)?,
                // A socket of another kind is in use, too.
                _ => return Err(ServeError::InUse { address: address() }),
            },
        }
        let socket = bind(path).map_err(failed)?;
        fs::set_permissions(path, Permissions::from_mode(SOCKET_MODE)).map_err(failed)?;
        let file = identity(path).map_err(failed)?;
        Ok((socket, Self { path: path.to_owned(), file }))
    }
}

impl Drop for SocketFile {
    fn drop(&mut self) {
        if identity(&self.path).is_ok_and(|found| found == self.file) {
            let _ = fs::remove_file(&self.path);
        }
    }
}

/// Mode of Unix sockets: owner and group may connect, other users may not.
const SOCKET_MODE: u32 = 0o660;

pub(crate) fn connects_stream(path: &Path) -> io::Result<()> {
    std::os::unix::net::UnixStream::connect(path).map(drop)
}

fn identity(path: &Path) -> io::Result<[u64; 2]> {
    fs::symlink_metadata(path).map(|found| [found.dev(), found.ino()])
}
