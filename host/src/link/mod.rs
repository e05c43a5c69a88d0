//! Data of a link: bytes with their instants, the board's number, its version of the protocol, and its start.

mod id;
mod segment;
mod start;
mod version;

pub use id::{DeviceId, DeviceIdError};
pub use segment::{Asked, Read, Segment};
pub(crate) use start::{contradicted_crystal, start_findings};
pub use version::Versions;
