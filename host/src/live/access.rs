//! Who may look, and who may change something.

use std::fmt;
use std::net::SocketAddr;
use std::str::FromStr;

use thiserror::Error;

use crate::http::{self, Reach};

/// The address of the page unless another is given.
pub(crate) const DEFAULT_LIVE_ADDRESS: &str = "127.0.0.1:7451";

/// Shortest token: 16 characters are beyond guessing over a network.
const LEAST_TOKEN: usize = 16;

/// A host and a port to listen on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct LiveAddress(pub(super) SocketAddr);

/// Why a page cannot be served so.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub(crate) enum AccessError {
    #[error("`{text}` is no address; give one such as {DEFAULT_LIVE_ADDRESS}, [::1]:7451 or 0.0.0.0:7451")]
    Address { text: String },
    #[error(
        "{address} can be reached from other hosts: give --live-token with a secret of {LEAST_TOKEN} characters or more, \
         or listen on 127.0.0.1"
    )]
    NoToken { address: SocketAddr },
    #[error("a token of {found} characters can be guessed; give --live-token with {LEAST_TOKEN} characters or more")]
    ShortToken { found: usize },
    #[error("a token has letters, digits, `-`, `_`, `.` and `~` only; `{letter}` is none of them")]
    Letter {
        /// The first other one.
        letter: char,
    },
}

impl FromStr for LiveAddress {
    type Err = AccessError;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        http::tcp_address(text).map(Self).ok_or_else(|| AccessError::Address { text: text.to_owned() })
    }
}

impl fmt::Display for LiveAddress {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.fmt(f)
    }
}

#[derive(Clone, PartialEq, Eq)]
pub(crate) struct Access {
    pub(super) address: SocketAddr,
    token: Option<String>,
    /// Whether a page may start recordings and move a replay.
    may_write: bool,
}

impl fmt::Debug for Access {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { address, token, may_write } = self;
        let token = token.as_ref().map(|_| "…");
        f.debug_struct("Access").field("address", address).field("token", &token).field("may_write", may_write).finish()
    }
}

impl Access {
    /// Pages at `address`. Those of other hosts need `token`, and change something only if `writes` allows it.
    pub(crate) fn new(address: LiveAddress, token: Option<String>, writes: bool) -> Result<Self, AccessError> {
        let LiveAddress(address) = address;
        if let Some(token) = &token {
            let is_plain = |letter: &char| letter.is_ascii_alphanumeric() || "-_.~".contains(*letter);
            if let Some(letter) = token.chars().find(|letter| !is_plain(letter)) {
                return Err(AccessError::Letter { letter });
            }
            if token.len() < LEAST_TOKEN {
                return Err(AccessError::ShortToken { found: token.len() });
            }
        }
        let is_local = address.ip().is_loopback();
        if !is_local && token.is_none() {
            return Err(AccessError::NoToken { address });
        }
        Ok(Self { address, token, may_write: is_local || writes })
    }

    /// Whether a page may start recordings and move a replay.
    pub(crate) fn may_write(&self) -> bool {
        self.may_write
    }

    /// The hosts that may connect.
    pub(super) fn reach(&self) -> Reach {
        if self.address.ip().is_loopback() { Reach::Loopback } else { Reach::Anywhere }
    }

    /// Whether `token` is the right one, or none is needed. Takes the same time for every wrong one of the right length.
    pub(super) fn admits(&self, token: Option<&str>) -> bool {
        let Some(own) = &self.token else { return true };
        let token = token.unwrap_or_default();
        let differences = own.bytes().zip(token.bytes()).fold(0, |sum, (own, other)| sum | (own ^ other));
        own.len() == token.len() && std::hint::black_box(differences) == 0
    }

    /// The URL of the page at the address that was bound.
    pub(super) fn url(&self, bound: SocketAddr) -> String {
        let token = self.token.as_ref().map_or(String::new(), |token| format!("#token={token}"));
        // A browser cannot ask for "every address".
        let host = match bound.ip() {
            ip if ip.is_unspecified() => "127.0.0.1".to_owned(),
            std::net::IpAddr::V6(ip) => format!("[{ip}]"),
            ip => ip.to_string(),
        };
        format!("http://{host}:{}/{token}", bound.port())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const TOKEN: &str = "correct-horse-battery";

    fn access(address: &str, token: Option<&str>, writes: bool) -> Result<Access, AccessError> {
        Access::new(address.parse().unwrap(), token.map(str::to_owned), writes)
    }

    #[test]
    fn other_hosts_need_a_token_and_leave_to_write() {
        for local in [DEFAULT_LIVE_ADDRESS, "localhost:0", "[::1]:7451", "127.8.9.1:80"] {
            let open = access(local, None, false).unwrap();
            assert!(open.may_write && open.reach() == Reach::Loopback && open.admits(None), "{local}");
        }
        for wide in ["0.0.0.0:7451", "[::]:7451", "192.0.2.1:80"] {
            assert!(matches!(access(wide, None, true), Err(AccessError::NoToken { .. })), "{wide}");
            let guarded = access(wide, Some(TOKEN), false).unwrap();
            assert!(!guarded.may_write && guarded.reach() == Reach::Anywhere, "{wide}");
            assert!(access(wide, Some(TOKEN), true).unwrap().may_write, "{wide}");
        }
    }

    #[test]
    fn only_the_whole_token_admits() {
        for address in ["127.0.0.1:0", "0.0.0.0:0"] {
            let guarded = access(address, Some(TOKEN), false).unwrap();
            assert!(guarded.admits(Some(TOKEN)));
            for wrong in [None, Some(""), Some("correct-horse-batterz"), Some("correct-horse-batter"), Some("correct")]
            {
                assert!(!guarded.admits(wrong), "{wrong:?}");
            }
            assert!(!guarded.admits(Some(&format!("{TOKEN}s"))));
            assert!(!format!("{guarded:?}").contains("horse"));
        }
        assert_eq!(access("127.0.0.1:0", Some("short"), false), Err(AccessError::ShortToken { found: 5 }));
        let letter = access("127.0.0.1:0", Some("a token with spaces"), false);
        assert_eq!(letter, Err(AccessError::Letter { letter: ' ' }));
    }

    #[test]
    fn addresses_are_read_as_they_are_written() {
        for text in [DEFAULT_LIVE_ADDRESS, "[::1]:7451", "0.0.0.0:1"] {
            assert_eq!(text.parse::<LiveAddress>().unwrap().to_string(), text);
        }
        for text in ["", "7451", "localhost:", "example.org:80", "unix:/run/live", "127.0.0.1:99999"] {
            assert!(text.parse::<LiveAddress>().is_err(), "{text}");
        }
        let guarded = access("0.0.0.0:0", Some(TOKEN), false).unwrap();
        assert_eq!(guarded.url("0.0.0.0:80".parse().unwrap()), format!("http://127.0.0.1:80/#token={TOKEN}"));
        assert_eq!(access("[::1]:0", None, false).unwrap().url("[::1]:5".parse().unwrap()), "http://[::1]:5/");
    }
}
