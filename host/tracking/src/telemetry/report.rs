//! The state of a daemon and its boards. The names of the fields are a stable interface.
//!
//! Counters never decrease; they count since the start of the daemon, or since it follows the board. All other values
//! are current, or of the last interval if the field says so.

use std::fmt;

use schemars::generate::SchemaSettings;
use schemars::{JsonSchema, Schema};
use serde::Serialize;
use slitpose_protocol::{ClockSource, SettingsSource};

use super::latency::Latency;
use crate::clock::HostInstant;
use crate::frame::FrameReport;
use crate::health::HeadHealth;
use crate::link::DeviceId;
use crate::pipeline::{Agreement, Outcomes};

/// The state of a daemon.
#[derive(Clone, Debug, PartialEq, Serialize, JsonSchema)]
pub struct DaemonReport {
    /// Name of the program.
    pub program: &'static str,
    /// Its version.
    pub version: &'static str,
    /// Time of its start, UTC, nanoseconds since 1970.
    pub started_utc_ns: u64,
    /// Time since its start, seconds.
    pub uptime_s: f64,
    /// Memory and threads, if the operating system reports them.
    pub process: Option<ProcessReport>,
    /// Its boards.
    pub boards: Vec<BoardReport>,
    /// The capture it writes.
    pub recorder: RecorderReport,
    /// The datagrams it sends; `None` without a datagram server.
    pub datagrams: Option<DatagramCounts>,
}

/// The JSON schema of a [`DaemonReport`], and within it that of a [`BoardReport`].
pub fn report_schema() -> Schema {
    let settings = SchemaSettings::draft2020_12().for_serialize();
    settings.into_generator().into_root_schema_for::<DaemonReport>()
}

/// Memory and threads of the daemon, from the operating system.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, JsonSchema)]
pub struct ProcessReport {
    /// Memory in RAM, bytes.
    pub resident_bytes: u64,
    /// Number of threads.
    pub threads: u64,
}

/// The state of one board.
#[derive(Clone, Debug, Default, PartialEq, Serialize, JsonSchema)]
pub struct BoardReport {
    /// The user's name for it: a port, or `sim`.
    pub name: String,
    /// Its unique number; `None` until it has introduced itself.
    pub device: Option<DeviceId>,
    /// Name of the board, from its firmware.
    pub board: String,
    /// Version of its firmware.
    pub firmware: String,
    /// Whether its photocurrents are computed, not measured.
    pub simulated: bool,
    /// Time of this report, CLOCK_MONOTONIC, nanoseconds. An old report shows that the daemon hangs.
    pub made_monotonic_ns: u64,
    /// Time of this report, UTC, nanoseconds since 1970.
    pub made_utc_ns: u64,
    /// The link to the board.
    pub link: LinkReport,
    /// Scans that arrived.
    pub scans: u64,
    /// Age of the last scan when the report was made, seconds; `None` before the first.
    pub last_scan_age_s: Option<f64>,
    /// Scans per second.
    pub rates: Rates,
    /// Losses by place.
    pub losses: Losses,
    /// Solutions by outcome.
    pub outcomes: Outcomes,
    /// Solutions of the last interval by outcome.
    pub recent_outcomes: Outcomes,
    /// Brightness of all light relative to scene or calibration, by the last pose; `None`: it is taken for known.
    pub light_level: Option<f64>,
    /// Poses without a velocity, by the reason.
    pub velocities_withheld: Withheld,
    /// The frame of the poses, and what became of setting its zero.
    pub frame: FrameReport,
    /// Losses between board and host in the last interval.
    pub recent_link_losses: LinkLosses,
    /// Age of the poses.
    pub latencies: Latencies,
    /// Whether the solver keeps up.
    pub lag: LagReport,
    /// The board's clock relative to the host's.
    pub clock: ClockReport,
    /// The board's trigger input; `None` before its first edge.
    pub trigger: Option<TriggerReport>,
    /// The board's own status; `None` before the first.
    pub vitals: Option<Vitals>,
    /// The board's last warning or error.
    pub complaint: Option<BoardEvent>,
    /// Health of the board's head; `None` before the first scan.
    pub head: Option<HeadHealth>,
    /// How the poses that the board finds itself compare with those found here; `None` if it sends none.
    pub board_poses: Option<Agreement>,
}

/// The trigger input of a board.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, JsonSchema)]
pub struct TriggerReport {
    /// Edges that arrived.
    pub edges: u64,
    /// Edges that came too fast for the board, at least, since its start.
    pub missed: u32,
    /// Edges that were dropped between board and host.
    pub dropped: u64,
    /// The last one by the board's clock, seconds.
    pub last_device_time_s: f64,
    /// Whether the line is high.
    pub is_high: bool,
}

/// Poses without a velocity, by the reason.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, JsonSchema)]
pub struct Withheld {
    /// There were too few poses yet.
    pub start: u64,
    /// The tool was not where its motion led: it hit something, or the pose was wrong.
    pub jump: u64,
}

