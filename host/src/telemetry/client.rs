//! Requests the status of a daemon.

use std::io::{self, Read, Write};
use std::net::TcpStream;
use std::os::unix::net::UnixStream;
use std::time::{Duration, Instant};

use thiserror::Error;

use super::StatusAddress;
use slitpose_head::foreign::printable;

/// Timeout of a request: a daemon answers within milliseconds.
const WITHIN: Duration = Duration::from_secs(2);

/// Longest answer: reports take some kilobytes per board.
const MOST_BYTES: usize = 1 << 24;

/// Why the request failed.
#[derive(Debug, Error)]
pub(crate) enum FetchError {
    /// No program listens at the address.
    #[error("nothing answers at {address}; start a daemon with `slitpose run --status {address}`, or give its address")]
    Connect {
        /// The address.
        address: String,
        /// The system's error.
        source: io::Error,
    },
    /// The answer was incomplete, or did not come.
    #[error("the answer from {address} did not come within {} s; see whether the daemon still runs", WITHIN.as_secs())]
    Broken {
        /// The address.
        address: String,
        /// The system's error.
        source: io::Error,
    },
    /// Another program listens at the address.
    #[error("what listens at {address} is no slitpose daemon; give the address of one")]
    NotHttp {
        /// The address.
        address: String,
    },
    /// The daemon answers with a status other than 200.
    #[error("{address} answers {status} to {path}: {}", printable(text))]
    Status {
        /// The address.
        address: String,
        /// The requested path.
        path: String,
        /// The HTTP status.
        status: u16,
        /// The body of the answer.
        text: String,
    },
}

/// The text at `path` of the daemon at `address`, such as `/status`.
///
/// # Errors
/// If there is no answer with the status 200 within two seconds.
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
        if left.is_zero() || answer.len() > MOST_BYTES {
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

/// Status and body of an answer.
fn parse(answer: &[u8]) -> Option<(u16, &str)> {
    let answer = std::str::from_utf8(answer).ok()?;
    let (head, body) = answer.split_once("\r\n\r\n")?;
    let mut words = head.lines().next()?.split(' ');
    words.next().filter(|version| version.starts_with("HTTP/1."))?;
    Some((words.next()?.parse().ok()?, body))
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
}
