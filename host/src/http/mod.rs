//! What the HTTP servers of the daemon share: limits of connections, and whose requests are answered.

mod connection;
mod origin;

pub(crate) use connection::{Door, Leash, Socket};
#[cfg(test)]
pub(crate) use connection::{LIFETIME, MOST};
pub(crate) use origin::is_own;

/// The hosts that may connect over TCP.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Reach {
    /// Programs of this host.
    Loopback,
    /// Every host that can reach the address, as permitted by the user.
    Anywhere,
}