/// State of the link to a board.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum LinkState {
    /// The daemon searches for the board.
    #[default]
    Searching,
    /// The port is open; no scan has come yet.
    Connecting,
    /// The board sends scans.
    Running,
    /// The board is connected but sends nothing, or no usable scan.
    Quiet,
    /// The board was connected and is missing now.
    Gone,
    /// The board cannot be used in its present state.
    Refused,
    /// The board is no longer followed: all requested scans have come, or it was given up.
    Ended,
}

impl LinkState {
    /// All of them.
    pub const ALL: [Self; 7] =
        [Self::Searching, Self::Connecting, Self::Running, Self::Quiet, Self::Gone, Self::Refused, Self::Ended];
}

impl fmt::Display for LinkState {
    /// The word used in tables and messages.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.serialize(f)
    }
}

/// The link to a board.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, JsonSchema)]
pub struct LinkReport {
    /// Its state.
    pub state: LinkState,
    /// Reason for the state in a sentence, if any.
    pub reason: Option<String>,
    /// Time at which the state began, UTC, nanoseconds since 1970.
    pub since_utc_ns: u64,
    /// Number of times that the board ran again after a loss.
    pub reconnects: u64,
    /// Failed attempts since the board last ran.
    pub attempts: u64,
}

/// Scans per second in the last interval.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, JsonSchema)]
pub struct Rates {
    /// Rate by the board's clock; `None` if no scan came.
    pub device_hz: Option<f64>,
    /// Rate by the host's clock; zero if no scan came.
    pub host_hz: f64,
    /// Length of the interval by the host's clock, seconds; zero before the first has ended.
    pub interval_s: f64,
}

/// Losses by place.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, JsonSchema)]
pub struct Losses {
    /// Losses on the board.
    pub board: BoardLosses,
    /// Losses between board and host.
    pub link: LinkLosses,
    /// Losses on the host.
    pub host: HostLosses,
}

/// Losses reported by the board.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, JsonSchema)]
pub struct BoardLosses {
    /// Scans dropped because the link did not take them in time.
    pub scans_dropped: u64,
    /// Scans lost in acquisition.
    pub scans_lost: u64,
    /// Overruns of the converters or of their DMA buffer.
    pub adc_overruns: u64,
}

/// Losses between board and host.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, JsonSchema)]
pub struct LinkLosses {
    /// Scans missing in the numbering that the board does not report as lost. Updated with each status of
    /// the board.
    pub scans: u64,
    /// Scans that came again, or behind later ones, and were not solved.
    pub scans_repeated: u64,
    /// Packets with a wrong checksum.
    pub bad_checksum: u64,
    /// Packets with broken framing.
    pub misframed: u64,
    /// Packets longer than the protocol allows.
    pub overlong: u64,
    /// Undamaged packets that this program cannot read, and batches without a hello.
    pub unreadable: u64,
    /// Poses of the board that cannot be right, and were left out.
    pub poses_refused: u64,
    /// Bytes of packets that could not be used.
    pub bytes_skipped: u64,
}

/// Losses on the host.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, JsonSchema)]
pub struct HostLosses {
    /// Bytes of the link that the recorder had no room for.
    pub bytes_unrecorded: u64,
    /// Poses that a subscriber did not take in time.
    pub poses_unsent: u64,
}

impl LinkLosses {
    /// Packets that came damaged.
    pub fn damaged(&self) -> u64 {
        self.bad_checksum + self.misframed + self.overlong
    }

    /// Losses since `before`.
    pub fn since(&self, before: &Self) -> Self {
        Self {
            scans: self.scans.saturating_sub(before.scans),
            scans_repeated: self.scans_repeated.saturating_sub(before.scans_repeated),
            bad_checksum: self.bad_checksum.saturating_sub(before.bad_checksum),
            misframed: self.misframed.saturating_sub(before.misframed),
            overlong: self.overlong.saturating_sub(before.overlong),
            unreadable: self.unreadable.saturating_sub(before.unreadable),
            poses_refused: self.poses_refused.saturating_sub(before.poses_refused),
            bytes_skipped: self.bytes_skipped.saturating_sub(before.bytes_skipped),
        }
    }
}

/// Age of the poses. The instant of a pose is known within the clock's uncertainty.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, JsonSchema)]
pub struct Latencies {
    /// From the instant of a pose until the host had read its scan: board and link.
    pub link: Latency,
    /// From then until the pose was published: the host.
    pub host: Latency,
    /// Sum of both.
    pub total: Latency,
}

/// How far the solver is behind the scans that arrive.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, JsonSchema)]
pub struct LagReport {
    /// Whether the solver is slower than the board, so that control loops get only the newest scans.
    #[serde(rename = "behind")]
    pub is_behind: bool,
    /// Time since the solver has been behind, seconds.
    pub behind_s: f64,
    /// Whether standard output was read more slowly than poses came.
    #[serde(rename = "output_blocked")]
    pub is_output_blocked: bool,
    /// Scans that have arrived and are not solved yet.
    pub waiting_scans: u64,
    /// Time that the oldest of them has waited, seconds.
    pub waiting_s: f64,
    /// Total of scans skipped unsolved. A capture contains them.
    pub skipped_scans: u64,
}

