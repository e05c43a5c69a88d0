//! Clients that follow boards, for boards that are not there yet.

use super::publisher::{MAX_FOLLOWERS, Subscription};
use crate::device::DeviceId;

/// As many for each of four boards.
const MAX_LEASES: usize = 4 * MAX_FOLLOWERS;

/// Who follows what, and until when.
#[derive(Debug, Default)]
pub(super) struct Leases(Vec<Lease>);

#[derive(Debug)]
struct Lease {
    /// `None`: every board.
    device: Option<DeviceId>,
    subscription: Subscription,
}

impl Leases {
    /// Keeps a new one, or renews one that is known. One too many is not kept: its client asks again.
    pub(super) fn renew(&mut self, device: Option<DeviceId>, new: &Subscription, now_ns: u64) {
        self.0.retain(|lease| lease.subscription.until_ns >= now_ns);
        let known = self.0.iter_mut().find(|lease| lease.device == device && lease.subscription.is_of(new));
        if let Some(lease) = known {
            lease.subscription.until_ns = new.until_ns;
        } else if self.0.len() < MAX_LEASES {
            self.0.push(Lease { device, subscription: new.clone() });
        }
    }

    /// Those of a board.
    pub(super) fn of(&self, device: DeviceId, now_ns: u64) -> impl Iterator<Item = &Subscription> {
        let is_meant = move |lease: &&Lease| lease.device.is_none_or(|wanted| wanted == device);
        let wanted = self.0.iter().filter(is_meant).map(|lease| &lease.subscription);
        wanted.filter(move |subscription| subscription.until_ns >= now_ns)
    }
}
