//! Units that do little more than hold their registers: clock recovery, system configuration, backup registers.

use super::Effects;
use super::registers::Bank;
#[cfg(test)]
use super::registers::assert_offsets;

/// Clock recovery system. The 48 MHz oscillator is taken as exact, so there is nothing to trim (RM0440, "Clock recovery
/// system").
pub mod crs {
    use super::super::registers::{ALL, registers};
    use super::{Bank, Effects};

    registers! {
        CR = 0x00, reset 0x4000, keeps ALL;
        CFGR = 0x04, reset 0x2022_BB7F, keeps ALL;
        ISR = 0x08;
        ICR = 0x0C;
    }

    /// CEN: the frequency error counter runs.
    pub const CEN: u32 = 1 << 5;
    const INTERRUPTS: u32 = 0xF;

    pub fn write(bank: &mut Bank, offset: u32, value: u32, effects: &mut Effects) {
        match offset {
            CR => effects.unmodelled_bits(value & INTERRUPTS),
            CFGR if bank[CR] & CEN != 0 && value != bank[CFGR] => {
                effects.violation(value, "CRS_CFGR is written only while CEN = 0");
            }
            ICR => return,
            _ => {}
        }
        bank.write(offset, value, effects);
    }
}

/// System configuration controller: the port of each external interrupt line, which nothing drives here (RM0440, "System
/// configuration controller"). The boot loader is not executed, so what it finds at 0 does not matter.
pub mod syscfg {
    use super::super::registers::{ALL, registers};

    registers! {
        MEMRMP = 0x00, keeps 0x107;
        CFGR1 = 0x04, reset 0x7C00_0001, keeps ALL;
        EXTICR = 0x08, keeps 0x7777;
        EXTICR2 = 0x0C, keeps 0x7777;
        EXTICR3 = 0x10, keeps 0x7777;
        EXTICR4 = 0x14, keeps 0x7777;
        SCSR = 0x18;
        CFGR2 = 0x1C;
    }
}

/// Backup registers of the tamper block (RM0440, "Tamper and backup registers"). They outlive
/// resets and are lost with the supply. Tamper detection is not modelled.
#[derive(Debug, Default)]
pub struct Backup {
    registers: [u32; 32],
}

const BKP0R: u32 = 0x100;
const BKP31R: u32 = 0x17C;

impl Backup {
    pub fn read(&self, offset: u32, effects: &mut Effects) -> u32 {
        match offset {
            BKP0R..=BKP31R => self.registers[((offset - BKP0R) / 4) as usize],
            _ => {
                effects.unmodelled();
                0
            }
        }
    }

    /// `access`: PWR_CR1.DBP.
    pub fn write(&mut self, offset: u32, value: u32, access: bool, effects: &mut Effects) {
        match offset {
            BKP0R..=BKP31R if access => self.registers[((offset - BKP0R) / 4) as usize] = value,
            BKP0R..=BKP31R => effects.violation(value, "TAMP_BKPxR are written only while PWR_CR1.DBP = 1"),
            _ => effects.unmodelled(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::facts::assert_facts;

    #[test]
    fn backup_registers_need_backup_access() {
        let (mut backup, mut effects) = (Backup::default(), Effects::default());
        backup.write(BKP31R, 7, false, &mut effects);
        assert_eq!((backup.read(BKP31R, &mut effects), effects.violation_count()), (0, 1));
        backup.write(BKP31R, 7, true, &mut effects);
        assert_eq!(backup.read(BKP31R, &mut effects), 7);
    }

    #[test]
    fn clock_recovery_is_fixed_while_it_runs() {
        let (mut bank, mut effects) = (Bank::new(crs::REGISTERS), Effects::default());
        crs::write(&mut bank, crs::CFGR, 0x1000_0000, &mut effects);
        crs::write(&mut bank, crs::CR, crs::CEN, &mut effects);
        assert_eq!(effects.violation_count(), 0);
        crs::write(&mut bank, crs::CFGR, 0, &mut effects);
        assert_eq!(effects.violation_count(), 1);
    }

    #[test]
    fn registers_are_those_of_st() {
        assert_facts!("TAMP_TypeDef."; BKP0R, BKP31R);
        let (lines, others): (Vec<_>, Vec<_>) = syscfg::REGISTERS.iter().partition(|it| it.name.starts_with("EXTICR"));
        assert_offsets("SYSCFG_TypeDef", others.into_iter().chain(lines.into_iter().take(1)));
        assert_offsets("CRS_TypeDef", crs::REGISTERS);
        assert_eq!(crs::CEN, crate::facts::bits("CRS_CR_CEN"));
    }
}
