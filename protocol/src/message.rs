//! Device to host: the messages of a board.
//!
//! The order of the variants is their number on the wire; a new one goes to the end.
//! Text and samples are borrowed from the decoder.

use core::fmt;

use heapless::Vec;
use postcard::take_from_bytes;
use serde::{Deserialize, Serialize};
use thiserror::Error;

use crate::batch::Batch;
use crate::command::Hashes;
use crate::frame::{Packet, PayloadError};
use crate::poses::Poses;
use crate::scan::AdcScaling;
use crate::schedule::{Schedule, ScheduleError};
use crate::schema::{self, SchemaKeys, SchemaMismatch};
use crate::{PROTOCOL, ProtocolVersion};

/// A message of a board.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub enum Message<'a> {
    /// The board's identity and how it samples.
    #[serde(borrow)]
    Hello(Hello<'a>),
    /// Consecutive scans.
    #[serde(borrow)]
    Batch(Batch<'a>),
    /// Counters and health, twice per second.
    Status(Status),
    /// An event on the board.
    #[serde(borrow)]
    Event(Event<'a>),
    /// The end of a command.
    Reply(Reply),
    /// The answer to a ping.
    Pong(Pong),
    /// The pose a simulator had at a scan.
    Truth(Truth),
    /// Poses that the board has solved.
    #[serde(borrow)]
    Poses(Poses<'a>),
    /// Edges of the trigger input.
    Edges(Edges),
}

impl<'p> Packet<'p> for Message<'p> {
    fn from_payload(payload: &'p [u8]) -> Result<Self, PayloadError> {
        let (kind, fields) =
            take_from_bytes::<u32>(payload).map_err(|_| PayloadError::NoKind { bytes: payload.len() })?;
        if kind as usize >= schema::MESSAGES.len() {
            return Err(PayloadError::UnknownMessage { kind });
        }
        // Checked before the fields are read: another major version has another layout,
        // and "wrong version" is more helpful than "malformed".
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

/// The board's identity and how it samples. Sent when a link is opened, on request, and
/// after every accepted [`Configure`](crate::Command::Configure), before the first batch
/// it applies to, so that a recording is self-contained.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Hello<'a> {
    /// The board's version of this protocol.
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
    /// Cause of the last reset.
    pub reset_cause: ResetCause,
    /// Stored hashes of the scene and calibration that the board belongs to.
    pub hashes: Hashes,
    /// Conversion of words to amperes.
    pub scaling: AdcScaling,
    /// Number of the configuration in force, incremented by the board, with wrap-around,
    /// at every accepted Configure; batches carry it.
    pub configuration: u16,
    /// The schedule of that configuration.
    pub schedule: Schedule,
}

impl Hello<'_> {
    /// Checks that every message and command known to both sides has the same layout.
    pub fn check_schemas(&self) -> Result<(), SchemaMismatch> {
        self.message_keys.check(&schema::MESSAGES)?;
        self.command_keys.check(&schema::COMMANDS)
    }
}

/// Origin of a board's photocurrents.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum BoardKind {
    /// Measured on detectors.
    Physical,
    /// Computed by a model.
    Simulated,
}

/// Cause of a board's last reset.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum ResetCause {
    /// Unknown to the board.
    Unknown,
    /// The supply was switched on.
    PowerOn,
    /// The supply voltage dropped.
    BrownOut,
    /// The reset pin.
    Pin,
    /// A request of the firmware.
    Software,
    /// The watchdog was not fed.
    Watchdog,
    /// A panic of the firmware, or an access to invalid memory.
    Panic,
    /// The firmware's stack had no room left.
    StackOverflow,
}

/// Counters since reset, health, and what the board started with. At every instant
/// `scans_taken = scans sent + scans_dropped + scans_lost + scans still on the board`.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Status {
    /// Device tick at which the status was made.
    pub tick: u64,
    /// Whether the board is acquiring; if not, its emitters are off.
    pub acquiring: bool,
    /// Scans taken: the least possible sequence number of the next scan.
    pub scans_taken: u64,
    /// Scans dropped because the link was too slow or not open.
    pub scans_dropped: u64,
    /// Batches of those scans.
    pub batches_dropped: u32,
    /// Scans lost in acquisition: overwritten before they were collected, or cut off
    /// when the configuration changed.
    pub scans_lost: u64,
    /// Overruns of the converters or their DMA.
    pub adc_overruns: u32,
    /// Replies, events and hellos dropped because the host sent commands without
    /// reading the answers.
    pub replies_dropped: u32,
    /// Frames from the host without a readable command number.
    pub commands_damaged: u32,
    /// Commands answered with a rejection.
    pub commands_rejected: u32,
    /// Supply voltage in volts.
    pub supply_v: f32,
    /// Temperature of the MCU in kelvin.
    pub temperature_k: f32,
    /// CPU load in thousandths.
    pub cpu_load_permille: u16,
    /// What the ticks are counted by.
    pub clock: ClockSource,
    /// Where the configuration came from at the start.
    pub settings: SettingsSource,
}

/// An event on the board that is not the answer to a command.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct Event<'a> {
    /// Device tick of the event.
    pub tick: u64,
    /// Its severity.
    pub severity: Severity,
    /// Description for people; programs rely on counters and replies.
    pub text: &'a str,
}

/// Severity of an [`Event`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub enum Severity {
    /// Information.
    Info,
    /// Data may be missing.
    Warning,
    /// The board cannot measure until the user acts.
    Error,
}

