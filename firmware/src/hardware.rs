//! The hardware edge: all that the core needs from below, one trait for each purpose.
//!
//! | trait | covers |
//! |---|---|
//! | [`Acquisition`] | emitters and converters |
//! | [`Storage`] | memory that outlives the supply |
//! | [`System`] | clock, trigger input, indicator, sensors, reset |

use slitpose_protocol::poses::TRIANGLE;
use slitpose_protocol::{BootTarget, Configuration, Edge, HardwareFault, Level, PoseRecord, Pulse, RawScan, Schedule};

use crate::settings::Settings;

/// All hardware of one board, real or simulated: a type has it by implementing the three
/// traits.
pub trait Hardware: Acquisition + Storage + System {}

impl<T: Acquisition + Storage + System> Hardware for T {}

/// Emitters that light slot by slot, and the converters that sample them.
pub trait Acquisition {
    /// Whether the hardware can run `configuration`, which is valid. Changes nothing.
    ///
    /// # Errors
    /// What the hardware cannot do.
    fn check(&self, configuration: &Configuration) -> Result<(), HardwareFault>;

    /// Lowers `levels`, one for each emitter, to the nearest ones that the hardware can
    /// drive by `schedule`. Changes nothing else.
    fn limit_levels(&self, schedule: &Schedule, levels: &mut [Level]);

    /// `Some`: light and sample by this configuration from the next frame on. `None`:
    /// switch the emitters off and stop sampling, both before the call returns. The
    /// emitters are off after every fault but [`HardwareFault::Emitters`].
    ///
    /// After the call no scan of an earlier configuration is handed out. Scans that were
    /// finished at the last [`next_scan`](Self::next_scan) and have not been handed out are
    /// lost, and the sequence shows the gap. Frames that have finished since then are cut off
    /// like the frame under way, and get no number.
    ///
    /// # Errors
    /// What the hardware cannot do, or what has failed. The caller then asks for `None`.
    fn acquire(&mut self, configuration: Option<&Configuration>) -> Result<(), HardwareFault>;

    /// Fills in the oldest finished scan that has not been handed out; `false` if there
    /// is none. `scan` has the shape of the configuration in force and arbitrary content;
    /// the hardware writes its sequence, tick, levels and words.
    ///
    /// `sequence` counts every frame sampled since reset, from 0 and without restart. It
    /// comes from a counter that an overrun does not stop, so that it shows how many scans
    /// an overrun has cost.
    ///
    /// # Errors
    /// [`ScanError::Overrun`] if scans were overwritten before they were collected; the
    /// next call goes on with the scans that are left. [`ScanError::Fault`] if there will
    /// be no more scans.
    fn next_scan(&mut self, scan: &mut RawScan) -> Result<bool, ScanError>;

    /// Makes these pulses from the next [`acquire`](Self::acquire) on, which is by `schedule`. A simulator may have no
    /// output.
    ///
    /// # Errors
    /// If the hardware cannot make them; it then makes those that it made before.
    fn set_pulse(&mut self, pulse: Pulse, schedule: &Schedule) -> Result<(), HardwareFault>;
}

/// Memory that keeps settings beyond the loss of supply.
pub trait Storage {
    /// Begins to keep `settings` and the bytes of a `head`, or with `None` to forget the settings that are kept.
    /// Without bytes no head is kept. Sampling goes on meanwhile.
    fn store(&mut self, settings: Option<&Settings>, head: &[u8]);

    /// How the last [`store`](Self::store) ended; `None` while it is under way.
    ///
    /// # Errors
    /// [`StorageError`] if it has failed.
    fn stored(&mut self) -> Option<Result<(), StorageError>>;
}

/// Clock, indicator, sensors and reset.
pub trait System {
    /// Device ticks since reset, at the tick rate of the configuration that the board was
    /// made with. Never goes backwards.
    fn now_ticks(&mut self) -> u64;

    /// The oldest edge of the trigger input since reset that has not been handed out.
    fn next_edge(&mut self) -> Option<Edge>;

    /// Edges since reset that came too fast, at least.
    fn missed_edges(&self) -> u32 {
        0
    }

    /// Shows `indicator` and measures the board's health. Called when the indicator
    /// changes and twice a second.
    fn housekeeping(&mut self, indicator: Indicator) -> Health;

    /// Shows or passes on a pose that the board has just solved.
    fn pose_solved(&mut self, _pose: &SolvedPose) {}

    /// Resets the board. Called when everything the board had to say has been sent, or has
    /// waited long enough. A simulator may have nothing to reset.
    fn reboot(&mut self, target: BootTarget);
}

/// A pose just solved.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SolvedPose {
    /// Sequence number of its scan.
    pub sequence: u64,
    /// Device tick at which its frame started.
    pub tick: u64,
    /// What came of it.
    pub record: PoseRecord,
    /// Covariance of (δt, δθ) in the base frame, m², m·rad, rad²: lower triangle, row by row. `None` without a pose.
    pub covariance: Option<[f32; TRIANGLE]>,
}

/// Why there is no scan although there should be.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ScanError {
    /// Scans were overwritten before they were collected, or the converters lost a
    /// conversion; the hardware is back in step.
    Overrun,
    /// The hardware cannot go on; its emitters are off.
    Fault(HardwareFault),
}

/// The memory did not keep, or did not forget, the settings.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct StorageError;

/// The state that the board's indicator light shows; the hardware chooses how.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Indicator {
    /// Waiting for a Start.
    Idle,
    /// Lighting and sampling.
    Acquiring,
    /// The host asked which board this is.
    Identify,
    /// A hardware fault ended acquisition, or emitters may be lit that should be off.
    /// Lasts until the next successful Start.
    Fault,
}

/// Readings of the board's own sensors.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Health {
    /// Supply voltage in volts.
    pub supply_v: f32,
    /// Temperature of the MCU in kelvin.
    pub temperature_k: f32,
    /// Share of processor time in use, in thousandths.
    pub cpu_load_permille: u16,
}
