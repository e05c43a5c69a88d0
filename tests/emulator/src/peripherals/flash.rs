//! Flash memory interface (RM0440, "Embedded flash memory"): programming by double words and
//! erasing by pages in two banks, of which one can be read while the other is written.
//!
//! Caches belong to the core's model. Mass erase, option bytes and fast programming are not
//! modelled.

use super::{Effects, TICKS_PER_SECOND, Ticks, interrupt};
use crate::memory::{BANK_BYTES, DOUBLE_WORD_BYTES, FLASH_BASE, FlashArray, PAGE_BYTES};

const ACR: u32 = 0x00;
const KEYR: u32 = 0x08;
const SR: u32 = 0x10;
const CR: u32 = 0x14;
const ECCR: u32 = 0x18;
const OPTR: u32 = 0x20;

const KEYS: [u32; 2] = [0x4567_0123, 0xCDEF_89AB];

const EOP: u32 = 1;
const PROGERR: u32 = 1 << 3;
const WRPERR: u32 = 1 << 4;
const PGAERR: u32 = 1 << 5;
const SIZERR: u32 = 1 << 6;
const PGSERR: u32 = 1 << 7;
const ERRORS: u32 = 0xC3FA;
const BSY: u32 = 1 << 16;

const PG: u32 = 1;
const PER: u32 = 1 << 1;
const BKER: u32 = 1 << 11;
const STRT: u32 = 1 << 16;
const EOPIE: u32 = 1 << 24;
const ERRIE: u32 = 1 << 25;
const LOCK: u32 = 1 << 31;
const CR_MODELLED: u32 = PG | PER | 0x7F << 3 | BKER | STRT | EOPIE | ERRIE | LOCK;

const ECCD: u32 = 1 << 31;
const ECC_BANK2: u32 = 1 << 21;

/// As delivered: two banks, BOR level 0 (RM0440, FLASH_OPTR).
const OPTIONS: u32 = 0xFFEF_F8AA;

/// Programming of a double word, and erasing of a page (data sheet, t_prog and t_ERASE, typical).
pub const PROGRAM_TICKS: Ticks = TICKS_PER_SECOND * 817 / 10_000_000;
/// See [`PROGRAM_TICKS`].
pub const ERASE_TICKS: Ticks = TICKS_PER_SECOND * 2_202 / 100_000;

/// Work under way.
#[derive(Clone, Copy, Debug)]
struct Work {
    what: What,
    begun: Ticks,
    ends: Ticks,
}

#[derive(Clone, Copy, Debug)]
enum What {
    Program { offset: usize, data: u64 },
    Erase { offset: usize },
}

impl What {
    fn bank(self) -> usize {
        match self {
            Self::Program { offset, .. } | Self::Erase { offset } => offset / BANK_BYTES,
        }
    }
}

/// The interface, and the cells behind it.
#[derive(Debug)]
pub struct Flash {
    /// The cells: code and data.
    pub cells: FlashArray,
    acr: u32,
    sr: u32,
    cr: u32,
    eccr: u32,
    keys_given: usize,
    /// The first word of a double word, and where it goes.
    first_word: Option<(usize, u32)>,
    work: Option<Work>,
    /// Content has changed since this was last asked.
    changed: bool,
}

impl Flash {
    /// State after power-on.
    pub fn new(cells: FlashArray) -> Self {
        Self {
            cells,
            acr: 0x0004_0600,
            sr: 0,
            cr: LOCK | 1 << 30,
            eccr: 0,
            keys_given: 0,
            first_word: None,
            work: None,
            changed: false,
        }
    }

    /// State after a reset: what was being written is torn.
    pub fn reset(&mut self, effects: &mut Effects) {
        self.cut(effects.now());
        let cells = std::mem::replace(&mut self.cells, FlashArray::erased());
        *self = Self { changed: true, ..Self::new(cells) };
        self.update_line(effects);
    }

    /// Ends what is under way unfinished, as a reset or the loss of supply does.
    pub fn cut(&mut self, now: Ticks) {
        if let Some(work) = self.work.take() {
            let share = (now - work.begun) as f64 / (work.ends - work.begun) as f64;
            self.apply(work.what, share);
        }
    }

    /// Whether content has changed since this was last asked.
    #[inline]
    pub fn take_changed(&mut self) -> bool {
        std::mem::take(&mut self.changed)
    }

    /// Wait states of a read that misses the caches.
    #[inline]
    pub fn latency(&self) -> u32 {
        self.acr & 0xF
    }

    /// Tells of a read at `offset`: it waits while its bank is written, and torn memory is noticed.
    #[inline]
    pub fn note_read(&mut self, offset: usize, effects: &mut Effects) {
        if let Some(work) = &self.work
            && work.what.bank() == offset / BANK_BYTES
        {
            effects.stalled_until = effects.stalled_until.max(work.ends);
        }
        if self.cells.has_torn() && self.cells.is_torn(offset) {
            let bank = if offset >= BANK_BYTES { ECC_BANK2 } else { 0 };
            let double_word = (offset % BANK_BYTES / DOUBLE_WORD_BYTES) as u32;
            self.eccr = ECCD | bank | double_word;
            effects.nmi = true;
        }
    }

