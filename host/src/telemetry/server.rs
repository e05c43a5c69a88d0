//! The status over HTTP: `/` for people, `/status` as JSON, `/metrics` for Prometheus, `/health` for probes.
//!
//! The server has its own thread and makes a report for each request. It has no authentication: by default it listens
//! for programs on its own host only, and never answers pages in browsers.

use std::io;
use std::sync::Arc;

use axum::Router;
use axum::extract::Request;
use axum::http::StatusCode;
use axum::http::header::{CONNECTION, CONTENT_TYPE};
use axum::middleware::{Next, from_fn};
use axum::response::{IntoResponse, Response};
use axum::routing::get;
use thiserror::Error;
use tokio::runtime::Builder;

use super::{DaemonReport, StatusAddress, metrics, view};
use crate::http::{self, BindScope, LimitedListener, Serving, Socket, SocketFile, SocketFileError};
use slitpose_tracking::clock::HostInstant;

/// Mode of the Unix socket: owner and group may connect, other users may not.
const SOCKET_MODE: u32 = 0o660;

const TEXT: &str = "text/plain; charset=utf-8";
const JSON: &str = "application/json";

#[derive(Debug, Error)]
pub(crate) enum StatusError {
    #[error(
        "{address} can be reached from other hosts, and the status server asks for no password; \
         give 127.0.0.1 or [::1], or a unix: path"
    )]
    NotLoopback { address: StatusAddress },
    #[error(transparent)]
    Socket(#[from] SocketFileError),
    #[error("another program serves {address}; give another address, or end that program")]
    InUse { address: StatusAddress },
    #[error("cannot listen on {address}")]
    Listen { address: StatusAddress, source: io::Error },
}

/// Serves the status until dropped.
#[derive(Debug)]
pub(crate) struct StatusServer {
    address: StatusAddress,
    // Ends before the file is removed.
    _serving: Serving,
    _file: Option<SocketFile>,
}

type Source = Arc<dyn Fn() -> DaemonReport + Send + Sync>;

impl StatusServer {
    /// Serves the reports of `source` at `address`. A socket left behind by a killed daemon is replaced.
    pub(crate) fn start(
        address: &StatusAddress,
        scope: BindScope,
        source: impl Fn() -> DaemonReport + Send + Sync + 'static,
    ) -> Result<Self, StatusError> {
        let listen = |source| StatusError::Listen { address: address.clone(), source };
        let runtime = Builder::new_current_thread().enable_all().build().map_err(listen)?;
        let (socket, address, file) = {
            // Sockets belong to the runtime in which they are created.
            let _entered = runtime.enter();
            match address {
                StatusAddress::Tcp(tcp) => {
                    if scope == BindScope::Loopback && !tcp.ip().is_loopback() {
                        return Err(StatusError::NotLoopback { address: address.clone() });
                    }
                    let (socket, bound) = http::listen(*tcp).map_err(|source| match source.kind() {
                        io::ErrorKind::AddrInUse => StatusError::InUse { address: address.clone() },
                        _ => listen(source),
                    })?;
                    (socket, StatusAddress::Tcp(bound), None)
                }
                StatusAddress::Unix(path) => {
                    let (listener, file) =
                        SocketFile::bind(path, SOCKET_MODE, |path| tokio::net::UnixListener::bind(path))?;
                    (Socket::Unix(listener), address.clone(), Some(file))
                }
            }
        };
        let source: Source = Arc::new(source);
        // Browsers cannot reach a Unix socket: any host name is allowed there.
        let named = if matches!(address, StatusAddress::Unix(_)) { BindScope::Anywhere } else { scope };
        let routes = routes(&source).layer(from_fn(move |request: Request, next: Next| async move {
            if http::is_own(request.headers(), named) {
                next.run(request).await
            } else {
                let text =
                    "pages in a browser get no answer; ask by 127.0.0.1, [::1] or localhost, without an Origin\n";
                reply(StatusCode::FORBIDDEN, TEXT, text.to_owned())
            }
        }));
        runtime.spawn(async move { axum::serve(LimitedListener::new(socket), routes).await });
        let serving = Serving::start("status", runtime)
            .map_err(|source| StatusError::Listen { address: address.clone(), source })?;
        Ok(Self { address, _serving: serving, _file: file })
    }

    /// The address it listens on, with the port that the system chose for port 0.
    pub(crate) fn address(&self) -> &StatusAddress {
        &self.address
    }
}

fn routes(source: &Source) -> Router {
    let page = |answer: fn(&DaemonReport) -> Response| {
        let source = Arc::clone(source);
        get(move || {
            let source = Arc::clone(&source);
            async move { answer(&source()) }
        })
    };
    Router::new()
        .route(
            "/",
            page(|report| {
                reply(StatusCode::OK, TEXT, view::daemon_lines(report, HostInstant::now()).join("\n") + "\n")
            }),
        )
        .route("/status", page(json))
        .route(
            "/metrics",
            page(|report| reply(StatusCode::OK, metrics::CONTENT_TYPE, metrics::text(report, HostInstant::now()))),
        )
        .route("/health", page(health))
        .fallback(|| async {
            reply(StatusCode::NOT_FOUND, TEXT, "there is /, /status, /metrics and /health\n".to_owned())
        })
}

fn json(report: &DaemonReport) -> Response {
    match serde_json::to_string(report) {
        Ok(text) => reply(StatusCode::OK, JSON, text + "\n"),
        Err(error) => reply(StatusCode::INTERNAL_SERVER_ERROR, TEXT, format!("{error}\n")),
    }
}

fn health(report: &DaemonReport) -> Response {
    let findings = report.findings(HostInstant::now());
    match findings.iter().map(|finding| format!("{finding}\n")).collect::<String>() {
        text if text.is_empty() => reply(StatusCode::OK, TEXT, "ok\n".to_owned()),
        text => reply(StatusCode::SERVICE_UNAVAILABLE, TEXT, text),
    }
}

/// An answer, after which the connection is closed.
fn reply(status: StatusCode, content_type: &'static str, text: String) -> Response {
    (status, [(CONTENT_TYPE, content_type), (CONNECTION, "close")], text).into_response()
}
