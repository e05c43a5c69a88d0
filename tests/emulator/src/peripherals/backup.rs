//! Backup registers of the tamper block (RM0440, "Tamper and backup registers"). They outlive
//! resets and are lost with the supply. Tamper detection is not modelled.

use super::Effects;

const BKP0R: u32 = 0x100;
const BKP31R: u32 = 0x17C;

/// The backup registers.
#[derive(Debug, Default)]
pub struct Backup {
    registers: [u32; 32],
}

impl Backup {
    /// State after power-on, or after a reset of the backup domain.
    pub fn new() -> Self {
        Self::default()
    }

    /// The backup domain was reset or has lost its supply.
    pub fn clear(&mut self) {
        *self = Self::new();
    }

    /// Value of a register.
    pub fn read(&mut self, offset: u32, effects: &mut Effects) -> u32 {
        match offset {
            BKP0R..=BKP31R => self.registers[((offset - BKP0R) / 4) as usize],
            _ => {
                effects.unmodelled();
                0
            }
        }
    }

    /// Writes a register. `access`: PWR_CR1.DBP.
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
    fn writes_need_backup_access() {
        let (mut backup, mut effects) = (Backup::new(), Effects::default());
        backup.write(BKP31R, 7, false, &mut effects);
        assert_eq!((backup.read(BKP31R, &mut effects), effects.violation_count()), (0, 1));
        backup.write(BKP31R, 7, true, &mut effects);
        assert_eq!(backup.read(BKP31R, &mut effects), 7);
        backup.clear();
        assert_eq!(backup.read(BKP31R, &mut effects), 0);
    }

    #[test]
    fn registers_are_those_of_st() {
        assert_facts!("TAMP_TypeDef."; BKP0R, BKP31R);
    }
}
