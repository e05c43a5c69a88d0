//! The state of a daemon and its boards. The names of the fields are an interface: they stay.
//!
//! Counters count since the start of the daemon, or of following that board, and only rise. All other values are
//! current, or of the last interval where the field says so.

use schemars::JsonSchema;
use schemars::generate::SchemaSettings;
use serde::Serialize;

use super::latency::Latency;
use crate::clock::HostInstant;
use crate::datagram::DatagramCounts;
use crate::health::HeadHealth;
use crate::link::DeviceId;
use crate::pipeline::Outcomes;

/// Everything a daemon has to say.
#[derive(Clone, Debug, PartialEq, Serialize, JsonSchema)]
pub(crate) struct DaemonReport {
    /// Name of the program.
    pub program: &'static str,
    /// Its version.
    pub version: &'static str,
    /// When it was started, UTC, nanoseconds since 1970 began.
    pub started_utc_ns: u64,
    /// For how long it has run, seconds.
    pub uptime_s: f64,
    /// Memory and threads, where the system tells.
    pub process: Option<ProcessReport>,
    /// Its boards.
    pub boards: Vec<BoardReport>,
    /// The capture it writes.
    pub recorder: RecorderReport,
    /// The datagrams it sends; `None` if nobody has asked for any.
    pub datagrams: Option<DatagramCounts>,
}

/// The JSON schema of a [`DaemonReport`], and within it that of a [`BoardReport`].
pub(crate) fn report_schema() -> String {
    let settings = SchemaSettings::draft2020_12().for_serialize();
    settings.into_generator().into_root_schema_for::<DaemonReport>().as_value().to_string()
}

/// What the system says of the daemon.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, JsonSchema)]
pub(crate) struct ProcessReport {
    /// Memory in RAM, bytes.
    pub resident_bytes: u64,
    /// Threads.
    pub threads: u64,
}

/// One board.
#[derive(Clone, Debug, Default, PartialEq, Serialize, JsonSchema)]
pub(crate) struct BoardReport {
    /// What the user calls it: a port, or `sim`.
    pub name: String,
    /// Its unique number; `None` until it has introduced itself.
    pub device: Option<DeviceId>,
    /// Name of the board, as its firmware has it.
    pub board: String,
    /// Version of its firmware.
    pub firmware: String,
    /// Whether its photocurrents are computed, not measured.
    pub simulated: bool,
    /// When this report was made, CLOCK_MONOTONIC. One that is old tells that the daemon is stuck.
    pub made_monotonic_ns: u64,
    /// When this report was made, UTC, nanoseconds since 1970 began.
    pub made_utc_ns: u64,
    /// The link to it.
    pub link: LinkReport,
    /// Scans that arrived.
    pub scans: u64,
    /// Age of the last scan when the report was made, seconds; `None` before the first.
    pub last_scan_age_s: Option<f64>,
    /// Scans a second.
    pub rates: Rates,
    /// What is missing, by the place it was lost at.
    pub losses: Losses,
    /// Solutions by what the solver says.
    pub outcomes: Outcomes,
    /// The same of the last interval.
    pub recent_outcomes: Outcomes,
    /// What was lost on the way in the last interval.
    pub recent_link_losses: LinkLosses,
    /// How old poses are.
    pub latencies: Latencies,
    /// Whether the solver keeps up.
    pub lag: LagReport,
    /// The board's clock by the host's.
    pub clock: ClockReport,
    /// What the board says of itself; `None` before its first status.
    pub vitals: Option<Vitals>,
    /// Its last warning or error.
    pub complaint: Option<BoardEvent>,
    /// Its optics; `None` before the first scan.
    pub head: Option<HeadHealth>,
}

/// Whether there is a board, and what it does.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub(crate) enum LinkState {
    /// It is looked for.
    #[default]
    Searching,
    /// It is there, and spoken to; no scan has come yet.
    Connecting,
    /// It sends scans.
    Running,
    /// It is there and sends nothing, or no usable scan.
    Quiet,
    /// It was there and is no more.
    Gone,
    /// It cannot be used as it is.
    Refused,
    /// It is no longer followed: all that was asked for has come, or it was given up.
    Ended,
}

