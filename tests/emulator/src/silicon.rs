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
    /// The USB host suspends the bus for 5 ms or resets it in the middle of streaming, again and again
    UsbHost,
}

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
