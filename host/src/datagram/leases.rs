//! The clients that follow boards: places are few, and shared evenly between users.

use super::socket::Party;
use super::subscription::{MAX_FOLLOWERS, Subscription};
use crate::link::DeviceId;

/// Most leases: all places of four boards.
const MAX_LEASES: usize = 4 * MAX_FOLLOWERS;

/// Which client follows which board, and until when; the boards may be missing yet.
#[derive(Debug, Default)]
pub(super) struct Leases(Vec<Lease>);

/// A place of a client.
#[derive(Clone, Debug)]
pub(super) struct Lease {
    /// `None`: every board.
    pub(super) device: Option<DeviceId>,
    pub(super) subscription: Subscription,
}

/// The answer to a request for a place.
#[derive(Debug)]
pub(super) enum Admission {
    /// The client has a place, as this subscription.
    Kept(Subscription),
    /// Granted as this subscription; other clients have lost their places for it.
    Instead(Subscription, Vec<Lease>),
    /// The client gets no place.
    Refused,
}

impl Lease {
    fn is_of(&self, device: Option<DeviceId>) -> bool {
        self.device.is_none() || device.is_none() || self.device == device
    }

    fn party(&self) -> Party {
        self.subscription.peer.party()
    }
}

impl Leases {
    /// Adds a new lease, or renews a known one.
    ///
    /// If all places are taken, the party with most of them loses its latest, as long as it has two more than the
    /// party that asks: so no user can exclude another, however many clients it starts.
    pub(super) fn renew(&mut self, device: Option<DeviceId>, new: &Subscription, now_ns: u64) -> Admission {
        self.0.retain(|lease| lease.subscription.until_ns >= now_ns);
        let known = self.0.iter_mut().find(|lease| lease.device == device && lease.subscription.is_of(new));
        if let Some(lease) = known {
            lease.subscription.until_ns = new.until_ns;
            return Admission::Kept(lease.subscription.clone());
        }
        let mut lost = Vec::new();
        while let Some(contested) = self.contested(device) {
            let Some(loser) = self.loser(&contested, new.peer.party()) else {
                // The places lost in vain are restored.
                self.0.append(&mut lost);
                return Admission::Refused;
            };
            lost.push(self.0.remove(loser));
        }
        self.0.push(Lease { device, subscription: new.clone() });
        if lost.is_empty() { Admission::Kept(new.clone()) } else { Admission::Instead(new.clone(), lost) }
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

    /// Index of the lease in `contested` that must end for one more of `party`.
    fn loser(&self, contested: &[usize], party: Party) -> Option<usize> {
        let count = |party: Party| contested.iter().filter(|&&number| self.0[number].party() == party).count();
        let most = contested.iter().copied().max_by_key(|&number| (count(self.0[number].party()), number))?;
        (count(self.0[most].party()) >= count(party) + 2).then_some(most)
    }

    /// The subscriptions of a board.
    pub(super) fn of(&self, device: DeviceId, now_ns: u64) -> impl Iterator<Item = &Subscription> {
        let is_meant = move |lease: &&Lease| lease.device.is_none_or(|wanted| wanted == device);
        self.valid(now_ns).filter(is_meant).map(|lease| &lease.subscription)
    }

    /// Leases that have not ended.
    pub(super) fn valid(&self, now_ns: u64) -> impl Iterator<Item = &Lease> {
        self.0.iter().filter(move |lease| lease.subscription.until_ns >= now_ns)
    }
}
