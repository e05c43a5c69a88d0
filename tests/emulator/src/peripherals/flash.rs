//! Interface of the embedded flash memory in dual-bank mode (RM0440, "Embedded flash memory").
//!
//! Modelled: latency, unlocking, programming of double words, erasure of pages with
//! their duration, error flags, and ECC errors of double words whose programming was cut short. Not modelled: fast
//! programming, erasure of banks, option bytes, write and read protection; the stall of a core that reads a busy bank, which
//! breaks a rule here.

use super::{Effects, Ticks, ticks};
use crate::faults::Fault;
use crate::memory::{BANK_BYTES, DOUBLE_WORD_BYTES, FLASH_BASE, FlashArray, PAGE_BYTES, load};
use crate::st;
use crate::st::FLASH::{
    ACR, ACR_LATENCY as LATENCY, CR, CR_BKER as BKER, CR_EOPIE as EOPIE, CR_ERRIE as ERRIE, CR_LOCK as LOCK,
    CR_OPTLOCK as OPTLOCK, CR_PER as PER, CR_PG as PG, CR_PNB, CR_STRT as STRT, ECCR, ECCR_BK_ECC as BK_ECC,
    ECCR_ECCD as ECCD, KEY1, KEY2, KEYR, OPTR, SR, SR_BSY as BSY, SR_EOP as EOP, SR_PGAERR as PGAERR,
    SR_PGSERR as PGSERR, SR_PROGERR as PROGERR, SR_SIZERR as SIZERR,
};

const ACR_RESET: u32 = 0x0004_0600;

const ERRORS: u32 = PROGERR | PGAERR | SIZERR | PGSERR;

const CR_MODELLED: u32 = PG | PER | CR_PNB | BKER | STRT | EOPIE | ERRIE | OPTLOCK | LOCK;

/// Option bytes as delivered: no protection, dual bank, brown-out level 0, watchdog by software.
const OPTR_DELIVERED: u32 = 0xFFEF_F8AA;

/// Programming of a double word (typical), and erasure of a page.
const PROGRAM_TICKS: Ticks = ticks(st::t::prog, 1_000_000);
const ERASE_TICKS: Ticks = ticks(st::t::ERASE, 1_000);

/// The core would stand still until the operation is done, and sampling is not looked after.
const BUSY_RULE: &str = "a bank is read, and code fetched from it, only while it is not busy";

#[derive(Clone, Copy, Debug)]
enum Work {
    Program { offset: usize, data: u64 },
    Erase { offset: usize, length: usize },
}

#[derive(Clone, Copy, Debug)]
struct Operation {
    work: Work,
    started: Ticks,
    done: Ticks,
}

impl Operation {
    fn bank(&self) -> usize {
        let (Work::Program { offset, .. } | Work::Erase { offset, .. }) = self.work;
        offset / BANK_BYTES
    }
}

/// The interface, with the cells behind it.
#[derive(Debug)]
pub struct Flash {
    pub array: FlashArray,
    acr: u32,
    sr: u32,
    cr: u32,
    eccr: u32,
    /// The first key was written.
    half_unlocked: bool,
    /// First word of a double word being programmed: offset and value.
    latch: Option<(usize, u32)>,
    operation: Option<Operation>,
    /// The pages of the settings, the first two of bank 2, are erased at each reset.
    pub loses_settings: bool,
}

impl Flash {
    /// The interface after reset, over `array`.
    pub fn new(array: FlashArray) -> Self {
        Self {
            array,
            acr: ACR_RESET,
            sr: 0,
            cr: LOCK | OPTLOCK,
            eccr: 0,
            half_unlocked: false,
            latch: None,
            operation: None,
            loses_settings: false,
        }
    }

    /// Reset or loss of power: an operation under way leaves torn cells.
    pub fn reset(&mut self, effects: &Effects) {
        if let Some(operation) = self.operation.take() {
            let granted = (effects.now - operation.started) as f64 / (operation.done - operation.started) as f64;
            match operation.work {
                Work::Program { offset, .. } if effects.faults.has(Fault::FlashTornOnes) => {
                    self.array.refusing.insert(offset);
                }
                work => self.apply(work, granted),
            }
        }
        if self.loses_settings {
            self.apply(Work::Erase { offset: BANK_BYTES, length: 2 * PAGE_BYTES }, 1.0);
        }
        let array = std::mem::replace(&mut self.array, FlashArray::erased());
        *self = Self { loses_settings: self.loses_settings, ..Self::new(array) };
    }

    /// Wait states of the cells, as set.
    #[inline]
    pub fn latency(&self) -> u32 {
        self.acr & LATENCY
    }

    pub fn read(&mut self, offset: u32, effects: &mut Effects) -> u32 {
        match offset {
            ACR => self.acr,
            SR => self.sr | if self.operation.is_some() { BSY } else { 0 },
            CR => self.cr,
            ECCR => self.eccr,
            OPTR => OPTR_DELIVERED,
            _ => {
                effects.unmodelled();
                0
            }
        }
    }

