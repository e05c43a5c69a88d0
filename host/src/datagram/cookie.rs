//! Proof that a client on UDP receives at its sender address.
//!
//! A UDP sender can forge its address. Without proof, a request of 24 bytes would direct thousands of datagrams
//! to a host that never asked. So a client is first sent a cookie, no longer than its request, and is served
//! once it has echoed the cookie. The server keeps no state for it: a cookie is a keyed hash of address and time,
//! as in TCP (Bernstein's SYN cookies, RFC 4987, section 3.6).

use std::hash::{BuildHasher, RandomState};
use std::net::SocketAddr;

/// A cookie is valid in its own epoch and in the next one. Clients that follow send a request each second.
const EPOCH_NS: u64 = 10_000_000_000;

/// Makes and verifies cookies by SipHash, with a random key for each server.
#[derive(Debug, Default)]
pub(super) struct Cookies(RandomState);

/// Validity of a cookie.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Worth {
    /// It proves the address.
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
