//! Host to device: everything a board can be asked.
//!
//! Each command travels in a [`Request`] with a number the host chooses; the board
//! answers every number once. Every command is valid in every state. The order of the
//! variants is their number on the wire; a new one goes to the end, and a board that
//! does not know it yet says so.

use postcard::take_from_bytes;
use serde::{Deserialize, Serialize};

use crate::frame::{Packet, PayloadError};
use crate::scan::Levels;
use crate::schedule::Schedule;
use crate::schema;

/// A command and the number its [`Reply`](crate::Reply) will carry.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Request {
    /// Chosen by the host; the board compares it with nothing.
    pub number: u16,
    /// What to do.
    pub command: Command,
}

/// What a host may ask of a board.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub enum Command {
    /// Send a [`Hello`](crate::Hello).
    Hello,
    /// Light and sample by the configuration in force. Accepted without effect while
    /// acquiring.
    Start,
    /// Switch the emitters off and sample no more. Accepted without effect while idle.
    Stop,
    /// Replace the configuration; while acquiring, from the next frame on.
    Configure(Configuration),
    /// Send a [`Pong`](crate::Pong).
    Ping {
        /// Returned in the pong.
        token: u32,
    },
    /// Show which board this is by its indicator light.
    Identify {
        /// For how many seconds; 0 ends it.
        seconds: u8,
    },
    /// Keep the configuration in force and these hashes, also without supply; the board
    /// starts with them from then on. Answered when they are safe.
    Store(Hashes),
    /// Forget what was stored; the board starts with its defaults from then on.
    Forget,
    /// Stop, go dark, and start anew, once the reply has been sent.
    Reboot(BootTarget),
}

/// What a board belongs to. The board compares them with nothing; a host that is about
/// to read its words by another scene or calibration does.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct Hashes {
    /// Hash of the scene; `None` without one.
    pub scene: Option<u64>,
    /// Hash of the calibration; `None` without one.
    pub calibration: Option<u64>,
}

/// What a board starts after a [`Reboot`](Command::Reboot).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum BootTarget {
    /// The firmware.
    Firmware,
    /// The controller's own boot loader, to be given new firmware.
    BootLoader,
}

/// What a board acquires by.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Configuration {
    /// When what is lit and sampled.
    pub schedule: Schedule,
    /// Level of each emitter, one a cell.
    pub levels: Levels,
    /// Whether the board keeps to them.
    pub exposure: Exposure,
}

/// Who sets the levels of the emitters.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub enum Exposure {
    /// The host: levels stay as configured.
    #[default]
    Fixed,
    /// The board: from the levels configured it lowers an emitter that saturates its
    /// detector and raises one whose light is faint. Batches carry the levels in force.
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
