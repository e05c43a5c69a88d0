//! Clients that follow boards.

use super::socket::Peer;

/// Most clients that follow a board at once: each costs the solver some microseconds per scan.
pub(super) const MAX_FOLLOWERS: usize = 16;

/// Most changes of followers that wait for their publisher.
pub(super) const MAX_NEWS: usize = 4 * MAX_FOLLOWERS;

/// A client that follows.
#[derive(Clone, Debug)]
pub(super) struct Subscription {
    /// Index of the daemon's socket that it wrote to.
    pub(super) socket: usize,
    pub(super) peer: Peer,
    /// End of the lease, CLOCK_MONOTONIC; 0 for a client that has lost its place.
    pub(super) until_ns: u64,
}

impl Subscription {
    /// Whether both belong to the same client.
    pub(super) fn is_of(&self, other: &Self) -> bool {
        self.socket == other.socket && self.peer == other.peer
    }
}
