//! What real silicon does against its manual, or at its worst: each fault can be switched on by itself.
//!
//! Without faults every transfer, trigger and conversion is ideal. The board must not show a wrong word with any of
//! them; `tests/data/stm32g474/README.md` has the sources.

use clap::ValueEnum;

use crate::named::{Named, Set};

/// A way in which the silicon misbehaves.
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
    /// The ECC error of a torn double word names the other bank (no source; the image does not ask)
    EccBank,
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
    /// The buffered DACs end 25 mV above ground (measured on an STM32L496; DS12288 promises 200 mV)
    #[value(name = "dac-rest-25")]
    DacRest25,
    /// The buffered DACs end 48 mV above ground (measured on an STM32F446)
    #[value(name = "dac-rest-48")]
    DacRest48,
    /// The buffered DACs end 80 mV above ground (more than any measured)
    #[value(name = "dac-rest-80")]
    DacRest80,
}

/// The lowest output of the buffered DACs by each fault, volts.
const DAC_RESTS_V: [(Fault, f64); 3] =
    [(Fault::DacRest25, 0.025), (Fault::DacRest48, 0.048), (Fault::DacRest80, 0.080)];

impl Named for Fault {
    const KIND: &'static str = "silicon fault";
    const HAS_ALL: bool = true;

    #[inline]
    fn index(self) -> u32 {
        self as u32
    }
}

/// The faults of a board's silicon.
pub type Silicon = Set<Fault>;

impl Silicon {
    /// The lowest output of the buffered DACs, volts: the highest of several faults, 0 without one.
    pub fn dac_rest_v(self) -> f64 {
        let rests = DAC_RESTS_V.iter().filter(|(fault, _)| self.has(*fault));
        rests.fold(0.0, |most, &(_, rest_v)| most.max(rest_v))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::facts::number;

    /// The data sheet's promise bounds them from above; each value that was measured on a relative is reached.
    #[test]
    fn dac_rests_are_between_what_was_measured_and_what_the_data_sheet_promises() {
        let highest_v = Silicon::all().dac_rest_v();
        assert!(highest_v >= number("V_DAC_rest_F407") && highest_v <= number("V_DAC_headroom"));
        for name in ["V_DAC_rest_L496", "V_DAC_rest_F446"] {
            assert!(DAC_RESTS_V.iter().any(|&(_, rest_v)| rest_v == number(name)), "{name}");
        }
        assert_eq!(Silicon::default().dac_rest_v(), 0.0);
    }
}
