//! Addresses of the datagram server: `unix:/run/slitpose/pose` or `udp:127.0.0.1:7440`.

use std::fmt;
use std::net::{AddrParseError, SocketAddr};
use std::path::PathBuf;
use std::str::FromStr;

use thiserror::Error;

/// An address at which clients request datagrams.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Address {
    /// A Unix socket at a path, for users with write permission on it.
    Unix(PathBuf),
    /// A UDP port of this host, for all users of the host.
    Udp(SocketAddr),
}

/// A text that is not a permitted [`Address`].
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum AddressError {
    /// Neither kind of address.
    #[error("`{text}` is no address for poses; give unix:PATH or udp:127.0.0.1:PORT")]
    Kind {
        /// The text.
        text: String,
    },
    /// A Unix socket without a path.
    #[error("`unix:` lacks the path of the socket; give unix:PATH")]
    NoPath,
    /// A UDP address that cannot be parsed.
    #[error("`{text}` is no address and port; give udp:127.0.0.1:PORT")]
    Udp {
        /// What follows `udp:`.
        text: String,
        /// The parser's error.
        source: AddrParseError,
    },
    /// Poses are not sent to other hosts.
    #[error(
        "{address} can be reached from other hosts, and poses carry no proof of their origin; give udp:127.0.0.1:PORT"
    )]
    NotLoopback {
        /// The address.
        address: SocketAddr,
    },
}

impl AddressError {
    /// Refuses addresses that other hosts can reach.
    pub(super) fn check(address: SocketAddr) -> Result<(), Self> {
        if address.ip().is_loopback() { Ok(()) } else { Err(Self::NotLoopback { address }) }
    }
}

impl FromStr for Address {
    type Err = AddressError;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        match text.split_once(':') {
            Some(("unix", "")) => Err(AddressError::NoPath),
            Some(("unix", path)) => Ok(Self::Unix(path.into())),
            Some(("udp", address)) => {
                let error = |source| AddressError::Udp { text: address.to_owned(), source };
                let address: SocketAddr = address.parse().map_err(error)?;
                AddressError::check(address)?;
                Ok(Self::Udp(address))
            }
            _ => Err(AddressError::Kind { text: text.to_owned() }),
        }
    }
}

impl fmt::Display for Address {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Unix(path) => write!(f, "unix:{}", path.display()),
            Self::Udp(address) => write!(f, "udp:{address}"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn addresses_are_read_as_they_are_written() {
        for text in ["unix:/run/slitpose/pose", "unix:pose", "udp:127.0.0.1:7440", "udp:[::1]:7440", "udp:127.9.9.9:0"]
        {
            assert_eq!(text.parse::<Address>().unwrap().to_string(), text);
        }
        for text in ["", "pose", "unix", "unix:", "tcp:127.0.0.1:1", "udp:", "udp:localhost:1", "udp:127.0.0.1"] {
            assert!(text.parse::<Address>().is_err(), "{text}");
        }
    }

    #[test]
    fn other_hosts_are_not_served() {
        for text in ["udp:0.0.0.0:7440", "udp:192.168.1.2:7440", "udp:[::]:7440"] {
            let error = text.parse::<Address>().unwrap_err();
            assert!(matches!(error, AddressError::NotLoopback { .. }), "{text}: {error}");
        }
    }
}
