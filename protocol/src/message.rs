//! Device to host: everything a board says.
//!
//! The order of the variants is their number on the wire; a new one goes to the end.
//! Text and samples are borrowed from the decoder, so decoding copies nothing twice.

use postcard::take_from_bytes;
use serde::{Deserialize, Serialize};
use thiserror::Error;

use crate::batch::Batch;
use crate::command::Hashes;
use crate::frame::{Packet, PayloadError};
use crate::scan::AdcScaling;
use crate::schedule::Schedule;
use crate::schedule_error::ScheduleError;
use crate::schema::{self, SchemaKeys, SchemaMismatch};
use crate::{PROTOCOL, ProtocolVersion};

/// Anything a board sends.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub enum Message<'a> {
    /// Who the board is and how it samples.
    #[serde(borrow)]
    Hello(Hello<'a>),
    /// Consecutive scans.
    #[serde(borrow)]
    Batch(Batch<'a>),
    /// Counters and health, twice a second.
    Status(Status),
    /// Something happened that no command asked for.
    #[serde(borrow)]
    Event(Event<'a>),
    /// The end of a command.
    Reply(Reply),
    /// The answer to a ping.
    Pong(Pong),
    /// The pose a simulator had at a scan.
    Truth(Truth),
}

impl<'p> Packet<'p> for Message<'p> {
    fn from_payload(payload: &'p [u8]) -> Result<Self, PayloadError> {
        let (kind, fields) =
            take_from_bytes::<u32>(payload).map_err(|_| PayloadError::NoKind { bytes: payload.len() })?;
        if kind as usize >= schema::MESSAGES.len() {
            return Err(PayloadError::UnknownMessage { kind });
        }
        // Said before the fields are read: another major version lays them out
        // differently, and "wrong version" helps where "malformed" does not.
        if let (schema::HELLO_KIND, &[major, minor, ..]) = (kind, fields)
            && major != PROTOCOL.major
        {
            return Err(PayloadError::Version { theirs: ProtocolVersion { major, minor }, ours: PROTOCOL });
        }
        match take_from_bytes(payload) {
            Ok((message, [])) => Ok(message),
            _ => Err(PayloadError::MalformedMessage { kind }),
        }
    }
}

/// Who the board is and how it samples: sent when a link is opened, when asked for, and
/// after every accepted [`Configure`](crate::Command::Configure) ahead of the first batch
/// it applies to, so that a recording can be read on its own.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Hello<'a> {
    /// Version of this protocol the board speaks.
    pub protocol: ProtocolVersion,
    /// Schema key of each message kind the board knows.
    #[serde(borrow)]
    pub message_keys: SchemaKeys<'a>,
    /// Schema key of each command kind the board knows.
    #[serde(borrow)]
    pub command_keys: SchemaKeys<'a>,
    /// Unique number of the device.
    pub device_id: [u8; 12],
    /// Whether photocurrents are measured or computed.
    pub kind: BoardKind,
    /// Name of the board, for people.
    pub board: &'a str,
    /// Version of the firmware, for people.
    pub firmware: &'a str,
    /// Why the board last started.
    pub reset_cause: ResetCause,
    /// What is stored on the board of the scene and calibration it belongs to.
    pub hashes: Hashes,
    /// What a word is worth in amperes.
    pub scaling: AdcScaling,
    /// Number of the configuration in force, counted up (and round) by the board at
    /// every accepted Configure; batches carry it.
    pub configuration: u16,
    /// The schedule of that configuration.
    pub schedule: Schedule,
}

impl Hello<'_> {
    /// Checks that every message and command known to both sides is laid out alike.
    ///
    /// # Errors
    /// The first kind whose schema keys differ.
    pub fn check_schemas(&self) -> Result<(), SchemaMismatch> {
        self.message_keys.check(&schema::MESSAGES)?;
        self.command_keys.check(&schema::COMMANDS)
    }
}

/// Where the photocurrents of a board come from.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum BoardKind {
    /// From detectors with light on them.
    Physical,
    /// From a model.
    Simulated,
}

/// Why a board started.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum ResetCause {
    /// The board cannot tell.
    Unknown,
    /// The supply came up.
    PowerOn,
    /// The supply sagged.
    BrownOut,
    /// The reset pin.
    Pin,
    /// The firmware asked for it.
    Software,
    /// The watchdog was not fed.
    Watchdog,
    /// The firmware met a state that it takes for impossible, or touched memory that is
    /// not there.
    Panic,
}

/// Counters since reset, and health. At every instant
/// `scans_taken = scans sent + scans_dropped + scans_lost + scans still on the board`.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Status {
    /// Device tick at which the status was made.
    pub tick: u64,
    /// Whether the board is acquiring; if not, its emitters are off.
    pub acquiring: bool,
    /// Scans taken: the sequence number the next scan would have at the earliest.
    pub scans_taken: u64,
    /// Scans dropped because the link did not take them in time or nobody listened.
    pub scans_dropped: u64,
    /// Batches those scans were in.
    pub batches_dropped: u32,
    /// Scans that never left the converters: overwritten before they were collected, or
    /// cut off when the configuration changed.
    pub scans_lost: u64,
    /// Times the converters or their memory reported an overrun.
    pub adc_overruns: u32,
    /// Replies, events and hellos dropped because the host sent commands without
    /// reading the answers.
    pub replies_dropped: u32,
    /// Frames from the host that carried no readable command number.
    pub commands_damaged: u32,
    /// Commands answered with a rejection.
    pub commands_rejected: u32,
    /// Supply voltage in volts.
    pub supply_v: f32,
    /// Temperature of the controller in kelvin.
    pub temperature_k: f32,
    /// Share of processor time in use, in thousandths.
    pub cpu_load_permille: u16,
}

