//! Non-blocking sockets of both kinds.

use std::fs::File;
use std::io::{self, ErrorKind};
use std::net::{SocketAddr, UdpSocket};
#[cfg(target_os = "linux")]
use std::os::fd::OwnedFd;
use std::os::fd::{AsFd, AsRawFd, BorrowedFd};
#[cfg(target_os = "linux")]
use std::os::unix::fs::OpenOptionsExt;
use std::os::unix::fs::{FileTypeExt, MetadataExt};
use std::os::unix::net::{self, UnixDatagram};
use std::path::Path;
use std::sync::Arc;

#[cfg(target_os = "linux")]
use nix::fcntl::OFlag;
use nix::sys::socket::{MsgFlags, send};
#[cfg(target_os = "linux")]
use nix::sys::socket::{setsockopt, sockopt::PassCred};

use super::{Address, require_loopback};
use crate::http::{ServeError, SocketFile};

#[derive(Debug)]
pub(super) enum Socket {
    Unix(UnixDatagram),
    Udp(UdpSocket),
}

/// The sender of a datagram to a [`Socket`], to which the socket can answer.
#[derive(Clone, Debug)]
pub(super) enum Peer {
    Passed(Arc<PassedSocket>),
    Unix(Arc<UnixPeer>),
    Udp(SocketAddr),
}

/// The end of a socket pair that a client has passed with its request. Datagrams wait in the send buffer of this end,
/// which no other client fills.
#[derive(Debug)]
pub(super) struct PassedSocket {
    socket: UnixDatagram,
    identity: (u64, u64),
    /// The process that made the pair, and its user.
    process: Option<i32>,
    user: Option<u32>,
}

#[cfg(target_os = "linux")]
impl PassedSocket {
    /// `None` if `passed` is no end of a pair: datagrams could reach a socket that is not the client's.
    fn new(passed: OwnedFd) -> Option<Self> {
        use nix::sys::socket::{SockType, getsockopt, sockopt};

        let credentials = getsockopt(&passed, sockopt::PeerCredentials).ok()?;
        let kind = getsockopt(&passed, sockopt::SockType).ok()?;
        let found = nix::sys::stat::fstat(&passed).ok()?;
        let socket = UnixDatagram::from(passed);
        let is_pair = kind == SockType::Datagram && socket.peer_addr().is_ok_and(|peer| peer.is_unnamed());
        is_pair.then(|| Self {
            socket,
            identity: (found.st_dev, found.st_ino),
            // Zero for a process that this one cannot see.
            process: Some(credentials.pid()).filter(|&process| process > 0),
            user: Some(credentials.uid()),
        })
    }
}

/// A client on a Unix socket that passed none of its own. All of these share the send buffer of the daemon's socket:
/// one that does not read can fill it for the others.
#[derive(Debug)]
pub(super) struct UnixPeer {
    name: net::SocketAddr,
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
    /// The client's process, if known.
    pub(super) fn process(&self) -> Option<i32> {
        match self {
            Self::Passed(peer) => peer.process,
            Self::Unix(_) | Self::Udp(_) => None,
        }
    }

    pub(super) fn party(&self) -> Party {
        match self {
            Self::Passed(peer) => Party::User(peer.user),
            Self::Unix(peer) => Party::User(peer.user),
            Self::Udp(_) => Party::Udp,
        }
    }
}