    pub fn write(&mut self, offset: u32, value: u32, effects: &mut Effects) {
        match offset {
            ACR => self.acr = value,
            KEYR => self.key(value, effects),
            SR => self.sr &= !value,
            CR => self.control(value, effects),
            ECCR => self.eccr &= !(value & ECCD),
            _ => effects.unmodelled(),
        }
        self.update_line(effects);
    }

    /// When the operation under way will be done.
    #[inline]
    pub fn next_event(&self) -> Ticks {
        self.operation.map_or(Ticks::MAX, |operation| operation.done)
    }

    pub fn advance(&mut self, effects: &mut Effects) {
        let Some(operation) = self.operation.take() else { return };
        self.apply(operation.work, 1.0);
        self.cr &= !STRT;
        // RM0440, "FLASH_SR": EOP is set only if its interrupt is enabled.
        if self.cr & EOPIE != 0 {
            self.sr |= EOP;
        }
        self.update_line(effects);
    }

    /// Reads cells; 1, 2 or 4 bytes at `offset`, aligned.
    #[inline]
    pub fn load(&mut self, offset: usize, width: u32, effects: &mut Effects) -> Option<u32> {
        if self.operation.is_some() || !self.array.torn.is_empty() {
            return self.load_carefully(offset, width, effects);
        }
        load(self.array.bytes(), offset, width)
    }

    /// Reads cells while some are torn or a bank is busy.
    #[cold]
    fn load_carefully(&mut self, offset: usize, width: u32, effects: &mut Effects) -> Option<u32> {
        if self.operation.is_some_and(|operation| operation.bank() == offset / BANK_BYTES) {
            effects.violation(0, BUSY_RULE);
        }
        let double_word = offset & !(DOUBLE_WORD_BYTES - 1);
        if self.array.torn.contains(&double_word) && self.eccr & ECCD == 0 {
            let bank = if offset >= BANK_BYTES { BK_ECC } else { 0 };
            self.eccr = ECCD | bank | (double_word % BANK_BYTES) as u32;
            effects.raise_nmi();
        }
        load(self.array.bytes(), offset, width)
    }

    /// Writes to cells, which programs them (RM0440, "Flash main memory programming sequences").
    pub fn store(&mut self, offset: usize, width: u32, value: u32, effects: &mut Effects) {
        let error = if self.cr & LOCK != 0 || self.cr & PG == 0 || self.cr & PER != 0 {
            Some((PGSERR, "flash is programmed only while PG alone is set"))
        } else if self.operation.is_some() {
            Some((PGSERR, "flash is programmed only while BSY = 0"))
        } else if self.sr & ERRORS != 0 {
            Some((PGSERR, "flash is programmed only after earlier error flags are cleared"))
        } else if width != 4 {
            Some((SIZERR, "flash is programmed by words"))
        } else {
            None
        };
        match error {
            Some((flag, rule)) => self.fail(flag, value, rule, effects),
            None => self.store_word(offset, value, effects),
        }
        self.update_line(effects);
    }

    fn store_word(&mut self, offset: usize, value: u32, effects: &mut Effects) {
        match self.latch.take() {
            None if offset.is_multiple_of(DOUBLE_WORD_BYTES) => self.latch = Some((offset, value)),
            Some((base, low)) if offset == base + 4 => {
                let data = u64::from(low) | u64::from(value) << 32;
                if self.array.double_word(base) != u64::MAX && data != 0 {
                    self.fail(PROGERR, value, "a double word is programmed only after its erasure", effects);
                } else if self.array.refusing.contains(&base) {
                    self.latch = None;
                    self.sr |= PROGERR;
                } else {
                    self.begin(Work::Program { offset: base, data }, PROGRAM_TICKS, effects);
                }
            }
            _ => self.fail(PGAERR, value, "the two words of a double word are programmed one after the other", effects),
        }
    }

    fn fail(&mut self, flag: u32, value: u32, rule: &'static str, effects: &mut Effects) {
        self.latch = None;
        self.sr |= flag;
        effects.violation(value, rule);
    }

    fn key(&mut self, key: u32, effects: &mut Effects) {
        match (self.half_unlocked, key) {
            (false, KEY1) => self.half_unlocked = true,
            (true, KEY2) => {
                self.half_unlocked = false;
                self.cr &= !LOCK;
            }
            _ => effects.violation(key, "the keys of the flash are KEY1 and KEY2, in this order"),
        }
    }

