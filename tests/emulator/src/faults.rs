//! What can be wrong with a board: each fault can be switched on by its name, those of the silicon by `--silicon`, those of
//! the board around it by `--flaw`.
//!
//! Without faults every transfer, trigger and conversion is ideal, and the board is built as `firmware/README.md` describes
//! it, with one time constant. The board must not show a wrong word with any fault of the silicon
//! (`tests/data/stm32g474/README.md` has the sources); `slitpose doctor --bring-up` must name each fault of the board,
//! except that of a detector which settles in time.

use std::fmt::Write;

use clap::ValueEnum;
use slitpose_head::simulator::Electrode;

/// Whose faults they are.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// What the microcontroller does against its manual, or at its worst.
    Silicon,
    /// What is wrong with wiring, parts and supply around it.
    Board,
}

/// A fault; names and phrases of help texts are those of the variants and their documentation.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Fault {
    /// After ADSTP the next conversion takes channel 0, unless the converter was disabled (ES0430)
    AdcStop,
    /// A conversion more than 1 ms after the one before or after calibration is wrong (ES0430)
    AdcStale,
    /// ADC1 and ADC2 are off by up to 8 codes while ADC3 to ADC5 convert (ES0430)
    AdcNeighbour,
    /// Triggers are seen up to 3 ticks late, and an eighth of a clock more (DS12288, t_LATR)
    TriggerPhase,
    /// Each DMA transfer takes 5 to 60 ticks (no figure is published)
    DmaLatency,
    /// A torn double word reads as erased, and refuses to be programmed (RM0440)
    FlashTornOnes,
    /// The crystal does not start
    HseDead,
    /// The supply detector reacts 100 us late (no figure is published)
    PvdSlow,
    /// The first access to each block of SRAM after a reset is a read, and a write is lost (ES0430)
    SramFirstWrite,
    /// What is fetched behind WFE or WFI is wrong, unless it is ISB (ES0430, with a debugger's DBG_SLEEP)
    SleepFetch,
    /// The USB host suspends the bus for 5 ms or resets it in the middle of streaming, again and again
    UsbHost,
    /// The buffered DACs end 80 mV above ground (25 to 69 mV were measured on relatives; DS12288 promises 200 mV)
    DacRest,
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
    /// The wire from the frame output to the trigger input is missing
    MissingWire,
}

const FIRST_OF_BOARD: Fault = Fault::OpenElectrode;

impl Fault {
    pub fn of(kind: Kind) -> &'static [Self] {
        let (silicon, board) = Self::value_variants().split_at(FIRST_OF_BOARD as usize);
        match kind {
            Kind::Silicon => silicon,
            Kind::Board => board,
        }
    }

    /// Its name on the command line.
    pub fn name(self) -> String {
        self.to_possible_value().expect("none is hidden").get_name().to_owned()
    }

    /// What happens, in a phrase.
    pub fn what(self) -> String {
        self.to_possible_value().and_then(|value| value.get_help().map(ToString::to_string)).unwrap_or_default()
    }

    /// All of a kind, a line each, for a help text.
    pub fn list(kind: Kind) -> String {
        Self::of(kind).iter().fold(String::new(), |mut list, fault| {
            let _ = write!(list, "\n  {:16} {}", fault.name(), fault.what());
            list
        })
    }
}

/// Some of the faults; none by default.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Faults(u64);

impl Faults {
    pub fn all_of_silicon() -> Self {
        Fault::of(Kind::Silicon).iter().copied().collect()
    }

    #[must_use]
    pub fn with(self, fault: Fault) -> Self {
        Self(self.0 | 1 << fault as u32)
    }

    #[must_use]
    pub fn and(self, others: Self) -> Self {
        Self(self.0 | others.0)
    }

    #[inline]
    pub fn has(self, fault: Fault) -> bool {
        self.0 >> fault as u32 & 1 != 0
    }

    /// Names of the silicon's faults separated by commas, or `all`.
    pub fn of_silicon(text: &str) -> Result<Self, String> {
        let all = if text == "all" { Ok(Self::all_of_silicon()) } else { Err("all, ") };
        all.or_else(|all| Self::parse(text, Kind::Silicon, "silicon fault", all))
    }

