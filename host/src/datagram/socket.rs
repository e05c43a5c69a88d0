//! Non-blocking sockets of both kinds.

use std::io::{self, ErrorKind, IoSlice, IoSliceMut};
use std::mem::MaybeUninit;
use std::net::{SocketAddr, UdpSocket};
use std::os::fd::{AsFd, AsRawFd, BorrowedFd, OwnedFd};
use std::os::unix::net::UnixDatagram;
use std::path::Path;
use std::sync::Arc;

use nix::sys::socket::{ControlMessage, MsgFlags, SockType, UnixAddr, getsockopt, send, sendmsg, sockopt};
use rustix::net::{RecvAncillaryBuffer, RecvAncillaryMessage, RecvFlags, recvmsg};

use super::layout::Request;
use crate::address::{Address, ServeError, SocketFile};

#[derive(Debug)]
pub(super) enum Socket {
    Unix(UnixDatagram),
    Udp(UdpSocket),
}

/// The sender of a datagram to a [`Socket`], to which the socket can answer.
#[derive(Clone, Debug)]
pub(super) enum Peer {
    Passed(Arc<PassedSocket>),
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

impl PassedSocket {
    /// `None` if `passed` is no end of a pair: datagrams could reach a socket that is not the client's.
    fn new(passed: OwnedFd) -> Option<Self> {
        #[cfg(target_os = "linux")]
        let credentials = getsockopt(&passed, sockopt::PeerCredentials).ok()?;
        #[cfg(target_os = "linux")]
        let (process, user) = (Some(credentials.pid()), Some(credentials.uid()));
        #[cfg(not(target_os = "linux"))]
        let (process, user) = (None, None);
        let kind = getsockopt(&passed, sockopt::SockType).ok()?;
        let found = nix::sys::stat::fstat(&passed).ok()?;
        let socket = UnixDatagram::from(passed);
        let is_pair = kind == SockType::Datagram && socket.peer_addr().is_ok_and(|peer| peer.is_unnamed());
        // Zero for a process that this one cannot see.
        let process = process.filter(|&process: &i32| process > 0);
        is_pair.then(|| Self { socket, identity: (found.st_dev, found.st_ino), process, user })
    }
}

impl Peer {
    pub(super) fn process(&self) -> Option<i32> {
        match self {
            Self::Passed(peer) => peer.process,
            Self::Udp(_) => None,
        }
    }

    /// Its user; `None` by UDP, where users are unknown.
    pub(super) fn user(&self) -> Option<u32> {
        match self {
            Self::Passed(peer) => peer.user,
            Self::Udp(_) => None,
        }
    }
}

impl PartialEq for Peer {
    fn eq(&self, other: &Self) -> bool {
        match (self, other) {
            (Self::Passed(a), Self::Passed(b)) => a.identity == b.identity,
            (Self::Udp(a), Self::Udp(b)) => a == b,
            _ => false,
        }
    }
}

/// The next datagram of a Unix socket, with the socket that its sender has passed.
fn receive_unix(socket: &UnixDatagram, buffer: &mut [u8]) -> io::Result<(usize, Option<Peer>)> {
    let mut space = [MaybeUninit::uninit(); rustix::cmsg_space!(ScmRights(1))];
    let mut control = RecvAncillaryBuffer::new(&mut space);
    let flags = RecvFlags::DONTWAIT | RecvFlags::CMSG_CLOEXEC;
    let received = recvmsg(socket, &mut [IoSliceMut::new(buffer)], &mut control, flags);
    let passed = control.drain().find_map(|message| match message {
        RecvAncillaryMessage::ScmRights(mut passed) => passed.next(),
        _ => None,
    });
    Ok((received?.bytes, passed.and_then(PassedSocket::new).map(|peer| Peer::Passed(Arc::new(peer)))))
}

#[derive(Debug)]
pub struct UnixClient {
    /// Where datagrams come.
    pub socket: UnixDatagram,
    passed: UnixDatagram,
    asks: UnixDatagram,
}

impl UnixClient {
    pub fn new() -> io::Result<Self> {
        let (socket, passed) = UnixDatagram::pair()?;
        Ok(Self { socket, passed, asks: UnixDatagram::unbound()? })
    }

    /// Sends `request` to the server whose socket is at `path`.
    pub fn ask(&self, path: &Path, request: Request) -> io::Result<usize> {
        pass(&self.asks, path, request, &self.passed)
    }
}

/// Sends `request` to the server at `path`, with `passed` as the socket for answers.
pub(super) fn pass(asks: &UnixDatagram, path: &Path, request: Request, passed: &impl AsFd) -> io::Result<usize> {
    let (bytes, passed, path) = (request.to_bytes(), [passed.as_fd().as_raw_fd()], UnixAddr::new(path)?);
    let rights = [ControlMessage::ScmRights(&passed)];
    Ok(sendmsg(asks.as_raw_fd(), &[IoSlice::new(&bytes)], &rights, MsgFlags::empty(), Some(&path))?)
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
            (Self::Udp(socket), Peer::Udp(peer)) => socket.send_to(bytes, peer),
            _ => return Delivery::Gone,
        };
        match sent {
            Ok(_) => Delivery::Sent,
            Err(error) if matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::Interrupted) => Delivery::Full,
            // No memory for it at this moment.
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

/// Refuses addresses that other hosts can reach.
pub(super) fn require_loopback(address: SocketAddr) -> Result<(), ServeError> {
    let reason = "poses carry no proof of their origin; give udp:127.0.0.1:PORT";
    let refused = || ServeError::NotLoopback { address: Address::Udp(address), reason };
    address.ip().is_loopback().then_some(()).ok_or_else(refused)
}
