//! Systems on which this program shares no memory with others: asking for it names what serves instead.

use std::path::Path;
use std::sync::atomic::AtomicU64;

use crate::address::{Address, ServeError};

#[derive(Debug)]
pub(crate) enum SharedMemory {}

impl SharedMemory {
    pub(crate) fn open(path: &Path, _: [u8; 8], _: usize) -> Result<Self, ServeError> {
        Err(ServeError::NoSharedMemory { address: Address::Memory(path.to_owned()) })
    }

    pub(crate) fn word(&self, _: usize) -> &AtomicU64 {
        match *self {}
    }
}
