//! Who may look at a page, and change something by it.

use std::net::SocketAddr;

use anyhow::{Result, bail, ensure};

use crate::address::{Address, tcp_address};
use crate::http::BindScope;
use slitpose_tracking::page::{Order, Refusal};

/// Carries out an order, or begins to.
pub(crate) type Control = Box<dyn Fn(Order) -> Result<(), Refusal> + Send + Sync>;

/// The address of the page unless another is given.
pub(crate) const DEFAULT_LIVE_ADDRESS: &str = "127.0.0.1:7451";

/// Shortest token: 16 characters are beyond guessing over a network.
const MIN_TOKEN: usize = 16;

/// The host and port that `text` names.
pub(crate) fn live_address(text: &str) -> Result<SocketAddr, String> {
    let hint =
        || format!("`{text}` is no address; give one such as {DEFAULT_LIVE_ADDRESS}, [::1]:7451 or 0.0.0.0:7451");
    tcp_address(text).ok_or_else(hint)
}

#[derive(Clone, PartialEq, Eq)]
pub(crate) struct Access {
    pub(super) address: SocketAddr,
    token: Option<String>,
    pub(crate) may_write: bool,
}

impl Access {
    /// Pages at `address`. Those of other hosts need `token`, and change something only if `writes` allows it.
    pub(crate) fn new(address: SocketAddr, token: Option<String>, writes: bool) -> Result<Self> {
        if let Some(token) = &token {
            let is_plain = |letter: &char| letter.is_ascii_alphanumeric() || "-_.~".contains(*letter);
            if let Some(letter) = token.chars().find(|letter| !is_plain(letter)) {
                bail!("a token has letters, digits, `-`, `_`, `.` and `~` only; `{letter}` is none of them");
            }
            let (found, hint) = (token.len(), format!("give --live-token with {MIN_TOKEN} characters or more"));
            ensure!(found >= MIN_TOKEN, "a token of {found} characters can be guessed; {hint}");
        }
        let is_local = address.ip().is_loopback();
        ensure!(
            is_local || token.is_some(),
            "{address} can be reached from other hosts: give --live-token with a secret of {MIN_TOKEN} characters or more, or \
             listen on 127.0.0.1"
        );
        Ok(Self { address, token, may_write: is_local || writes })
    }

    pub(super) fn scope(&self) -> BindScope {
        if self.address.ip().is_loopback() { BindScope::Loopback } else { BindScope::Anywhere }
    }

    /// Whether `token` is the right one, or none is needed. Takes the same time for every wrong one of the right length.
    pub(super) fn admits(&self, token: Option<&str>) -> bool {
        let Some(own) = &self.token else { return true };
        let token = token.unwrap_or_default();
        let differences = own.bytes().zip(token.bytes()).fold(0, |sum, (own, other)| sum | (own ^ other));
        own.len() == token.len() && std::hint::black_box(differences) == 0
    }

    /// The URL of the page at the address that was bound.
    pub(super) fn url(&self, bound: &Address) -> String {
        let (Address::Tcp(bound) | Address::Udp(bound)) = bound else { return bound.to_string() };
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

    fn access(address: &str, token: Option<&str>, writes: bool) -> Result<Access> {
        Access::new(live_address(address).unwrap(), token.map(str::to_owned), writes)
    }

    #[test]
    fn other_hosts_need_a_token_and_leave_to_write() {
        for local in [DEFAULT_LIVE_ADDRESS, "localhost:0", "[::1]:7451", "127.8.9.1:80"] {
            let open = access(local, None, false).unwrap();
            assert!(open.may_write && open.scope() == BindScope::Loopback && open.admits(None), "{local}");
        }
        for wide in ["0.0.0.0:7451", "[::]:7451", "192.0.2.1:80"] {
            let refused = access(wide, None, true).err().unwrap().to_string();
            assert!(refused.contains("from other hosts: give --live-token"), "{refused}");
            let guarded = access(wide, Some(TOKEN), false).unwrap();
            assert!(!guarded.may_write && guarded.scope() == BindScope::Anywhere, "{wide}");
            assert!(access(wide, Some(TOKEN), true).unwrap().may_write, "{wide}");
        }
    }

    #[test]
    fn only_the_whole_token_admits() {
        for address in ["127.0.0.1:0", "0.0.0.0:0"] {
            let guarded = access(address, Some(TOKEN), false).unwrap();
            let (longer, shorter) = (format!("{TOKEN}s"), &TOKEN[..TOKEN.len() - 1]);
            assert!(guarded.admits(Some(TOKEN)));
            assert!([None, Some(""), Some(shorter), Some(&longer)].iter().all(|wrong| !guarded.admits(*wrong)));
        }
        for token in ["", "short", "a token with spaces"] {
            assert!(access("127.0.0.1:0", Some(token), false).is_err(), "`{token}`");
        }
    }

    #[test]
    fn a_page_has_an_address_that_a_browser_can_open() {
        let guarded = access("0.0.0.0:0", Some(TOKEN), false).unwrap();
        assert_eq!(
            guarded.url(&Address::Tcp("0.0.0.0:80".parse().unwrap())),
            format!("http://127.0.0.1:80/#token={TOKEN}")
        );
        assert_eq!(
            access("[::1]:0", None, false).unwrap().url(&Address::Tcp("[::1]:5".parse().unwrap())),
            "http://[::1]:5/"
        );
    }
}
