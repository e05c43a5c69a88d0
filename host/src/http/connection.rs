//! Connections to a server of the daemon, with limits on their number and duration.

use std::io;
use std::pin::Pin;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::task::{Context, Poll};
use std::time::Duration;

use axum::extract::connect_info::Connected;
use axum::serve::{IncomingStream, Listener};
use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};
use tokio::net::{TcpListener, TcpStream, UnixListener, UnixStream};
use tokio::time::{Sleep, sleep};

/// A connection is closed after this time unless its [`Leash`] was released: an answer takes milliseconds.
pub(crate) const LIFETIME: Duration = Duration::from_secs(3);

/// Most simultaneous connections; more are closed at once.
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
    /// Has one more reference than there are connections.
    open: Arc<()>,
}

impl Door {
    pub(crate) fn new(socket: Socket) -> Self {
        Self { socket, open: Arc::new(()) }
    }
}

impl Listener for Door {
    type Io = Connection;
    type Addr = ();

    async fn accept(&mut self) -> (Self::Io, Self::Addr) {
        loop {
            let accepted = match &self.socket {
                Socket::Tcp(listener) => listener.accept().await.map(|(stream, _)| Stream::Tcp(stream)),
                Socket::Unix(listener) => listener.accept().await.map(|(stream, _)| Stream::Unix(stream)),
            };
            match accepted {
                Ok(stream) if Arc::strong_count(&self.open) <= MOST => {
                    let end = Box::pin(sleep(LIFETIME));
                    let leash = Leash::default();
                    return (Connection { stream, end, leash, _open: Arc::clone(&self.open) }, ());
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
pub(crate) struct Leash(Arc<AtomicBool>);

impl Leash {
    /// From now on the connection may last.
    pub(crate) fn release(&self) {
        self.0.store(true, Ordering::Relaxed);
    }

    fn is_released(&self) -> bool {
        self.0.load(Ordering::Relaxed)
    }
}

impl Connected<IncomingStream<'_, Door>> for Leash {
    fn connect_info(stream: IncomingStream<'_, Door>) -> Self {
        stream.io().leash.clone()
    }
}

/// A connection that fails at the end of its lifetime.
pub(crate) struct Connection {
    stream: Stream,
    end: Pin<Box<Sleep>>,
    leash: Leash,
    _open: Arc<()>,
}

impl Connection {
    /// The result of `poll`, or an error after the connection's lifetime.
    fn in_time<T>(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        poll: impl FnOnce(&mut Stream, &mut Context<'_>) -> Poll<io::Result<T>>,
    ) -> Poll<io::Result<T>> {
        let polled = poll(&mut self.stream, context);
        if polled.is_pending() && !self.leash.is_released() && self.end.as_mut().poll(context).is_ready() {
            return Poll::Ready(Err(io::ErrorKind::TimedOut.into()));
        }
        polled
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
