use super::*;
use crate::facts::{self, assert_facts};

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
fn refuses_what_is_locked_narrow_askew_or_not_erased() {
    let (mut flash, mut effects) = (Flash::new(FlashArray::erased()), Effects::default());
    flash.write(CR, PG, &mut effects);
    flash.store(OFFSET, 4, 0, &mut effects);
    assert_eq!((flash.read(SR, &mut effects), effects.violation_count()), (PGSERR, 2));
    let (mut flash, mut effects) = unlocked();
    flash.write(CR, PG, &mut effects);
    flash.store(OFFSET, 2, 0, &mut effects);
    assert_eq!(flash.read(SR, &mut effects), SIZERR);
    flash.write(SR, SIZERR, &mut effects);
    flash.store(OFFSET + 4, 4, 0, &mut effects);
    assert_eq!(flash.read(SR, &mut effects), PGAERR);
    flash.write(SR, PGAERR, &mut effects);
    program(&mut flash, &mut effects, [1, 2]);
    finish(&mut flash, &mut effects);
    flash.write(SR, EOP, &mut effects);
    program(&mut flash, &mut effects, [0, 2]);
    assert_eq!(flash.read(SR, &mut effects), PROGERR);
    flash.write(SR, PROGERR, &mut effects);
    program(&mut flash, &mut effects, [0, 0]);
    assert_eq!(flash.read(SR, &mut effects), BSY, "zeros may be programmed over anything");
}

#[test]
fn a_busy_bank_stalls_and_then_gives_the_new_content() {
    let (mut flash, mut effects) = unlocked();
    program(&mut flash, &mut effects, [5, 6]);
    assert_eq!(flash.load(0, 4, &mut effects), Some(u32::MAX));
    assert_eq!(effects.stalled_until, 0);
    assert_eq!(flash.load(OFFSET, 4, &mut effects), Some(5));
    assert_eq!(effects.stalled_until, PROGRAM_TICKS);
}

#[test]
fn erasing_the_running_bank_stalls_the_core() {
    let (mut flash, mut effects) = unlocked();
    effects.pc = FLASH_BASE + 0x100;
    flash.write(CR, PER | 127 << 3 | STRT, &mut effects);
    assert_eq!(effects.stalled_until, ERASE_TICKS);
}

#[test]
fn a_torn_double_word_raises_the_nmi_once_per_flag() {
    let (mut flash, mut effects) = unlocked();
    program(&mut flash, &mut effects, [0, 1]);
    flash.reset(&Effects::starting_at(PROGRAM_TICKS / 2));
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

#[test]
fn a_wrong_key_jams_until_reset() {
    let (mut flash, mut effects) = (Flash::new(FlashArray::erased()), Effects::default());
    flash.write(KEYR, 1, &mut effects);
    flash.write(KEYR, KEY1, &mut effects);
    flash.write(KEYR, KEY2, &mut effects);
    assert_ne!(flash.read(CR, &mut effects) & LOCK, 0);
    flash.reset(&Effects::starting_at(0));
    flash.write(KEYR, KEY1, &mut effects);
    flash.write(KEYR, KEY2, &mut effects);
    assert_eq!(flash.read(CR, &mut effects) & LOCK, 0);
}

#[test]
fn registers_and_times_are_those_of_st() {
    assert_facts!("FLASH_TypeDef."; ACR, PDKEYR, KEYR, OPTKEYR, SR, CR, ECCR, OPTR);
    assert_facts!("FLASH_"; KEY1, KEY2, LATENCY = "ACR_LATENCY", ECCD = "ECCR_ECCD", BK_ECC = "ECCR_BK_ECC");
    assert_facts!("FLASH_SR_"; EOP, PROGERR, PGAERR, SIZERR, PGSERR, BSY);
    assert_facts!("FLASH_CR_"; PG, PER, MER1, BKER, MER2, STRT, EOPIE, ERRIE, OPTLOCK, LOCK);
    assert_eq!(CR_MODELLED & 0x3FF, PG | PER | MER1 | facts::bits("FLASH_CR_PNB"));
    assert_eq!(OPTR_DELIVERED & facts::bits("FLASH_OPTR_DBANK"), facts::bits("FLASH_OPTR_DBANK"));
    let ticks = |name, unit_s: f64| (facts::number(name) * unit_s * TICKS_PER_SECOND as f64).round() as Ticks;
    assert_eq!((PROGRAM_TICKS, ERASE_TICKS), (ticks("t_prog", 1e-6), ticks("t_ERASE", 1e-3)));
}
