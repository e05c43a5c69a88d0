//! What servers of HTTP share: limits of connections, whose requests are answered, and threads.

use std::future::pending;
use std::net::IpAddr;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Weak};
use std::time::Duration;

use anyhow::Result;
use axum::extract::Request;
use axum::http::header::{CONNECTION, HOST, ORIGIN};
use axum::http::{HeaderMap, HeaderName, HeaderValue, StatusCode};
use axum::middleware::{Next, from_fn};
use axum::response::{IntoResponse, Response};
use axum::serve::Listener;
use axum::{Extension, Router};
use hyper::server::conn::http1;
use hyper_util::rt::TokioIo;
use hyper_util::service::TowerToHyperService;
use tokio::io::{AsyncRead, AsyncWrite};
use tokio::net::TcpListener;
use tokio::runtime::Builder;
use tokio::sync::{Notify, oneshot};
use tokio::time::{Instant, sleep_until};

use crate::address::{Address, cannot_listen};
use crate::background::{Background, drive};
use crate::platform::{SocketFile, listen_local};

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
    /// Where it listens, with the port that the system chose for port 0.
    pub(crate) address: Address,
    _thread: Background<oneshot::Sender<()>>,
    _file: Option<SocketFile>,
}

impl Serving {
    /// Serves `routes` at `address` to programs in `scope`, pages of others get `refusal`. `begin` starts further tasks.
    pub(crate) fn http(
        name: &str,
        address: &Address,
        scope: BindScope,
        refusal: &'static str,
        routes: Router,
        begin: impl FnOnce(),
    ) -> Result<Self> {
        let failed = |source| cannot_listen(address, source);
        // Browsers cannot reach a Unix socket: any host name is allowed there.
        let named = if matches!(address, Address::Unix(_)) { BindScope::Anywhere } else { scope };
        let guard = move |request: Request, next: Next| async move {
            match is_own(request.headers(), named) {
                true => next.run(request).await,
                false => reply(StatusCode::FORBIDDEN, refusal),
            }
        };
        let routes = routes.layer(from_fn(guard));
        let runtime = Builder::new_current_thread().enable_all().build().map_err(failed)?;
        let (address, file) = runtime.block_on(async {
            let bound = match address {
                Address::Unix(path) => {
                    let (listener, file) = listen_local(path)?;
                    tokio::spawn(accept(listener, |_| None, routes));
                    (address.clone(), Some(file))
                }
                Address::Memory(_) => return Err(failed(std::io::ErrorKind::Unsupported.into())),
                Address::Tcp(tcp) | Address::Udp(tcp) => {
                    let listener = TcpListener::bind(tcp).await.map_err(failed)?;
                    let bound = Address::Tcp(listener.local_addr().map_err(failed)?);
                    tokio::spawn(accept(listener, |other| Some(other.ip()), routes));
                    (bound, None)
                }
            };
            begin();
            Ok(bound)
        })?;
        Ok(Self { address, _thread: drive(name, runtime)?, _file: file })
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
fn is_own(headers: &HeaderMap, scope: BindScope) -> bool {
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

/// Whether a request with these headers is one of HTTP, and comes from a program of this host.
pub fn is_own_request<'a>(headers: impl IntoIterator<Item = (&'a [u8], &'a [u8])>) -> bool {
    let read = |(name, value)| Some((HeaderName::from_bytes(name).ok()?, HeaderValue::from_bytes(value).ok()?));
    let mut map = HeaderMap::new();
    headers.into_iter().all(|header| read(header).map(|(name, value)| map.append(name, value)).is_some())
        && is_own(&map, BindScope::Loopback)
}

/// Whether `host`, with or without a port, is a loopback name.
fn is_loopback(host: &str) -> bool {
    let name = match host.strip_prefix('[').and_then(|rest| rest.split_once(']')) {
        Some((address, _)) => address,
        None => host.rsplit_once(':').map_or(host, |(name, _)| name),
    };
    name.eq_ignore_ascii_case("localhost") || name.parse().is_ok_and(|address: IpAddr| address.is_loopback())
}

/// A connection is closed after this time unless it was [released](Connection::release): an answer takes milliseconds.
pub(crate) const LIFETIME: Duration = Duration::from_secs(3);

/// Most simultaneous connections. For one more the oldest is closed of those that were not released, of the address that
/// has most of these: silent connections keep nobody out.
pub(crate) const MOST: usize = 100;

/// A connection that lasts no longer than its lifetime, or until another one needs its place, unless it is released.
#[derive(Debug)]
pub(crate) struct Connection {
    /// The other end's; `None` on a Unix socket.
    pub(crate) address: Option<IpAddr>,
    is_released: AtomicBool,
    until: Instant,
    end: Notify,
}

impl Connection {
    /// From now on the connection may last.
    pub(crate) fn release(&self) {
        self.is_released.store(true, Ordering::Relaxed);
    }

    /// Does `work`; `None` if the connection has to end before.
    pub(crate) async fn while_open<T>(&self, work: impl Future<Output = T>) -> Option<T> {
        tokio::select! {
            done = work => Some(done),
            () = self.end.notified() => None,
            () = self.outlives() => None,
        }
    }

    /// Waits for the end of its lifetime; for ever if it is released by then.
    async fn outlives(&self) {
        sleep_until(self.until).await;
        if self.is_released.load(Ordering::Relaxed) {
            pending::<()>().await;
        }
    }
}

/// Accepts connections, no more than [`MOST`] at a time.
async fn accept<L: Listener>(mut listener: L, address: fn(L::Addr) -> Option<IpAddr>, routes: Router) {
    // The oldest first.
    let mut open: Vec<Weak<Connection>> = Vec::new();
    loop {
        let (stream, other) = listener.accept().await;
        serve(stream, address(other), &routes, &mut open);
    }
}

/// Serves a connection if there is room for it among those that are `open`.
fn serve<S>(stream: S, address: Option<IpAddr>, routes: &Router, open: &mut Vec<Weak<Connection>>)
where
    S: AsyncRead + AsyncWrite + Unpin + Send + 'static,
{
    if !make_room(open) {
        return;
    }
    let until = Instant::now() + LIFETIME;
    let connection = Arc::new(Connection { address, is_released: false.into(), until, end: Notify::new() });
    open.push(Arc::downgrade(&connection));
    let service = TowerToHyperService::new(routes.clone().layer(Extension(Arc::clone(&connection))));
    let serving = http1::Builder::new().serve_connection(TokioIo::new(stream), service).with_upgrades();
    tokio::spawn(async move { connection.while_open(serving).await });
}

/// Makes room for one more connection; `false` if there is none.
fn make_room(open: &mut Vec<Weak<Connection>>) -> bool {
    open.retain(|connection| connection.strong_count() > 0);
    if open.len() < MOST {
        return true;
    }
    let strangers: Vec<_> =
        open.iter().filter_map(Weak::upgrade).filter(|other| !other.is_released.load(Ordering::Relaxed)).collect();
    let count = |address| strangers.iter().filter(|other| other.address == address).count();
    // The first of equals.
    let oldest = strangers.iter().rev().max_by_key(|connection| count(connection.address));
    oldest
        .inspect(|oldest| {
            oldest.end.notify_one();
            open.retain(|connection| !std::ptr::eq(connection.as_ptr(), Arc::as_ptr(oldest)));
        })
        .is_some()
}

#[cfg(test)]
mod tests {
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