/// Something happened that no command asked for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct Event<'a> {
    /// Device tick at which it happened.
    pub tick: u64,
    /// How bad it is.
    pub severity: Severity,
    /// What happened, for people; programs rely on counters and replies.
    pub text: &'a str,
}

/// How bad an [`Event`] is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub enum Severity {
    /// Worth knowing.
    Info,
    /// Data may be missing.
    Warning,
    /// The board cannot do its job until someone acts.
    Error,
}

/// The end of a command: sent once for every command whose number could be read, after
/// everything else the command yields.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct Reply {
    /// Number of the command, as the host gave it.
    pub number: u16,
    /// Whether it was carried out.
    pub outcome: Result<(), Rejection>,
}

/// Why a command was not carried out. The board is as it was before, unless the variant
/// says otherwise.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Error, Serialize, Deserialize)]
pub enum Rejection {
    /// The firmware does not know the command.
    #[error("command kind {kind} is unknown to this firmware: update it")]
    Unsupported {
        /// Number of the command's variant.
        kind: u32,
    },
    /// The checksum is right but the fields are not those of the command.
    #[error("the fields of command kind {kind} cannot be read: compare schema keys")]
    Malformed {
        /// Number of the command's variant.
        kind: u32,
    },
    /// The schedule contradicts itself.
    #[error("schedule refused: {0}")]
    Schedule(ScheduleError),
    /// The levels do not match the cells of the schedule.
    #[error("{levels} emitter levels for {cells} cells: give one a cell")]
    Levels {
        /// Levels given.
        levels: u8,
        /// Cells of the schedule.
        cells: u8,
    },
    /// The schedule counts in other ticks than the board.
    #[error("schedule in ticks of {asked_hz} Hz, the board counts {board_hz} Hz")]
    TickRate {
        /// Ticks per second of the schedule.
        asked_hz: u32,
        /// Ticks per second of the board.
        board_hz: u32,
    },
    /// The hardware refused or failed. Acquisition has stopped and emitters are off.
    #[error("hardware: {0}; acquisition has stopped")]
    Hardware(HardwareFault),
    /// The hardware cannot run the configuration.
    #[error("the board cannot run this: {0}")]
    Unsuited(HardwareFault),
    /// An earlier Store or Forget has not finished.
    #[error("settings are being stored: wait for the reply")]
    Storing,
    /// What was to be stored could not be read back. What was stored before is still
    /// there, unless the Forget failed half-way.
    #[error("settings could not be stored: the board's flash memory does not take them")]
    Storage,
}

/// What part of a board failed, or cannot do what was asked.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Error, Serialize, Deserialize)]
pub enum HardwareFault {
    /// The timers cannot make the durations of the schedule.
    #[error("the timers cannot make this schedule: change its durations")]
    Timing,
    /// The converters need another time for a conversion.
    #[error("a conversion cannot take {asked_ticks} ticks: the nearest possible is {nearest_ticks}")]
    Conversion {
        /// Ticks of a conversion asked for.
        asked_ticks: u32,
        /// What comes nearest among the times the converters can take.
        nearest_ticks: u32,
    },
    /// The first conversion comes too early to be prepared.
    #[error("settling of {asked_ticks} ticks is too short to start a conversion in: at least {least_ticks}")]
    Settling {
        /// Ticks of settling asked for.
        asked_ticks: u32,
        /// Least possible with this conversion time.
        least_ticks: u32,
    },
    /// The converters cannot sum this many conversions.
    #[error("the converters cannot sum {oversampling} conversions: use a power of two")]
    Oversampling {
        /// Conversions asked for.
        oversampling: u16,
    },
    /// The board has fewer channels than the schedule has cells.
    #[error("{cells} cells asked for, the board has {channels}")]
    Channels {
        /// Cells asked for.
        cells: u8,
        /// Cells the board can sample.
        channels: u8,
    },
    /// The emitters cannot be driven at the levels asked for.
    #[error("the emitters cannot be driven as asked: lower the levels")]
    Emitters,
    /// Two emitters that are lit together share one source of their level.
    #[error("emitters {first} and {second} share a level and are lit together: give both the same level")]
    SharedLevel {
        /// The first emitter.
        first: u8,
        /// The second.
        second: u8,
    },
    /// The supply is too low to measure by.
    #[error("the supply is too low: check the cable and the power source")]
    Supply,
    /// The converters or their data path did not start or stop.
    #[error("the converters do not answer: reset the board")]
    Converters,
    /// Sequence or tick of a scan went backwards, or a scan has the wrong shape.
    #[error("scan counters are inconsistent: reset the board")]
    Counters,
}

/// The answer to a [`Ping`](crate::Command::Ping).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct Pong {
    /// The token of the ping.
    pub token: u32,
    /// Device tick at which the ping was read.
    pub tick: u64,
}

/// The pose a simulator had at the reference instant of a scan. Sent by simulators
/// only, never by a board with light in it.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Truth {
    /// Sequence number of the scan.
    pub sequence: u64,
    /// Translation of `base_from_tool` in metres, at the scan's tick plus
    /// [`Schedule::reference_ticks`].
    pub translation_m: [f64; 3],
    /// Rotation of `base_from_tool` at the same instant: unit quaternion x, y, z, w.
    pub rotation_xyzw: [f64; 4],
}