    /// A write into the memory itself.
    pub fn program(&mut self, offset: usize, width: u32, value: u32, effects: &mut Effects) {
        if self.cr & (LOCK | PG) != PG {
            effects.violation(value, "flash is written only while unlocked and FLASH_CR.PG = 1");
            return self.fail(PGSERR, effects);
        }
        if width != 4 {
            effects.violation(value, "flash is programmed by words");
            return self.fail(SIZERR, effects);
        }
        match self.first_word.take() {
            None if offset.is_multiple_of(DOUBLE_WORD_BYTES) => self.first_word = Some((offset, value)),
            Some((first, low)) if offset == first + 4 => {
                let data = u64::from(low) | u64::from(value) << 32;
                self.program_double_word(first, data, effects);
            }
            _ => {
                effects.violation(value, "both words of a double word are programmed, the lower first");
                self.fail(PGAERR, effects);
            }
        }
    }

    fn program_double_word(&mut self, offset: usize, data: u64, effects: &mut Effects) {
        // RM0440: only an erased double word may be programmed, or any with zeros.
        if self.cells.double_word(offset) != u64::MAX && data != 0 {
            effects.violation(data as u32, "only an erased double word is programmed");
            return self.fail(PROGERR, effects);
        }
        self.begin(What::Program { offset, data }, PROGRAM_TICKS, effects);
    }

    fn begin(&mut self, what: What, duration: Ticks, effects: &mut Effects) {
        if self.sr & BSY != 0 {
            return effects.violation(0, "flash is commanded only while FLASH_SR.BSY = 0");
        }
        let now = effects.now();
        self.sr |= BSY;
        self.work = Some(Work { what, begun: now, ends: now + duration });
    }

    fn fail(&mut self, flag: u32, effects: &mut Effects) {
        self.sr |= flag;
        self.update_line(effects);
    }

    fn apply(&mut self, what: What, share: f64) {
        match what {
            What::Program { offset, data } => self.cells.program(offset, data, share),
            What::Erase { offset } => self.cells.erase(offset, PAGE_BYTES, share),
        }
        self.changed = true;
    }

    /// Value of a register.
    pub fn read(&mut self, offset: u32, effects: &mut Effects) -> u32 {
        match offset {
            ACR => self.acr,
            KEYR => 0,
            SR => self.sr,
            CR => self.cr,
            ECCR => self.eccr,
            OPTR => OPTIONS,
            _ => {
                effects.unmodelled();
                0
            }
        }
    }

    /// Writes a register.
    pub fn write(&mut self, offset: u32, value: u32, effects: &mut Effects) {
        match offset {
            ACR => self.acr = value,
            KEYR => self.take_key(value, effects),
            SR => self.sr &= !(value & (ERRORS | EOP | PROGERR | WRPERR | PGAERR | SIZERR | PGSERR)),
            CR => self.write_control(value, effects),
            ECCR => self.eccr &= !(value & ECCD),
            _ => effects.unmodelled(),
        }
        self.update_line(effects);
    }

    fn take_key(&mut self, value: u32, effects: &mut Effects) {
        if KEYS.get(self.keys_given) != Some(&value) {
            return effects.violation(value, "FLASH_KEYR takes its two keys in order, once after each LOCK");
        }
        self.keys_given += 1;
        if self.keys_given == KEYS.len() {
            self.cr &= !LOCK;
        }
    }

    fn write_control(&mut self, value: u32, effects: &mut Effects) {
        if self.cr & LOCK != 0 {
            return effects.violation(value, "FLASH_CR is written only while unlocked");
        }
        if self.sr & BSY != 0 && (value ^ self.cr) & !(EOPIE | ERRIE) != 0 {
            effects.violation(value, "FLASH_CR is written only while FLASH_SR.BSY = 0");
        }
        if value & !(CR_MODELLED | 1 << 30) != 0 {
            effects.unmodelled();
        }
        self.cr = value & !STRT;
        if value & LOCK != 0 {
            self.keys_given = 0;
        }
        if value & STRT != 0 {
            if value & PER == 0 {
                effects.violation(value, "FLASH_CR.STRT starts only an erase that was chosen");
                return;
            }
            let bank = if value & BKER != 0 { BANK_BYTES } else { 0 };
            let page = (value >> 3 & 0x7F) as usize;
            self.begin(What::Erase { offset: bank + page * PAGE_BYTES }, ERASE_TICKS, effects);
        }
    }

    /// When the work under way ends.
    pub fn next_event(&self) -> Ticks {
        self.work.map_or(Ticks::MAX, |work| work.ends)
    }