impl LinkState {
    /// All of them.
    pub(crate) const ALL: [Self; 7] =
        [Self::Searching, Self::Connecting, Self::Running, Self::Quiet, Self::Gone, Self::Refused, Self::Ended];

    /// The word used in tables and messages.
    pub(crate) fn as_str(self) -> &'static str {
        match self {
            Self::Searching => "searching",
            Self::Connecting => "connecting",
            Self::Running => "running",
            Self::Quiet => "quiet",
            Self::Gone => "gone",
            Self::Refused => "refused",
            Self::Ended => "ended",
        }
    }
}

/// The link to a board.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, JsonSchema)]
pub(crate) struct LinkReport {
    /// Its state.
    pub state: LinkState,
    /// Why, in a sentence, if there is something to say.
    pub reason: Option<String>,
    /// Since when, UTC, nanoseconds since 1970 began.
    pub since_utc_ns: u64,
    /// Times it ran again after it had run before.
    pub reconnects: u64,
    /// Times it was looked for in vain since it ran last.
    pub attempts: u64,
}

/// Scans a second, of the last interval.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, JsonSchema)]
pub(crate) struct Rates {
    /// By the board's clock; `None` if no scan came.
    pub device_hz: Option<f64>,
    /// By the host's clock: zero if none came.
    pub host_hz: f64,
    /// Length of the interval by the host's clock, seconds; zero before the first has ended.
    pub interval_s: f64,
}

/// What is missing, by place.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, JsonSchema)]
pub(crate) struct Losses {
    /// On the board.
    pub board: BoardLosses,
    /// Between board and host.
    pub link: LinkLosses,
    /// On the host.
    pub host: HostLosses,
}

/// What the board says it has lost.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, JsonSchema)]
pub(crate) struct BoardLosses {
    /// Scans it dropped, as the link did not take them in time.
    pub scans_dropped: u64,
    /// Scans that never left its converters.
    pub scans_lost: u64,
    /// Overruns of its converters or their memory.
    pub adc_overruns: u64,
}

/// What was lost on the way.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, JsonSchema)]
pub(crate) struct LinkLosses {
    /// Scans missing in the numbering that the board does not account for. Known when its next status
    /// has come.
    pub scans: u64,
    /// Packets with a wrong checksum.
    pub bad_checksum: u64,
    /// Packets with broken framing.
    pub misframed: u64,
    /// Packets longer than any is.
    pub overlong: u64,
    /// Undamaged packets that this program cannot read, and batches that no hello explains.
    pub unreadable: u64,
    /// Bytes of all of these.
    pub bytes_skipped: u64,
}

/// What the host had and did not keep.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, JsonSchema)]
pub(crate) struct HostLosses {
    /// Bytes of the link that the recorder had no room for.
    pub bytes_unrecorded: u64,
    /// Poses that a subscriber did not take in time.
    pub poses_unsent: u64,
}

impl LinkLosses {
    /// Packets that were damaged on their way.
    pub(crate) fn damaged(&self) -> u64 {
        self.bad_checksum + self.misframed + self.overlong
    }

    /// What has been lost since `before`.
    pub(crate) fn since(&self, before: &Self) -> Self {
        Self {
            scans: self.scans.saturating_sub(before.scans),
            bad_checksum: self.bad_checksum.saturating_sub(before.bad_checksum),
            misframed: self.misframed.saturating_sub(before.misframed),
            overlong: self.overlong.saturating_sub(before.overlong),
            unreadable: self.unreadable.saturating_sub(before.unreadable),
            bytes_skipped: self.bytes_skipped.saturating_sub(before.bytes_skipped),
        }
    }
}

impl Losses {
    /// Packets that were damaged on their way.
    pub(crate) fn damaged(&self) -> u64 {
        self.link.damaged()
    }
}

