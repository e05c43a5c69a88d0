//! What may be wrong with a board's wiring, parts and supply: each flaw can be planted by itself.
//!
//! Without flaws the board is built as `firmware/README.md` describes it. `slitpose doctor --bring-up` must name each of
//! them. Faults of the microcontroller itself are in `silicon`.

use std::fmt;
use std::str::FromStr;

use slitpose_head::simulator::Electrode;
use thiserror::Error;

/// A flaw of the board or of the head in front of it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Flaw {
    /// An electrode without connection to its stage.
    OpenElectrode,
    /// A stage whose output lies at ground.
    StuckElectrode,
    /// A channel with five times the converter's noise.
    NoisyChannel,
    /// An emitter without current.
    DeadEmitter,
    /// Two gate lines on each other's drivers.
    SwappedGates,
    /// Both electrodes of two cells on each other's inputs.
    SwappedCells,
    /// A level line that stays at the nominal level.
    StuckLevel,
    /// An emitter of half the intensity.
    WeakEmitter,
    /// Stages that are slower than the scene says.
    SlowFrontEnd,
    /// Light of an emitter that reaches the next cell.
    MissingBaffle,
    /// A supply below its tolerance.
    LowSupply,
    /// Flash pages that do not keep the settings over a reset.
    LostSettings,
}

impl Flaw {
    /// All flaws, in the order in which they are listed.
    pub const ALL: [Self; 12] = [
        Self::OpenElectrode,
        Self::StuckElectrode,
        Self::NoisyChannel,
        Self::DeadEmitter,
        Self::SwappedGates,
        Self::SwappedCells,
        Self::StuckLevel,
        Self::WeakEmitter,
        Self::SlowFrontEnd,
        Self::MissingBaffle,
        Self::LowSupply,
        Self::LostSettings,
    ];

    /// What is wrong, in a phrase.
    pub fn what(self) -> &'static str {
        match self {
            Self::OpenElectrode => "I_X1 of cell 2 is not connected: always dark",
            Self::StuckElectrode => "the stage of I_X2 of cell 4 lies at ground: always code 0",
            Self::NoisyChannel => "I_X1 of cell 1 has five times the converter's noise",
            Self::DeadEmitter => "emitter 3 stays dark",
            Self::SwappedGates => "the gate lines of emitters 1 and 4 are exchanged",
            Self::SwappedCells => "the inputs of cells 0 and 5 are exchanged",
            Self::StuckLevel => "the level line of emitters 0 to 2 stays at nominal",
            Self::WeakEmitter => "emitter 5 has half its intensity",
            Self::SlowFrontEnd => "all stages have 2.5 times the scene's time constant",
            Self::MissingBaffle => "5 % of the light of cells 1 and 2 reaches the other one as well",
            Self::LowSupply => "the supply is 3.0 V",
            Self::LostSettings => "flash does not keep stored settings over a reset",
        }
    }

    /// The name on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::OpenElectrode => "open-electrode",
            Self::StuckElectrode => "stuck-electrode",
            Self::NoisyChannel => "noisy-channel",
            Self::DeadEmitter => "dead-emitter",
            Self::SwappedGates => "swapped-gates",
            Self::SwappedCells => "swapped-cells",
            Self::StuckLevel => "stuck-level",
            Self::WeakEmitter => "weak-emitter",
            Self::SlowFrontEnd => "slow-front-end",
            Self::MissingBaffle => "missing-baffle",
            Self::LowSupply => "low-supply",
            Self::LostSettings => "lost-settings",
        }
    }
}

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
pub(super) const SLOW_FACTOR: f64 = 2.5;
pub(super) const BAFFLE: [usize; 2] = [1, 2];
pub(super) const BAFFLE_SHARE: f64 = 0.05;
pub(crate) const LOW_SUPPLY_V: f64 = 3.0;

/// A set of flaws; empty by default.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Flaws(u16);

impl Flaws {
    /// Whether `flaw` is among them.
    #[inline]
    pub fn has(self, flaw: Flaw) -> bool {
        self.0 >> flaw as u16 & 1 != 0
    }
}

impl FromIterator<Flaw> for Flaws {
    fn from_iter<I: IntoIterator<Item = Flaw>>(flaws: I) -> Self {
        Self(flaws.into_iter().fold(0, |bits, flaw| bits | 1 << flaw as u16))
    }
}

/// A name that no flaw has.
#[derive(Debug, Error)]
#[error("no flaw is called `{name}`; there are {}", Names)]
pub struct UnknownFlaw {
    name: String,
}

struct Names;

impl fmt::Display for Names {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&Flaw::ALL.map(Flaw::name).join(", "))
    }
}

impl FromStr for Flaws {
    type Err = UnknownFlaw;

    /// Names separated by commas.
    fn from_str(text: &str) -> Result<Self, UnknownFlaw> {
        let of = |name: &str| {
            let flaw = Flaw::ALL.into_iter().find(|flaw| flaw.name() == name);
            flaw.ok_or_else(|| UnknownFlaw { name: name.to_owned() })
        };
        text.split(',').map(str::trim).map(of).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn flaws_are_read_by_name_and_unknown_ones_refused() {
        let some: Flaws = "low-supply, dead-emitter".parse().expect("names");
        assert!(some.has(Flaw::LowSupply) && some.has(Flaw::DeadEmitter) && !some.has(Flaw::OpenElectrode));
        assert!(Flaw::ALL.into_iter().all(|flaw| flaw.name().parse::<Flaws>().expect("a name").has(flaw)));
        let error = "low-supply,x".parse::<Flaws>().expect_err("no such flaw").to_string();
        assert!(error.contains("`x`") && error.contains("missing-baffle"), "{error}");
    }
}
