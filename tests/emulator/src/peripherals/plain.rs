//! Units that do little more than hold their registers: clock recovery, system configuration, backup registers and
//! the CRC unit.

use super::Effects;
use super::effects::{ALL, Bank, Register};
use crate::st::CRC::{CR, CR_RESET, CR_REV_IN, CR_REV_OUT, DR, IDR, INIT, POL};
use crate::st::{CRS, SYSCFG, TAMP};

/// Clock recovery system. The 48 MHz oscillator is taken as exact, so there is nothing to trim (RM0440, "Clock recovery
/// system").
pub const CRS_REGISTERS: &[Register] = &[
    (CRS::CR, 1, 0x4000, !CRS_INTERRUPTS),
    (CRS::CFGR, 1, 0x2022_BB7F, ALL),
    (CRS::ISR, 1, 0, 0),
    (CRS::ICR, 1, 0, ALL),
];

const CRS_INTERRUPTS: u32 = 0xF;

/// System configuration controller: the port of each external interrupt line, which nothing drives here (RM0440, "System
/// configuration controller"). The boot loader is not executed, so what it finds at 0 does not matter.
pub const SYSCFG_REGISTERS: &[Register] = &[
    (SYSCFG::MEMRMP, 1, 0, 0x107),
    (SYSCFG::CFGR1, 1, 0x7C00_0001, ALL),
    (SYSCFG::EXTICR, 4, 0, 0x7777),
    (SYSCFG::SCSR, 1, 0, 0),
    (SYSCFG::CFGR2, 1, 0, 0),
];

/// Backup registers of the tamper block (RM0440, "Tamper and backup registers"). They outlive
/// resets and are lost with the supply. Tamper detection is not modelled.
pub const BACKUP_REGISTERS: &[Register] = &[(TAMP::BKP0R, 32, 0, ALL)];

/// Writes a backup register; `access`: PWR_CR1.DBP.
pub fn write_backup(bank: &mut Bank, offset: u32, value: u32, access: bool, effects: &mut Effects) {
    if access {
        bank.write(offset, value, effects);
    } else {
        effects.violation(value, "TAMP_BKPxR are written only while PWR_CR1.DBP = 1");
    }
}

const CRC_REGISTERS: &[Register] = &[
    // The checksum, its bits not reversed.
    (DR, 1, u32::MAX, 0),
    (IDR, 1, 0, ALL),
    (CR, 1, 0, CR_REV_IN | CR_REV_OUT | CR_RESET),
    (INIT, 1, u32::MAX, ALL),
    (POL, 1, crate::st::DEFAULT::CRC32_POLY, ALL),
];

/// CRC calculation unit, for polynomials of 32 bits and words (RM0440, "Cyclic redundancy check calculation unit").
///
/// A word takes four cycles of the bus, and the next one may be written meanwhile (RM0440, "CRC functional
/// description"): here its checksum is there at once.
#[derive(Debug)]
pub struct Crc(Bank);

impl Crc {
    pub fn new() -> Self {
        Self(Bank::new(CRC_REGISTERS))
    }

    pub fn read(&self, offset: u32, effects: &mut Effects) -> u32 {
        match offset {
            DR if self.0[CR] & CR_REV_OUT != 0 => self.0[DR].reverse_bits(),
            _ => self.0.read(offset, effects),
        }
    }

    /// Data count as a word.
    pub fn write(&mut self, offset: u32, value: u32, effects: &mut Effects) {
        if offset == DR {
            return self.add(value);
        }
        self.0.write(offset, value, effects);
        match offset {
            CR => {
                // Bytes and halves, reversed where they are.
                effects.unmodelled_bits(if value & CR_REV_IN == CR_REV_IN { 0 } else { value & CR_REV_IN });
                if value & CR_RESET != 0 {
                    self.0[CR] &= !CR_RESET;
                    self.0[DR] = self.0[INIT];
                }
            }
            INIT => self.0[DR] = value,
            _ => {}
        }
    }

    fn add(&mut self, word: u32) {
        let word = if self.0[CR] & CR_REV_IN != 0 { word.reverse_bits() } else { word };
        let polynomial = self.0[POL];
        self.0[DR] =
            (0..32).fold(self.0[DR] ^ word, |sum, _| if sum >> 31 != 0 { sum << 1 ^ polynomial } else { sum << 1 });
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::st::TAMP::BKP31R;

    #[test]
    fn backup_registers_need_backup_access() {
        let (mut bank, mut effects) = (Bank::new(BACKUP_REGISTERS), Effects::default());
        write_backup(&mut bank, BKP31R, 7, false, &mut effects);
        assert_eq!((bank.read(BKP31R, &mut effects), effects.violation_count), (0, 1));
        write_backup(&mut bank, BKP31R, 7, true, &mut effects);
        assert_eq!(bank.read(BKP31R, &mut effects), 7);
    }
}
