//! System configuration controller: the port of each external interrupt line (RM0440, "System
//! configuration controller").

use super::Effects;

const MEMRMP: u32 = 0x00;
const CFGR1: u32 = 0x04;
const EXTICR1: u32 = 0x08;
const EXTICR4: u32 = 0x14;
const SCSR: u32 = 0x18;
const CFGR2: u32 = 0x1C;

const CFGR1_RESET: u32 = 0x7C00_0001;

/// The controller.
#[derive(Debug)]
pub struct Syscfg {
    cfgr1: u32,
    exticr: [u32; 4],
}

impl Syscfg {
    /// State after power-on.
    pub fn new() -> Self {
        Self { cfgr1: CFGR1_RESET, exticr: [0; 4] }
    }

    /// State after reset.
    pub fn reset(&mut self) {
        *self = Self::new();
    }

    /// Value of a register.
    pub fn read(&mut self, offset: u32, effects: &mut Effects) -> u32 {
        match offset {
            CFGR1 => self.cfgr1,
            EXTICR1..=EXTICR4 => self.exticr[((offset - EXTICR1) / 4) as usize],
            // Flash at 0, banks not swapped.
            MEMRMP | SCSR | CFGR2 => 0,
            _ => {
                effects.unmodelled();
                0
            }
        }
    }

    /// Writes a register.
    pub fn write(&mut self, offset: u32, value: u32, effects: &mut Effects) {
        match offset {
            // The boot loader is not executed, so what it finds at 0 does not matter.
            MEMRMP => {}
            CFGR1 => self.cfgr1 = value,
            EXTICR1..=EXTICR4 => self.exticr[((offset - EXTICR1) / 4) as usize] = value & 0x7777,
            _ => effects.unmodelled(),
        }
    }

    /// Index of the port (0: A) whose pin `pin` feeds the external interrupt line of that number.
    pub fn port_of_line(&self, pin: u8) -> usize {
        let pin = usize::from(pin);
        (self.exticr[pin / 4] >> (4 * (pin % 4)) & 7) as usize
    }
}

impl Default for Syscfg {
    fn default() -> Self {
        Self::new()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::facts::assert_facts;

    #[test]
    fn each_line_has_a_port() {
        let (mut syscfg, mut effects) = (Syscfg::new(), Effects::default());
        syscfg.write(EXTICR4, 0x0020, &mut effects);
        assert_eq!((syscfg.port_of_line(13), syscfg.port_of_line(12)), (2, 0));
    }

    #[test]
    fn registers_are_those_of_st() {
        assert_facts!("SYSCFG_TypeDef."; MEMRMP, CFGR1, EXTICR1 = "EXTICR", SCSR, CFGR2);
    }
}
