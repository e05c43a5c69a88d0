//! The sending side, on the thread that solves.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use crossbeam_channel::Receiver;

use super::PoseDatagram;
use super::slot::Slot;
use super::socket::{Delivery, Socket};
use super::subscription::{MAX_FOLLOWERS, MAX_NEWS, Subscription};
use slitpose_tracking::clock::HostInstant;
use slitpose_tracking::pipeline::Record;

/// Sends the poses of one board. Never waits, takes no lock, allocates nothing.
#[derive(Debug)]
pub struct Publisher {
    shared: Arc<Shared>,
    slot: Arc<Slot>,
    subscriptions: Receiver<Subscription>,
    followers: Vec<Subscription>,
    number: u64,
    missed: u64,
    is_behind: bool,
}

impl Publisher {
    pub(super) fn new(shared: Arc<Shared>, slot: Arc<Slot>, subscriptions: Receiver<Subscription>) -> Self {
        Self {
            shared,
            slot,
            subscriptions,
            followers: Vec::with_capacity(MAX_FOLLOWERS),
            number: 0,
            missed: 0,
            is_behind: false,
        }
    }

    /// Number of datagrams that followers have missed because they did not read in time.
    pub fn missed(&self) -> u64 {
        self.missed
    }

    /// Sets whether the next poses are marked as those of a solver that is behind.
    pub(crate) fn set_behind(&mut self, is_behind: bool) {
        self.is_behind = is_behind;
    }

    /// Sends a pose to all followers, and stores it for clients that request the newest.
    pub fn publish(&mut self, record: &Record, now: HostInstant) {
        self.number += 1;
        let mut datagram = PoseDatagram::new(record, self.number, now);
        if self.is_behind {
            datagram.mark_behind();
        }
        self.slot.store(&datagram);
        for subscription in self.subscriptions.try_iter().take(MAX_NEWS) {
            admit(&mut self.followers, subscription, &self.shared.counters);
        }
        self.followers.retain(|follower| now.monotonic_ns <= follower.until_ns);
        let Shared { sockets, counters } = &*self.shared;
        let missed_by_all = &mut self.missed;
        self.followers.retain(|Subscription { socket, peer, misses, .. }| {
            datagram.set_missed(misses.count());
            match sockets[*socket].send(datagram.as_bytes(), peer) {
                Delivery::Sent => Counters::count(&counters.sent),
                Delivery::Full => {
                    misses.add(now.monotonic_ns);
                    *missed_by_all += 1;
                    Counters::count(&counters.missed);
                }
                Delivery::Gone => return false,
            }
            true
        });
    }
}

/// Adds a client, or renews the lease of a known one.
fn admit(followers: &mut Vec<Subscription>, new: Subscription, counters: &Counters) {
    if new.until_ns == 0 {
        followers.retain(|known| !known.is_of(&new));
    } else if let Some(known) = followers.iter_mut().find(|known| known.is_of(&new)) {
        known.until_ns = new.until_ns;
    } else if followers.len() < MAX_FOLLOWERS {
        followers.push(new);
    } else {
        Counters::count(&counters.refused);
    }
}

#[derive(Debug, Default)]
pub(super) struct Counters {
    pub(super) requests: AtomicU64,
    pub(super) places_refused: AtomicU64,
    pub(super) unproven: AtomicU64,
    pub(super) refused: AtomicU64,
    pub(super) sent: AtomicU64,
    pub(super) missed: AtomicU64,
}

impl Counters {
    pub(super) fn count(counter: &AtomicU64) {
        counter.fetch_add(1, Ordering::Relaxed);
    }
}

#[derive(Debug)]
pub(super) struct Shared {
    pub(super) sockets: Vec<Socket>,
    pub(super) counters: Counters,
}
