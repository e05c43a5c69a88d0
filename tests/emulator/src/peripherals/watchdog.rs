//! Independent watchdog (RM0440, "Independent watchdog").
//!
//! Counts the 32 kHz internal oscillator, taken as exact. Once started only a reset stops it.
//! Updates of its registers are in force at once; the hardware takes five oscillator periods.

use super::{Effects, ResetCause, TICKS_PER_SECOND, Ticks};

const KR: u32 = 0x00;
const PR: u32 = 0x04;
const RLR: u32 = 0x08;
const SR: u32 = 0x0C;
const WINR: u32 = 0x10;

const KEY_UNLOCK: u32 = 0x5555;
const KEY_REFRESH: u32 = 0xAAAA;
const KEY_START: u32 = 0xCCCC;

/// Low-speed internal oscillator, in hertz.
const LSI_HZ: u64 = 32_000;

/// The watchdog.
#[derive(Debug)]
pub struct Watchdog {
    unlocked: bool,
    prescaler: u32,
    reload: u32,
    window: u32,
    /// When the counter was last reloaded; `None` before the start.
    refreshed: Option<Ticks>,
}

impl Watchdog {
    /// State after any reset: stopped.
    pub fn new() -> Self {
        Self { unlocked: false, prescaler: 0, reload: 0xFFF, window: 0xFFF, refreshed: None }
    }

    /// Value of a register.
    pub fn read(&mut self, offset: u32, effects: &mut Effects) -> u32 {
        match offset {
            KR | SR => 0,
            PR => self.prescaler,
            RLR => self.reload,
            WINR => self.window,
            _ => {
                effects.unmodelled();
                0
            }
        }
    }

    /// Writes a register.
    pub fn write(&mut self, offset: u32, value: u32, effects: &mut Effects) {
        match offset {
            KR => self.key(value & 0xFFFF, effects),
            PR | RLR | WINR if !self.unlocked => {
                effects.violation(value, "IWDG_PR, RLR and WINR are written only after the key 0x5555");
            }
            PR => self.prescaler = value & 7,
            RLR => self.reload = value & 0xFFF,
            WINR => {
                self.window = value & 0xFFF;
                // RM0440, "Window option": writing the window reloads the counter.
                self.refreshed = self.refreshed.map(|_| effects.now());
            }
            _ => effects.unmodelled(),
        }
    }

    /// Tick at which the watchdog bites.
    pub fn next_event(&self) -> Ticks {
        self.refreshed.map_or(Ticks::MAX, |at| at + (u64::from(self.reload) + 1) * self.count_ticks())
    }

    /// The time is over.
    pub fn advance(&mut self, effects: &mut Effects) {
        self.refreshed = None;
        effects.request_reset(ResetCause::Watchdog);
    }

    fn key(&mut self, key: u32, effects: &mut Effects) {
        self.unlocked = key == KEY_UNLOCK;
        match key {
            KEY_START => self.refreshed = self.refreshed.or(Some(effects.now())),
            KEY_REFRESH => self.refresh(effects),
            _ => {}
        }
    }

    fn refresh(&mut self, effects: &mut Effects) {
        let Some(since) = self.refreshed else { return };
        let counted = (effects.now() - since) / self.count_ticks();
        if u64::from(self.reload).saturating_sub(counted) > u64::from(self.window) {
            effects.request_reset(ResetCause::Watchdog);
        }
        self.refreshed = Some(effects.now());
    }

    /// Ticks per count: 4 · 2^PR oscillator periods, at most 256.
    fn count_ticks(&self) -> u64 {
        (4 << self.prescaler.min(6)) * TICKS_PER_SECOND / LSI_HZ
    }
}

impl Default for Watchdog {
    fn default() -> Self {
        Self::new()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::facts::assert_facts;

    fn started() -> (Watchdog, Effects) {
        let (mut watchdog, mut effects) = (Watchdog::new(), Effects::default());
        for (offset, value) in [(KR, KEY_UNLOCK), (PR, 1), (RLR, 399), (KR, KEY_START)] {
            watchdog.write(offset, value, &mut effects);
        }
        (watchdog, effects)
    }

    #[test]
    fn bites_after_its_period() {
        // 400 counts of 8 periods of 32 kHz: 0.1 s.
        let (mut watchdog, mut effects) = started();
        assert_eq!(watchdog.next_event(), TICKS_PER_SECOND / 10);
        effects.now = 1_000;
        watchdog.write(KR, KEY_REFRESH, &mut effects);
        assert_eq!(watchdog.next_event(), TICKS_PER_SECOND / 10 + 1_000);
        effects.now = watchdog.next_event();
        watchdog.advance(&mut effects);
        assert_eq!(effects.reset, Some(ResetCause::Watchdog));
    }

    #[test]
    fn registers_are_locked_without_the_key() {
        let (mut watchdog, mut effects) = (Watchdog::new(), Effects::default());
        watchdog.write(RLR, 1, &mut effects);
        assert_eq!(effects.violation_count(), 1);
        assert_eq!(watchdog.read(RLR, &mut effects), 0xFFF);
        watchdog.write(KR, KEY_REFRESH, &mut effects);
        assert_eq!(watchdog.next_event(), Ticks::MAX);
    }

    #[test]
    fn feeding_before_the_window_opens_resets() {
        let (mut watchdog, mut effects) = started();
        watchdog.write(KR, KEY_UNLOCK, &mut effects);
        watchdog.write(WINR, 200, &mut effects);
        effects.now = TICKS_PER_SECOND / 10 / 400 * 198;
        watchdog.write(KR, KEY_REFRESH, &mut effects);
        assert_eq!(effects.reset, Some(ResetCause::Watchdog));
        effects.reset = None;
        effects.now *= 3;
        watchdog.write(KR, KEY_REFRESH, &mut effects);
        assert_eq!(effects.reset, None);
    }

    #[test]
    fn registers_and_clock_are_those_of_st() {
        assert_facts!("IWDG_TypeDef."; KR, PR, RLR, SR, WINR);
        assert_facts!("LL_IWDG_KEY_"; KEY_UNLOCK = "WR_ACCESS_ENABLE", KEY_REFRESH = "RELOAD", KEY_START = "ENABLE");
        assert_eq!(LSI_HZ as f64, 1e3 * crate::facts::number("LSI"));
    }
}
