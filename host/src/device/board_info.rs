//! The hello of a board, with owned texts.

use serde::{Serialize, Serializer};
use slitpose_protocol::schema::SchemaMismatch;
use slitpose_protocol::{AdcScaling, BoardKind, Hashes, Hello, PROTOCOL, ProtocolVersion, ResetCause, Schedule};

use crate::link::DeviceId;

/// A hello that owns its texts.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct BoardInfo {
    /// The board.
    pub device: DeviceId,
    /// Whether its photocurrents are measured.
    pub kind: BoardKind,
    /// Name of the board, for people.
    pub board: String,
    /// Version of its firmware, for people.
    pub firmware: String,
    /// Version of the protocol it speaks.
    pub protocol: ProtocolVersion,
    /// The first kind of message with another layout than in this program, if any.
    pub mismatch: Option<SchemaMismatch>,
    /// Cause of its last reset.
    pub reset_cause: ResetCause,
    /// Hashes stored on it.
    pub hashes: Hashes,
    /// Scaling of its words.
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

/// The JSON form, in SI units.
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
