//! Non-blocking sockets of both kinds.

use std::io::{self, ErrorKind};
use std::net::SocketAddr;
use std::sync::Arc;

use anyhow::Result;
use tokio::io::Interest;
use tokio::net::UdpSocket;

use crate::address::{Address, cannot_listen, require_loopback};
use crate::platform::{AsyncLocalDatagram, PassedSocket, SocketFile, bind_local, is_out_of_memory, receive_local};

#[derive(Debug)]
pub(super) enum Socket {
    Unix(AsyncLocalDatagram),
    Udp(UdpSocket),
}

/// The sender of a datagram to a [`Socket`], to which the socket can answer.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Peer {
    Passed(Arc<PassedSocket>),
    Udp(SocketAddr),
}

impl Peer {
    /// Its process and its user; unknown by UDP.
    pub(super) fn owner(&self) -> (Option<i32>, Option<u32>) {
        match self {
            Self::Passed(peer) => (peer.process, peer.user),
            Self::Udp(_) => (None, None),
        }
    }
}

impl Socket {
    /// In a runtime: binds `address`; also returns the guard that removes the socket's file, if it has one.
    pub(super) fn bind(address: &Address) -> Result<(Self, Option<SocketFile>)> {
        let error = |source| cannot_listen(address, source);
        match address {
            Address::Unix(path) => bind_local(path).map(|(socket, file)| (Self::Unix(socket), Some(file))),
            Address::Memory(_) => Err(error(ErrorKind::Unsupported.into())),
            Address::Udp(udp) | Address::Tcp(udp) => {
                require_loopback(address, NO_PROOF)?;
                let socket = std::net::UdpSocket::bind(udp).map_err(error)?;
                socket.set_nonblocking(true).map_err(error)?;
                Ok((Self::Udp(UdpSocket::from_std(socket).map_err(error)?), None))
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

    /// Waits for the next datagram; also returns its sender, if it can be answered.
    pub(super) async fn receive(&self, buffer: &mut [u8]) -> io::Result<(usize, Option<Peer>)> {
        match self {
            Self::Unix(socket) => {
                let received = socket.async_io(Interest::READABLE, || receive_local(socket, buffer)).await;
                received.map(|(count, peer)| (count, peer.map(|it| Peer::Passed(Arc::new(it)))))
            }
            Self::Udp(socket) => socket.recv_from(buffer).await.map(|(count, peer)| (count, Some(Peer::Udp(peer)))),
        }
    }

    pub(super) fn send(&self, bytes: &[u8], peer: &Peer) -> Delivery {
        let sent = match (self, peer) {
            (Self::Unix(_), Peer::Passed(peer)) => peer.send(bytes),
            (Self::Udp(socket), Peer::Udp(peer)) => socket.try_send_to(bytes, *peer),
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

/// Why addresses that other hosts can reach are refused.
pub(super) const NO_PROOF: &str = "poses carry no proof of their origin; give udp:127.0.0.1:PORT";
