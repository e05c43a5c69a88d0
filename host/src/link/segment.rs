//! Bytes that a link delivered, with their instants.

use crate::clock::HostInstant;

/// Consecutive reads of a link, for pipeline and capture: the bytes, the time of each read, and the pings sent
/// meanwhile. Its memory is reused.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Segment {
    /// The link was opened anew before these bytes, or bytes before them are missing in a capture: an incomplete
    /// packet before them is lost.
    pub opened: bool,
    /// All bytes.
    pub bytes: Vec<u8>,
    /// The reads that gave `bytes`; their lengths add up to its length.
    pub reads: Vec<Read>,
    /// Pings sent since the segment before. Their answers, if they came, are in later reads.
    pub asked: Vec<Asked>,
}

/// One read.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Read {
    /// Number of bytes read.
    pub bytes: usize,
    /// Time at which the read returned; `None` if the stream, of a simulated board, does not run in real
    /// time.
    pub at: Option<HostInstant>,
}

/// A ping.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Asked {
    /// Its token.
    pub token: u32,
    /// Time at which it was about to be sent.
    pub at: HostInstant,
}

/// Most memory that an empty segment keeps: 30 ms of a board at 4 kHz, truths included. A stall may make many segments
/// larger.
const KEPT_BYTES: usize = 1 << 14;

impl Segment {
    /// An empty segment with room for this many bytes.
    pub fn with_capacity(bytes: usize) -> Self {
        Self { bytes: Vec::with_capacity(bytes), ..Self::default() }
    }

    /// Empties the segment and keeps its memory, unless it has grown too large.
    pub fn clear(&mut self) {
        self.opened = false;
        self.bytes.clear();
        self.bytes.shrink_to(KEPT_BYTES);
        self.reads.clear();
        self.asked.clear();
    }

    /// Whether the segment has neither bytes nor pings.
    pub fn is_empty(&self) -> bool {
        !self.opened && self.bytes.is_empty() && self.asked.is_empty()
    }

    /// Appends the bytes of one read.
    pub fn push(&mut self, bytes: &[u8], at: Option<HostInstant>) {
        self.bytes.extend_from_slice(bytes);
        self.reads.push(Read { bytes: bytes.len(), at });
    }

    /// Appends `other`; a reopened link begins a segment of its own.
    ///
    /// # Panics
    /// If `other` opens the link anew and `self` has bytes already.
    pub fn append(&mut self, other: &Self) {
        assert!(!other.opened || self.bytes.is_empty(), "a link opened anew within a segment");
        self.opened |= other.opened;
        self.bytes.extend_from_slice(&other.bytes);
        self.reads.extend_from_slice(&other.reads);
        self.asked.extend_from_slice(&other.asked);
    }

    /// Drops all bytes after the first `length`.
    pub fn truncate(&mut self, length: usize) {
        self.bytes.truncate(length);
        let mut left = self.bytes.len();
        self.reads.retain_mut(|read| {
            read.bytes = read.bytes.min(left);
            left -= read.bytes;
            read.bytes > 0
        });
    }

    /// Drops the first `length` bytes.
    #[cfg(feature = "zenoh")]
    pub(crate) fn skip(&mut self, length: usize) {
        let mut left = length.min(self.bytes.len());
        self.bytes.drain(..left);
        self.reads.retain_mut(|read| {
            let cut = left.min(read.bytes);
            read.bytes -= cut;
            left -= cut;
            read.bytes > 0
        });
    }

    /// The bytes of each read, with its instant.
    pub fn chunks(&self) -> impl Iterator<Item = (&[u8], Option<HostInstant>)> {
        let mut rest = &self.bytes[..];
        self.reads.iter().map(move |read| {
            let (bytes, behind) = rest.split_at(read.bytes.min(rest.len()));
            rest = behind;
            (bytes, read.at)
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(monotonic_ns: u64) -> Option<HostInstant> {
        Some(HostInstant { monotonic_ns, utc_ns: 0 })
    }

    #[test]
    fn what_is_cut_off_is_the_end() {
        let mut segment = Segment::default();
        segment.push(b"abc", at(1));
        segment.push(b"de", at(2));
        segment.push(b"f", at(3));
        let whole = segment.clone();
        segment.truncate(4);
        assert_eq!(segment.chunks().collect::<Vec<_>>(), [(&b"abc"[..], at(1)), (&b"d"[..], at(2))]);
        segment.truncate(0);
        assert!(segment.is_empty());
        segment.append(&whole);
        assert_eq!(segment, whole);
    }
}
