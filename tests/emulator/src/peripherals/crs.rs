//! Clock recovery system: it holds its registers. The 48 MHz oscillator is taken as exact, so
//! there is nothing to trim (RM0440, "Clock recovery system").

use super::Effects;

const CR: u32 = 0x00;
const CFGR: u32 = 0x04;
const ISR: u32 = 0x08;
const ICR: u32 = 0x0C;

/// CEN: the frequency error counter runs.
const CEN: u32 = 1 << 5;
/// Interrupt enables.
const INTERRUPTS: u32 = 0xF;

/// Clock recovery.
#[derive(Debug)]
pub struct Crs {
    cr: u32,
    cfgr: u32,
}

impl Crs {
    /// State after power-on.
    pub fn new() -> Self {
        Self { cr: 0x4000, cfgr: 0x2022_BB7F }
    }

    /// State after reset.
    pub fn reset(&mut self) {
        *self = Self::new();
    }

    /// Value of a register.
    pub fn read(&mut self, offset: u32, effects: &mut Effects) -> u32 {
        match offset {
            CR => self.cr,
            CFGR => self.cfgr,
            ISR | ICR => 0,
            _ => {
                effects.unmodelled();
                0
            }
        }
    }

    /// Writes a register.
    pub fn write(&mut self, offset: u32, value: u32, effects: &mut Effects) {
        match offset {
            CR => {
                effects.unmodelled_bits(value & INTERRUPTS);
                self.cr = value;
            }
            CFGR => {
                if self.cr & CEN != 0 && value != self.cfgr {
                    effects.violation(value, "CRS_CFGR is written only while CEN = 0");
                }
                self.cfgr = value;
            }
            ICR => {}
            _ => effects.unmodelled(),
        }
    }
}

impl Default for Crs {
    fn default() -> Self {
        Self::new()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::facts::assert_facts;

    #[test]
    fn configuration_is_fixed_while_it_runs() {
        let (mut crs, mut effects) = (Crs::new(), Effects::default());
        crs.write(CFGR, 0x1000_0000, &mut effects);
        crs.write(CR, CEN, &mut effects);
        assert_eq!(effects.violation_count(), 0);
        crs.write(CFGR, 0, &mut effects);
        assert_eq!(effects.violation_count(), 1);
    }

    #[test]
    fn registers_are_those_of_st() {
        assert_facts!("CRS_TypeDef."; CR, CFGR, ISR, ICR);
        assert_facts!("CRS_CR_"; CEN);
    }
}
