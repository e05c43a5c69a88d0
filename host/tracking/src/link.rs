//! Data of a link: bytes with their instants, the board's number, its version of the protocol, and its start.

use std::borrow::Cow;
use std::fmt;
use std::str::FromStr;

use schemars::{JsonSchema, Schema, SchemaGenerator, json_schema};
use serde::{Serialize, Serializer};
use slitpose_head::finding::Finding;
use slitpose_protocol::{ClockSource, PROTOCOL, ProtocolVersion, SettingsSource};
use thiserror::Error;

use crate::clock::HostInstant;

/// The unique number of a board, 24 hexadecimal digits: in its hello, and its USB serial number.
///
/// ```
/// use slitpose_tracking::link::DeviceId;
/// let device: DeviceId = "0036002900544850025a0320".parse()?;
/// assert_eq!(device.0[..4], [0x00, 0x36, 0x00, 0x29]);
/// assert_eq!(device.to_string(), "0036002900544850025a0320");
/// # Ok::<(), slitpose_tracking::link::DeviceIdError>(())
/// ```
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct DeviceId(pub [u8; 12]);

impl fmt::Display for DeviceId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.with_digits(|digits| f.write_str(digits))
    }
}

impl DeviceId {
    /// Passes the digits on. Every pose has them: byte by byte formatting would take a sixth of the time of its line.
    pub(crate) fn with_digits<T>(self, with: impl FnOnce(&str) -> T) -> T {
        let mut digits = [0; 24];
        for (pair, byte) in digits.chunks_exact_mut(2).zip(self.0) {
            pair.copy_from_slice(&[byte >> 4, byte & 15].map(|digit| b"0123456789abcdef"[usize::from(digit)]));
        }
        with(str::from_utf8(&digits).expect("ASCII"))
    }
}

impl Serialize for DeviceId {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        self.with_digits(|digits| serializer.serialize_str(digits))
    }
}

impl JsonSchema for DeviceId {
    fn schema_name() -> Cow<'static, str> {
        "DeviceId".into()
    }

    fn json_schema(_: &mut SchemaGenerator) -> Schema {
        json_schema!({ "type": "string", "pattern": "^[0-9a-f]{24}$" })
    }
}

/// A text that is not a [`DeviceId`].
#[derive(Clone, Debug, PartialEq, Eq, Error)]
#[error("`{text}` is no serial number of a board; give 24 hexadecimal digits, as `slitpose device list` shows them")]
pub struct DeviceIdError {
    /// The text.
    pub text: String,
}

impl FromStr for DeviceId {
    type Err = DeviceIdError;

    /// Digits above 9 may be upper or lower case.
    fn from_str(text: &str) -> Result<Self, Self::Err> {
        let error = || DeviceIdError { text: text.to_owned() };
        if text.len() != 24 || !text.bytes().all(|byte| byte.is_ascii_hexdigit()) {
            return Err(error());
        }
        let mut id = [0; 12];
        for (byte, at) in id.iter_mut().zip((0..).step_by(2)) {
            *byte = u8::from_str_radix(&text[at..at + 2], 16).map_err(|_| error())?;
        }
        Ok(Self(id))
    }
}

