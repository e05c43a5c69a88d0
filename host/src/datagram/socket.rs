//! Sockets of both kinds, none of which ever blocks.

use std::fs::{self, Permissions};
use std::io::{self, ErrorKind};
use std::net::{SocketAddr, UdpSocket};
use std::os::fd::{AsFd, BorrowedFd};
use std::os::unix::fs::{FileTypeExt, MetadataExt, PermissionsExt};
use std::os::unix::net::{self, UnixDatagram};
use std::path::{Path, PathBuf};

use super::{Address, AddressError, DatagramError};

/// A bound socket.
#[derive(Debug)]
pub(super) enum Socket {
    Unix(UnixDatagram),
    Udp(UdpSocket),
}

/// Who sent a datagram to a [`Socket`], and can be answered by it.
#[derive(Clone, Debug)]
pub(super) enum Peer {
    Unix(net::SocketAddr),
    Udp(SocketAddr),
}

impl PartialEq for Peer {
    fn eq(&self, other: &Self) -> bool {
        match (self, other) {
            (Self::Unix(a), Self::Unix(b)) => {
                a.as_pathname() == b.as_pathname() && abstract_name(a) == abstract_name(b)
            }
            (Self::Udp(a), Self::Udp(b)) => a == b,
            _ => false,
        }
    }
}

#[cfg(any(target_os = "linux", target_os = "android"))]
fn abstract_name(address: &net::SocketAddr) -> Option<&[u8]> {
    #[cfg(target_os = "android")]
    use std::os::android::net::SocketAddrExt;
    #[cfg(target_os = "linux")]
    use std::os::linux::net::SocketAddrExt;
    address.as_abstract_name()
}

/// Other systems have no names outside the file system.
#[cfg(not(any(target_os = "linux", target_os = "android")))]
fn abstract_name(_: &net::SocketAddr) -> Option<&[u8]> {
    None
}

impl Socket {
    /// Binds `address`; with it comes what removes the socket's file, if it has one.
    pub(super) fn bind(address: &Address) -> Result<(Self, Option<SocketFile>), DatagramError> {
        let error = |source| DatagramError::Bind { address: address.clone(), source };
        match address {
            Address::Unix(path) => {
                let socket = bind_path(path)?;
                socket.set_nonblocking(true).map_err(error)?;
                let file = SocketFile::of(path).map_err(error)?;
                Ok((Self::Unix(socket), Some(file)))
            }
            Address::Udp(address) => {
                AddressError::check(*address)?;
                let socket = UdpSocket::bind(address).map_err(error)?;
                socket.set_nonblocking(true).map_err(error)?;
                Ok((Self::Udp(socket), None))
            }
        }
    }

    /// Where it is bound: a port of 0 has become one that was free.
    pub(super) fn address(&self, asked: &Address) -> Address {
        match self {
            Self::Udp(socket) => socket.local_addr().map_or_else(|_| asked.clone(), Address::Udp),
            Self::Unix(_) => asked.clone(),
        }
    }

    /// The next datagram, if one is there, and who can be answered, if anybody.
    pub(super) fn receive(&self, buffer: &mut [u8]) -> io::Result<(usize, Option<Peer>)> {
        match self {
            Self::Unix(socket) => {
                let (count, peer) = socket.recv_from(buffer)?;
                // Without a name nobody can be answered.
                let is_named = peer.as_pathname().is_some() || abstract_name(&peer).is_some();
                Ok((count, is_named.then_some(Peer::Unix(peer))))
            }
            Self::Udp(socket) => socket.recv_from(buffer).map(|(count, peer)| (count, Some(Peer::Udp(peer)))),
        }
    }

    pub(super) fn send(&self, bytes: &[u8], peer: &Peer) -> Delivery {
        let sent = match (self, peer) {
            (Self::Unix(socket), Peer::Unix(peer)) => socket.send_to_addr(bytes, peer),
            (Self::Udp(socket), Peer::Udp(peer)) => socket.send_to(bytes, peer),
            _ => return Delivery::Gone,
        };
        match sent {
            Ok(_) => Delivery::Sent,
            Err(error) if matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::Interrupted) => Delivery::Full,
            // As some systems call a full queue.
            Err(error) if error.raw_os_error() == Some(nix::errno::Errno::ENOBUFS as i32) => Delivery::Full,
            Err(_) => Delivery::Gone,
        }
    }
}

/// What became of a datagram.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Delivery {
    /// It lies in the receiver's queue.
    Sent,
    /// The queue is full.
    Full,
    /// There is no receiver any more.
    Gone,
}

impl AsFd for Socket {
    fn as_fd(&self) -> BorrowedFd<'_> {
        match self {
            Self::Unix(socket) => socket.as_fd(),
            Self::Udp(socket) => socket.as_fd(),
        }
    }
}

/// Whoever is of the daemon's group may ask; it needs the right to write for that.
const SOCKET_MODE: u32 = 0o660;

/// Binds a path, for the daemon's user and group.
fn bind_path(path: &Path) -> Result<UnixDatagram, DatagramError> {
    let socket = claim_path(path)?;
    fs::set_permissions(path, Permissions::from_mode(SOCKET_MODE))
        .map_err(|source| DatagramError::Bind { address: Address::Unix(path.to_owned()), source })?;
    Ok(socket)
}

/// Binds a path, in place of a socket that a daemon has left behind when it was killed.
fn claim_path(path: &Path) -> Result<UnixDatagram, DatagramError> {
    let error = |source| DatagramError::Bind { address: Address::Unix(path.to_owned()), source };
    match UnixDatagram::bind(path) {
        Err(source) if source.kind() == ErrorKind::AddrInUse => {}
        bound => return bound.map_err(error),
    }
    if !fs::symlink_metadata(path).map_err(error)?.file_type().is_socket() {
        return Err(DatagramError::NotASocket { path: path.to_owned() });
    }
    match UnixDatagram::unbound().and_then(|probe| probe.connect(path)) {
        Err(source) if source.kind() == ErrorKind::ConnectionRefused => {}
        _ => return Err(DatagramError::InUse { path: path.to_owned() }),
    }
    fs::remove_file(path).map_err(error)?;
    UnixDatagram::bind(path).map_err(error)
}

/// The file of a bound Unix socket; removed when dropped, unless another one has taken its place.
#[derive(Debug)]
pub(super) struct SocketFile {
    path: PathBuf,
    identity: (u64, u64),
}

impl SocketFile {
    fn of(path: &Path) -> io::Result<Self> {
        Ok(Self { path: path.to_owned(), identity: identity(path)? })
    }
}

/// Which file lies at a path.
fn identity(path: &Path) -> io::Result<(u64, u64)> {
    fs::symlink_metadata(path).map(|metadata| (metadata.dev(), metadata.ino()))
}

impl Drop for SocketFile {
    fn drop(&mut self) {
        if identity(&self.path).is_ok_and(|found| found == self.identity) {
            // What cannot be removed is found stale by the next daemon.
            let _ = fs::remove_file(&self.path);
        }
    }
}
