//! What may be wrong with a board's wiring, parts and supply: each flaw can be planted by itself.
//!
//! Without flaws the board is built as `firmware/README.md` describes it, with one time constant. `slitpose doctor
//! --bring-up` must name each flaw, except that of a detector which settles in time. Faults of the microcontroller
//! itself are in `silicon`.

use clap::ValueEnum;
use slitpose_head::simulator::Electrode;

use crate::named::{Named, Set};

/// A flaw of the board or of the head in front of it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Flaw {
    /// I_X1 of cell 2 is not connected: always dark
    OpenElectrode,
    /// The stage of I_X2 of cell 4 lies at ground: always code 0
    StuckElectrode,
    /// I_X1 of cell 1 has five times the converter's noise
    NoisyChannel,
    /// Emitter 3 stays dark
    DeadEmitter,
    /// The gate lines of emitters 1 and 4 are exchanged
    SwappedGates,
    /// The inputs of cells 0 and 5 are exchanged
    SwappedCells,
    /// The level line of emitters 0 to 2 stays at nominal
    StuckLevel,
    /// The level line of emitters 0 to 2 is 0.1 V too high
    LiftedLevel,
    /// The switch of emitter 2 stays on: its gate does not darken it
    StuckGate,
    /// Emitter 5 has half its intensity
    WeakEmitter,
    /// All stages have 2.5 times the scene's time constant
    SlowFrontEnd,
    /// Detectors are resistive lines of 0.6 us, in a chain of several poles
    LineDetector,
    /// Detectors are resistive lines of 1.0 us, in a chain of several poles
    SlowDetector,
    /// 5 % of the light of cells 1 and 2 reaches the other one as well
    MissingBaffle,
    /// The supply is 3.0 V
    LowSupply,
    /// Flash does not keep stored settings over a reset
    LostSettings,
}

impl Named for Flaw {
    const KIND: &'static str = "flaw";
    const HAS_ALL: bool = false;

    #[inline]
    fn index(self) -> u32 {
        self as u32
    }
}

/// The flaws of a board and its head.
pub type Flaws = Set<Flaw>;

/// The electrodes, emitters and lines that flaws concern.
pub(super) const OPEN: (usize, Electrode) = (2, Electrode::X1);
pub(super) const STUCK: (usize, Electrode) = (4, Electrode::X2);
pub(super) const NOISY: (usize, Electrode) = (1, Electrode::X1);
pub(super) const NOISE_FACTOR: f64 = 5.0;
pub(super) const DEAD: usize = 3;
pub(super) const WEAK: usize = 5;
pub(super) const WEAK_STRENGTH: f64 = 0.5;
pub(super) const GATES: [usize; 2] = [1, 4];
pub(super) const CELLS: [usize; 2] = [0, 5];
pub(super) const LEVEL_LINE: usize = 0;
/// 0.1 V of 3.3 V, in codes of the DAC.
pub(super) const LIFTED_CODES: u16 = 124;
pub(super) const STUCK_GATE: usize = 2;
pub(super) const SLOW_FACTOR: f64 = 2.5;
pub(super) const LINES_S: [(Flaw, f64); 2] = [(Flaw::LineDetector, 0.6e-6), (Flaw::SlowDetector, 1.0e-6)];
pub(super) const BAFFLE: [usize; 2] = [1, 2];
pub(super) const BAFFLE_SHARE: f64 = 0.05;
pub(crate) const LOW_SUPPLY_V: f64 = 3.0;