impl PartialEq for Peer {
    fn eq(&self, other: &Self) -> bool {
        match (self, other) {
            (Self::Passed(a), Self::Passed(b)) => a.identity == b.identity,
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

/// The next datagram of a Unix socket, and its sender.
#[cfg(target_os = "linux")]
fn receive_unix(socket: &UnixDatagram, buffer: &mut [u8]) -> io::Result<(usize, Option<Peer>)> {
    use std::io::IoSliceMut;
    use std::os::linux::net::SocketAddrExt;

    use nix::sys::socket::{ControlMessageOwned, SockaddrLike, UnixAddr, UnixCredentials, recvmsg};

    let mut control = nix::cmsg_space!(UnixCredentials);
    let mut parts = [IoSliceMut::new(buffer)];
    let flags = MsgFlags::MSG_DONTWAIT | MsgFlags::MSG_PEEK;
    let message = recvmsg::<UnixAddr>(socket.as_raw_fd(), &mut parts, Some(&mut control), flags)?;
    // There is room for credentials only: what is cut off is a passed socket.
    if message.flags.contains(MsgFlags::MSG_CTRUNC) {
        let (count, passed) = receive_passed(socket, buffer)?;
        return Ok((count, passed.and_then(PassedSocket::new).map(|peer| Peer::Passed(Arc::new(peer)))));
    }
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
    // A datagram that was longer than the buffer fills it.
    let count = socket.recv(buffer)?;
    Ok((count, name.and_then(|name| UnixPeer::new(name, user)).map(|peer| Peer::Unix(Arc::new(peer)))))
}

/// The next datagram, with the socket that its sender has passed.
#[cfg(target_os = "linux")]
fn receive_passed(socket: &UnixDatagram, buffer: &mut [u8]) -> io::Result<(usize, Option<OwnedFd>)> {
    use std::io::IoSliceMut;
    use std::mem::MaybeUninit;

    use rustix::net::{RecvAncillaryBuffer, RecvAncillaryMessage, RecvFlags, recvmsg};

    let mut space = [MaybeUninit::uninit(); rustix::cmsg_space!(ScmRights(1))];
    let mut control = RecvAncillaryBuffer::new(&mut space);
    let flags = RecvFlags::DONTWAIT | RecvFlags::CMSG_CLOEXEC;
    // Credentials would take the room. A request that another client sends meanwhile lacks them, and is refused if its
    // name is a file: the client asks again.
    setsockopt(socket, PassCred, &false)?;
    let received = recvmsg(socket, &mut [IoSliceMut::new(buffer)], &mut control, flags);
    setsockopt(socket, PassCred, &true)?;
    let passed = control.drain().find_map(|message| match message {
        RecvAncillaryMessage::ScmRights(mut passed) => passed.next(),
        _ => None,
    });
    Ok((received?.bytes, passed))
}

#[cfg(not(target_os = "linux"))]
fn receive_unix(socket: &UnixDatagram, buffer: &mut [u8]) -> io::Result<(usize, Option<Peer>)> {
    let (count, name) = socket.recv_from(buffer)?;
    Ok((count, UnixPeer::new(name, None).map(|peer| Peer::Unix(Arc::new(peer)))))
}

impl Socket {
    /// Binds `address`; also returns the guard that removes the socket's file, if it has one.
    pub(super) fn bind(address: &Address) -> Result<(Self, Option<SocketFile>), ServeError> {
        let error = |source| ServeError::of(address, source);
        match address {
            Address::Unix(path) => {
                let connect = |path: &Path| UnixDatagram::unbound()?.connect(path);
                let (socket, file) = SocketFile::bind(path, connect, |path| UnixDatagram::bind(path))?;
                socket.set_nonblocking(true).map_err(error)?;
                #[cfg(target_os = "linux")]
                setsockopt(&socket, PassCred, &true).map_err(|errno| error(errno.into()))?;
                Ok((Self::Unix(socket), Some(file)))
            }
            Address::Udp(udp) | Address::Tcp(udp) => {
                require_loopback(*udp)?;
                let socket = UdpSocket::bind(udp).map_err(error)?;
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
            Self::Unix(socket) => receive_unix(socket, buffer),
            Self::Udp(socket) => socket.recv_from(buffer).map(|(count, peer)| (count, Some(Peer::Udp(peer)))),
        }
    }

    pub(super) fn send(&self, bytes: &[u8], peer: &Peer) -> Delivery {
        let sent = match (self, peer) {
            // The client may have made its end a blocking one.
            (Self::Unix(_), Peer::Passed(peer)) => {
                let flags = MsgFlags::MSG_DONTWAIT | MsgFlags::MSG_NOSIGNAL;
                send(peer.socket.as_raw_fd(), bytes, flags).map_err(io::Error::from)
            }
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

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Delivery {
    Sent,
    Full,
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
