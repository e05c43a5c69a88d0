//! Requests the status of a daemon.

use std::fmt;
use std::io::{self, Read, Write};
use std::net::{SocketAddr, TcpStream};
use std::os::unix::net::UnixStream;
use std::path::PathBuf;
use std::str::FromStr;
use std::time::{Duration, Instant};

use slitpose_head::foreign::printable;
use thiserror::Error;

use crate::http;

/// Timeout of a request: a daemon answers within milliseconds.
const WITHIN: Duration = Duration::from_secs(2);

/// Longest answer: reports take some kilobytes per board.
const MAX_BYTES: usize = 1 << 24;

#[derive(Debug, Error)]
pub(crate) enum FetchError {
    #[error("nothing answers at {address}; start a daemon with `slitpose run --status {address}`, or give its address")]
    Connect { address: String, source: io::Error },
    #[error("the answer from {address} did not come within {} s; see whether the daemon still runs", WITHIN.as_secs())]
    Broken { address: String, source: io::Error },
    #[error("what listens at {address} is no slitpose daemon; give the address of one")]
    NotHttp { address: String },
    #[error("{address} answers {status} to {path}: {}", printable(text))]
    Status { address: String, path: String, status: u16, text: String },
}

/// The text at `path` of the daemon at `address`, such as `/status`.
pub(crate) fn fetch(address: &StatusAddress, path: &str) -> Result<String, FetchError> {
    let connect = |source| FetchError::Connect { address: address.to_string(), source };
    let answer = match address {
        StatusAddress::Tcp(to) => {
            ask(TcpStream::connect_timeout(to, WITHIN).map_err(connect)?, TcpStream::set_read_timeout, path)
        }
        StatusAddress::Unix(to) => ask(UnixStream::connect(to).map_err(connect)?, UnixStream::set_read_timeout, path),
    };
    let answer = answer.map_err(|source| FetchError::Broken { address: address.to_string(), source })?;
    match parse(&answer) {
        Some((200, text)) => Ok(text.to_owned()),
        Some((status, text)) => Err(FetchError::Status {
            address: address.to_string(),
            path: path.to_owned(),
            status,
            text: text.trim_end().to_owned(),
        }),
        None => Err(FetchError::NotHttp { address: address.to_string() }),
    }
}

/// A request by HTTP/1.0 (RFC 1945), where the answer ends with the connection.
fn ask<S: Read + Write>(
    mut stream: S,
    set_timeout: impl Fn(&S, Option<Duration>) -> io::Result<()>,
    path: &str,
) -> io::Result<Vec<u8>> {
    let until = Instant::now() + WITHIN;
    write!(stream, "GET {path} HTTP/1.0\r\nHost: localhost\r\n\r\n")?;
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

/// The default address of `slitpose status`.
pub(crate) const DEFAULT_STATUS_ADDRESS: &str = "127.0.0.1:7450";

/// Prefix that distinguishes a path from a host.
const UNIX: &str = "unix:";

/// An address to listen on, or to connect to.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum StatusAddress {
    Tcp(SocketAddr),
    Unix(PathBuf),
}

/// A text that is not a [`StatusAddress`].
#[derive(Clone, Debug, PartialEq, Eq, Error)]
#[error("`{text}` is no address; give one such as {DEFAULT_STATUS_ADDRESS}, [::1]:7450, or unix:/run/slitpose/status")]
pub struct AddressError {
    pub text: String,
}

impl FromStr for StatusAddress {
    type Err = AddressError;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        let error = || AddressError { text: text.to_owned() };
        if let Some(path) = text.strip_prefix(UNIX) {
            return if path.is_empty() { Err(error()) } else { Ok(Self::Unix(path.into())) };
        }
        http::tcp_address(text).map(Self::Tcp).ok_or_else(error)
    }
}

impl fmt::Display for StatusAddress {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Tcp(address) => address.fmt(f),
            Self::Unix(path) => write!(f, "{UNIX}{}", path.display()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn answers_are_read_and_other_things_are_not() {
        assert_eq!(
            parse(b"HTTP/1.0 200 OK\r\nContent-Type: text/plain\r\n\r\nok\r\n\r\nx"),
            Some((200, "ok\r\n\r\nx"))
        );
        assert_eq!(parse(b"HTTP/1.1 503 Service Unavailable\r\n\r\n"), Some((503, "")));
        for other in
            [&b""[..], b"SSH-2.0-OpenSSH\r\n\r\n", b"HTTP/1.1 200 OK\r\n", b"HTTP/1.1\r\n\r\n", b"\xff\r\n\r\n"]
        {
            assert_eq!(parse(other), None, "{other:?}");
        }
    }

    #[test]
    fn a_missing_daemon_and_another_program_give_different_errors() {
        let silent = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
        let address = StatusAddress::Tcp(silent.local_addr().unwrap());
        let answers =
            std::thread::spawn(move || silent.accept().map(|(mut client, _)| client.write_all(b"SSH-2.0\r\n")));
        assert!(matches!(fetch(&address, "/status"), Err(FetchError::NotHttp { .. } | FetchError::Broken { .. })));
        answers.join().unwrap().unwrap().unwrap();
        assert!(matches!(fetch(&address, "/status"), Err(FetchError::Connect { .. })));
    }

    #[test]
    fn addresses_are_read_as_they_are_written() {
        for text in [DEFAULT_STATUS_ADDRESS, "[::1]:7450", "0.0.0.0:1", "unix:/run/slitpose/status"] {
            assert_eq!(text.parse::<StatusAddress>().unwrap().to_string(), text);
        }
        assert_eq!("localhost:7450".parse(), DEFAULT_STATUS_ADDRESS.parse::<StatusAddress>());
        for text in ["", "7450", ":7450", "127.0.0.1", "127.0.0.1:99999", "unix:", "example.org:80", "localhost:x"] {
            assert!(text.parse::<StatusAddress>().is_err(), "{text}");
        }
    }
}
