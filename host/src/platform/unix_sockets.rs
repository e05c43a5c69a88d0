//! Sockets in the file system: streams for the status and the 6-DoF mouse, datagrams for poses.

use std::fs::{self, Permissions};
use std::io::{self, ErrorKind, IoSlice, IoSliceMut};
use std::mem::MaybeUninit;
use std::os::fd::{AsFd, AsRawFd, OwnedFd};
use std::os::unix::fs::{FileTypeExt, MetadataExt, PermissionsExt};
use std::path::{Path, PathBuf};

use anyhow::{Result, bail};
use nix::errno::Errno;
use nix::libc::{dev_t, ino_t};
use nix::sys::socket::{ControlMessage, MsgFlags, SockType, UnixAddr, getsockopt, send, sendmsg, sockopt};
use rustix::net::{RecvAncillaryBuffer, RecvAncillaryMessage, RecvFlags, recvmsg};

use crate::address::{Address, cannot_listen, in_use};
use crate::datagram::Request;

use std::os::unix::net::UnixDatagram as LocalDatagram;
pub(crate) use std::os::unix::net::UnixStream as LocalStream;
pub(crate) use tokio::net::{UnixDatagram as AsyncLocalDatagram, UnixListener as AsyncLocalListener};

/// A bound socket; its file is removed when this is dropped, unless it has been replaced.
#[derive(Debug)]
pub(crate) struct SocketFile {
    path: PathBuf,
    file: [u64; 2],
}

impl SocketFile {
    /// Binds a socket at `path` by `bind`, for the user and the group of this program; one that a killed program has left
    /// behind is replaced. `connect` finds out whether anybody serves it.
    fn bind<T>(
        path: &Path,
        connect: impl FnOnce(&Path) -> io::Result<()>,
        bind: impl FnOnce(&Path) -> io::Result<T>,
    ) -> Result<(T, Self)> {
        let address = Address::Unix(path.to_owned());
        let failed = |source| cannot_listen(&address, source);
        match fs::symlink_metadata(path) {
            Err(error) if error.kind() == ErrorKind::NotFound => {}
            Err(source) => return Err(failed(source)),
            Ok(found) if !found.file_type().is_socket() => {
                bail!("{} is no socket and is left alone; give another path", path.display());
            }
            Ok(_) => match connect(path) {
                Err(error) if error.kind() == ErrorKind::ConnectionRefused => fs::remove_file(path).map_err(failed)?,
                // A socket of another kind is in use, too.
                _ => return Err(in_use(&address)),
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

/// In a runtime.
pub(crate) fn listen_local(path: &Path) -> Result<(AsyncLocalListener, SocketFile)> {
    SocketFile::bind(path, |path| LocalStream::connect(path).map(drop), |path| AsyncLocalListener::bind(path))
}

/// A stream to who listens at `path`.
pub(crate) fn connect_local(path: &Path) -> io::Result<LocalStream> {
    LocalStream::connect(path)
}

/// In a runtime.
pub(crate) fn bind_local(path: &Path) -> Result<(AsyncLocalDatagram, SocketFile)> {
    let connect = |path: &Path| LocalDatagram::unbound()?.connect(path);
    SocketFile::bind(path, connect, |path| AsyncLocalDatagram::bind(path))
}

fn identity(path: &Path) -> io::Result<[u64; 2]> {
    fs::symlink_metadata(path).map(|found| [found.dev(), found.ino()])
}

/// The end of a socket pair that a client has passed with its request. Datagrams wait in the send buffer of this end,
/// which no other client fills.
#[derive(Debug)]
pub(crate) struct PassedSocket {
    socket: LocalDatagram,
    identity: (dev_t, ino_t),
    /// The process that made the pair, and its user.
    pub(crate) process: Option<i32>,
    pub(crate) user: Option<u32>,
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
        let socket = LocalDatagram::from(passed);
        let is_pair = kind == SockType::Datagram && socket.peer_addr().is_ok_and(|peer| peer.is_unnamed());
        // Zero for a process that this one cannot see.
        let process = process.filter(|&process: &i32| process > 0);
        is_pair.then(|| Self { socket, identity: (found.st_dev, found.st_ino), process, user })
    }

    /// Sends a datagram without waiting, also if the client has made its end a blocking one. SIGPIPE is ignored by every
    /// program in Rust.
    pub(crate) fn send(&self, bytes: &[u8]) -> io::Result<usize> {
        Ok(send(self.socket.as_raw_fd(), bytes, MsgFlags::MSG_DONTWAIT)?)
    }
}

impl PartialEq for PassedSocket {
    fn eq(&self, other: &Self) -> bool {
        self.identity == other.identity
    }
}

/// Whether there was no memory for a datagram at that moment.
pub(crate) fn is_out_of_memory(error: &io::Error) -> bool {
    error.raw_os_error() == Some(Errno::ENOBUFS as i32)
}

/// The next datagram of a Unix socket, with the socket that its sender has passed.
pub(crate) fn receive_local(socket: &impl AsFd, buffer: &mut [u8]) -> io::Result<(usize, Option<PassedSocket>)> {
    let mut space = [MaybeUninit::uninit(); rustix::cmsg_space!(ScmRights(1))];
    let mut control = RecvAncillaryBuffer::new(&mut space);
    let flags = RecvFlags::DONTWAIT;
    #[cfg(not(target_vendor = "apple"))]
    let flags = flags | RecvFlags::CMSG_CLOEXEC;
    let received = recvmsg(socket, &mut [IoSliceMut::new(buffer)], &mut control, flags);
    let passed = control.drain().find_map(|message| match message {
        RecvAncillaryMessage::ScmRights(mut passed) => passed.next(),
        _ => None,
    });
    Ok((received?.bytes, passed.and_then(PassedSocket::new)))
}

/// A client of the datagrams, for tests.
#[derive(Debug)]
pub struct UnixClient {
    /// Where datagrams come.
    pub socket: LocalDatagram,
    passed: LocalDatagram,
    asks: LocalDatagram,
}

impl UnixClient {
    /// A client with a socket pair of its own.
    pub fn new() -> io::Result<Self> {
        let (socket, passed) = LocalDatagram::pair()?;
        Ok(Self { socket, passed, asks: LocalDatagram::unbound()? })
    }

    /// Sends `request` to the server whose socket is at `path`.
    pub fn ask(&self, path: &Path, request: Request) -> io::Result<usize> {
        pass(&self.asks, path, request, &self.passed)
    }
}

/// Sends `request` to the server at `path`, with `passed` as the socket for answers.
pub(crate) fn pass(asks: &LocalDatagram, path: &Path, request: Request, passed: &impl AsFd) -> io::Result<usize> {
    let (bytes, passed, path) = (request.to_bytes(), [passed.as_fd().as_raw_fd()], UnixAddr::new(path)?);
    let rights = [ControlMessage::ScmRights(&passed)];
    Ok(sendmsg(asks.as_raw_fd(), &[IoSlice::new(&bytes)], &rights, MsgFlags::empty(), Some(&path))?)
}
