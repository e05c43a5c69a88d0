//! Extended interrupts and events: lines 0 to 15 (pins) and 16 (voltage detector) (RM0440,
//! "Extended interrupts and events controller").

use super::{Edge, Effects, interrupt};

const IMR1: u32 = 0x00;
const EMR1: u32 = 0x04;
const RTSR1: u32 = 0x08;
const FTSR1: u32 = 0x0C;
const SWIER1: u32 = 0x10;
const PR1: u32 = 0x14;
const IMR2: u32 = 0x20;
const EMR2: u32 = 0x24;
const RTSR2: u32 = 0x28;
const PR2: u32 = 0x34;

/// EXTI line of the voltage detector's output.
pub const PVD_LINE: u8 = 16;
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

/// The controller.
#[derive(Debug)]
pub struct Exti {
    imr: u32,
    imr2: u32,
    rtsr: u32,
    ftsr: u32,
    pending: u32,
}

impl Exti {
    /// State after power-on.
    pub fn new() -> Self {
        Self { imr: IMR1_RESET, imr2: IMR2_RESET, rtsr: 0, ftsr: 0, pending: 0 }
    }

    /// State after reset.
    pub fn reset(&mut self, effects: &mut Effects) {
        *self = Self::new();
        self.update_lines(effects);
    }

    /// Value of a register.
    pub fn read(&mut self, offset: u32, effects: &mut Effects) -> u32 {
        match offset {
            IMR1 => self.imr,
            RTSR1 => self.rtsr,
            FTSR1 => self.ftsr,
            PR1 => self.pending,
            IMR2 => self.imr2,
            EMR1 | SWIER1 | EMR2..=PR2 => 0,
            _ => {
                effects.unmodelled();
                0
            }
        }
    }

    /// Writes a register.
    pub fn write(&mut self, offset: u32, value: u32, effects: &mut Effects) {
        match offset {
            IMR1 => {
                effects.unmodelled_bits(value & !(IMR1_RESET | MODELLED));
                self.imr = value;
            }
            RTSR1 => self.rtsr = value,
            FTSR1 => self.ftsr = value,
            SWIER1 => self.pending |= value & self.imr & MODELLED,
            PR1 => self.pending &= !value,
            IMR2 => {
                effects.unmodelled_bits(value & !IMR2_RESET);
                self.imr2 = value;
            }
            EMR1 | EMR2 | RTSR2..=PR2 => effects.unmodelled_bits(value),
            _ => effects.unmodelled(),
        }
        self.update_lines(effects);
    }

    /// An edge on `line`.
    pub fn edge(&mut self, line: u8, edge: Edge, effects: &mut Effects) {
        let selected = match edge {
            Edge::Rising => self.rtsr,
            Edge::Falling => self.ftsr,
        };
        self.pending |= selected & 1 << line;
        self.update_lines(effects);
    }

    fn update_lines(&self, effects: &mut Effects) {
        for (lines, number) in GROUPS {
            effects.set_line(number, self.pending & self.imr & lines != 0);
        }
    }
}

impl Default for Exti {
    fn default() -> Self {
        Self::new()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::facts::assert_facts;

    #[test]
    fn selected_edges_interrupt_until_cleared() {
        let (mut exti, mut effects) = (Exti::new(), Effects::default());
        exti.write(IMR1, IMR1_RESET | 1 << PVD_LINE | 1 << 13, &mut effects);
        exti.write(RTSR1, 1 << PVD_LINE, &mut effects);
        exti.edge(PVD_LINE, Edge::Falling, &mut effects);
        exti.edge(13, Edge::Rising, &mut effects);
        assert_eq!(effects.lines(), &[0; 4]);
        exti.edge(PVD_LINE, Edge::Rising, &mut effects);
        assert_eq!(effects.lines(), &[1 << interrupt::PVD_PVM, 0, 0, 0]);
        exti.write(PR1, 1 << PVD_LINE, &mut effects);
        assert_eq!(effects.lines(), &[0; 4]);
        exti.write(FTSR1, 1 << 13, &mut effects);
        exti.edge(13, Edge::Falling, &mut effects);
        assert_eq!(effects.lines(), &[0, 1 << (interrupt::EXTI15_10 - 32), 0, 0]);
    }

    #[test]
    fn registers_are_those_of_st() {
        assert_facts!("EXTI_TypeDef."; IMR1, EMR1, RTSR1, FTSR1, SWIER1, PR1, IMR2, EMR2, RTSR2, PR2);
        assert_eq!(1 << PVD_LINE, crate::facts::bits("LL_EXTI_LINE_16"));
    }
}
