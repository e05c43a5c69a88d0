//! The status over HTTP, served and requested: `/` for people, `/status` as JSON, `/metrics` for Prometheus, `/health` for
//! probes; and one order, `POST /zero/BOARD/MILLISECONDS`.
//!
//! The server has its own thread and makes a report for each request. It has no authentication: by default it listens
//! for programs on its own host only, and never answers pages in browsers.

use std::io;
use std::io::{Read, Write};
use std::net::TcpStream;
use std::sync::Arc;
use std::time::{Duration, Instant};

use anyhow::{Context, Result, anyhow};
use axum::Router;
use axum::extract::Path;
use axum::http::StatusCode;
use axum::http::header::CONTENT_TYPE;
use axum::response::Response;
use axum::routing::{get, post};

use super::{metrics, view};
use crate::address::{Address, require_loopback};
use crate::http;
use crate::http::{BindScope, Serving};
use crate::live::Control;
use crate::platform::{LocalStream, connect_local};
use slitpose_tracking::clock::HostInstant;
use slitpose_tracking::page::Order;
use slitpose_tracking::telemetry::DaemonReport;

const TEXT: &str = "text/plain; charset=utf-8";
const JSON: &str = "application/json";

type Source = Arc<dyn Fn() -> DaemonReport + Send + Sync>;

/// Serves the reports of `source` at `address`. A socket left behind by a killed daemon is replaced.
pub(crate) fn serve_status(
    address: &Address,
    source: impl Fn() -> DaemonReport + Send + Sync + 'static,
    control: Control,
) -> Result<Serving> {
    require_loopback(address, "the status server asks for no password; give 127.0.0.1 or [::1], or a unix: path")?;
    let source: Source = Arc::new(source);
    let refusal = "pages in a browser get no answer; ask by 127.0.0.1, [::1] or localhost, without an Origin\n";
    Serving::http("status", address, BindScope::Loopback, refusal, routes(&source, Arc::new(control)), || ())
}

fn routes(source: &Source, control: Arc<Control>) -> Router {
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
        .route(
            "/zero/{board}/{milliseconds}",
            post(move |Path((board, milliseconds)): Path<(usize, u32)>| async move {
                match control(Order::Frame(board, (milliseconds > 0).then(|| f64::from(milliseconds) * 1e-3))) {
                    Ok(()) => reply(StatusCode::ACCEPTED, TEXT, "begun; /status says what becomes of it\n".to_owned()),
                    Err(reason) => reply(StatusCode::CONFLICT, TEXT, format!("{reason}\n")),
                }
            }),
        )
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

fn reply(status: StatusCode, content_type: &'static str, text: String) -> Response {
    http::reply(status, ([(CONTENT_TYPE, content_type)], text))
}

// Requests.

/// Timeout of a request: a daemon answers within milliseconds.
const WITHIN: Duration = Duration::from_secs(2);

/// Longest answer: reports take some kilobytes per board.
const MAX_BYTES: usize = 1 << 24;

/// HTTP status and text at `path` of the daemon at `address`, such as `/status`.
pub(crate) fn fetch(address: &Address, path: &str) -> Result<(u16, String)> {
    request(address, &format!("GET {path}"))
}

/// Answer of the daemon at `address` to a request of this method and path.
pub(crate) fn request(address: &Address, request: &str) -> Result<(u16, String)> {
    let connect = || {
        format!(
            "nothing answers at {address}; start a daemon with `slitpose run --status {address}`, or give its address"
        )
    };
    let answer = match address {
        Address::Tcp(to) | Address::Udp(to) => {
            let stream = TcpStream::connect_timeout(to, WITHIN).with_context(connect)?;
            ask(stream, TcpStream::set_read_timeout, request)
        }
        Address::Unix(to) => ask(connect_local(to).with_context(connect)?, LocalStream::set_read_timeout, request),
        Address::Memory(_) => Err(io::ErrorKind::Unsupported.into()),
    };
    let seconds = WITHIN.as_secs();
    let answer = answer.with_context(|| {
        format!("the answer from {address} did not come within {seconds} s; see whether the daemon still runs")
    })?;
    let other = || anyhow!("what listens at {address} is no slitpose daemon; give the address of one");
    parse(&answer).map(|(status, text)| (status, text.to_owned())).ok_or_else(other)
}

/// A request by HTTP/1.0 (RFC 1945), where the answer ends with the connection.
fn ask<S: Read + Write>(
    mut stream: S,
    set_timeout: impl Fn(&S, Option<Duration>) -> io::Result<()>,
    request: &str,
) -> io::Result<Vec<u8>> {
    let until = Instant::now() + WITHIN;
    write!(stream, "{request} HTTP/1.0\r\nHost: localhost\r\n\r\n")?;
    let (mut answer, mut chunk) = (Vec::new(), [0; 4096]);
    loop {
        let left = until.saturating_duration_since(Instant::now());
        if left.is_zero() || answer.len() > MAX_BYTES {
            return Err(io::ErrorKind::TimedOut.into());
        }
        set_timeout(&stream, Some(left))?;
        match stream.read(&mut chunk) {
            Ok(0) => return Ok(answer),
            Ok(count) => answer.extend_from_slice(&chunk[..count]),
            Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
            Err(error) => return Err(error),
        }
    }
}

fn parse(answer: &[u8]) -> Option<(u16, &str)> {
    let answer = std::str::from_utf8(answer).ok()?;
    let (head, body) = answer.split_once("\r\n\r\n")?;
    let mut words = head.lines().next()?.split(' ');
    words.next().filter(|version| version.starts_with("HTTP/1."))?;
    Some((words.next()?.parse().ok()?, body))
}

pub(crate) const DEFAULT_STATUS_ADDRESS: &str = "127.0.0.1:7450";

pub(crate) fn status_address(text: &str) -> Result<Address, String> {
    let hint = || {
        format!(
            "`{text}` is no address; give one such as {DEFAULT_STATUS_ADDRESS}, [::1]:7450, or unix:/run/slitpose/status"
        )
    };
    Address::of_stream(text).ok_or_else(hint)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_missing_daemon_and_another_program_give_different_errors() {
        let silent = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
        let address = Address::Tcp(silent.local_addr().unwrap());
        let answers =
            std::thread::spawn(move || silent.accept().map(|(mut client, _)| client.write_all(b"SSH-2.0 200\r\n\r\n")));
        let other = fetch(&address, "/status").unwrap_err().to_string();
        assert!(other.contains("is no slitpose daemon") || other.contains("did not come"), "{other}");
        answers.join().unwrap().unwrap().unwrap();
        assert!(fetch(&address, "/status").unwrap_err().to_string().contains("nothing answers"));
    }

    #[test]
    fn addresses_are_read_as_they_are_written() {
        for text in [DEFAULT_STATUS_ADDRESS, "[::1]:7450", "0.0.0.0:1", "unix:/run/slitpose/status"] {
            assert_eq!(status_address(text).unwrap().to_string(), text);
        }
        assert_eq!(status_address("localhost:7450"), status_address(DEFAULT_STATUS_ADDRESS));
        for text in ["", "7450", ":7450", "127.0.0.1", "127.0.0.1:99999", "unix:", "example.org:80", "localhost:x"] {
            assert!(status_address(text).is_err(), "{text}");
        }
    }
}
