//! Power control: backup-domain access, voltage scaling and the voltage detector (RM0440,
//! "Power control").

use super::Effects;
use super::registers::{ALL, Bank, registers};

registers! {
    CR1 = 0x00, reset 0x0200, keeps ALL;
    CR2 = 0x04, keeps 0xF;
    /// Wake-up from standby and pulls in standby have no meaning without standby.
    CR3 = 0x08, reset 0x8000, keeps ALL;
    CR4 = 0x0C, keeps ALL;
    SR1 = 0x10;
    SR2 = 0x14;
    SCR = 0x18;
    PUCRA = 0x20;
    PDCRG = 0x54;
    CR5 = 0x80, reset R1MODE, keeps R1MODE;
}

const DBP: u32 = 1 << 8;
/// Low-power modes, voltage range 2 and low-power run.
const CR1_UNMODELLED: u32 = 0b111 | 1 << 10 | 1 << 14;
const PVDE: u32 = 1;
const PVDO: u32 = 1 << 11;
/// Main regulator started, as SR2 shows it.
const REGLPS: u32 = 1 << 8;
const R1MODE: u32 = 1 << 8;

/// Falling thresholds of the voltage detector by PLS code, in volts (data sheet, "Embedded
/// reset and power control block characteristics", V_PVD0 to V_PVD6, typical). The seventh code
/// compares an external pin, which is not modelled.
const PVD_FALLING_V: [f64; 7] = [2.05, 2.20, 2.36, 2.52, 2.64, 2.81, 2.90];
/// Hysteresis of the detector (data sheet, V_hyst_BOR_PVD).
const PVD_HYSTERESIS_V: f64 = 0.1;

#[derive(Debug)]
pub struct Power {
    bank: Bank,
    pub supply_v: f64,
    /// PVDO, which goes to EXTI line 16: the supply is below the threshold.
    pub is_low: bool,
}

impl Power {
    /// State after power-on, at `supply_v` volts.
    pub fn new(supply_v: f64) -> Self {
        Self { bank: Bank::new(REGISTERS), supply_v, is_low: false }
    }

    pub fn reset(&mut self) {
        *self = Self::new(self.supply_v);
    }

    pub fn read(&self, offset: u32, effects: &mut Effects) -> u32 {
        match offset {
            SR2 => REGLPS | if self.is_low { PVDO } else { 0 },
            PUCRA | PDCRG => {
                effects.unmodelled();
                0
            }
            _ => self.bank.read(offset, effects),
        }
    }

    pub fn write(&mut self, offset: u32, value: u32, effects: &mut Effects) {
        match offset {
            CR1 => effects.unmodelled_bits(value & CR1_UNMODELLED),
            CR2 => {
                effects.unmodelled_bits(value & !0xF);
                effects.unmodelled_bits(u32::from(value >> 1 & 7 == 7));
            }
            _ => {}
        }
        if !matches!(offset, SCR | PUCRA..=PDCRG) {
            self.bank.write(offset, value, effects);
        }
        self.compare();
    }

    /// Whether the backup domain may be written (DBP).
    pub fn backup_access(&self) -> bool {
        self.bank[CR1] & DBP != 0
    }

    /// Whether range 1 runs in boost mode, which the core needs above 150 MHz.
    pub fn is_boosted(&self) -> bool {
        self.bank[CR5] & R1MODE == 0
    }

    pub fn compare(&mut self) {
        let threshold = PVD_FALLING_V.get((self.bank[CR2] >> 1 & 7) as usize);
        self.is_low = match threshold {
            Some(falling) if self.bank[CR2] & PVDE != 0 => {
                self.supply_v < falling + if self.is_low { PVD_HYSTERESIS_V } else { 0.0 }
            }
            _ => false,
        };
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::facts::{self, assert_facts};

    #[test]
    fn detector_has_its_threshold_and_hysteresis() {
        let (mut power, mut effects) = (Power::new(3.3), Effects::default());
        power.supply_v = 2.5;
        power.compare();
        assert!(!power.is_low, "the detector is off");
        power.supply_v = 3.3;
        power.compare();
        power.write(CR2, PVDE | 5 << 1, &mut effects);
        let seen = [2.85, 2.80, 2.88, 2.92].map(|volts| {
            power.supply_v = volts;
            power.compare();
            (power.is_low, power.read(SR2, &mut effects) & PVDO != 0)
        });
        assert_eq!(seen, [(false, false), (true, true), (true, true), (false, false)]);
    }

    #[test]
    fn registers_and_thresholds_are_those_of_st() {
        super::super::registers::assert_offsets("PWR_TypeDef", REGISTERS);
        assert_facts!("PWR_"; DBP = "CR1_DBP", PVDE = "CR2_PVDE", PVDO = "SR2_PVDO", REGLPS = "SR2_REGLPS");
        assert_facts!("PWR_"; R1MODE = "CR5_R1MODE");
        assert_eq!(facts::bits("PWR_CR2_PLS"), 7 << 1);
        assert_eq!(PVD_FALLING_V, [0, 1, 2, 3, 4, 5, 6].map(|level| facts::number(&format!("V_PVD{level}_falling"))));
        assert_eq!(PVD_HYSTERESIS_V, facts::number("V_hyst_BOR_PVD"));
    }
}
