//! Asks a port for a board. Only one Hello is sent, so that other devices are not disturbed.

use std::time::Duration;

use slitpose_protocol::ProtocolVersion;

use super::ports::Port;
use super::{BoardInfo, Conversation, DeviceError, SerialDevice};
use crate::link::DeviceId;

/// Timeout: a running board answers within milliseconds; the rest is for a busy host.
const ANSWER_WITHIN: Duration = Duration::from_secs(1);

/// The state of a port.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum PortState {
    /// It was not asked.
    NotAsked,
    /// A board answers.
    Free,
    /// Another program has it.
    InUse,
    /// This user may not open it.
    NoPermission,
    /// No board answers.
    NoAnswer,
    /// A board with another protocol.
    OtherVersion(ProtocolVersion),
}

impl PortState {
    /// In words.
    pub(crate) fn as_str(self) -> &'static str {
        match self {
            Self::NotAsked => "not asked",
            Self::Free => "free",
            Self::InUse => "in use",
            Self::NoPermission => "no permission",
            Self::NoAnswer => "no answer",
            Self::OtherVersion(_) => "other version",
        }
    }
}

/// A port, its state and its board.
#[derive(Clone, Debug, PartialEq)]
pub struct Listed {
    /// The port.
    pub port: Port,
    /// Its state.
    pub(crate) state: PortState,
    /// The board's hello.
    pub(crate) board: Option<BoardInfo>,
}

impl Listed {
    /// A port that has not been asked.
    pub fn new(port: Port) -> Self {
        Self { port, state: PortState::NotAsked, board: None }
    }

    /// Asks a port.
    pub fn ask(port: Port) -> Self {
        match greet(&port.name) {
            Ok(board) => {
                let state = match board.mismatch {
                    None => PortState::Free,
                    Some(_) => PortState::OtherVersion(board.protocol),
                };
                Self { port, state, board: Some(board) }
            }
            Err(error) => {
                let state = match error {
                    DeviceError::Busy { .. } => PortState::InUse,
                    DeviceError::Forbidden { .. } => PortState::NoPermission,
                    DeviceError::Version { versions, .. } => PortState::OtherVersion(versions.board),
                    _ => PortState::NoAnswer,
                };
                Self { port, state, board: None }
            }
        }
    }

    /// Asks all at once, so that silent ones do not add up.
    pub(crate) fn ask_all(ports: Vec<Port>) -> Vec<Self> {
        std::thread::scope(|scope| {
            let asked: Vec<_> = ports
                .into_iter()
                .map(|port| {
                    let fallback = Self::new(port.clone());
                    (fallback, scope.spawn(move || Self::ask(port)))
                })
                .collect();
            asked.into_iter().map(|(fallback, thread)| thread.join().unwrap_or(fallback)).collect()
        })
    }

    /// Number of the board, from its hello or from USB, if known.
    pub fn device(&self) -> Option<DeviceId> {
        self.board.as_ref().map(|board| board.device).or(self.port.device())
    }
}

fn greet(port: &str) -> Result<BoardInfo, DeviceError> {
    Conversation::open(Box::new(SerialDevice::open(port)?))?.introduce(ANSWER_WITHIN)
}
