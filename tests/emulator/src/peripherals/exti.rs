//! Extended interrupts and events: lines 0 to 15 (pins) and 16 (voltage detector) (RM0440,
//! "Extended interrupts and events controller").

use super::effects::{ALL, Bank, Register};
use super::{Edge, Effects, interrupt};

use crate::st::EXTI::{EMR1, EMR2, FTSR1, IMR1, IMR2, PR1, PR2, RTSR1, RTSR2, SWIER1};

const REGISTERS: &[Register] = &[
    (IMR1, IMR1_RESET, ALL),
    (EMR1, 0, 0),
    (RTSR1, 0, ALL),
    (FTSR1, 0, ALL),
    (SWIER1, 0, 0),
    (PR1, 0, 0),
    (IMR2, IMR2_RESET, ALL),
    (EMR2, 0, 0),
    (RTSR2, 0, 0),
    (PR2, 0, 0),
];

/// EXTI line of the voltage detector's output.
pub const PVD_LINE: u8 = crate::st::LL::EXTI_LINE_16.trailing_zeros() as u8;
/// Lines that some model drives.
const MODELLED: u32 = 0x1_FFFF;
/// Direct lines are unmasked after reset.
const IMR1_RESET: u32 = 0x1F84_0000;
const IMR2_RESET: u32 = 0x0000_003C;

/// Interrupt of each group of lines.
const GROUPS: [(u32, u8); 8] = [
    (1, interrupt::EXTI0),
    (1 << 1, interrupt::EXTI0 + 1),
    (1 << 2, interrupt::EXTI0 + 2),
    (1 << 3, interrupt::EXTI0 + 3),
    (1 << 4, interrupt::EXTI0 + 4),
    (0x3E0, interrupt::EXTI9_5),
    (0xFC00, interrupt::EXTI15_10),
    (1 << PVD_LINE, interrupt::PVD_PVM),
];

#[derive(Debug)]
pub struct Exti(Bank);

impl Exti {
    pub fn new() -> Self {
        Self(Bank::new(REGISTERS))
    }

    pub fn reset(&mut self, effects: &mut Effects) {
        self.0.reset();
        self.update_lines(effects);
    }

    pub fn read(&self, offset: u32, effects: &mut Effects) -> u32 {
        if matches!(offset, RTSR2..=PR2) { 0 } else { self.0.read(offset, effects) }
    }

    pub fn write(&mut self, offset: u32, value: u32, effects: &mut Effects) {
        match offset {
            IMR1 => effects.unmodelled_bits(value & !(IMR1_RESET | MODELLED)),
            IMR2 => effects.unmodelled_bits(value & !IMR2_RESET),
            _ => {}
        }
        match offset {
            SWIER1 => self.0[PR1] |= value & self.0[IMR1] & MODELLED,
            PR1 => self.0[PR1] &= !value,
            EMR1 | EMR2 | RTSR2..=PR2 => effects.unmodelled_bits(value),
            _ => self.0.write(offset, value, effects),
        }
        self.update_lines(effects);
    }

    /// An edge on `line`.
    pub fn edge(&mut self, line: u8, edge: Edge, effects: &mut Effects) {
        let selected = match edge {
            Edge::Rising => self.0[RTSR1],
            Edge::Falling => self.0[FTSR1],
        };
        self.0[PR1] |= selected & 1 << line;
        self.update_lines(effects);
    }

    fn update_lines(&self, effects: &mut Effects) {
        for (lines, number) in GROUPS {
            effects.set_line(number, self.0[PR1] & self.0[IMR1] & lines != 0);
        }
    }
}