    fn control(&mut self, value: u32, effects: &mut Effects) {
        if self.cr & LOCK != 0 {
            effects.violation(value, "FLASH_CR is written only after it is unlocked");
            return;
        }
        if self.operation.is_some() {
            effects.violation(value, "FLASH_CR is written only while BSY = 0");
            return;
        }
        effects.unmodelled_bits(value & !CR_MODELLED);
        self.cr = value & CR_MODELLED;
        self.latch = None;
        if value & STRT == 0 {
            return;
        }
        match self.erasure() {
            Some((offset, length)) if self.sr & ERRORS == 0 && value & PG == 0 => {
                self.begin(Work::Erase { offset, length }, ERASE_TICKS, effects);
            }
            _ => self.fail(PGSERR, value, "STRT is set with PER and without error flags", effects),
        }
        if self.operation.is_none() {
            self.cr &= !STRT;
        }
    }

    /// What FLASH_CR selects for erasure: offset and length.
    fn erasure(&self) -> Option<(usize, usize)> {
        let page = (self.cr >> 3 & 0x7F) as usize;
        let bank = if self.cr & BKER != 0 { BANK_BYTES } else { 0 };
        (self.cr & PER != 0).then_some((bank + page * PAGE_BYTES, PAGE_BYTES))
    }

    fn begin(&mut self, work: Work, duration: Ticks, effects: &mut Effects) {
        let operation = Operation { work, started: effects.now, done: effects.now + duration };
        self.operation = Some(operation);
        if effects.pc.wrapping_sub(FLASH_BASE) as usize / BANK_BYTES == operation.bank() {
            effects.violation(effects.pc, BUSY_RULE);
        }
    }

    fn apply(&mut self, work: Work, complete: f64) {
        match work {
            Work::Program { offset, data } => self.array.program(offset, data, complete),
            Work::Erase { offset, length } => self.array.erase(offset, length, complete),
        }
    }

    fn update_line(&self, effects: &mut Effects) {
        let end = self.sr & EOP != 0 && self.cr & EOPIE != 0;
        let error = self.sr & ERRORS != 0 && self.cr & ERRIE != 0;
        effects.set_line(st::FLASH::IRQn, end || error);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn refuses_what_is_not_erased() {
        let (mut flash, mut effects) = unlocked();
        program(&mut flash, &mut effects, [1, 2]);
        finish(&mut flash, &mut effects);
        flash.write(SR, EOP, &mut effects);
        program(&mut flash, &mut effects, [0, 2]);
        assert_eq!((flash.read(SR, &mut effects), effects.violation_count), (PROGERR, 1));
        flash.write(SR, PROGERR, &mut effects);
        program(&mut flash, &mut effects, [0, 0]);
        assert_eq!(flash.read(SR, &mut effects), BSY, "zeros may be programmed over anything");
    }

    /// Page 3 of bank 2.
    const OFFSET: usize = BANK_BYTES + 3 * PAGE_BYTES;
    fn unlocked() -> (Flash, Effects) {
        let (mut flash, mut effects) = (Flash::new(FlashArray::erased()), Effects::default());
        flash.write(KEYR, KEY1, &mut effects);
        flash.write(KEYR, KEY2, &mut effects);
        assert_eq!(flash.read(CR, &mut effects) & LOCK, 0);
        (flash, effects)
    }

    fn finish(flash: &mut Flash, effects: &mut Effects) {
        effects.now = flash.next_event();
        flash.advance(effects);
    }

    fn program(flash: &mut Flash, effects: &mut Effects, words: [u32; 2]) {
        flash.write(CR, PG | EOPIE, effects);
        flash.store(OFFSET, 4, words[0], effects);
        flash.store(OFFSET + 4, 4, words[1], effects);
    }

    #[test]
    fn a_busy_bank_is_neither_run_from_nor_read() {
        for (pc, rules) in [(FLASH_BASE, 1), (FLASH_BASE + BANK_BYTES as u32, 0)] {
            let (mut flash, mut effects) = unlocked();
            effects.pc = pc;
            flash.write(CR, PER | 127 << 3 | STRT, &mut effects);
            assert_eq!(effects.violation_count, rules);
            flash.load(OFFSET, 4, &mut effects);
            assert_eq!(effects.violation_count, rules);
            flash.load(0, 4, &mut effects);
            assert_eq!(effects.violation_count, rules + 1);
        }
    }

    #[test]
    fn a_torn_double_word_raises_the_nmi_once_per_flag() {
        let (mut flash, mut effects) = unlocked();
        program(&mut flash, &mut effects, [0, 1]);
        flash.reset(&Effects { now: PROGRAM_TICKS / 2, ..Effects::default() });
        assert!(!effects.nmi);
        flash.load(OFFSET + 4, 4, &mut effects);
        assert!(std::mem::take(&mut effects.nmi));
        assert_eq!(flash.read(ECCR, &mut effects), ECCD | BK_ECC | (3 * PAGE_BYTES as u32));
        flash.load(OFFSET, 4, &mut effects);
        assert!(!effects.nmi);
        flash.write(ECCR, ECCD, &mut effects);
        flash.load(OFFSET, 4, &mut effects);
        assert!(effects.nmi);
    }
}