/// The board's clock relative to the host's.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, JsonSchema)]
pub struct ClockReport {
    /// Greatest error of the instants of scans by the host's clock, either way, seconds; `None` while
    /// unknown.
    pub uncertainty_s: Option<f64>,
    /// Rate error of the board's clock, ppm, positive if fast; `None` while unknown.
    pub drift_ppm: Option<f64>,
    /// The board reports a crystal, and its rate has broken the bounds of one: the wider bounds of an internal oscillator
    /// hold.
    pub contradicts_crystal: bool,
}

/// A board's own status.
#[derive(Clone, Debug, PartialEq, Serialize, JsonSchema)]
pub struct Vitals {
    /// Cause of the last reset.
    pub reset_cause: String,
    /// Source of its clock: `internal` (oscillator of the MCU), `crystal`, or `crystal_failed` (oscillator of the MCU, as
    /// the crystal did not start).
    #[schemars(with = "String")]
    pub clock_source: ClockSource,
    /// Source of its configuration at the start: `defaults`, `stored`, or `passed_over` (defaults, as three starts in a
    /// row with the stored settings failed).
    #[schemars(with = "String")]
    pub settings: SettingsSource,
    /// Whether it acquires scans.
    pub acquiring: bool,
    /// Supply voltage, volts.
    pub supply_v: f32,
    /// Temperature of its MCU, kelvin.
    pub temperature_k: f32,
    /// CPU load, 0 to 1.
    pub cpu_load: f64,
    /// Replies dropped since its reset because the host did not read them.
    pub replies_dropped: u32,
    /// Commands received damaged since its reset.
    pub commands_damaged: u32,
    /// Commands refused since its reset.
    pub commands_rejected: u32,
}

/// A warning or error that a board reported.
#[derive(Clone, Debug, PartialEq, Serialize, JsonSchema)]
pub struct BoardEvent {
    /// Whether it is an error, not a warning.
    pub is_error: bool,
    /// Time by the board's clock, seconds; `None` if the clock's rate is unknown.
    pub device_time_s: Option<f64>,
    /// Description.
    pub text: String,
}

/// Whether scans are recorded.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum RecorderState {
    /// No recording was requested.
    #[default]
    Off,
    /// Scans are recorded.
    Recording,
    /// The recording failed.
    Failed,
}

impl RecorderState {
    /// All of them.
    pub const ALL: [Self; 3] = [Self::Off, Self::Recording, Self::Failed];
}

impl fmt::Display for RecorderState {
    /// The word used in tables and messages.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.serialize(f)
    }
}

/// The capture that a daemon writes.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, JsonSchema)]
pub struct RecorderReport {
    /// State of the recording.
    pub state: RecorderState,
    /// Reason of a failure.
    pub reason: Option<String>,
    /// The file.
    pub file: Option<String>,
    /// Bytes written to it.
    pub bytes: u64,
    /// Number of files begun.
    pub files: u64,
    /// Number of flushes to the disk, about one per second: recorded data then survive a power cut.
    pub flushes: u64,
    /// Bytes of links that were not recorded: the disk was too slow, or failed.
    pub bytes_dropped: u64,
}

/// Counts of datagrams sent and refused since the server started.
#[derive(Clone, Debug, Default, PartialEq, Serialize, JsonSchema)]
pub struct DatagramCounts {
    /// Places taken by clients now.
    pub places_taken: u64,
    /// Places of each board; users share them evenly, and all clients on UDP count as one user.
    pub places: u64,
    /// Clients that got no place, or lost theirs to another user's client.
    pub places_refused: u64,
    /// Valid requests.
    pub requests: u64,
    /// Requests refused: unreadable, from clients without a valid name of their own, or too many at a time.
    pub refused: u64,
    /// Requests on UDP without a valid cookie, answered with a cookie.
    pub unproven: u64,
    /// Datagrams sent.
    pub sent: u64,
    /// Datagrams for which a client's queue had no room. Not known for UDP.
    pub missed: u64,
    /// Clients that do not read fast enough. Not known for UDP.
    pub slow_clients: Vec<SlowClient>,
}

/// A client that has missed poses for more than a second, without a second in which it missed none.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, JsonSchema)]
pub struct SlowClient {
    /// Its process; `None` if unknown.
    pub process: Option<i32>,
    /// Its user; `None` if unknown.
    pub user: Option<u32>,
    /// Poses that it has missed.
    pub missed: u64,
    /// For how long it has missed poses, seconds.
    pub missing_s: f64,
}

impl BoardReport {
    /// A unique name for the board: its number, or its port before the number is known.
    pub fn label(&self) -> String {
        self.device.map_or_else(|| self.name.clone(), |device| device.to_string())
    }

    /// Age of this report at `now`, seconds.
    pub fn age_s(&self, now: HostInstant) -> f64 {
        now.monotonic_ns.saturating_sub(self.made_monotonic_ns) as f64 * 1e-9
    }
}
