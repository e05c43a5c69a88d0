//! Asks a port for a board. Only one Hello is sent, so that other devices are not disturbed.

use std::time::Duration;

use serde::{Serialize, Serializer};
use slitpose_protocol::schema::SchemaMismatch;
use slitpose_protocol::{AdcScaling, BoardKind, Hashes, Hello, PROTOCOL, ProtocolVersion, ResetCause, Schedule};

use super::ports::Port;
use super::{Conversation, DeviceError, SerialDevice};
use slitpose_tracking::link::DeviceId;

/// Timeout: a running board answers within milliseconds; the rest is for a busy host.
const ANSWER_WITHIN: Duration = Duration::from_secs(1);

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum PortState {
    /// It was not asked.
    NotAsked,
    Free,
    InUse,
    /// This user may not open it.
    NoPermission,
    NoAnswer,
    OtherVersion(ProtocolVersion),
}

impl PortState {
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
    pub port: Port,
    pub(crate) state: PortState,
    pub(crate) board: Option<BoardInfo>,
}

impl Listed {
    /// A port that has not been asked.
    pub fn new(port: Port) -> Self {
        Self { port, state: PortState::NotAsked, board: None }
    }

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

#[derive(Clone, Debug, PartialEq)]
pub(crate) struct BoardInfo {
    pub device: DeviceId,
    pub kind: BoardKind,
    pub board: String,
    pub firmware: String,
    pub protocol: ProtocolVersion,
    /// The first kind of message with another layout than in this program, if any.
    pub mismatch: Option<SchemaMismatch>,
    /// Cause of its last reset.
    pub reset_cause: ResetCause,
    pub hashes: Hashes,
    pub scaling: AdcScaling,
    pub configuration: u16,
    pub schedule: Schedule,
}

impl From<&Hello<'_>> for BoardInfo {
    fn from(hello: &Hello<'_>) -> Self {
        Self {
            device: DeviceId(hello.device_id),
            kind: hello.kind,
            board: hello.board.to_owned(),
            firmware: hello.firmware.to_owned(),
            protocol: hello.protocol,
            mismatch: hello.check_schemas().err(),
            reset_cause: hello.reset_cause,
            hashes: hello.hashes,
            scaling: hello.scaling,
            configuration: hello.configuration,
            schedule: hello.schedule.clone(),
        }
    }
}

impl BoardInfo {
    /// `physical` or `simulated`.
    pub(crate) fn kind_name(&self) -> &'static str {
        match self.kind {
            BoardKind::Physical => "physical",
            BoardKind::Simulated => "simulated",
        }
    }

    /// Cause of its last reset, in one word.
    pub(crate) fn reset_cause_name(&self) -> &'static str {
        match self.reset_cause {
            ResetCause::Unknown => "unknown",
            ResetCause::PowerOn => "power_on",
            ResetCause::BrownOut => "brown_out",
            ResetCause::Pin => "pin",
            ResetCause::Software => "software",
            ResetCause::Watchdog => "watchdog",
            ResetCause::Panic => "panic",
            ResetCause::StackOverflow => "stack_overflow",
        }
    }
}

#[derive(Serialize)]
struct Fields<'a> {
    serial: DeviceId,
    board: &'a str,
    kind: &'a str,
    firmware: &'a str,
    protocol: String,
    program_protocol: String,
    /// The kind of message with another layout than in this program.
    mismatch: Option<&'a str>,
    reset_cause: &'a str,
    /// 16 hexadecimal digits, as in messages: JSON numbers do not hold 64 bits everywhere.
    scene_hash: Option<String>,
    calibration_hash: Option<String>,
    full_scale_a: f64,
    scaling: AdcScaling,
    frame_rate_hz: f64,
    configuration: u16,
    schedule: &'a Schedule,
}

impl Serialize for BoardInfo {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let hex = |hash: Option<u64>| hash.map(|hash| format!("{hash:016x}"));
        let fields = Fields {
            serial: self.device,
            board: &self.board,
            kind: self.kind_name(),
            firmware: &self.firmware,
            protocol: self.protocol.to_string(),
            program_protocol: PROTOCOL.to_string(),
            mismatch: self.mismatch.map(|mismatch| mismatch.name),
            reset_cause: self.reset_cause_name(),
            scene_hash: hex(self.hashes.scene),
            calibration_hash: hex(self.hashes.calibration),
            full_scale_a: self.scaling.full_scale_a(),
            scaling: self.scaling,
            frame_rate_hz: self.schedule.frame_rate_hz(),
            configuration: self.configuration,
            schedule: &self.schedule,
        };
        fields.serialize(serializer)
    }
}
