//! Non-blocking sockets of both kinds.

use std::fs::{self, File, Permissions};
#[cfg(target_os = "linux")]
use std::io::IoSliceMut;
use std::io::{self, ErrorKind};
use std::net::{SocketAddr, UdpSocket};
#[cfg(target_os = "linux")]
use std::os::fd::AsRawFd;
use std::os::fd::{AsFd, BorrowedFd};
#[cfg(target_os = "linux")]
use std::os::unix::fs::OpenOptionsExt;
use std::os::unix::fs::{FileTypeExt, MetadataExt, PermissionsExt};
use std::os::unix::net::{self, UnixDatagram};
use std::path::{Path, PathBuf};
use std::sync::Arc;

#[cfg(target_os = "linux")]
use nix::fcntl::OFlag;
#[cfg(target_os = "linux")]
use nix::sys::socket::{setsockopt, sockopt::PassCred};

use super::{Address, AddressError, DatagramError};

/// A bound socket.
#[derive(Debug)]
pub(super) enum Socket {
    Unix(UnixDatagram),
    Udp(UdpSocket),
}

/// The sender of a datagram to a [`Socket`], to which the socket can answer.
#[derive(Clone, Debug)]
pub(super) enum Peer {
    Unix(Arc<UnixPeer>),
    Udp(SocketAddr),
}

/// A client on a Unix socket.
#[derive(Debug)]
pub(super) struct UnixPeer {
    /// The name chosen by the client.
    name: net::SocketAddr,
    /// The address to send to.
    address: net::SocketAddr,
    /// The file of its socket, if its name is one.
    file: Option<PinnedSocket>,
    user: Option<u32>,
}

/// A party in the sharing of places.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Party {
    /// A user of this host; `None` if the system does not name the user.
    User(Option<u32>),
    /// Any client by UDP, where users are unknown.
    Udp,
}

impl Peer {
    pub(super) fn party(&self) -> Party {
        match self {
            Self::Unix(peer) => Party::User(peer.user),
            Self::Udp(_) => Party::Udp,
        }
    }
}

impl PartialEq for Peer {
    fn eq(&self, other: &Self) -> bool {
        match (self, other) {
            (Self::Unix(a), Self::Unix(b)) => {
                a.name.as_pathname() == b.name.as_pathname()
                    && abstract_name(&a.name) == abstract_name(&b.name)
                    && a.file.as_ref().map(|file| file.identity) == b.file.as_ref().map(|file| file.identity)
            }
            (Self::Udp(a), Self::Udp(b)) => a == b,
            _ => false,
        }
    }
}

impl UnixPeer {
    /// The client called `name` of `user`; `None` if it cannot be answered: it has no name, or the name does not lead
    /// to its own socket.
    fn new(name: net::SocketAddr, user: Option<u32>) -> Option<Self> {
        let (address, file) = match name.as_pathname() {
            Some(path) => pinned(path, user).ok()?,
            None => abstract_name(&name).map(|_| (name.clone(), None))?,
        };
        Some(Self { name, address, file, user })
    }
}

/// The file of a client's socket, held open: datagrams go to this file even if its owner replaces it by a link to
/// another user's socket.
#[derive(Debug)]
struct PinnedSocket {
    _file: File,
    identity: (u64, u64),
}

/// The socket at `path`, if it is one and belongs to `user` (root may use any socket), and a name that leads to this
/// socket only.
#[cfg(target_os = "linux")]
fn pinned(path: &Path, user: Option<u32>) -> io::Result<(net::SocketAddr, Option<PinnedSocket>)> {
    let flags = OFlag::O_PATH | OFlag::O_NOFOLLOW;
    let file = File::options().read(true).custom_flags(flags.bits()).open(path)?;
    let found = file.metadata()?;
    let is_own = user.is_none_or(|user| user == 0 || user == found.uid());
    if !found.file_type().is_socket() || !is_own {
        return Err(ErrorKind::PermissionDenied.into());
    }
    let address = net::SocketAddr::from_pathname(format!("/proc/self/fd/{}", file.as_raw_fd()))?;
    Ok((address, Some(PinnedSocket { _file: file, identity: (found.dev(), found.ino()) })))
}

