//! What servers of HTTP share: limits of connections, whose requests are answered, and threads.

use std::io::{self, ErrorKind};
use std::net::IpAddr;
use std::pin::Pin;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::task::{Context, Poll};
use std::thread::JoinHandle;
use std::time::Duration;

use axum::Router;
use axum::extract::Request;
use axum::extract::connect_info::Connected;
use axum::http::header::{CONNECTION, HOST, ORIGIN};
use axum::http::{HeaderMap, StatusCode};
use axum::middleware::{Next, from_fn};
use axum::response::{IntoResponse, Response};
use axum::serve::{IncomingStream, Listener};
use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};
use tokio::net::{TcpListener, UnixListener};
use tokio::runtime::Builder;
use tokio::sync::oneshot;
use tokio::time::{Sleep, sleep};

use crate::address::{Address, ServeError, SocketFile, connects_stream};

/// The hosts that may connect over TCP.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum BindScope {
    Loopback,
    /// Every host that can reach the address, as permitted by the user.
    Anywhere,
}

/// A server on a thread of its own, with all its tasks, until this is dropped.
#[derive(Debug)]
pub(crate) struct Serving {
    end: Option<oneshot::Sender<()>>,
    thread: Option<JoinHandle<()>>,
    _file: Option<SocketFile>,
}

impl Serving {
    /// Serves `routes` at `address` to programs in `scope`, pages of others get `refusal`; returns the address with the port
    /// that the system chose for port 0. `begin` starts further tasks.
    pub(crate) fn http(
        name: &str,
        address: &Address,
        scope: BindScope,
        refusal: &'static str,
        routes: Router,
        begin: impl FnOnce(),
    ) -> Result<(Self, Address), ServeError> {
        let failed = |source| ServeError::of(address, source);
        let listen = || match address {
            Address::Unix(path) => {
                let (listener, file) = SocketFile::bind(path, connects_stream, |path| UnixListener::bind(path))?;
                Ok((Socket::Unix(listener), address.clone(), Some(file)))
            }
            Address::Tcp(tcp) | Address::Udp(tcp) => {
                let listener = std::net::TcpListener::bind(tcp).map_err(failed)?;
                listener.set_nonblocking(true).map_err(failed)?;
                let bound = Address::Tcp(listener.local_addr().map_err(failed)?);
                Ok((Socket::Tcp(TcpListener::from_std(listener).map_err(failed)?), bound, None))
            }
        };
        // Browsers cannot reach a Unix socket: any host name is allowed there.
        let named = if matches!(address, Address::Unix(_)) { BindScope::Anywhere } else { scope };
        let guard = move |request: Request, next: Next| async move {
            match is_own(request.headers(), named) {
                true => next.run(request).await,
                false => reply(StatusCode::FORBIDDEN, refusal),
            }
        };
        let routes = routes.layer(from_fn(guard)).into_make_service_with_connect_info::<ConnectionDeadline>();
        let (mut bound, mut file) = (address.clone(), None);
        let mut serving = Self::start(name, address, async || {
            let socket;
            (socket, bound, file) = listen()?;
            tokio::spawn(async move { axum::serve(LimitedListener::new(socket), routes).await });
            begin();
            Ok(())
        })?;
        serving._file = file;
        Ok((serving, bound))
    }

    /// Runs the tasks that `begin` starts, for a server at `address`.
    pub(crate) fn start(
        name: &str,
        address: &Address,
        begin: impl AsyncFnOnce() -> Result<(), ServeError>,
    ) -> Result<Self, ServeError> {
        let failed = |source| ServeError::of(address, source);
        let runtime = Builder::new_current_thread().enable_all().build().map_err(failed)?;
        runtime.block_on(begin())?;
        let (end, ended) = oneshot::channel();
        let run = move || {
            // Either way this has been dropped. The tasks end with the runtime: a graceful shutdown would wait for
            // connections that hang.
            let _ = runtime.block_on(ended);
        };
        let thread = std::thread::Builder::new().name(name.to_owned()).spawn(run).map_err(failed)?;
        Ok(Self { end: Some(end), thread: Some(thread), _file: None })
    }
}

