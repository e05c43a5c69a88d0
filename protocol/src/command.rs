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
}

/// What a board acquires by.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Configuration {
    /// When what is lit and sampled.
    pub schedule: Schedule,
    /// Level of each emitter, one a cell.
    pub levels: Levels,
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
