//! Extended interrupts and events: line 16, the voltage detector; nothing drives the pins' (RM0440,
//! "Extended interrupts and events controller").

use super::Effects;
use super::effects::{ALL, Bank, Register};

use crate::st::EXTI::{EMR1, EMR2, FTSR1, IMR1, IMR2, PR1, RTSR1, RTSR2, SWIER1};

const REGISTERS: &[Register] = &[
    (IMR1, 1, IMR1_RESET, IMR1_RESET | MODELLED),
    (EMR1, 1, 0, 0),
    (RTSR1, 1, 0, ALL),
    (FTSR1, 1, 0, ALL),
    (SWIER1, 1, 0, 0),
    (PR1, 1, 0, 0),
    (IMR2, 1, IMR2_RESET, IMR2_RESET),
    (EMR2, 1, 0, 0),
    // To PR2.
    (RTSR2, 4, 0, 0),
];

/// The voltage detector's output.
const PVD: u32 = crate::st::LL::EXTI_LINE_16;
/// The lines of pins, too, may be set up.
const MODELLED: u32 = 0x1_FFFF;
/// Direct lines are unmasked after reset.
const IMR1_RESET: u32 = 0x1F84_0000;
const IMR2_RESET: u32 = 0x0000_003C;

#[derive(Debug)]
pub struct Exti(Bank);

impl Exti {
    pub fn new() -> Self {
        Self(Bank::new(REGISTERS))
    }

    pub fn reset(&mut self, effects: &mut Effects) {
        self.0.reset();
        self.update_line(effects);
    }

    pub fn read(&self, offset: u32, effects: &mut Effects) -> u32 {
        self.0.read(offset, effects)
    }

    pub fn write(&mut self, offset: u32, value: u32, effects: &mut Effects) {
        match offset {
            PR1 => self.0[PR1] &= !value,
            _ => self.0.write(offset, value, effects),
        }
        self.update_line(effects);
    }

    /// The supply has crossed the voltage detector's threshold, whose output rises where it is `low`.
    pub fn supply_crosses(&mut self, low: bool, effects: &mut Effects) {
        self.0[PR1] |= self.0[if low { RTSR1 } else { FTSR1 }] & PVD;
        self.update_line(effects);
    }

    fn update_line(&self, effects: &mut Effects) {
        effects.set_line(crate::st::PVD::PVM_IRQn, self.0[PR1] & self.0[IMR1] & PVD != 0);
    }
}
