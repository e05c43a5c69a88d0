//! The hardware edge: all a board core needs from below.

use slitpose_protocol::{Configuration, HardwareFault, RawScan};

/// Emitters, converters, clock and sensors of one board, real or simulated.
pub trait Hardware {
    /// Device ticks since reset, in ticks of the configuration the board was made with.
    /// Never goes backwards.
    fn now_ticks(&mut self) -> u64;

    /// `Some`: light and sample by this configuration from the next frame on. `None`:
    /// emitters off and sampling stopped, both done when the call returns.
    ///
    /// Scans of an earlier configuration are not handed out after this call; those that
    /// had not been collected are gone, and the sequence shows it.
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
    /// [`Overrun`] if scans were overwritten before they were collected; the next call
    /// goes on with what is left.
    fn next_scan(&mut self, scan: &mut RawScan) -> Result<bool, Overrun>;

    /// Shows the indicator and measures the board's health. Called when the indicator
    /// changes and with every status.
    fn housekeeping(&mut self, indicator: Indicator) -> Health;
}

/// Scans were overwritten before they were collected, or the converters lost a
/// conversion; the hardware is back in step.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Overrun;

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
