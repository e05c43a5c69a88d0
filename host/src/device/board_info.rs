//! What a board says of itself, kept beyond the bytes it came in.

use slitpose_protocol::schema::SchemaMismatch;
use slitpose_protocol::{AdcScaling, BoardKind, Hashes, Hello, ProtocolVersion, ResetCause, Schedule};

use super::DeviceId;

/// A hello that owns its texts.
#[derive(Clone, Debug, PartialEq)]
pub struct BoardInfo {
    /// Which board.
    pub device: DeviceId,
    /// Whether its photocurrents are measured.
    pub kind: BoardKind,
    /// Name of the board, for people.
    pub board: String,
    /// Version of its firmware, for people.
    pub firmware: String,
    /// Version of the protocol it speaks.
    pub protocol: ProtocolVersion,
    /// The first kind of message that it lays out otherwise than this program, if any.
    pub mismatch: Option<SchemaMismatch>,
    /// Why it last started.
    pub reset_cause: ResetCause,
    /// What is stored on it.
    pub hashes: Hashes,
    /// What a word is worth.
    pub scaling: AdcScaling,
    /// Number of the configuration in force.
    pub configuration: u16,
    /// Its schedule.
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
    pub fn kind_name(&self) -> &'static str {
        match self.kind {
            BoardKind::Physical => "physical",
            BoardKind::Simulated => "simulated",
        }
    }

    /// Why it last started, in one word.
    pub fn reset_cause_name(&self) -> &'static str {
        match self.reset_cause {
            ResetCause::Unknown => "unknown",
            ResetCause::PowerOn => "power_on",
            ResetCause::BrownOut => "brown_out",
            ResetCause::Pin => "pin",
            ResetCause::Software => "software",
            ResetCause::Watchdog => "watchdog",
            ResetCause::Panic => "panic",
        }
    }
}