    /// Names of the board's faults separated by commas.
    pub fn of_board(text: &str) -> Result<Self, String> {
        Self::parse(text, Kind::Board, "flaw", "")
    }

    fn parse(text: &str, kind: Kind, called: &str, all: &str) -> Result<Self, String> {
        let known = Fault::of(kind);
        let find = |name: &str| {
            known.iter().copied().find(|fault| fault.name() == name).ok_or_else(|| {
                let names: Vec<_> = known.iter().map(|fault| fault.name()).collect();
                format!("no {called} is called `{name}`; there are {all}{}", names.join(", "))
            })
        };
        text.split(',').map(str::trim).map(find).collect()
    }
}

impl FromIterator<Fault> for Faults {
    fn from_iter<I: IntoIterator<Item = Fault>>(faults: I) -> Self {
        faults.into_iter().fold(Self::default(), Self::with)
    }
}

/// The lowest output of buffered DACs, volts.
pub(crate) const DAC_REST_V: f64 = 0.080;

/// The electrodes, emitters and lines that flaws concern.
pub(crate) const OPEN: (usize, Electrode) = (2, Electrode::X1);
pub(crate) const STUCK: (usize, Electrode) = (4, Electrode::X2);
pub(crate) const NOISY: (usize, Electrode) = (1, Electrode::X1);
pub(crate) const NOISE_FACTOR: f64 = 5.0;
pub(crate) const DEAD: usize = 3;
pub(crate) const WEAK: usize = 5;
pub(crate) const WEAK_STRENGTH: f64 = 0.5;
pub(crate) const GATES: [usize; 2] = [1, 4];
pub(crate) const CELLS: [usize; 2] = [0, 5];
pub(crate) const LEVEL_LINE: usize = 0;
/// 0.1 V of 3.3 V, in codes of the DAC.
pub(crate) const LIFTED_CODES: u16 = 124;
pub(crate) const STUCK_GATE: usize = 2;
pub(crate) const SLOW_FACTOR: f64 = 2.5;
pub(crate) const LINES_S: [(Fault, f64); 2] = [(Fault::LineDetector, 0.6e-6), (Fault::SlowDetector, 1.0e-6)];
pub(crate) const BAFFLE: [usize; 2] = [1, 2];
pub(crate) const BAFFLE_SHARE: f64 = 0.05;
pub(crate) const LOW_SUPPLY_V: f64 = 3.0;

#[cfg(test)]
mod tests {
    use super::*;
    use crate::facts::number;

    #[test]
    fn faults_are_read_by_name_and_unknown_ones_refused() {
        let some = Faults::of_silicon("hse-dead, adc-stop").expect("names");
        assert!(some.has(Fault::HseDead) && some.has(Fault::AdcStop) && !some.has(Fault::AdcStale));
        assert_eq!(Faults::of_silicon("all").expect("all"), Faults::all_of_silicon());
        assert_eq!(Faults::all_of_silicon().0.count_ones(), 12);
        for (result, name, known) in [
            (Faults::of_silicon("adc-stop,low-supply"), "`low-supply`", "are all, adc-stop, "),
            (Faults::of_board("low-supply,x"), "no flaw is called `x`", "missing-baffle"),
            (Faults::of_board("all"), "`all`", "are open-electrode, "),
        ] {
            let error = result.expect_err("no such fault");
            assert!(error.contains(name) && error.contains(known), "{error}");
        }
    }

    #[test]
    fn each_has_a_phrase_of_its_own() {
        let phrases: std::collections::BTreeSet<_> = Fault::value_variants().iter().map(|fault| fault.what()).collect();
        assert!(phrases.len() == Fault::value_variants().len() && !phrases.contains(""), "{phrases:?}");
    }

    #[test]
    fn dacs_rest_between_what_was_measured_and_what_the_data_sheet_promises() {
        for relative in ["L496", "F446", "F407"] {
            assert!(DAC_REST_V >= number(&format!("V_DAC_rest_{relative}")), "{relative}");
        }
        assert!(DAC_REST_V <= number("V_DAC_headroom"));
    }
}
