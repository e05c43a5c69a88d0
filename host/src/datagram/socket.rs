//! Non-blocking sockets of both kinds.

use std::io::{self, ErrorKind};
use std::net::{SocketAddr, UdpSocket};
use std::sync::Arc;

use anyhow::Result;
use tokio::io::Interest;

use crate::address::{Address, cannot_listen, require_loopback};
use crate::platform::{
    AsyncLocalDatagram, LocalDatagram, PassedSocket, SocketFile, bind_local, is_out_of_memory, receive_local,
};

#[derive(Debug)]
pub(super) enum Socket {
    Unix(LocalDatagram),
    Udp(UdpSocket),
}

/// The sender of a datagram to a [`Socket`], to which the socket can answer.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Peer {
    Passed(Arc<PassedSocket>),
    Udp(SocketAddr),
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

impl Socket {
    /// Binds `address`; also returns the guard that removes the socket's file, if it has one.
    pub(super) fn bind(address: &Address) -> Result<(Self, Option<SocketFile>)> {
        let error = |source| cannot_listen(address, source);
        match address {
            Address::Unix(path) => {
                let (socket, file) = bind_local(path)?;
                socket.set_nonblocking(true).map_err(error)?;
                Ok((Self::Unix(socket), Some(file)))
            }
            Address::Memory(_) => Err(error(ErrorKind::Unsupported.into())),
            Address::Udp(udp) | Address::Tcp(udp) => {
                require_loopback(address, NO_PROOF)?;
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
            Self::Unix(socket) => {
                receive_local(socket, buffer).map(|(count, peer)| (count, peer.map(|it| Peer::Passed(Arc::new(it)))))
            }
            Self::Udp(socket) => socket.recv_from(buffer).map(|(count, peer)| (count, Some(Peer::Udp(peer)))),
        }
    }

    /// In a runtime: what waits for its datagrams.
    pub(super) fn waiting(&self) -> io::Result<Waiting> {
        Ok(match self {
            Self::Unix(socket) => Waiting::Unix(AsyncLocalDatagram::from_std(socket.try_clone()?)?),
            Self::Udp(socket) => Waiting::Udp(tokio::net::UdpSocket::from_std(socket.try_clone()?)?),
        })
    }

    pub(super) fn send(&self, bytes: &[u8], peer: &Peer) -> Delivery {
        let sent = match (self, peer) {
            (Self::Unix(_), Peer::Passed(peer)) => peer.send(bytes),
            (Self::Udp(socket), Peer::Udp(peer)) => socket.send_to(bytes, peer),
            _ => return Delivery::Gone,
        };
        match sent {
            Ok(_) => Delivery::Sent,
            Err(error) if matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::Interrupted) => Delivery::Full,
            Err(error) if is_out_of_memory(&error) => Delivery::Full,
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

#[derive(Debug)]
pub(super) enum Waiting {
    Unix(AsyncLocalDatagram),
    Udp(tokio::net::UdpSocket),
}

impl Waiting {
    /// What `receive` takes from the socket, as soon as it finds something.
    pub(super) async fn next<T>(&self, receive: impl FnMut() -> io::Result<T>) -> io::Result<T> {
        match self {
            Self::Unix(socket) => socket.async_io(Interest::READABLE, receive).await,
            Self::Udp(socket) => socket.async_io(Interest::READABLE, receive).await,
        }
    }
}

/// Why addresses that other hosts can reach are refused.
pub(super) const NO_PROOF: &str = "poses carry no proof of their origin; give udp:127.0.0.1:PORT";
