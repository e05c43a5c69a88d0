//! The newest pose, as a datagram, for control loops.
//!
//! A client sends a [`Request`] to one of the daemon's sockets, on a Unix socket or on UDP, for the newest
//! datagram of each board once, or for all datagrams of some seconds. All datagrams have one size:
//! [`PoseDatagram`] has their layout, and `include/slitpose_pose.h` defines it in C, with functions to
//! receive them.
//!
//! A datagram is sent by the thread that solved it, with no queue between solver and socket. The permissions
//! of a Unix socket decide which users may connect. On UDP every user of the host may, and can forge its
//! address: there a client is served once it has echoed a cookie. Places of followers are few; users share
//! them evenly, and a client without a place is notified.
//!
//! Each client has a queue of its own. On a Unix socket a datagram waits in the send buffer of the socket that sent it:
//! from one socket for all, a client that does not read would fill that buffer for the others (unix(7); in Linux,
//! `unix_dgram_sendmsg` charges the sender until the receiver has read). So a client makes a socket pair and passes one
//! end with each request, and the daemon sends from that end. Clients that pass none are answered by their names, from
//! the daemon's socket: they share its buffer among themselves, and with nobody else. On UDP a datagram waits in the
//! receiver's buffer.
//!
//! The sending thread never waits: sockets do not block, requests come through a bounded queue, and the
//! newest datagram is stored for answers in a slot whose writer waits for no reader. The datagrams that a client misses
//! are counted and reported to it; one that misses some for over a second is a finding.

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

use std::sync::atomic;

pub use address::{Address, AddressError};
pub use error::DatagramError;
pub use layout::{Answer, Mode, PoseDatagram, Request};
pub use publisher::Publisher;
pub use server::{DatagramCounts, DatagramServer};
pub use subscription::SlowClient;

/// Attempts to copy the newest datagram undisturbed. A copy takes a ten-thousandth of the time between two scans.
const ATTEMPTS: usize = 100;
