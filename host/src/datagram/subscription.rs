//! Who wants to be sent all datagrams.

use super::socket::Peer;

/// Clients that may follow a board at once: each costs its solver some microseconds a scan.
pub(super) const MAX_FOLLOWERS: usize = 16;

/// News of followers that may wait for their publisher.
pub(super) const MAX_NEWS: usize = 4 * MAX_FOLLOWERS;

/// A client that wants all datagrams.
#[derive(Clone, Debug)]
pub(super) struct Subscription {
    /// Which of the daemon's sockets it wrote to.
    pub(super) socket: usize,
    pub(super) peer: Peer,
    /// CLOCK_MONOTONIC; 0 for one that has lost its place.
    pub(super) until_ns: u64,
}

impl Subscription {
    /// Whether both are of the same client.
    pub(super) fn is_of(&self, other: &Self) -> bool {
        self.socket == other.socket && self.peer == other.peer
    }
}
