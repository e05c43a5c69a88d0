//! Host to device: the commands of a board.
//!
//! Each command is sent in a [`Request`] with a number chosen by the host; the board
//! answers every number once. Every command is valid in every state. The order of the
//! variants is their number on the wire; a new one goes to the end, and a board that
//! does not know it rejects it.

use heapless::Vec;
use postcard::take_from_bytes;
use serde::{Deserialize, Serialize};

use crate::frame::{Packet, PayloadError};
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
    Ping {
        /// Returned in the pong.
        token: u32,
    },
    /// Blink the indicator light to identify the board.
    Identify {
        /// Duration in seconds; 0 ends it.
        seconds: u8,
    },
    /// Store the configuration in force and these hashes in flash memory; the board
    /// starts with them from then on. Answered when they are stored.
    Store(Hashes),
    /// Erase the stored data; the board starts with its defaults from then on.
    Forget,
    /// Stop, switch the emitters off, and reset, once the reply has been sent.
    Reboot(BootTarget),
    /// Take a part of the head that the board is to solve poses with; the last one ends it.
    Head(HeadPart),
    /// Send scans, poses or both from now on, until the next reset.
    Stream(Stream),
}

/// Bytes of a head in one command.
pub const HEAD_PART_BYTES: usize = 128;

/// A part of a compiled head. Parts are sent in order, from offset 0 on, which begins anew.
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

/// What a board sends of each scan.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct Stream {
    /// Its words, in batches.
    pub scans: bool,
    /// Its pose, if the board has a head.
    pub poses: bool,
}

/// Hashes of the scene and calibration that a board belongs to. The board only stores
/// them; the host compares them with the scene and calibration it uses.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct Hashes {
    /// Hash of the scene; `None` without one.
    pub scene: Option<u64>,
    /// Hash of the calibration; `None` without one.
    pub calibration: Option<u64>,
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
