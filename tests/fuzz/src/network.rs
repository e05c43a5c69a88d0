//! What programs and pages on the network send to a host.

use slitpose::datagram::{Answer, Request};
use slitpose::inputs;

/// What is read as a request or an answer is written as the same bytes, but for requests without a cookie, which are
/// shorter.
pub(crate) fn datagram(bytes: &[u8]) {
    if let Some(request) = Request::from_bytes(bytes) {
        let written = request.to_bytes();
        assert_eq!(Request::from_bytes(&written), Some(request));
        assert!(written == *bytes || (bytes.len() < Request::BYTES && request.cookie == 0));
    }
    if let Some(answer) = Answer::from_bytes(bytes) {
        assert_eq!(answer.to_bytes(), bytes);
    }
}

/// A message of a page is refused, or it is an object with a kind.
pub(crate) fn page(bytes: &[u8]) {
    if let Ok(text) = std::str::from_utf8(bytes)
        && inputs::is_page_request(text)
    {
        let object: serde_json::Map<String, serde_json::Value> = serde_json::from_str(text).expect("an object");
        assert!(object.get("kind").is_some_and(serde_json::Value::is_string), "{text}");
    }
}

/// One header a line, the name before the first colon. Served are requests without `Origin` and with no `Host` but one of
/// this host, or with the origin that `Host` names.
pub(crate) fn http(bytes: &[u8]) {
    let lines = bytes.split(|&byte| byte == b'\n');
    let headers: Vec<_> = lines
        .filter_map(|line| {
            let colon = line.iter().position(|&byte| byte == b':')?;
            Some((&line[..colon], &line[colon + 1..]))
        })
        .collect();
    if !inputs::is_own_request(headers.iter().copied()) {
        return;
    }
    let valued = |asked: &str| {
        let is_asked = move |(name, _): &&(&[u8], &[u8])| name.eq_ignore_ascii_case(asked.as_bytes());
        headers.iter().filter(is_asked).map(|(_, value)| String::from_utf8_lossy(value)).collect::<Vec<_>>()
    };
    for host in valued("host") {
        let host = host.to_ascii_lowercase();
        assert!(host.contains("localhost") || host.contains("127.") || host.contains("::"), "served {host}");
    }
    for origin in valued("origin") {
        assert!(origin.starts_with("http://"), "served {origin}");
    }
}
