//! The hardware edge: all a board core needs from below.

use slitpose_protocol::{BootTarget, Configuration, HardwareFault, RawScan};

use crate::settings::Settings;

/// Emitters, converters, clock and sensors of one board, real or simulated.
pub trait Hardware {
    /// Device ticks since reset, in ticks of the configuration the board was made with.
    /// Never goes backwards.
    fn now_ticks(&mut self) -> u64;

    /// Whether the hardware can run a valid configuration. Changes nothing.
    ///
    /// # Errors
    /// What it cannot do.
    fn check(&self, configuration: &Configuration) -> Result<(), HardwareFault>;

    /// `Some`: light and sample by this configuration from the next frame on. `None`:
    /// emitters off and sampling stopped, both done when the call returns. With any fault
    /// but [`HardwareFault::Emitters`] the emitters are off all the same.
    ///
    /// Scans of an earlier configuration are not handed out after this call. Those that
    /// were there at the last [`next_scan`](Self::next_scan) are gone, and the sequence
    /// shows it; what has been sampled since is cut off like the frame under way and does
    /// not count.
    ///
    /// # Errors
    /// What cannot be done or has failed. The caller then asks for `None`.
    fn acquire(&mut self, configuration: Option<&Configuration>) -> Result<(), HardwareFault>;

    /// Fills in the oldest finished scan that has not been handed out; `false` if there
    /// is none. `scan` arrives in the shape of the configuration in force and holds
    /// whatever was in it; sequence, tick, levels and words are all to be written.
    ///
    /// `sequence` counts every frame sampled since reset, from 0 and without restart,
    /// and comes from a counter that an overrun does not stop: it is what shows how much
    /// an overrun has cost.
    ///
    /// # Errors
    /// [`ScanError::Overrun`] if scans were overwritten before they were collected; the
    /// next call goes on with what is left. [`ScanError::Fault`] if there will be no more.
    fn next_scan(&mut self, scan: &mut RawScan) -> Result<bool, ScanError>;

    /// Shows the indicator and measures the board's health. Called when the indicator
    /// changes and twice a second.
    fn housekeeping(&mut self, indicator: Indicator) -> Health;

    /// Begins to keep `settings` beyond the loss of supply, or to forget what is kept.
    /// Sampling goes on meanwhile.
    fn store(&mut self, settings: Option<&Settings>);

    /// Whether that has been done: `None` while it is under way.
    ///
    /// # Errors
    /// [`StorageError`] if it cannot be done.
    fn stored(&mut self) -> Option<Result<(), StorageError>>;

    /// Starts anew. Everything said has been sent when this is called, or waited for long
    /// enough. A simulator may have nothing to start.
    fn reboot(&mut self, target: BootTarget);
}

/// Why there is no scan although there should be.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ScanError {
    /// Scans were overwritten before they were collected, or the converters lost a
    /// conversion; the hardware is back in step.
    Overrun,
    /// The hardware cannot go on; what it lights is off.
    Fault(HardwareFault),
}

/// The memory did not take what it was given.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct StorageError;

/// What the board's indicator light shows; how is the hardware's choice.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Indicator {
    /// Waiting for a Start.
    Idle,
    /// Lighting and sampling.
    Acquiring,
    /// "It is me": the host asked which board this is.
    Identify,
    /// The hardware failed: acquisition ended by it, or emitters may be lit that should
    /// not be. Until the next successful Start.
    Fault,
}

/// What the board's own sensors say.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Health {
    /// Supply voltage in volts.
    pub supply_v: f32,
    /// Temperature of the controller in kelvin.
    pub temperature_k: f32,
    /// Share of processor time in use, in thousandths.
    pub cpu_load_permille: u16,
}
