//! Digital-to-analog converters, without trigger, wave and sample-and-hold modes (RM0440,
//! "Digital-to-analog converter").
//!
//! A code written to a holding register is at the output in the same tick; the hardware takes
//! up to three bus cycles, and the analog stage about a microsecond, which belongs to the optics.
//! The output buffer reaches ground unless the silicon has one of the faults `dac-rest`.

use super::Effects;
use super::registers::{ALL, Bank, Register};

use crate::st::DAC::{
    CCR, CR, CR_EN1, CR_EN2, DHR8R1, DHR8R2, DHR12L1, DHR12L2, DHR12R1, DHR12R2, DHR12RD, DOR1, DOR2, MCR, MCR_HFSEL,
    SR, SR_DAC1RDY, SR_DAC2RDY,
};

const REGISTERS: &[Register] = &[
    (CR, 0, CR_MODELLED),
    (DHR12R1, 0, 0),
    (DHR12L1, 0, 0),
    (DHR8R1, 0, 0),
    (DHR12R2, 0, 0),
    (DHR12L2, 0, 0),
    (DHR8R2, 0, 0),
    (DHR12RD, 0, 0),
    (DOR1, 0, 0),
    (DOR2, 0, 0),
    (SR, 0, 0),
    (CCR, 0, ALL),
    (MCR, 0, ALL),
];

const CR_EN: [u32; 2] = [CR_EN1, CR_EN2];
const CR_MODELLED: u32 = CR_EN1 | CR_EN2;
const SR_RDY: [u32; 2] = [SR_DAC1RDY, SR_DAC2RDY];

#[derive(Debug)]
pub struct Dac {
    bank: Bank,
    codes: [u16; 2],
    /// The code of the lowest voltage that the output buffer reaches.
    rest: u16,
}

impl Dac {
    pub fn new() -> Self {
        Self { bank: Bank::new(REGISTERS), codes: [0; 2], rest: 0 }
    }

    pub fn reset(&mut self) {
        *self = Self { rest: self.rest, ..Self::new() };
    }

    /// Faults dac-rest: the output buffer goes no lower than `rest_v`, of 3.3 V.
    pub fn set_rest_v(&mut self, rest_v: f64) {
        self.rest = (rest_v / 3.3 * 4096.0).round() as u16;
    }

    pub fn read(&self, offset: u32, effects: &mut Effects) -> u32 {
        match offset {
            DHR12R1 | DOR1 => u32::from(self.codes[0]),
            DHR12R2 | DOR2 => u32::from(self.codes[1]),
            SR => (0..2).filter(|&channel| self.enabled(channel)).map(|channel| SR_RDY[channel]).sum(),
            // Not read back.
            DHR12L1..=DHR8R1 | DHR12L2..=DHR12RD => {
                effects.unmodelled();
                0
            }
            _ => self.bank.read(offset, effects),
        }
    }

    pub fn write(&mut self, offset: u32, value: u32, effects: &mut Effects) {
        match offset {
            DHR12R1 => self.set(0, value),
            DHR12L1 => self.set(0, value >> 4),
            DHR8R1 => self.set(0, (value & 0xFF) << 4),
            DHR12R2 => self.set(1, value),
            DHR12L2 => self.set(1, value >> 4),
            DHR8R2 => self.set(1, (value & 0xFF) << 4),
            DHR12RD => {
                self.set(0, value);
                self.set(1, value >> 16);
            }
            SR => {}
            CR => {
                effects.unmodelled_bits(value & !CR_MODELLED);
                self.bank.write(CR, value, effects);
            }
            MCR => self.write_mcr(value, effects),
            _ => self.bank.write(offset, value, effects),
        }
    }

    /// 12-bit code at the output of channel 1; 0 while it is off.
    #[inline]
    pub fn output(&self) -> u16 {
        if self.enabled(0) { self.codes[0].max(self.rest) } else { 0 }
    }

    fn enabled(&self, channel: usize) -> bool {
        self.bank[CR] & CR_EN[channel] != 0
    }

    fn set(&mut self, channel: usize, value: u32) {
        self.codes[channel] = (value & 0xFFF) as u16;
    }

    fn write_mcr(&mut self, value: u32, effects: &mut Effects) {
        for channel in 0..2 {
            if self.enabled(channel) && (value ^ self.bank[MCR]) & (7 << (16 * channel)) != 0 {
                effects.violation(value, "DAC_MCR.MODE is written only while ENx = 0");
            }
        }
        // The modes of the channels but "external pin with buffer" are not.
        effects.unmodelled_bits(value & !MCR_HFSEL);
        self.bank.write(MCR, value, effects);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn code_is_out_only_while_enabled() {
        let (mut dac, mut effects) = (Dac::new(), Effects::default());
        dac.write(DHR12R1, 0x1ABC, &mut effects);
        assert_eq!(dac.output(), 0);
        dac.write(CR, 1, &mut effects);
        assert_eq!(dac.output(), 0xABC);
        assert_eq!(dac.read(SR, &mut effects), SR_RDY[0]);
        dac.set_rest_v(0.048);
        dac.reset();
        assert_eq!(dac.output(), 0);
        dac.write(CR, 1, &mut effects);
        assert_eq!(dac.output(), 60);
    }

    #[test]
    fn mode_is_fixed_while_enabled() {
        let (mut dac, mut effects) = (Dac::new(), Effects::default());
        dac.write(MCR, MCR_HFSEL, &mut effects);
        dac.write(CR, 1, &mut effects);
        assert_eq!(effects.violation_count(), 0);
        dac.write(MCR, MCR_HFSEL | 2, &mut effects);
        assert_eq!(effects.violation_count(), 1);
    }
}