/// Consecutive reads of a link, for pipeline and capture: the bytes, the time of each read, and the pings sent
/// meanwhile. Its memory is reused.
///
/// ```
/// use slitpose_tracking::link::Segment;
/// let mut segment = Segment::default();
/// segment.push(b"first", None);
/// segment.push(b"second", None);
/// let lengths: Vec<_> = segment.chunks().map(|(bytes, _)| bytes.len()).collect();
/// assert_eq!(lengths, [5, 6]);
/// ```
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
    pub fn skip(&mut self, length: usize) {
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

/// What a board's status says of its start: one finding on its clock, one on its settings.
pub fn start_findings(clock: ClockSource, settings: SettingsSource) -> [Finding; 2] {
    let (oscillator, stored) = ("oscillator", "settings");
    [
        match clock {
            ClockSource::Internal | ClockSource::Crystal => Finding::ok(oscillator, clock.to_string()),
            ClockSource::CrystalFailed => Finding::warning(
                oscillator,
                format!("{clock}: rates and times of the board are right to some per cent only"),
                "reset the board; if it comes again, check the crystal and its solder joints",
            ),
        },
        match settings {
            SettingsSource::Defaults | SettingsSource::Stored => Finding::ok(stored, settings.to_string()),
            SettingsSource::PassedOver => Finding::warning(
                stored,
                settings.to_string(),
                "store them again with `slitpose device set --scene SCENE`, or forget them with `--clear`",
            ),
        },
    ]
}

/// The finding on a board that says crystal and has drifted from the host's clock as none does.
pub fn contradicted_crystal() -> Finding {
    Finding::warning(
        "board clock",
        "the board says that it runs from a crystal and does not keep time as a crystal does, by this host's clock",
        "unless this host was suspended or NTP corrected its clock meanwhile, check the board's crystal",
    )
}

/// A board's version of the protocol, compared with that of this program.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Versions {
    /// The board's version.
    pub board: ProtocolVersion,
}

impl fmt::Display for Versions {
    /// Both versions, the older side, and the next step.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (board, ours) = (self.board, PROTOCOL);
        write!(f, "the board speaks protocol {board}, this program {ours}: ")?;
        match (board.major, board.minor).cmp(&(ours.major, ours.minor)) {
            std::cmp::Ordering::Less => f.write_str(
                "the firmware is older; update it: build the image from the source of this program with \
                 firmware/build, and flash it as firmware/README.md tells",
            ),
            std::cmp::Ordering::Greater => {
                f.write_str("this program is older; update slitpose to the release that the firmware is from")
            }
            std::cmp::Ordering::Equal => f.write_str(
                "the same version, but different builds; build firmware (firmware/build) and program from the same \
                 source, and update both",
            ),
        }
    }
}

#[cfg(test)]
mod tests {
    use slitpose_head::finding::Grade;

    use super::*;

    #[test]
    fn ids_are_read_as_they_are_written() {
        let id = DeviceId(*b"\x00\x36\xffsimulated");
        assert_eq!(id.to_string().parse(), Ok(id));
        assert_eq!(id.to_string().to_uppercase().parse(), Ok(id));
        for text in ["", "00", "0036ff73696d756c617465", "0036ff73696d756c61746g65", "+036ff73696d756c6174650a"] {
            assert!(text.parse::<DeviceId>().is_err(), "{text}");
        }
    }

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

    #[test]
    fn what_failed_at_the_start_is_a_warning_with_a_next_step() {
        for clock in ClockSource::ALL {
            for settings in SettingsSource::ALL {
                let found = start_findings(clock, settings);
                let failed = [clock == ClockSource::CrystalFailed, settings == SettingsSource::PassedOver];
                for (finding, failed) in found.iter().zip(failed) {
                    let grade = if failed { Grade::Warning } else { Grade::Ok };
                    assert_eq!((finding.grade, finding.next_step.is_some()), (grade, failed), "{finding}");
                }
            }
        }
        let [oscillator, settings] = start_findings(ClockSource::CrystalFailed, SettingsSource::PassedOver);
        assert!(oscillator.text.contains("crystal did not start"), "{oscillator}");
        assert!(settings.to_string().contains("three starts in a row") && settings.to_string().contains("--clear"));
    }

    #[test]
    fn the_older_side_is_the_one_to_be_updated() {
        let text = |major, minor| Versions { board: ProtocolVersion { major, minor } }.to_string();
        let ProtocolVersion { major, minor } = PROTOCOL;
        assert!(text(major - 1, minor + 1).contains("the firmware is older; update it"));
        assert!(text(major + 1, minor).contains("this program is older; update slitpose"));
        assert!(text(major, minor + 1).contains("this program is older"));
        assert!(text(major, minor).contains("different builds"));
    }
}
