//! Digital-to-analog converters: channel 1, codes of 12 bits to the right, without trigger, wave and sample-and-hold modes
//! (RM0440, "Digital-to-analog converter").
//!
//! A code written to a holding register is at the output in the same tick; the hardware takes
//! up to three bus cycles, and the analog stage about a microsecond, which belongs to the optics.
//! The output buffer reaches ground unless the silicon has the fault `dac-rest`.

use super::Effects;
use super::effects::{ALL, Bank, Register};

use crate::st::DAC::{CCR, CR, CR_EN1, DHR12R1, MCR, MCR_HFSEL};

const REGISTERS: &[Register] = &[(CR, 1, 0, CR_EN1), (DHR12R1, 1, 0, 0xFFF), (CCR, 1, 0, ALL), (MCR, 1, 0, MCR_HFSEL)];

#[derive(Debug)]
pub struct Dac {
    bank: Bank,
    /// The code of the lowest voltage that the output buffer reaches.
    rest: u16,
}

impl Dac {
    pub fn new() -> Self {
        Self { bank: Bank::new(REGISTERS), rest: 0 }
    }

    pub fn reset(&mut self) {
        self.bank.reset();
    }

    /// Fault dac-rest: the output buffer goes no lower than `rest_v`, of 3.3 V.
    pub fn set_rest_v(&mut self, rest_v: f64) {
        self.rest = (rest_v / 3.3 * 4096.0).round() as u16;
    }

    pub fn read(&self, offset: u32, effects: &mut Effects) -> u32 {
        self.bank.read(offset, effects)
    }

    pub fn write(&mut self, offset: u32, value: u32, effects: &mut Effects) {
        // The mode is "external pin with buffer".
        if offset == MCR && self.is_enabled() && value & 7 != 0 {
            effects.violation(value, "DAC_MCR.MODE is written only while ENx = 0");
        }
        // A narrow write is repeated over the word.
        self.bank.write(offset, if offset == DHR12R1 { value & 0xFFF } else { value }, effects);
    }

    /// 12-bit code at the output; 0 while it is off.
    #[inline]
    pub fn output(&self) -> u16 {
        if self.is_enabled() { (self.bank[DHR12R1] as u16).max(self.rest) } else { 0 }
    }

    fn is_enabled(&self) -> bool {
        self.bank[CR] & CR_EN1 != 0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn mode_is_fixed_while_enabled() {
        let (mut dac, mut effects) = (Dac::new(), Effects::default());
        dac.write(MCR, MCR_HFSEL, &mut effects);
        dac.write(CR, 1, &mut effects);
        assert_eq!(effects.violation_count, 0);
        dac.write(MCR, MCR_HFSEL | 2, &mut effects);
        assert_eq!(effects.violation_count, 1);
    }
}