impl Drop for Serving {
    fn drop(&mut self) {
        drop(self.end.take());
        if let Some(thread) = self.thread.take() {
            // A panic of the thread has already been reported on standard error.
            let _ = thread.join();
        }
    }
}

/// An answer, after which the connection is closed.
pub(crate) fn reply(status: StatusCode, text: impl IntoResponse) -> Response {
    (status, [(CONNECTION, "close")], text).into_response()
}

// Any page can make a browser send requests to a port of the browser's host. A page whose domain resolves to this host
// (DNS rebinding) could even read the answers: its requests carry that domain as `Host`. Requests of other pages carry
// the page's origin as `Origin` (RFC 6454, section 7). Programs send neither.

/// Whether these are the headers of a program's request to a name of this host.
pub(crate) fn is_own(headers: &HeaderMap, scope: BindScope) -> bool {
    let mut hosts = headers.get_all(HOST).iter();
    let host = hosts.next().map(|host| host.as_bytes());
    if hosts.next().is_some() {
        return false;
    }
    // A server that any host may reach may have any name.
    let is_ours = |host: &[u8]| scope == BindScope::Anywhere || std::str::from_utf8(host).is_ok_and(is_loopback);
    host.is_none_or(is_ours)
        && headers.get_all(ORIGIN).iter().all(|origin| {
            let origin = origin.as_bytes();
            origin.strip_prefix(b"http://").is_some_and(|origin| Some(origin) == host)
        })
}

/// Whether `host`, with or without a port, is a loopback name.
fn is_loopback(host: &str) -> bool {
    let name = match host.strip_prefix('[').and_then(|rest| rest.split_once(']')) {
        Some((address, _)) => address,
        None => host.rsplit_once(':').map_or(host, |(name, _)| name),
    };
    name.eq_ignore_ascii_case("localhost") || name.parse().is_ok_and(|address: IpAddr| address.is_loopback())
}

/// A connection is closed after this time unless its [`ConnectionDeadline`] was released: an answer takes milliseconds.
pub(crate) const LIFETIME: Duration = Duration::from_secs(3);

/// Most simultaneous connections. For one more the oldest is closed of those whose [`ConnectionDeadline`] was not released, of the
/// address that has most of these: silent connections keep nobody out.
pub(crate) const MOST: usize = 100;

/// Pause before a failed accept is tried again: file descriptors may have run out.
const PAUSE: Duration = Duration::from_millis(100);

pub(crate) enum Socket {
    Tcp(TcpListener),
    Unix(UnixListener),
}

/// Accepts no more than [`MOST`] connections at a time.
pub(crate) struct LimitedListener {
    socket: Socket,
    /// The oldest first; each is closed by dropping the sender.
    open: Vec<(ConnectionDeadline, oneshot::Sender<()>)>,
}

impl LimitedListener {
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

impl Listener for LimitedListener {
    type Io = Connection;
    type Addr = ();

