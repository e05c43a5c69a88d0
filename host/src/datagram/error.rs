//! Why datagrams cannot be served.

use std::io;
use std::path::PathBuf;

use thiserror::Error;

use super::{Address, AddressError};

/// Why datagrams cannot be served.
#[derive(Debug, Error)]
pub enum DatagramError {
    /// Another daemon uses the socket.
    #[error("{} is in use by another program that runs; give another path, or stop that program", path.display())]
    InUse {
        /// The socket.
        path: PathBuf,
    },
    /// The path is that of another kind of file.
    #[error("{} exists and is no socket; give another path", path.display())]
    NotASocket {
        /// The file.
        path: PathBuf,
    },
    /// The address cannot be bound.
    #[error("cannot listen on {address}; check that its folder exists and may be written to, or that the port is free")]
    Bind {
        /// The address.
        address: Address,
        /// The system's error.
        source: io::Error,
    },
    /// The address is not permitted.
    #[error(transparent)]
    Address(#[from] AddressError),
    /// The system does not start a thread.
    #[error("cannot start a thread for requests")]
    Thread(#[source] io::Error),
}
