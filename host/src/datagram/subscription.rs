//! Clients that follow boards: places are few, and shared evenly between users.

use std::hash::{BuildHasher, RandomState};
use std::net::SocketAddr;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use super::socket::Peer;
use slitpose_tracking::link::DeviceId;
use slitpose_tracking::telemetry::SlowClient;

/// Most clients that follow a board at once: each costs the solver some microseconds per scan.
pub(super) const MAX_FOLLOWERS: usize = 16;

/// Most changes of followers that wait for their publisher.
pub(super) const MAX_NEWS: usize = 4 * MAX_FOLLOWERS;

/// A client without a full queue for this long reads fast enough; one with full queues for longer does not.
const SLOW_NS: u64 = 1_000_000_000;

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

impl Subscription {
    /// Whether both belong to the same client.
    pub(super) fn is_of(&self, other: &Self) -> bool {
        self.socket == other.socket && self.peer == other.peer
    }

    pub(super) fn slow(&self, now_ns: u64) -> Option<SlowClient> {
        let [missed, since_ns, last_ns] =
            [&self.misses.count, &self.misses.since_ns, &self.misses.last_ns].map(|it| it.load(Ordering::Relaxed));
        let is_slow = now_ns.saturating_sub(last_ns) < SLOW_NS && last_ns.saturating_sub(since_ns) >= SLOW_NS;
        let (process, user) = self.peer.owner();
        is_slow.then(|| SlowClient { process, user, missed, missing_s: now_ns.saturating_sub(since_ns) as f64 * 1e-9 })
    }
}

impl Misses {
    pub(super) fn count(&self) -> u64 {
        self.count.load(Ordering::Relaxed)
    }

    pub(super) fn add(&self, now_ns: u64) {
        if now_ns.saturating_sub(self.last_ns.swap(now_ns, Ordering::Relaxed)) >= SLOW_NS {
            self.since_ns.store(now_ns, Ordering::Relaxed);
        }
        self.count.fetch_add(1, Ordering::Relaxed);
    }
}

/// Most leases: all places of four boards.
const MAX_LEASES: usize = 4 * MAX_FOLLOWERS;

/// Which client follows which board, and until when; the boards may be missing yet.
#[derive(Debug, Default)]
pub(super) struct Leases(Vec<Lease>);

#[derive(Clone, Debug)]
pub(super) struct Lease {
    pub(super) device: Option<DeviceId>,
    pub(super) subscription: Subscription,
}

impl Lease {
    fn is_of(&self, device: Option<DeviceId>) -> bool {
        self.device.is_none() || device.is_none() || self.device == device
    }

    fn user(&self) -> Option<u32> {
        self.subscription.peer.owner().1
    }
}

impl Leases {
    /// Adds a new lease, or renews a known one.
    ///
    /// If all places are taken, the user with most of them loses its latest, as long as it has two more than the one
    /// that asks: so no user can exclude another, however many clients it starts. All clients by UDP count as one user. Returns the client's subscription
    /// and the leases that have ended for it; `None` if it gets no place.
    pub(super) fn renew(
        &mut self,
        device: Option<DeviceId>,
        new: &Subscription,
        now_ns: u64,
    ) -> Option<(Subscription, Vec<Lease>)> {
        self.0.retain(|lease| lease.subscription.until_ns >= now_ns);
        let known = self.0.iter_mut().find(|lease| lease.device == device && lease.subscription.is_of(new));
        if let Some(lease) = known {
            lease.subscription.until_ns = new.until_ns;
            return Some((lease.subscription.clone(), Vec::new()));
        }
        let mut lost = Vec::new();
        while let Some(contested) = self.contested(device) {
            let Some(loser) = self.loser(&contested, new.peer.owner().1) else {
                // The places lost in vain are restored.
                self.0.append(&mut lost);
                return None;
            };
            lost.push(self.0.remove(loser));
        }
        self.0.push(Lease { device, subscription: new.clone() });
        Some((new.clone(), lost))
    }

