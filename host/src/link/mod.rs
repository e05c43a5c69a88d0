//! Data of a link: bytes with their instants, the board's number, and its version of the protocol.

mod id;
mod segment;
mod version;

pub use id::{DeviceId, DeviceIdError};
pub use segment::{Asked, Read, Segment};
pub use version::Versions;
