//! The address of a daemon's status.

use std::fmt;
use std::net::SocketAddr;
use std::path::PathBuf;
use std::str::FromStr;

use thiserror::Error;

use crate::http;

/// The default address of `slitpose status`.
pub(crate) const DEFAULT_STATUS_ADDRESS: &str = "127.0.0.1:7450";

/// Prefix that distinguishes a path from a host.
const UNIX: &str = "unix:";

/// An address to listen on, or to connect to.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum StatusAddress {
    /// A TCP port.
    Tcp(SocketAddr),
    /// A socket in the file system.
    Unix(PathBuf),
}

/// A text that is not a [`StatusAddress`].
#[derive(Clone, Debug, PartialEq, Eq, Error)]
#[error("`{text}` is no address; give one such as {DEFAULT_STATUS_ADDRESS}, [::1]:7450, or unix:/run/slitpose/status")]
pub struct AddressError {
    /// The text.
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