    /// The work under way is done.
    pub fn advance(&mut self, effects: &mut Effects) {
        if let Some(work) = self.work.take() {
            self.apply(work.what, 1.0);
        }
        self.sr &= !BSY;
        // RM0440, FLASH_SR.EOP: set only while its interrupt is enabled.
        if self.cr & EOPIE != 0 {
            self.sr |= EOP;
        }
        self.update_line(effects);
    }

    fn update_line(&self, effects: &mut Effects) {
        let end = self.sr & EOP != 0 && self.cr & EOPIE != 0;
        let error = self.sr & ERRORS != 0 && self.cr & ERRIE != 0;
        effects.set_line(interrupt::FLASH, end || error);
    }
}

/// Where flash lies, as an offset; `None` elsewhere. It is also seen at address 0.
#[inline]
pub fn offset_of(address: u32) -> Option<usize> {
    let offset = if address < crate::memory::FLASH_BYTES as u32 { address } else { address.wrapping_sub(FLASH_BASE) };
    (offset < crate::memory::FLASH_BYTES as u32).then_some(offset as usize)
}

#[cfg(test)]
mod tests {
    use super::*;

    const AT: usize = BANK_BYTES + 16;

    fn unlocked() -> (Flash, Effects) {
        let (mut flash, mut effects) = (Flash::new(FlashArray::erased()), Effects::default());
        for key in KEYS {
            flash.write(KEYR, key, &mut effects);
        }
        (flash, effects)
    }

    fn finish(flash: &mut Flash, effects: &mut Effects) {
        effects.now = flash.next_event();
        flash.advance(effects);
    }

    #[test]
    fn a_double_word_is_programmed_and_erased() {
        let (mut flash, mut effects) = unlocked();
        flash.write(CR, PG | EOPIE, &mut effects);
        flash.program(AT, 4, 0x1111_2222, &mut effects);
        assert_eq!(flash.next_event(), Ticks::MAX, "half a double word is nothing");
        flash.program(AT + 4, 4, 0x3333_4444, &mut effects);
        assert_eq!((flash.read(SR, &mut effects), flash.next_event()), (BSY, PROGRAM_TICKS));
        finish(&mut flash, &mut effects);
        assert_eq!(flash.cells.double_word(AT), 0x3333_4444_1111_2222);
        assert_eq!((flash.read(SR, &mut effects), effects.lines()[0]), (EOP, 1 << interrupt::FLASH));
        flash.write(SR, EOP, &mut effects);
        assert_eq!(effects.lines()[0], 0);

        flash.write(CR, PER | BKER | STRT, &mut effects);
        assert_eq!(flash.next_event() - effects.now(), ERASE_TICKS);
        finish(&mut flash, &mut effects);
        assert_eq!(flash.cells.double_word(AT), u64::MAX);
        assert_eq!(effects.violation_count(), 0);
    }

    #[test]
    fn rules_of_programming() {
        let (mut flash, mut effects) = (Flash::new(FlashArray::erased()), Effects::default());
        flash.program(AT, 4, 0, &mut effects);
        flash.write(CR, PG, &mut effects);
        assert_eq!(effects.violation_count(), 2, "locked");
        let (mut flash, mut effects) = unlocked();
        flash.write(CR, PG, &mut effects);
        flash.program(AT + 4, 4, 0, &mut effects);
        assert_eq!(flash.read(SR, &mut effects) & ERRORS, PGAERR);
        flash.program(AT, 2, 0, &mut effects);
        assert_eq!(flash.read(SR, &mut effects) & ERRORS, PGAERR | SIZERR);
        flash.cells.load(AT, &[0x55; 8]);
        flash.program(AT, 4, 1, &mut effects);
        flash.program(AT + 4, 4, 1, &mut effects);
        assert_ne!(flash.read(SR, &mut effects) & PROGERR, 0);
    }

    #[test]
    fn a_cut_leaves_torn_memory_that_answers_with_an_nmi() {
        let (mut flash, mut effects) = unlocked();
        flash.write(CR, PG, &mut effects);
        flash.program(AT, 4, 0, &mut effects);
        flash.program(AT + 4, 4, 0, &mut effects);
        effects.now = PROGRAM_TICKS / 2;
        flash.reset(&mut effects);
        assert!(!effects.nmi);
        flash.note_read(AT, &mut effects);
        assert!(effects.nmi);
        assert_eq!(flash.read(ECCR, &mut effects), ECCD | ECC_BANK2 | 2);
        flash.write(ECCR, ECCD, &mut effects);
        assert_eq!(flash.read(ECCR, &mut effects) & ECCD, 0);
    }

    #[test]
    fn reading_waits_for_its_own_bank_only() {
        let (mut flash, mut effects) = unlocked();
        flash.write(CR, PER | BKER | STRT, &mut effects);
        flash.note_read(0x100, &mut effects);
        assert_eq!(effects.stalled_until, 0);
        flash.note_read(AT, &mut effects);
        assert_eq!(effects.stalled_until, ERASE_TICKS);
    }
}
