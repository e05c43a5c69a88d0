//! Host to device: the commands of a board.
//!
//! Each command is sent in a [`Request`] with a number chosen by the host; the board
//! answers every number once. Every command is valid in every state. The order of the
//! variants is their number on the wire; a new one goes to the end, and a board that
//! does not know it rejects it.

use core::num::NonZeroU32;

use heapless::Vec;
use postcard::take_from_bytes;
use serde::{Deserialize, Serialize};

use crate::frame::{CRC, Packet, PayloadError};
use crate::scan::Levels;
use crate::schedule::Schedule;
use crate::schema;

/// A command and the number its [`Reply`](crate::Reply) will carry.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Request {
    /// A number chosen by the host; the board only returns it.
    pub number: u16,
    /// The command.
    pub command: Command,
}

/// A command of a host to a board.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[allow(missing_docs, reason = "fields are named by what they are")]
pub enum Command {
    /// Send a [`Hello`](crate::Hello).
    Hello,
    /// Start acquisition with the configuration in force. Accepted without effect while
    /// acquiring.
    Start,
    /// Stop acquisition and switch the emitters off. Accepted without effect while idle.
    Stop,
    /// Replace the configuration; while acquiring, from the next frame on.
    Configure(Configuration),
    /// Send a [`Pong`](crate::Pong).
    Ping { token: u32 },
    /// Blink the indicator light for so many seconds to identify the board; 0 ends it.
    Identify { seconds: u8 },
    /// Store the configuration in force and these hashes in flash memory; the board
    /// starts with them from then on. Answered when they are stored.
    Store(Hashes),
    /// Erase the stored data; the board starts with its defaults from then on.
    Forget,
    /// Stop, switch the emitters off, and reset, once the reply has been sent.
    Reboot(BootTarget),
    /// Take a part of the head that the board is to solve poses with; the last one ends it.
    Head(HeadPart),
    /// Send these of the scans and poses from now on. After a reset and after each Stop: [`Stream::SCANS`].
    Stream(Stream),
    /// Take this as the photocurrent of an electrode at the end of the converters' range, as their front end has it,
    /// from now on; Store keeps it. It replaces the configuration by the same one, so that scans before and after are told
    /// apart, and the board then has no head: its numbers hold for the full scale before.
    FullScale { full_scale_pa: NonZeroU32 },
    /// At most so many scans, or poses, in a packet from now on; 1 sends each at once. After a reset and after each Stop: as
    /// many as suit the rate of frames.
    Packet { scans: u8 },
    /// Make these pulses while acquiring, from the next Start on until the next Stop or Configure.
    Pulse(Pulse),
}

/// Pulses of a board's frame output, by which other instruments follow its frames.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct Pulse {
    /// A pulse at each frame whose sequence number is a multiple of this; 0 makes none.
    pub every: u16,
    /// It rises with the first sample of this slot, and falls with that of the next.
    pub slot: u8,
}

impl Pulse {
    /// No pulses: so a board starts.
    pub const NONE: Self = Self { every: 0, slot: 0 };
}

/// Bytes of a head in one command.
pub const HEAD_PART_BYTES: usize = 128;

/// A part of a compiled head. Parts are sent in order, from offset 0 on, which begins anew.
///
/// ```
/// use slitpose_protocol::{HEAD_PART_BYTES, HeadPart};
/// let parts: Vec<_> = HeadPart::all(&[7; 300]).collect();
/// assert_eq!(parts.iter().map(|part| (part.offset, part.bytes.len())).collect::<Vec<_>>(), [(0, 128), (128, 128), (256, 44)]);
/// ```
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct HeadPart {
    /// Place of the first byte.
    pub offset: u16,
    /// Bytes of the whole head; zero: from now on the board has none.
    pub total: u16,
    /// The bytes.
    pub bytes: Vec<u8, HEAD_PART_BYTES>,
}

impl HeadPart {
    /// The parts of a whole head, in order.
    pub fn all(head: &[u8]) -> impl Iterator<Item = Self> + '_ {
        head.chunks(HEAD_PART_BYTES).enumerate().map(|(index, part)| Self {
            offset: (index * HEAD_PART_BYTES) as u16,
            total: head.len() as u16,
            bytes: part.iter().copied().collect(),
        })
    }
}

/// Scans that a [sample](Stream::scans) holds: enough to learn how the tool moves, and then to judge poses.
pub const SAMPLE_SCANS: u16 = 32;

