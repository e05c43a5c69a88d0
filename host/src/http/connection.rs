//! Connections to a server of the daemon, with limits on their number and duration.

use std::io;
use std::net::IpAddr;
use std::pin::Pin;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::task::{Context, Poll};
use std::time::Duration;

use axum::extract::connect_info::Connected;
use axum::serve::{IncomingStream, Listener};
use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};
use tokio::net::{TcpListener, TcpStream, UnixListener, UnixStream};
use tokio::sync::oneshot;
use tokio::time::{Sleep, sleep};

/// A connection is closed after this time unless its [`Leash`] was released: an answer takes milliseconds.
pub(crate) const LIFETIME: Duration = Duration::from_secs(3);

/// Most simultaneous connections. For one more the oldest is closed of those whose [`Leash`] was not released, of the
/// address that has most of these: silent connections keep nobody out.
pub(crate) const MOST: usize = 100;

/// Pause before a failed accept is tried again: file descriptors may have run out.
const PAUSE: Duration = Duration::from_millis(100);

/// A listening socket of either kind.
pub(crate) enum Socket {
    Tcp(TcpListener),
    Unix(UnixListener),
}

/// Accepts no more than [`MOST`] connections at a time.
pub(crate) struct Door {
    socket: Socket,
    /// The oldest first; each is closed by dropping the sender.
    open: Vec<(Leash, oneshot::Sender<()>)>,
}

impl Door {
    pub(crate) fn new(socket: Socket) -> Self {
        Self { socket, open: Vec::new() }
    }

    /// Makes room for one more connection; `false` if there is none.
    fn make_room(&mut self) -> bool {
        self.open.retain(|(_, end)| !end.is_closed());
        if self.open.len() < MOST {
            return true;
        }
        let strangers = || (0..self.open.len()).filter(|&number| !self.open[number].0.is_released());
        let address_of = |number: usize| self.open[number].0.address;
        let count = |number: usize| strangers().filter(|&other| address_of(other) == address_of(number)).count();
        // The first of equals.
        let oldest = strangers().rev().max_by_key(|&number| count(number));
        oldest.map(|number| self.open.remove(number)).is_some()
    }
}

impl Listener for Door {
    type Io = Connection;
    type Addr = ();

    async fn accept(&mut self) -> (Self::Io, Self::Addr) {
        loop {
            let accepted = match &self.socket {
                Socket::Tcp(listener) => {
                    listener.accept().await.map(|(stream, address)| (Stream::Tcp(stream), Some(address.ip())))
                }
                Socket::Unix(listener) => listener.accept().await.map(|(stream, _)| (Stream::Unix(stream), None)),
            };
            match accepted {
                Ok((stream, address)) if self.make_room() => {
                    let leash = Leash { address, ..Leash::default() };
                    let (end, ended) = oneshot::channel();
                    self.open.push((leash.clone(), end));
                    let lifetime = Box::pin(sleep(LIFETIME));
                    return (Connection { stream, lifetime, ended, is_over: false, leash }, ());
                }
                Ok(_) => {}
                Err(_) => sleep(PAUSE).await,
            }
        }
    }

    fn local_addr(&self) -> io::Result<Self::Addr> {
        Ok(())
    }
}

enum Stream {
    Tcp(TcpStream),
    Unix(UnixStream),
}

/// Ends the lifetime's limit of one connection.
#[derive(Clone, Debug, Default)]
pub(crate) struct Leash {
    /// The other end's; `None` on a Unix socket.
    pub(crate) address: Option<IpAddr>,
    is_released: Arc<AtomicBool>,
}

impl Leash {
    /// From now on the connection may last.
    pub(crate) fn release(&self) {
        self.is_released.store(true, Ordering::Relaxed);
    }

    fn is_released(&self) -> bool {
        self.is_released.load(Ordering::Relaxed)
    }
}

impl Connected<IncomingStream<'_, Door>> for Leash {
    fn connect_info(stream: IncomingStream<'_, Door>) -> Self {
        stream.io().leash.clone()
    }
}

/// A connection that fails at the end of its lifetime, or when another one needs its place.
pub(crate) struct Connection {
    stream: Stream,
    lifetime: Pin<Box<Sleep>>,
    ended: oneshot::Receiver<()>,
    is_over: bool,
    leash: Leash,
}

impl Connection {
    /// The result of `poll`, or an error after the connection's lifetime.
    fn in_time<T>(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        poll: impl FnOnce(&mut Stream, &mut Context<'_>) -> Poll<io::Result<T>>,
    ) -> Poll<io::Result<T>> {
        let polled = poll(&mut self.stream, context);
        if self.leash.is_released() || polled.is_ready() {
            return polled;
        }
        // A receiver that is ready is not polled again.
        self.is_over = self.is_over
            || self.lifetime.as_mut().poll(context).is_ready()
            || Pin::new(&mut self.ended).poll(context).is_ready();
        if self.is_over { Poll::Ready(Err(io::ErrorKind::TimedOut.into())) } else { polled }
    }
}

impl AsyncRead for Connection {
    fn poll_read(self: Pin<&mut Self>, context: &mut Context<'_>, buffer: &mut ReadBuf<'_>) -> Poll<io::Result<()>> {
        self.in_time(context, |stream, context| match stream {
            Stream::Tcp(stream) => Pin::new(stream).poll_read(context, buffer),
            Stream::Unix(stream) => Pin::new(stream).poll_read(context, buffer),
        })
    }
}

impl AsyncWrite for Connection {
    fn poll_write(self: Pin<&mut Self>, context: &mut Context<'_>, bytes: &[u8]) -> Poll<io::Result<usize>> {
        self.in_time(context, |stream, context| match stream {
            Stream::Tcp(stream) => Pin::new(stream).poll_write(context, bytes),
            Stream::Unix(stream) => Pin::new(stream).poll_write(context, bytes),
        })
    }

    fn poll_flush(self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        self.in_time(context, |stream, context| match stream {
            Stream::Tcp(stream) => Pin::new(stream).poll_flush(context),
            Stream::Unix(stream) => Pin::new(stream).poll_flush(context),
        })
    }

    fn poll_shutdown(self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        self.in_time(context, |stream, context| match stream {
            Stream::Tcp(stream) => Pin::new(stream).poll_shutdown(context),
            Stream::Unix(stream) => Pin::new(stream).poll_shutdown(context),
        })
    }
}
