//! What real silicon does against its manual, or at its worst: each fault can be switched on by itself.
//!
//! Without faults every transfer, trigger and conversion is ideal. The board must not show a wrong word with any of
//! them; `tests/data/stm32g474/README.md` has the sources.

use std::fmt;
use std::str::FromStr;

use thiserror::Error;

/// A way in which the silicon misbehaves.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Fault {
    /// After ADSTP the next conversion takes channel 0, unless the converter was disabled in between.
    AdcStop,
    /// A conversion later than 1 ms after the one before, or after calibration, is wrong.
    AdcStale,
    /// A converter is disturbed by one of the other group that converts at the same time.
    AdcNeighbour,
    /// Converters take a trigger 0 to 3 ticks late, by the phase of their clock, and an eighth of a clock more.
    TriggerPhase,
    /// Each DMA transfer takes 5 to 60 ticks from its turn to its end.
    DmaLatency,
    /// The ECC error of a torn double word names the other bank.
    EccBank,
    /// A double word torn while it was programmed reads as erased, and refuses to be programmed.
    FlashTornOnes,
    /// The crystal does not start.
    HseDead,
    /// The supply detector reacts 100 µs late.
    PvdSlow,
    /// The USB host suspends the bus or resets it in the middle of streaming, again and again.
    UsbHost,
}

impl Fault {
    /// What it does, in a sentence.
    pub fn what(self) -> &'static str {
        match self {
            Self::AdcStop => {
                "after ADSTP the next conversion takes channel 0, unless the converter was disabled (ES0430)"
            }
            Self::AdcStale => "a conversion more than 1 ms after the one before or after calibration is wrong (ES0430)",
            Self::AdcNeighbour => "ADC1 and ADC2 are off by up to 8 codes while ADC3 to ADC5 convert (ES0430)",
            Self::TriggerPhase => {
                "triggers are seen up to 3 ticks late, and an eighth of a clock more (DS12288, t_LATR)"
            }
            Self::DmaLatency => "each DMA transfer takes 5 to 60 ticks (no figure is published)",
            Self::EccBank => {
                "the ECC error of a torn double word names the other bank (no source; the image does not ask)"
            }
            Self::FlashTornOnes => "a torn double word reads as erased, and refuses to be programmed (RM0440)",
            Self::HseDead => "the crystal does not start",
            Self::PvdSlow => "the supply detector reacts 100 us late (no figure is published)",
            Self::UsbHost => {
                "the USB host suspends the bus for 5 ms or resets it in the middle of streaming, again and again"
            }
        }
    }

    /// All faults, in the order in which they are listed.
    pub const ALL: [Self; 10] = [
        Self::AdcStop,
        Self::AdcStale,
        Self::AdcNeighbour,
        Self::TriggerPhase,
        Self::DmaLatency,
        Self::EccBank,
        Self::FlashTornOnes,
        Self::HseDead,
        Self::PvdSlow,
        Self::UsbHost,
    ];

    /// The name on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::AdcStop => "adc-stop",
            Self::AdcStale => "adc-stale",
            Self::AdcNeighbour => "adc-neighbour",
            Self::TriggerPhase => "trigger-phase",
            Self::DmaLatency => "dma-latency",
            Self::EccBank => "ecc-bank",
            Self::FlashTornOnes => "flash-torn-ones",
            Self::HseDead => "hse-dead",
            Self::PvdSlow => "pvd-slow",
            Self::UsbHost => "usb-host",
        }
    }
}

/// A set of faults; empty by default.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Silicon(u16);

impl Silicon {
    /// All faults.
    pub fn all() -> Self {
        Fault::ALL.into_iter().collect()
    }

    /// These and `fault`.
    #[must_use]
    pub fn with(self, fault: Fault) -> Self {
        Self(self.0 | 1 << fault as u16)
    }

    /// Whether `fault` is among them.
    #[inline]
    pub fn has(self, fault: Fault) -> bool {
        self.0 >> fault as u16 & 1 != 0
    }
}

impl FromIterator<Fault> for Silicon {
    fn from_iter<I: IntoIterator<Item = Fault>>(faults: I) -> Self {
        Self(faults.into_iter().fold(0, |bits, fault| bits | 1 << fault as u16))
    }
}

/// No fault has that name.
#[derive(Debug, Error)]
#[error("no silicon fault is called `{name}`; there are all, {}", Names)]
pub struct UnknownFault {
    name: String,
}

struct Names;

impl fmt::Display for Names {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&Fault::ALL.map(Fault::name).join(", "))
    }
}

impl FromStr for Silicon {
    type Err = UnknownFault;

    /// Names separated by commas, or `all`.
    fn from_str(text: &str) -> Result<Self, UnknownFault> {
        if text == "all" {
            return Ok(Self::all());
        }
        let of = |name: &str| {
            let fault = Fault::ALL.into_iter().find(|fault| fault.name() == name);
            fault.ok_or_else(|| UnknownFault { name: name.to_owned() })
        };
        text.split(',').map(str::trim).map(of).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn faults_are_read_by_name_and_unknown_ones_told() {
        let some: Silicon = "hse-dead, adc-stop".parse().expect("names");
        assert!(some.has(Fault::HseDead) && some.has(Fault::AdcStop) && !some.has(Fault::AdcStale));
        assert_eq!("all".parse::<Silicon>().expect("all"), Silicon::all());
        assert!(Fault::ALL.into_iter().all(|fault| fault.name().parse::<Silicon>().expect("a name").has(fault)));
        let error = "adc-stop,x".parse::<Silicon>().expect_err("no such fault").to_string();
        assert!(error.contains("`x`") && error.contains("usb-host"), "{error}");
    }
}
