//! Clients that follow boards.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use schemars::JsonSchema;
use serde::Serialize;

use super::socket::{Party, Peer};

/// Most clients that follow a board at once: each costs the solver some microseconds per scan.
pub(super) const MAX_FOLLOWERS: usize = 16;

/// Most changes of followers that wait for their publisher.
pub(super) const MAX_NEWS: usize = 4 * MAX_FOLLOWERS;

/// A client without a full queue for this long reads fast enough; one with full queues for longer does not.
const SLOW_NS: u64 = 1_000_000_000;

/// A client that follows.
#[derive(Clone, Debug)]
pub(super) struct Subscription {
    /// Index of the daemon's socket that it wrote to.
    pub(super) socket: usize,
    pub(super) peer: Peer,
    /// End of the lease, CLOCK_MONOTONIC; 0 for a client that has lost its place.
    pub(super) until_ns: u64,
    pub(super) misses: Arc<Misses>,
}

/// Datagrams that the full queue of a client has refused. Times are CLOCK_MONOTONIC.
#[derive(Debug, Default)]
pub(super) struct Misses {
    count: AtomicU64,
    since_ns: AtomicU64,
    last_ns: AtomicU64,
}

/// A client that has missed poses for more than a second, without a second in which it missed none.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, JsonSchema)]
pub struct SlowClient {
    /// Its process; `None` if unknown.
    pub process: Option<i32>,
    /// Its user; `None` if unknown.
    pub user: Option<u32>,
    /// Whether other clients share its queue: those that pass no socket with their requests.
    pub shares_queue: bool,
    /// Poses that it has missed.
    pub missed: u64,
    /// For how long it has missed poses, seconds.
    pub missing_s: f64,
}

impl Subscription {
    /// Whether both belong to the same client.
    pub(super) fn is_of(&self, other: &Self) -> bool {
        self.socket == other.socket && self.peer == other.peer
    }

    /// The client, if it is slow.
    pub(super) fn slow(&self, now_ns: u64) -> Option<SlowClient> {
        let [missed, since_ns, last_ns] =
            [&self.misses.count, &self.misses.since_ns, &self.misses.last_ns].map(|it| it.load(Ordering::Relaxed));
        let is_slow = now_ns.saturating_sub(last_ns) < SLOW_NS && last_ns.saturating_sub(since_ns) >= SLOW_NS;
        let user = if let Party::User(user) = self.peer.party() { user } else { None };
        is_slow.then(|| SlowClient {
            process: self.peer.process(),
            user,
            shares_queue: matches!(self.peer, Peer::Unix(_)),
            missed,
            missing_s: now_ns.saturating_sub(since_ns) as f64 * 1e-9,
        })
    }
}

impl Misses {
    pub(super) fn count(&self) -> u64 {
        self.count.load(Ordering::Relaxed)
    }

    /// Counts a datagram.
    pub(super) fn add(&self, now_ns: u64) {
        if now_ns.saturating_sub(self.last_ns.swap(now_ns, Ordering::Relaxed)) >= SLOW_NS {
            self.since_ns.store(now_ns, Ordering::Relaxed);
        }
        self.count.fetch_add(1, Ordering::Relaxed);
    }
}
