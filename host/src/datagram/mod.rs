//! The newest pose, as a datagram, for control loops.
//!
//! A client sends a [`Request`] to one of the daemon's sockets, on a Unix socket or on UDP. It asks
//! for the newest datagram of each board once, or for all of them for some seconds. All datagrams are
//! of one size: [`PoseDatagram`] has their layout, and `include/slitpose_pose.h` says it in C, with
//! functions to receive them.
//!
//! A datagram goes out from the thread that solved it, with nothing between solver and socket.
//! Who may write to a Unix socket its permissions say. On UDP everybody on the host may, and under any address:
//! there a client is served once it has echoed a cookie that was sent to it. Places of followers are few; users
//! share them evenly, and a client without a place is told so.
//!
//! Nothing there waits: sockets do not block, requests come through a bounded queue, and the newest
//! datagram is left for answers in a slot whose writer waits for no reader. A client that does not
//! read fills its own queue and no other; what it misses is counted, and it is told how many.

mod address;
mod cookie;
mod error;
mod layout;
mod leases;
mod publisher;
mod server;
mod shared;
mod slot;
mod socket;
mod subscription;
#[cfg(test)]
mod tests;

pub use address::{Address, AddressError};
pub use error::DatagramError;
pub use layout::{Answer, Mode, PoseDatagram, Request};
pub use publisher::Publisher;
pub use server::{DatagramCounts, DatagramServer};
