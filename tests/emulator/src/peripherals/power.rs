//! Power control, the supply detector, and the external interrupt line it is on (RM0440, "PWR"
//! and "EXTI"). The detector's hysteresis is not modelled.

use super::{Effects, interrupt};

const CR1: u32 = 0x00;
const CR2: u32 = 0x04;
const CR4: u32 = 0x0C;
const SR1: u32 = 0x10;
const SR2: u32 = 0x14;
const SCR: u32 = 0x18;
const CR5: u32 = 0x80;

const DBP: u32 = 1 << 8;
const PVDE: u32 = 1;
const PVDO: u32 = 1 << 11;

/// Thresholds that PLS selects, in volts (data sheet, V_PVD0 to V_PVD6, falling, typical).
const THRESHOLDS_V: [f64; 7] = [2.05, 2.20, 2.36, 2.52, 2.64, 2.81, 2.91];

/// Below this the device is held in reset (data sheet, V_BOR0).
pub const BROWN_OUT_V: f64 = 1.7;

const IMR1: u32 = 0x00;
const EMR1: u32 = 0x04;
const RTSR1: u32 = 0x08;
const FTSR1: u32 = 0x0C;
const SWIER1: u32 = 0x10;
const PR1: u32 = 0x14;
const IMR2: u32 = 0x20;
const PR2: u32 = 0x34;

/// The detector's line.
const PVD_LINE: u32 = 1 << 16;

/// Power control and external interrupts.
#[derive(Debug)]
pub struct Power {
    cr: [u32; 4],
    cr5: u32,
    supply_v: f64,
    was_low: bool,
    imr: u32,
    emr: u32,
    rtsr: u32,
    ftsr: u32,
    pr: u32,
}

impl Power {
    /// State after power-on with `supply_v` volts.
    pub fn new(supply_v: f64) -> Self {
        Self {
            cr: [0x0200, 0, 0x8000, 0],
            cr5: 0x0100,
            supply_v,
            was_low: false,
            imr: 0x1F84_0000,
            emr: 0,
            rtsr: 0,
            ftsr: 0,
            pr: 0,
        }
    }

    /// State after any reset of the device.
    pub fn reset(&mut self, effects: &mut Effects) {
        *self = Self::new(self.supply_v);
        self.update_line(effects);
    }

    /// State after the reset bit of PWR alone.
    pub fn reset_control(&mut self) {
        let fresh = Self::new(self.supply_v);
        (self.cr, self.cr5) = (fresh.cr, fresh.cr5);
    }

    /// Whether the backup domain may be written.
    #[inline]
    pub fn may_write_backup(&self) -> bool {
        self.cr[0] & DBP != 0
    }

    /// The supply, in volts.
    pub fn supply_v(&self) -> f64 {
        self.supply_v
    }

    /// Sets the supply.
    pub fn set_supply(&mut self, volts: f64, effects: &mut Effects) {
        self.supply_v = volts;
        self.detect(effects);
    }

    /// Value of a register of PWR.
    pub fn read(&mut self, offset: u32, effects: &mut Effects) -> u32 {
        match offset {
            CR1..=CR4 => self.cr[(offset / 4) as usize],
            SR1 => 0,
            SR2 => {
                if self.is_low() {
                    PVDO
                } else {
                    0
                }
            }
            CR5 => self.cr5,
            _ => {
                effects.unmodelled();
                0
            }
        }
    }

    /// Writes a register of PWR.
    pub fn write(&mut self, offset: u32, value: u32, effects: &mut Effects) {
        match offset {
            CR1..=CR4 => self.cr[(offset / 4) as usize] = value,
            SCR => {}
            CR5 => self.cr5 = value,
            SR1 | SR2 => effects.violation(value, "PWR_SRx are read-only"),
            _ => effects.unmodelled(),
        }
        if offset == CR2 {
            self.detect(effects);
        }
    }

    /// Value of a register of EXTI.
    pub fn read_lines(&mut self, offset: u32, effects: &mut Effects) -> u32 {
        match offset {
            IMR1 => self.imr,
            EMR1 => self.emr,
            RTSR1 => self.rtsr,
            FTSR1 => self.ftsr,
            SWIER1 => 0,
            PR1 => self.pr,
            IMR2..=PR2 => 0,
            _ => {
                effects.unmodelled();
                0
            }
        }
    }

    /// Writes a register of EXTI.
    pub fn write_lines(&mut self, offset: u32, value: u32, effects: &mut Effects) {
        match offset {
            IMR1 => self.imr = value,
            EMR1 => self.emr = value,
            RTSR1 => self.rtsr = value,
            FTSR1 => self.ftsr = value,
            SWIER1 => self.pr |= value & self.imr,
            PR1 => self.pr &= !value,
            _ => effects.unmodelled(),
        }
        if value & !PVD_LINE != 0 && matches!(offset, RTSR1 | FTSR1 | SWIER1) {
            // Other lines have no source here.
            effects.unmodelled();
        }
        self.update_line(effects);
    }

    fn is_low(&self) -> bool {
        let threshold = THRESHOLDS_V.get((self.cr[1] >> 1 & 7) as usize);
        self.cr[1] & PVDE != 0 && threshold.is_some_and(|&threshold| self.supply_v < threshold)
    }

    /// The detector's output rises as the supply falls.
    fn detect(&mut self, effects: &mut Effects) {
        let is_low = self.is_low();
        let edge = match (self.was_low, is_low) {
            (false, true) => self.rtsr,
            (true, false) => self.ftsr,
            _ => 0,
        };
        self.pr |= edge & PVD_LINE;
        self.was_low = is_low;
        self.update_line(effects);
    }

    fn update_line(&self, effects: &mut Effects) {
        effects.set_line(interrupt::PVD_PVM, self.pr & self.imr & PVD_LINE != 0);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_falling_supply_interrupts_once() {
        let mut effects = Effects::default();
        let mut power = Power::new(3.3);
        power.write(CR2, 6 << 1 | PVDE, &mut effects);
        power.write_lines(RTSR1, PVD_LINE, &mut effects);
        power.write_lines(IMR1, PVD_LINE, &mut effects);
        power.set_supply(2.95, &mut effects);
        assert_eq!(effects.lines()[0], 0);
        power.set_supply(2.85, &mut effects);
        assert_eq!(effects.lines()[0], 1 << interrupt::PVD_PVM);
        assert_eq!(power.read(SR2, &mut effects), PVDO);
        power.write_lines(PR1, PVD_LINE, &mut effects);
        assert_eq!(effects.lines()[0], 0);
        power.set_supply(3.3, &mut effects);
        assert_eq!((effects.lines()[0], power.read(SR2, &mut effects)), (0, 0));
    }
}