/// How old poses are. The instant of the sample is known to the clock's uncertainty.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, JsonSchema)]
pub(crate) struct Latencies {
    /// From the instant that a pose refers to until the host had read it: board and link.
    pub link: Latency,
    /// From there until the pose was published: the host.
    pub host: Latency,
    /// Both.
    pub total: Latency,
}

/// How far solving is behind what comes, in the last moments.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, JsonSchema)]
pub(crate) struct LagReport {
    /// Control loops get the newest scan only: the solver takes longer than the board.
    #[serde(rename = "behind")]
    pub is_behind: bool,
    /// For how long that has been so, seconds.
    pub behind_s: f64,
    /// Standard output was not read as fast as poses came.
    #[serde(rename = "output_blocked")]
    pub is_output_blocked: bool,
    /// Scans that have arrived and are not solved yet.
    pub waiting_scans: u64,
    /// For how long the oldest of them has waited, seconds.
    pub waiting_s: f64,
    /// Scans that were given up unsolved, in all. A capture has them.
    pub skipped_scans: u64,
}

/// The board's clock by the host's.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, JsonSchema)]
pub(crate) struct ClockReport {
    /// The instants of scans are right to this by the host's clock, either way, seconds; `None` while
    /// they are not known.
    pub uncertainty_s: Option<f64>,
    /// By how many millionths the board's clock is fast; `None` if not known.
    pub drift_ppm: Option<f64>,
}

/// What a board says of itself.
#[derive(Clone, Debug, PartialEq, Serialize, JsonSchema)]
pub(crate) struct Vitals {
    /// Why it last started.
    pub reset_cause: String,
    /// Whether it acquires.
    pub acquiring: bool,
    /// Supply voltage, volts.
    pub supply_v: f32,
    /// Temperature of its controller, kelvin.
    pub temperature_k: f32,
    /// Share of its processor's time in use, 0 to 1.
    pub cpu_load: f64,
    /// Replies it dropped, as the host did not read them; since its reset.
    pub replies_dropped: u32,
    /// Commands that reached it damaged; since its reset.
    pub commands_damaged: u32,
    /// Commands it refused; since its reset.
    pub commands_rejected: u32,
}

/// A warning or error that a board reported.
#[derive(Clone, Debug, PartialEq, Serialize, JsonSchema)]
pub(crate) struct BoardEvent {
    /// Whether it can still do its job.
    pub is_error: bool,
    /// When, by its clock, seconds; `None` if its clock is not known yet.
    pub device_time_s: Option<f64>,
    /// What.
    pub text: String,
}

/// Whether scans are recorded.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub(crate) enum RecorderState {
    /// Nobody asked for it.
    #[default]
    Off,
    /// They are.
    Recording,
    /// They were to be, and are not.
    Failed,
}

impl RecorderState {
    /// All of them.
    pub(crate) const ALL: [Self; 3] = [Self::Off, Self::Recording, Self::Failed];

    /// The word used in tables and messages.
    pub(crate) fn as_str(self) -> &'static str {
        match self {
            Self::Off => "off",
            Self::Recording => "recording",
            Self::Failed => "failed",
        }
    }
}

/// The capture that a daemon writes.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, JsonSchema)]
pub(crate) struct RecorderReport {
    /// Whether it does.
    pub state: RecorderState,
    /// Why it failed.
    pub reason: Option<String>,
    /// The file.
    pub file: Option<String>,
    /// Bytes written to it.
    pub bytes: u64,
    /// Files begun.
    pub files: u64,
    /// Times that all recorded until then was made to survive a power cut: about once a second.
    pub flushes: u64,
    /// Bytes of links that were not recorded: the disk was too slow, or failed.
    pub bytes_dropped: u64,
}

impl BoardReport {
    /// What to call the board where a name must not be shared: its number, or its port before that is known.
    pub(crate) fn label(&self) -> String {
        self.device.map_or_else(|| self.name.clone(), |device| device.to_string())
    }

    /// Age of this report at `now`, seconds.
    pub(crate) fn age_s(&self, now: HostInstant) -> f64 {
        now.monotonic_ns.saturating_sub(self.made_monotonic_ns) as f64 * 1e-9
    }
}
