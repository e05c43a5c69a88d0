//! Power control: backup-domain access, voltage scaling and the voltage detector (RM0440,
//! "Power control").

use super::Effects;

const CR1: u32 = 0x00;
const CR2: u32 = 0x04;
const CR3: u32 = 0x08;
const CR4: u32 = 0x0C;
const SR1: u32 = 0x10;
const SR2: u32 = 0x14;
const SCR: u32 = 0x18;
const PUCRA: u32 = 0x20;
const PDCRG: u32 = 0x54;
const CR5: u32 = 0x80;

const DBP: u32 = 1 << 8;
/// Low-power modes, voltage range 2 and low-power run.
const CR1_UNMODELLED: u32 = 0b111 | 1 << 10 | 1 << 14;
const CR1_RESET: u32 = 0x0200;
const PVDE: u32 = 1;
const PVDO: u32 = 1 << 11;
/// Main regulator started, as SR2 shows it.
const REGLPS: u32 = 1 << 8;
const R1MODE: u32 = 1 << 8;
const CR3_RESET: u32 = 0x8000;

/// Falling thresholds of the voltage detector by PLS code, in volts (data sheet, "Embedded
/// reset and power control block characteristics", V_PVD0 to V_PVD6, typical). The seventh code
/// compares an external pin, which is not modelled.
const PVD_FALLING_V: [f64; 7] = [2.05, 2.20, 2.36, 2.52, 2.64, 2.81, 2.90];
/// Hysteresis of the detector (data sheet, V_hyst_BOR_PVD).
const PVD_HYSTERESIS_V: f64 = 0.1;

/// Power control.
#[derive(Debug)]
pub struct Power {
    cr1: u32,
    cr2: u32,
    cr3: u32,
    cr4: u32,
    cr5: u32,
    supply_v: f64,
    /// PVDO: the supply is below the threshold.
    low: bool,
}

impl Power {
    /// State after power-on, at `supply_v` volts.
    pub fn new(supply_v: f64) -> Self {
        Self { cr1: CR1_RESET, cr2: 0, cr3: CR3_RESET, cr4: 0, cr5: R1MODE, supply_v, low: false }
    }

    /// State after reset.
    pub fn reset(&mut self) {
        *self = Self::new(self.supply_v);
    }

    /// Value of a register.
    pub fn read(&mut self, offset: u32, effects: &mut Effects) -> u32 {
        match offset {
            CR1 => self.cr1,
            CR2 => self.cr2,
            CR3 => self.cr3,
            CR4 => self.cr4,
            CR5 => self.cr5,
            SR1 | SCR => 0,
            SR2 => REGLPS | if self.low { PVDO } else { 0 },
            _ => {
                effects.unmodelled();
                0
            }
        }
    }

    /// Writes a register.
    pub fn write(&mut self, offset: u32, value: u32, effects: &mut Effects) {
        match offset {
            CR1 => {
                effects.unmodelled_bits(value & CR1_UNMODELLED);
                self.cr1 = value;
            }
            CR2 => {
                effects.unmodelled_bits(value & !0xF);
                effects.unmodelled_bits(u32::from(value >> 1 & 7 == 7));
                self.cr2 = value & 0xF;
            }
            // Wake-up from standby and pulls in standby have no meaning without standby.
            CR3 => self.cr3 = value,
            CR4 => self.cr4 = value,
            CR5 => self.cr5 = value & R1MODE,
            SCR | PUCRA..=PDCRG => {}
            _ => effects.unmodelled(),
        }
        self.compare();
    }

    /// Whether the backup domain may be written (DBP).
    pub fn backup_access(&self) -> bool {
        self.cr1 & DBP != 0
    }

    /// Whether range 1 runs in boost mode, which the core needs above 150 MHz.
    pub fn is_boosted(&self) -> bool {
        self.cr5 & R1MODE == 0
    }

    /// PVDO, which goes to EXTI line 16.
    pub fn is_low(&self) -> bool {
        self.low
    }

    /// The supply, in volts.
    pub fn supply_v(&self) -> f64 {
        self.supply_v
    }

    /// Sets the supply.
    pub fn set_supply_v(&mut self, volts: f64) {
        self.supply_v = volts;
    }

    /// Lets the detector see the supply.
    pub fn compare(&mut self) {
        let threshold = PVD_FALLING_V.get((self.cr2 >> 1 & 7) as usize);
        self.low = match threshold {
            Some(falling) if self.cr2 & PVDE != 0 => {
                self.supply_v < falling + if self.low { PVD_HYSTERESIS_V } else { 0.0 }
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
        power.set_supply_v(2.5);
        power.compare();
        assert!(!power.is_low(), "the detector is off");
        power.set_supply_v(3.3);
        power.compare();
        power.write(CR2, PVDE | 5 << 1, &mut effects);
        let seen = [2.85, 2.80, 2.88, 2.92].map(|volts| {
            power.set_supply_v(volts);
            power.compare();
            (power.is_low(), power.read(SR2, &mut effects) & PVDO != 0)
        });
        assert_eq!(seen, [(false, false), (true, true), (true, true), (false, false)]);
    }

    #[test]
    fn boost_and_backup_access_follow_their_bits() {
        let (mut power, mut effects) = (Power::new(3.3), Effects::default());
        assert!(!power.is_boosted() && !power.backup_access());
        power.write(CR5, 0, &mut effects);
        power.write(CR1, CR1_RESET | DBP, &mut effects);
        assert!(power.is_boosted() && power.backup_access());
    }

    #[test]
    fn registers_and_thresholds_are_those_of_st() {
        assert_facts!("PWR_TypeDef."; CR1, CR2, CR3, CR4, SR1, SR2, SCR, PUCRA, PDCRG, CR5);
        assert_facts!("PWR_"; DBP = "CR1_DBP", PVDE = "CR2_PVDE", PVDO = "SR2_PVDO", REGLPS = "SR2_REGLPS");
        assert_facts!("PWR_"; R1MODE = "CR5_R1MODE");
        assert_eq!(facts::bits("PWR_CR2_PLS"), 7 << 1);
        assert_eq!(PVD_FALLING_V, [0, 1, 2, 3, 4, 5, 6].map(|level| facts::number(&format!("V_PVD{level}_falling"))));
        assert_eq!(PVD_HYSTERESIS_V, facts::number("V_hyst_BOR_PVD"));
    }
}