/// On other systems a socket cannot be held open: its name is trusted.
#[cfg(not(target_os = "linux"))]
fn pinned(path: &Path, _: Option<u32>) -> io::Result<(net::SocketAddr, Option<PinnedSocket>)> {
    Ok((net::SocketAddr::from_pathname(path)?, None))
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

/// The next datagram of a Unix socket: its length, its sender's name, and the user of the sender's process.
#[cfg(target_os = "linux")]
fn receive_with_user(
    socket: &UnixDatagram,
    buffer: &mut [u8],
) -> io::Result<(usize, Option<net::SocketAddr>, Option<u32>)> {
    use std::os::linux::net::SocketAddrExt;

    use nix::sys::socket::{ControlMessageOwned, MsgFlags, SockaddrLike, UnixAddr, UnixCredentials, recvmsg};

    let mut control = nix::cmsg_space!(UnixCredentials);
    let mut parts = [IoSliceMut::new(buffer)];
    let message = recvmsg::<UnixAddr>(socket.as_raw_fd(), &mut parts, Some(&mut control), MsgFlags::MSG_DONTWAIT)?;
    let user = message.cmsgs()?.find_map(|control| match control {
        ControlMessageOwned::ScmCredentials(credentials) => Some(credentials.uid()),
        _ => None,
    });
    // A sender without a name has no address at all, not even an empty one.
    let address = message.address.filter(|address| address.len() as usize > size_of::<nix::libc::sa_family_t>());
    let name = address.and_then(|address| match (address.path(), address.as_abstract()) {
        (Some(path), _) => net::SocketAddr::from_pathname(path).ok(),
        (_, Some(name)) => net::SocketAddr::from_abstract_name(name).ok(),
        _ => None,
    });
    // A datagram that was longer than the buffer fills it, as with `recv`.
    Ok((message.bytes, name, user))
}

#[cfg(not(target_os = "linux"))]
fn receive_with_user(
    socket: &UnixDatagram,
    buffer: &mut [u8],
) -> io::Result<(usize, Option<net::SocketAddr>, Option<u32>)> {
    socket.recv_from(buffer).map(|(count, name)| (count, Some(name), None))
}

impl Socket {
    /// Binds `address`; also returns the guard that removes the socket's file, if it has one.
    pub(super) fn bind(address: &Address) -> Result<(Self, Option<SocketFile>), DatagramError> {
        let error = |source| DatagramError::Bind { address: address.clone(), source };
        match address {
            Address::Unix(path) => {
                let socket = bind_path(path)?;
                socket.set_nonblocking(true).map_err(error)?;
                #[cfg(target_os = "linux")]
                setsockopt(&socket, PassCred, &true).map_err(|errno| error(errno.into()))?;
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

    /// The bound address, with the port that the system chose for port 0.
    pub(super) fn address(&self, asked: &Address) -> Address {
        match self {
            Self::Udp(socket) => socket.local_addr().map_or_else(|_| asked.clone(), Address::Udp),
            Self::Unix(_) => asked.clone(),
        }
    }

    /// The next datagram, if there is one, and its sender, if it can be answered.
    pub(super) fn receive(&self, buffer: &mut [u8]) -> io::Result<(usize, Option<Peer>)> {
        match self {
            Self::Unix(socket) => {
                let (count, name, user) = receive_with_user(socket, buffer)?;
                Ok((count, name.and_then(|name| UnixPeer::new(name, user)).map(|peer| Peer::Unix(Arc::new(peer)))))
            }
            Self::Udp(socket) => socket.recv_from(buffer).map(|(count, peer)| (count, Some(Peer::Udp(peer)))),
        }
    }

    pub(super) fn send(&self, bytes: &[u8], peer: &Peer) -> Delivery {
        let sent = match (self, peer) {
            (Self::Unix(socket), Peer::Unix(peer)) => socket.send_to_addr(bytes, &peer.address),
            (Self::Udp(socket), Peer::Udp(peer)) => socket.send_to(bytes, peer),
            _ => return Delivery::Gone,
        };
        match sent {
            Ok(_) => Delivery::Sent,
            Err(error) if matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::Interrupted) => Delivery::Full,
            // The error of some systems for a full queue.
            Err(error) if error.raw_os_error() == Some(nix::errno::Errno::ENOBUFS as i32) => Delivery::Full,
            Err(_) => Delivery::Gone,
        }
    }
}

/// The result of sending a datagram.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Delivery {
    /// It is in the receiver's queue.
    Sent,
    /// The queue is full.
    Full,
    /// The receiver is gone.
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

/// Users of the daemon's group may connect, which requires write permission.
const SOCKET_MODE: u32 = 0o660;

/// Binds a path, for the daemon's user and group.
fn bind_path(path: &Path) -> Result<UnixDatagram, DatagramError> {
    let socket = claim_path(path)?;
    fs::set_permissions(path, Permissions::from_mode(SOCKET_MODE))
        .map_err(|source| DatagramError::Bind { address: Address::Unix(path.to_owned()), source })?;
    Ok(socket)
}

/// Binds a path, replacing a socket left behind by a killed daemon.
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

/// Identity of the file at a path.
fn identity(path: &Path) -> io::Result<(u64, u64)> {
    fs::symlink_metadata(path).map(|metadata| (metadata.dev(), metadata.ino()))
}

impl Drop for SocketFile {
    fn drop(&mut self) {
        if identity(&self.path).is_ok_and(|found| found == self.identity) {
            // If the file cannot be removed, the next daemon finds it stale.
            let _ = fs::remove_file(&self.path);
        }
    }
}