    async fn accept(&mut self) -> (Self::Io, Self::Addr) {
        loop {
            let accepted: io::Result<(Stream, _)> = match &self.socket {
                Socket::Tcp(listener) => {
                    listener.accept().await.map(|(stream, address)| (Box::pin(stream) as Stream, Some(address.ip())))
                }
                Socket::Unix(listener) => listener.accept().await.map(|(stream, _)| (Box::pin(stream) as Stream, None)),
            };
            match accepted {
                Ok((stream, address)) if self.make_room() => {
                    let deadline = ConnectionDeadline { address, ..ConnectionDeadline::default() };
                    let (end, ended) = oneshot::channel();
                    self.open.push((deadline.clone(), end));
                    let lifetime = Box::pin(sleep(LIFETIME));
                    return (Connection { stream, lifetime, ended, is_over: false, deadline }, ());
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

trait Io: AsyncRead + AsyncWrite + Send {}

impl<T: AsyncRead + AsyncWrite + Send> Io for T {}

type Stream = Pin<Box<dyn Io>>;

/// Ends the lifetime's limit of one connection.
#[derive(Clone, Debug, Default)]
pub(crate) struct ConnectionDeadline {
    /// The other end's; `None` on a Unix socket.
    pub(crate) address: Option<IpAddr>,
    is_released: Arc<AtomicBool>,
}

impl ConnectionDeadline {
    /// From now on the connection may last.
    pub(crate) fn release(&self) {
        self.is_released.store(true, Ordering::Relaxed);
    }

    fn is_released(&self) -> bool {
        self.is_released.load(Ordering::Relaxed)
    }
}

impl Connected<IncomingStream<'_, LimitedListener>> for ConnectionDeadline {
    fn connect_info(stream: IncomingStream<'_, LimitedListener>) -> Self {
        stream.io().deadline.clone()
    }
}

/// A connection that fails at the end of its lifetime, or when another one needs its place.
pub(crate) struct Connection {
    stream: Stream,
    lifetime: Pin<Box<Sleep>>,
    ended: oneshot::Receiver<()>,
    is_over: bool,
    deadline: ConnectionDeadline,
}

impl Connection {
    /// The result of `poll`, or an error after the connection's lifetime.
    fn in_time<T>(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        poll: impl FnOnce(&mut Stream, &mut Context<'_>) -> Poll<io::Result<T>>,
    ) -> Poll<io::Result<T>> {
        let polled = poll(&mut self.stream, context);
        if self.deadline.is_released() || polled.is_ready() {
            return polled;
        }
        // A receiver that is ready is not polled again.
        self.is_over = self.is_over
            || self.lifetime.as_mut().poll(context).is_ready()
            || Pin::new(&mut self.ended).poll(context).is_ready();
        if self.is_over { Poll::Ready(Err(ErrorKind::TimedOut.into())) } else { polled }
    }
}

impl AsyncRead for Connection {
    fn poll_read(self: Pin<&mut Self>, context: &mut Context<'_>, buffer: &mut ReadBuf<'_>) -> Poll<io::Result<()>> {
        self.in_time(context, |stream, context| stream.as_mut().poll_read(context, buffer))
    }
}

impl AsyncWrite for Connection {
    fn poll_write(self: Pin<&mut Self>, context: &mut Context<'_>, bytes: &[u8]) -> Poll<io::Result<usize>> {
        self.in_time(context, |stream, context| stream.as_mut().poll_write(context, bytes))
    }

    fn poll_flush(self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        self.in_time(context, |stream, context| stream.as_mut().poll_flush(context))
    }

    fn poll_shutdown(self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        self.in_time(context, |stream, context| stream.as_mut().poll_shutdown(context))
    }
}

#[cfg(test)]
mod tests {
    use axum::http::HeaderValue;

    use super::*;

    fn is_allowed(host: Option<&'static str>, origin: Option<&'static str>, scope: BindScope) -> bool {
        let mut headers = HeaderMap::new();
        for (name, value) in [(HOST, host), (ORIGIN, origin)] {
            headers.extend(value.map(|value| (name, HeaderValue::from_static(value))));
        }
        is_own(&headers, scope)
    }

    #[test]
    fn pages_of_others_are_not_answered() {
        for host in ["localhost", "LOCALHOST:7450", "127.0.0.1", "127.0.0.1:7450", "127.3.2.1:1", "[::1]:7450", "[::1]"]
        {
            assert!(is_allowed(Some(host), None, BindScope::Loopback), "{host}");
        }
        assert!(is_allowed(None, None, BindScope::Loopback), "as HTTP/1.0 may do");
        for host in ["evil.example:7450", "localhost.evil.example", "127.0.0.1.evil.example", "", "[::2]:1", "10.0.0.1"]
        {
            assert!(!is_allowed(Some(host), None, BindScope::Loopback), "{host}");
            assert!(is_allowed(Some(host), None, BindScope::Anywhere), "{host}");
        }
        for scope in [BindScope::Loopback, BindScope::Anywhere] {
            let asked_by = |origin| is_allowed(Some("127.0.0.1:7450"), Some(origin), scope);
            assert!(asked_by("http://127.0.0.1:7450"));
            for origin in ["http://evil.example", "https://127.0.0.1:7450", "http://127.0.0.1:8000", "null", ""] {
                assert!(!asked_by(origin), "{origin}");
            }
        }
    }
}
