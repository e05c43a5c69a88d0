//! Power control: backup-domain access, voltage scaling and the voltage detector (RM0440,
//! "Power control").

use super::Effects;
use super::effects::{ALL, Bank, Register};
use crate::st::PWR::{CR1_DBP as DBP, CR2_PVDE as PVDE, CR5_R1MODE as R1MODE, SR2_PVDO as PVDO, SR2_REGLPS as REGLPS};
use crate::st::V;

use crate::st::PWR::{CR1, CR2, CR3, CR4, CR5, PDCRG, PUCRA, SCR, SR1, SR2};

const REGISTERS: &[Register] = &[
    (CR1, 1, 0x0200, !LOW_POWER_MODES),
    (CR2, 1, 0, 0xF),
    // Wake-up from standby and pulls in standby have no meaning without standby.
    (CR3, 1, 0x8000, ALL),
    (CR4, 1, 0, ALL),
    (SR1, 1, 0, 0),
    (SR2, 1, 0, 0),
    (SCR, 1, 0, 0),
    (PUCRA, 1, 0, 0),
    (PDCRG, 1, 0, 0),
    (CR5, 1, R1MODE, R1MODE),
];

/// Of CR1: low-power modes, voltage range 2 and low-power run.
const LOW_POWER_MODES: u32 = 0b111 | 1 << 10 | 1 << 14;

/// Falling thresholds of the voltage detector by PLS code, in volts (data sheet, "Embedded
/// reset and power control block characteristics", V_PVD0 to V_PVD6, typical). The seventh code
/// compares an external pin, which is not modelled.
const PVD_FALLING_V: [f64; 7] = [
    V::PVD0_falling,
    V::PVD1_falling,
    V::PVD2_falling,
    V::PVD3_falling,
    V::PVD4_falling,
    V::PVD5_falling,
    V::PVD6_falling,
];

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
        effects.unmodelled_bits(u32::from(offset == CR2 && value >> 1 & 7 == 7));
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
                self.supply_v < falling + if self.is_low { V::hyst_BOR_PVD } else { 0.0 }
            }
            _ => false,
        };
    }
}
