//! Independent watchdog (RM0440, "Independent watchdog").
//!
//! Counts the 32 kHz internal oscillator, taken as exact. Once started only a reset stops it; its window and the lock of its registers are not modelled.
//! Updates of its registers are in force at once; the hardware takes five oscillator periods.

use super::effects::{Bank, Register};
use super::{Effects, ResetCause, TICKS_PER_SECOND, Ticks};
use crate::st::LL::{IWDG_KEY_ENABLE as KEY_START, IWDG_KEY_RELOAD as KEY_REFRESH};

use crate::st::IWDG::{KR, PR, RLR, SR, WINR};

const REGISTERS: &[Register] =
    &[(KR, 1, 0, 0), (PR, 1, 0, 7), (RLR, 1, 0xFFF, 0xFFF), (SR, 1, 0, 0), (WINR, 1, 0xFFF, 0)];

/// Low-speed internal oscillator, in hertz.
const LSI_HZ: u64 = 1_000 * crate::st::one_word::LSI as u64;

#[derive(Debug)]
pub struct Watchdog {
    bank: Bank,
    /// When the counter was last reloaded; `None` before the start.
    refreshed: Option<Ticks>,
}

impl Watchdog {
    /// State after any reset: stopped.
    pub fn new() -> Self {
        Self { bank: Bank::new(REGISTERS), refreshed: None }
    }

    pub fn read(&self, offset: u32, effects: &mut Effects) -> u32 {
        self.bank.read(offset, effects)
    }

    pub fn write(&mut self, offset: u32, value: u32, effects: &mut Effects) {
        match offset {
            KR => self.key(value & 0xFFFF, effects),
            _ => self.bank.write(offset, value, effects),
        }
    }

    pub fn next_event(&self) -> Ticks {
        self.refreshed.map_or(Ticks::MAX, |at| at + (u64::from(self.bank[RLR]) + 1) * self.count_ticks())
    }

    pub fn advance(&mut self, effects: &mut Effects) {
        self.refreshed = None;
        effects.request_reset(ResetCause::Watchdog);
    }

    fn key(&mut self, key: u32, effects: &mut Effects) {
        match key {
            KEY_START => self.refreshed = self.refreshed.or(Some(effects.now)),
            KEY_REFRESH => self.refreshed = self.refreshed.map(|_| effects.now),
            _ => {}
        }
    }

    /// Ticks per count: 4 · 2^PR oscillator periods, at most 256.
    fn count_ticks(&self) -> u64 {
        (4 << self.bank[PR].min(6)) * TICKS_PER_SECOND / LSI_HZ
    }
}