    /// Indices of the leases of which one must end before there is a place for `device`.
    fn contested(&self, device: Option<DeviceId>) -> Option<Vec<usize>> {
        let of = |device: Option<DeviceId>| -> Vec<usize> {
            let is_meant = |lease: &Lease| lease.device.is_none() || lease.device == device;
            (0..self.0.len()).filter(|&number| is_meant(&self.0[number])).collect()
        };
        let boards = self.0.iter().filter(|lease| lease.is_of(device)).map(|lease| lease.device);
        let fullest = boards.chain([device]).map(of).max_by_key(Vec::len);
        let is_full = |places: &Vec<usize>| places.len() >= MAX_FOLLOWERS;
        let all = (self.0.len() >= MAX_LEASES).then(|| (0..self.0.len()).collect());
        fullest.filter(is_full).or(all)
    }

    /// Index of the lease in `contested` that must end for one more of `user`.
    fn loser(&self, contested: &[usize], user: Option<u32>) -> Option<usize> {
        let count = |user: Option<u32>| contested.iter().filter(|&&number| self.0[number].user() == user).count();
        let most = contested.iter().copied().max_by_key(|&number| (count(self.0[number].user()), number))?;
        (count(self.0[most].user()) >= count(user) + 2).then_some(most)
    }

    pub(super) fn of(&self, device: DeviceId, now_ns: u64) -> impl Iterator<Item = &Subscription> {
        let is_meant = move |lease: &&Lease| lease.device.is_none_or(|wanted| wanted == device);
        self.valid(now_ns).filter(is_meant).map(|lease| &lease.subscription)
    }

    /// Leases that have not ended.
    pub(super) fn valid(&self, now_ns: u64) -> impl Iterator<Item = &Lease> {
        self.0.iter().filter(move |lease| lease.subscription.until_ns >= now_ns)
    }
}

// A UDP sender can forge its address. Without proof, a request of 24 bytes would direct thousands of datagrams
// to a host that never asked. So a client is first sent a cookie, no longer than its request, and is served
// once it has echoed the cookie. The server keeps no state for it: a cookie is a keyed hash of address and time,
// as in TCP (Bernstein's SYN cookies, RFC 4987, section 3.6).

/// A cookie is valid in its own epoch and in the next one. Clients that follow send a request each second.
const EPOCH_NS: u64 = 10_000_000_000;

/// Makes and verifies cookies by SipHash, with a random key for each server.
#[derive(Debug, Default)]
pub(super) struct Cookies(RandomState);

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Worth {
    Good,
    /// It proves the address, but expires soon; with the next cookie.
    Old(u64),
    /// It is invalid; with a valid cookie.
    Nothing(u64),
}

impl Cookies {
    /// Validity of the `cookie` of a client at `address` at `now_ns` by CLOCK_MONOTONIC.
    pub(super) fn judge(&self, address: SocketAddr, cookie: u64, now_ns: u64) -> Worth {
        let epoch = now_ns / EPOCH_NS;
        let of = |epoch: u64| self.0.hash_one((address, epoch)).max(1);
        match cookie {
            cookie if cookie == of(epoch) => Worth::Good,
            cookie if epoch > 0 && cookie == of(epoch - 1) => Worth::Old(of(epoch)),
            _ => Worth::Nothing(of(epoch)),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_cookie_proves_one_address_for_some_seconds() {
        let cookies = Cookies::default();
        let [here, there]: [SocketAddr; 2] = ["127.0.0.1:4000", "127.0.0.1:4001"].map(|text| text.parse().unwrap());
        let Worth::Nothing(cookie) = cookies.judge(here, 0, EPOCH_NS) else { panic!("zero is no cookie") };
        assert_eq!(cookies.judge(here, cookie, 2 * EPOCH_NS - 1), Worth::Good);
        let Worth::Old(next) = cookies.judge(here, cookie, 2 * EPOCH_NS) else { panic!("too old too early") };
        assert_eq!(cookies.judge(here, next, 2 * EPOCH_NS), Worth::Good);
        assert_eq!(cookies.judge(here, cookie, 3 * EPOCH_NS - 1), Worth::Old(next));
        assert!(matches!(cookies.judge(here, cookie, 3 * EPOCH_NS), Worth::Nothing(_)));
        assert!(matches!(cookies.judge(there, cookie, EPOCH_NS), Worth::Nothing(_)));
        // Another server has another key.
        assert!(matches!(Cookies::default().judge(here, cookie, EPOCH_NS), Worth::Nothing(_)));
    }
}
