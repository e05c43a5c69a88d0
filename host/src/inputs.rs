//! What strangers can send to this host, each kind read from bytes alone: the doors that are not public, for the fuzz
//! targets of `tests/fuzz`.

use std::io::Cursor;
use std::path::Path;

use axum::http::{HeaderMap, HeaderName, HeaderValue};

use crate::commands;
use crate::http::{self, BindScope};
use slitpose_tracking::capture::{CaptureError, CaptureReader, Entry};
use slitpose_tracking::link::Segment;
use slitpose_tracking::page::Request;

/// What a capture holds.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Captured {
    /// Boards with a scene, as often as they are set up.
    pub setups: u64,
    /// Bytes of links.
    pub link_bytes: u64,
    /// Bytes of the file in whole records.
    pub whole_bytes: u64,
    /// Bytes of the file that could not be read.
    pub lost_bytes: u64,
    /// Whether data are or may be missing.
    pub has_loss: bool,
}

/// Reads the bytes of a capture to their end, from `from_ns` on.
pub fn capture(bytes: &[u8], from_ns: u64) -> Result<Captured, CaptureError> {
    let path = Path::new("bytes");
    let mut reader = CaptureReader::new(path, Cursor::new(bytes))?.starting_at(from_ns);
    let (mut captured, mut segment) = (Captured::default(), Segment::default());
    while let Some(entry) = reader.next(&mut segment)? {
        match entry {
            Entry::Setup(_) => captured.setups += 1,
            Entry::Hello { .. } | Entry::Note { .. } => {}
            Entry::Link { .. } => captured.link_bytes += segment.bytes.len() as u64,
        }
    }
    let end = reader.end();
    Ok(Captured { whole_bytes: end.whole_bytes, lost_bytes: end.lost_bytes, has_loss: end.has_loss(), ..captured })
}

/// The options that a configuration file of `run` sets, or why it cannot be used.
pub fn configuration(text: &str) -> Result<Vec<String>, String> {
    commands::configured_options(Path::new("config.toml"), text)
}

/// Whether a page's message to the live server is a request.
pub fn is_page_request(text: &str) -> bool {
    Request::read(text).is_ok()
}

/// Whether a request with these headers is one of HTTP, and comes from a program of this host.
pub fn is_own_request<'a>(headers: impl IntoIterator<Item = (&'a [u8], &'a [u8])>) -> bool {
    let mut map = HeaderMap::new();
    for (name, value) in headers {
        let (Ok(name), Ok(value)) = (HeaderName::from_bytes(name), HeaderValue::from_bytes(value)) else {
            return false;
        };
        map.append(name, value);
    }
    http::is_own(&map, BindScope::Loopback)
}
