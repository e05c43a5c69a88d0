//! Why datagrams cannot be served.

use std::io;
use std::path::PathBuf;

use thiserror::Error;

use super::{Address, AddressError};

/// Why datagrams cannot be served.
#[derive(Debug, Error)]
pub enum DatagramError {
    /// Another daemon answers there.
    #[error("{} is in use by another program that runs; give another path, or stop that program", path.display())]
    InUse {
        /// The socket.
        path: PathBuf,
    },
    /// Something else lies there.
    #[error("{} exists and is no socket; give another path", path.display())]
    NotASocket {
        /// The file.
        path: PathBuf,
    },
    /// The system does not want it.
    #[error("cannot listen on {address}; check that its folder exists and may be written to, or that the port is free")]
    Bind {
        /// Where.
        address: Address,
        /// The system's error.
        source: io::Error,
    },
    /// Nothing to listen on.
    #[error(transparent)]
    Address(#[from] AddressError),
    /// No thread.
    #[error("cannot start a thread for requests")]
    Thread(#[source] io::Error),
}
