//! What crosses between a link to a board and those who read it: what came and when, whose it is, and of
//! which firmware.

mod id;
mod segment;
mod version;

pub use id::{DeviceId, DeviceIdError};
pub use segment::{Asked, Read, Segment};
pub use version::Versions;