/// What a board sends of its scans and of the poses that it finds in them.
///
/// ```
/// use slitpose_protocol::Stream;
/// let every_tenth_pose = Stream { scans: 0, poses: 10 };
/// assert!(every_tenth_pose.has_pose(20) && !every_tenth_pose.has_pose(21) && !every_tenth_pose.has_scan(20));
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct Stream {
    /// Of this many consecutive scans the first [`SAMPLE_SCANS`] are sent: all, if it is no more than these; none, if
    /// it is zero. They are counted from sequence number 0 on.
    pub scans: u16,
    /// Of this many consecutive poses one is sent, that of a scan whose number is a multiple; none, if it is zero.
    pub poses: u8,
}

impl Stream {
    /// All scans, no poses: what a board sends that has not been told otherwise.
    pub const SCANS: Self = Self { scans: 1, poses: 0 };

    /// All scans and all poses.
    pub const BOTH: Self = Self { scans: 1, poses: 1 };

    /// All poses, and a sample of the scans by which a host can check them: 3 % of them, 125 in a second of 4 kHz.
    pub const POSES: Self = Self { scans: 1_024, poses: 1 };

    /// Whether scan number `sequence` is sent.
    pub fn has_scan(self, sequence: u64) -> bool {
        // A modulus of 32 bits is one instruction of the board's.
        self.scans != 0 && sequence as u32 % u32::from(self.scans) < u32::from(SAMPLE_SCANS)
    }

    /// Whether the pose of scan number `sequence` is sent.
    pub fn has_pose(self, sequence: u64) -> bool {
        self.poses != 0 && (sequence as u32).is_multiple_of(u32::from(self.poses))
    }
}

/// Hashes of the scene and calibration that a board belongs to. The board only stores
/// them; the host compares them with the scene and calibration it uses.
///
/// ```
/// use slitpose_protocol::Hashes;
/// let hashes = Hashes { scene: Some(1), calibration: None };
/// assert_ne!(hashes.number(), Hashes::default().number());
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct Hashes {
    /// Hash of the scene; `None` without one.
    pub scene: Option<u64>,
    /// Hash of the calibration; `None` without one.
    pub calibration: Option<u64>,
}

impl Hashes {
    /// A number that tells heads apart: CRC-32/ISO-HDLC of both hashes, little endian, zero for none.
    pub fn number(&self) -> u32 {
        let mut digest = CRC.digest();
        for hash in [self.scene, self.calibration] {
            digest.update(&hash.unwrap_or(0).to_le_bytes());
        }
        digest.finalize()
    }
}

/// The program that a board starts after a [`Reboot`](Command::Reboot).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum BootTarget {
    /// The firmware.
    Firmware,
    /// The boot loader of the MCU, to receive new firmware.
    BootLoader,
}

/// The configuration of an acquisition.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Configuration {
    /// The times at which emitters are lit and cells sampled.
    pub schedule: Schedule,
    /// Level of each emitter, one per cell.
    pub levels: Levels,
    /// Whether the board adjusts the levels.
    pub exposure: Exposure,
}

/// Control of the emitters' levels.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub enum Exposure {
    /// The levels stay as configured.
    #[default]
    Fixed,
    /// Starting from the configured levels, the board lowers an emitter that saturates
    /// its detector and raises one whose light is faint. Batches carry the levels in
    /// force.
    Automatic,
}

impl<'p> Packet<'p> for Request {
    fn from_payload(payload: &'p [u8]) -> Result<Self, PayloadError> {
        let (number, kind) =
            take_from_bytes::<(u16, u32)>(payload).map_err(|_| PayloadError::NoKind { bytes: payload.len() })?.0;
        if kind as usize >= schema::COMMANDS.len() {
            return Err(PayloadError::UnknownCommand { number, kind });
        }
        match take_from_bytes(payload) {
            Ok((request, [])) => Ok(request),
            _ => Err(PayloadError::MalformedCommand { number, kind }),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sent(stream: Stream, scans: u64) -> (usize, usize) {
        let count = |is_sent: &dyn Fn(u64) -> bool| (0..scans).filter(|&sequence| is_sent(sequence)).count();
        (count(&|sequence| stream.has_scan(sequence)), count(&|sequence| stream.has_pose(sequence)))
    }

    #[test]
    fn samples_begin_at_multiples_and_zero_is_none() {
        assert_eq!(sent(Stream::BOTH, 3_000), (3_000, 3_000));
        assert_eq!(sent(Stream { scans: SAMPLE_SCANS, poses: 4 }, 3_000), (3_000, 750));
        assert_eq!(sent(Stream { scans: 100, poses: 0 }, 3_000), (30 * usize::from(SAMPLE_SCANS), 0));
        assert_eq!(sent(Stream { scans: 0, poses: 1 }, 3_000), (0, 3_000));
        let sampled = Stream { scans: 100, poses: 0 };
        assert!(sampled.has_scan(200) && sampled.has_scan(231) && !sampled.has_scan(232) && !sampled.has_scan(199));
    }
}