/// The end of a command: sent once for every command with a readable number, after all
/// other messages that the command causes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct Reply {
    /// Number of the command, as the host gave it.
    pub number: u16,
    /// Whether it was carried out.
    pub outcome: Result<(), Rejection>,
}

/// Why a command was not carried out. The state of the board is unchanged, unless the
/// variant says otherwise.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Error, Serialize, Deserialize)]
#[allow(missing_docs, reason = "the texts say what each is")]
pub enum Rejection {
    #[error("command kind {kind} is unknown to this firmware: update it")]
    Unsupported { kind: u32 },
    #[error("the fields of command kind {kind} cannot be read: compare schema keys")]
    Malformed { kind: u32 },
    #[error("schedule refused: {0}")]
    Schedule(ScheduleError),
    #[error("{levels} emitter levels for {cells} cells: give one a cell")]
    Levels { levels: u8, cells: u8 },
    #[error("schedule in ticks of {asked_hz} Hz, the board counts {board_hz} Hz")]
    TickRate { asked_hz: u32, board_hz: u32 },
    #[error("hardware: {0}; acquisition has stopped")]
    Hardware(HardwareFault),
    #[error("the board cannot run this: {0}")]
    Unsuited(HardwareFault),
    #[error("settings are being stored: wait for the reply")]
    Storing,
    #[error("settings could not be stored: the board's flash memory does not take them")]
    Storage,
}

/// The part of a board that failed, or that cannot run a configuration.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Error, Serialize, Deserialize)]
#[allow(missing_docs, reason = "the texts say what each is")]
pub enum HardwareFault {
    #[error("the timers cannot make this schedule: change its durations")]
    Timing,
    #[error("a conversion cannot take {asked_ticks} ticks: the nearest possible is {nearest_ticks}")]
    Conversion { asked_ticks: u32, nearest_ticks: u32 },
    #[error("settling of {asked_ticks} ticks is too short to start a conversion in: at least {least_ticks}")]
    Settling { asked_ticks: u32, least_ticks: u32 },
    #[error("the converters cannot sum {oversampling} conversions: use a power of two")]
    Oversampling { oversampling: u16 },
    #[error("{cells} cells asked for, the board has {channels}")]
    Channels { cells: u8, channels: u8 },
    #[error("the emitters cannot be driven as asked: lower the levels")]
    Emitters,
    #[error("emitters {first} and {second} share a level and are lit together: give both the same level")]
    SharedLevel { first: u8, second: u8 },
    #[error("the supply is too low: check the cable and the power source")]
    Supply,
    #[error("the converters do not answer: reset the board")]
    Converters,
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

/// Most edges in a message.
pub const MAX_EDGES: usize = 8;

/// Consecutive edges of a board's trigger input.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Edges {
    /// Number of the first one: the board numbers all edges since its reset from 0. A gap shows edges that were dropped
    /// because the link was too slow or not open.
    pub number: u32,
    /// Edges since reset that came too fast for the board, at least; these have no numbers.
    pub missed: u32,
    /// The edges, the oldest first.
    pub edges: Vec<Edge, MAX_EDGES>,
}

/// An edge of the trigger input: its device tick, doubled, plus one if the line has risen.
///
/// ```
/// use slitpose_protocol::Edge;
/// let edge = Edge::new(170_000_000, true);
/// assert!(edge.tick() == 170_000_000 && edge.is_high());
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct Edge(u64);

impl Edge {
    /// An edge at a device tick, after which the line is high or low.
    pub fn new(tick: u64, is_high: bool) -> Self {
        Self(tick << 1 | u64::from(is_high))
    }

    /// Device tick of the edge.
    pub fn tick(self) -> u64 {
        self.0 >> 1
    }

    /// Whether the line has risen.
    pub fn is_high(self) -> bool {
        self.0 & 1 != 0
    }
}

/// The true pose at the reference instant of a scan. Sent by simulated boards only.
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

/// What a board's ticks are counted by, since its start.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ClockSource {
    /// The MCU's own RC oscillator, of the 1 % class: the board has no crystal.
    Internal,
    /// A crystal.
    Crystal,
    /// The MCU's own RC oscillator, as the board's crystal did not start.
    CrystalFailed,
}

/// Where a board's configuration came from when it started; after a Store or Forget, where the
/// next start would take it from.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum SettingsSource {
    /// From the firmware: none are stored, or they are not for this board.
    Defaults,
    /// From the settings stored on the board.
    Stored,
    /// From the firmware, although settings are stored: the board failed three times in a row
    /// while starting with them.
    PassedOver,
}

impl ClockSource {
    /// All of them, in the order of the wire.
    pub const ALL: [Self; 3] = [Self::Internal, Self::Crystal, Self::CrystalFailed];

    /// One word, for programs.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Internal => "internal",
            Self::Crystal => "crystal",
            Self::CrystalFailed => "crystal_failed",
        }
    }
}

impl SettingsSource {
    /// All of them, in the order of the wire.
    pub const ALL: [Self; 3] = [Self::Defaults, Self::Stored, Self::PassedOver];

    /// One word, for programs.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Defaults => "defaults",
            Self::Stored => "stored",
            Self::PassedOver => "passed_over",
        }
    }
}

impl fmt::Display for ClockSource {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Internal => "internal oscillator",
            Self::Crystal => "crystal",
            Self::CrystalFailed => "internal oscillator, as the crystal did not start",
        })
    }
}

impl fmt::Display for SettingsSource {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Defaults => "defaults of the firmware",
            Self::Stored => "stored on the board",
            Self::PassedOver => "defaults of the firmware, as three starts in a row with the stored ones failed",
        })
    }
}
