//! Whether a request comes from a program, and not from a page in a browser.
//!
//! Any page can make a browser send requests to a port of the browser's host. A page whose domain resolves to this host
//! (DNS rebinding) could even read the answers: its requests carry that domain as `Host`. Requests of other pages carry
//! the page's origin as `Origin` (RFC 6454, section 7). Programs send neither.

use std::net::IpAddr;

use axum::http::HeaderMap;
use axum::http::header::{HOST, ORIGIN};

use super::Reach;

/// Whether these are the headers of a program's request to a name of this host.
pub(crate) fn is_own(headers: &HeaderMap, reach: Reach) -> bool {
    let mut hosts = headers.get_all(HOST).iter();
    let host = hosts.next().map(|host| host.as_bytes());
    if hosts.next().is_some() {
        return false;
    }
    // A server that any host may reach may have any name.
    let is_ours = |host: &[u8]| reach == Reach::Anywhere || std::str::from_utf8(host).is_ok_and(is_loopback);
    host.is_none_or(is_ours)
        && headers.get_all(ORIGIN).iter().all(|origin| {
            let origin = origin.as_bytes();
            origin.strip_prefix(b"http://").is_some_and(|origin| Some(origin) == host)
        })
}

/// Whether `host`, with or without a port, is a loopback name.
fn is_loopback(host: &str) -> bool {
    let name = match host.strip_prefix('[').and_then(|rest| rest.split_once(']')) {
        Some((address, _)) => address,
        None => host.rsplit_once(':').map_or(host, |(name, _)| name),
    };
    name.eq_ignore_ascii_case("localhost") || name.parse().is_ok_and(|address: IpAddr| address.is_loopback())
}

#[cfg(test)]
mod tests {
    use axum::http::HeaderValue;

    use super::*;

    fn is_allowed(host: Option<&'static str>, origin: Option<&'static str>, reach: Reach) -> bool {
        let mut headers = HeaderMap::new();
        for (name, value) in [(HOST, host), (ORIGIN, origin)] {
            headers.extend(value.map(|value| (name, HeaderValue::from_static(value))));
        }
        is_own(&headers, reach)
    }

    #[test]
    fn pages_of_others_are_not_answered() {
        for host in ["localhost", "LOCALHOST:7450", "127.0.0.1", "127.0.0.1:7450", "127.3.2.1:1", "[::1]:7450", "[::1]"]
        {
            assert!(is_allowed(Some(host), None, Reach::Loopback), "{host}");
        }
        assert!(is_allowed(None, None, Reach::Loopback), "as HTTP/1.0 may do");
        for host in ["evil.example:7450", "localhost.evil.example", "127.0.0.1.evil.example", "", "[::2]:1", "10.0.0.1"]
        {
            assert!(!is_allowed(Some(host), None, Reach::Loopback), "{host}");
            assert!(is_allowed(Some(host), None, Reach::Anywhere), "{host}");
        }
        for reach in [Reach::Loopback, Reach::Anywhere] {
            let asked_by = |origin| is_allowed(Some("127.0.0.1:7450"), Some(origin), reach);
            assert!(asked_by("http://127.0.0.1:7450"));
            for origin in ["http://evil.example", "https://127.0.0.1:7450", "http://127.0.0.1:8000", "null", ""] {
                assert!(!asked_by(origin), "{origin}");
            }
        }
    }
}
