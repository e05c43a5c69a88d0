//! Power, resets and time, with programs of a few instructions.

use super::*;
use crate::board::Board;
use crate::cpu::{Bus, Size};
use crate::memory::{BANK_BYTES, PAGE_BYTES, RAM_BASE};
use crate::peripherals::TICKS_PER_SECOND;

/// `b .`
const SPIN: &[u16] = &[0xE7FE];
/// `wfi`, `b` back to it.
const SLEEP: &[u16] = &[0xBF30, 0xE7FD];
/// Jumps to 0x1FFF_0100: `ldr r0, [pc]`, `bx r0`, literal.
const BOOT: &[u16] = &[0x4800, 0x4700, 0x0101, 0x1FFF];

/// Writes `value` to `address`, then spins.
fn store_word(address: u32, value: u32) -> Vec<u16> {
    let halves = |word: u32| [word as u16, (word >> 16) as u16];
    let code = [0x4801, 0x4902, 0x6001, 0xE7FE];
    code.into_iter().chain(halves(address)).chain(halves(value)).collect()
}

struct Nothing;

impl World for Nothing {
    fn drive(&mut self, _: Ticks, _: u8, _: [u16; 2]) {}

    fn sample(&mut self, _: Ticks, _: u8, _: u8) -> u16 {
        0
    }
}

/// A machine with a vector table and `code` behind it.
fn machine(code: &[u16]) -> Machine<Nothing> {
    let mut flash = FlashArray::erased();
    flash.load(0, &0x2000_1000_u32.to_le_bytes());
    flash.load(4, &0x0800_0009_u32.to_le_bytes());
    let bytes: Vec<u8> = code.iter().flat_map(|half| half.to_le_bytes()).collect();
    flash.load(8, &bytes);
    flash.load(BANK_BYTES, &[0; PAGE_BYTES]);
    Machine::new(flash, Nothing)
}

fn put(board: &mut Board<Nothing>, address: u32, value: u32) {
    board.write(address, Size::Word, value).unwrap();
}

fn get(board: &mut Board<Nothing>, address: u32) -> u32 {
    board.read(address, Size::Word).unwrap()
}

fn causes(machine: &Machine<Nothing>) -> Vec<ResetCause> {
    machine.resets().iter().map(|reset| reset.cause).collect()
}

/// Starts the watchdog: 0.1 s.
fn start_watchdog(machine: &mut Machine<Nothing>) {
    for (offset, value) in [(0, 0x5555), (4, 1), (8, 399), (0, 0xCCCC)] {
        put(&mut machine.board, 0x4000_3000 + offset, value);
    }
}

/// Starts the erasure of the first page of bank 2.
fn start_erasure(machine: &mut Machine<Nothing>) {
    for (offset, value) in [(8, 0x4567_0123), (8, 0xCDEF_89AB), (0x14, 1 << 1 | 1 << 11 | 1 << 16)] {
        put(&mut machine.board, 0x4002_2000 + offset, value);
    }
}

fn enable_backup(machine: &mut Machine<Nothing>) {
    put(&mut machine.board, 0x4002_1058, 1 << 10 | 1 << 28);
    put(&mut machine.board, 0x4000_7000, 0x300);
}

#[test]
fn load_is_the_share_of_time_awake() {
    let mut spinning = machine(SPIN);
    assert_eq!(spinning.run_until(10_000), Stop::Reached);
    assert!(spinning.awake_ticks() >= 10_000);
    let mut sleeping = machine(SLEEP);
    assert_eq!(sleeping.run_until(10_000), Stop::Reached);
    assert_eq!(sleeping.now(), 10_000);
    assert!(sleeping.awake_ticks() < 100);
}

#[test]
fn an_interrupt_line_wakes_the_core_at_its_tick() {
    // `cpsid i`, enables TIM2 in the NVIC, `wfi`, `b .`: it wakes without taking the interrupt.
    let mut machine = machine(&[0xB672, 0x4802, 0x4902, 0x6001, 0xBF30, 0xE7FE, 0xE100, 0xE000, 0x0000, 0x1000]);
    put(&mut machine.board, 0x4002_1058, 1);
    for (offset, value) in [(0x2C, 4_999), (0x0C, 1), (0x00, 1)] {
        put(&mut machine.board, 0x4000_0000 + offset, value);
    }
    machine.run_until(4_999);
    assert_eq!(machine.now(), 4_999);
    let awake = machine.awake_ticks();
    machine.run_until(5_100);
    assert_eq!(machine.awake_ticks() - awake, machine.now() - 5_000);
}

#[test]
fn the_watchdog_resets_and_ram_stays() {
    let mut machine = machine(SPIN);
    start_watchdog(&mut machine);
    put(&mut machine.board, RAM_BASE, 0x1234_5678);
    machine.run_until(TICKS_PER_SECOND / 10 + 100);
    assert_eq!(causes(&machine), [ResetCause::PowerOn, ResetCause::Watchdog]);
    assert!(machine.resets()[1].at - TICKS_PER_SECOND / 10 < 4);
    assert_eq!(machine.board.ram_word(RAM_BASE), Some(0x1234_5678));
    assert_eq!(get(&mut machine.board, 0x4002_1094) >> 29, 1);
    assert_eq!(machine.run_until(TICKS_PER_SECOND / 2), Stop::Reached);
    assert_eq!(machine.resets().len(), 2, "the reset has stopped the watchdog");
}

#[test]
fn a_locked_up_core_waits_for_the_watchdog() {
    let undefined = &[0xDE00];
    let mut alone = machine(undefined);
    assert!(matches!(alone.run_until(1_000), Stop::Lockup(_)));
    let mut guarded = machine(undefined);
    start_watchdog(&mut guarded);
    guarded.run_until(TICKS_PER_SECOND / 10 - 1);
    assert_eq!(causes(&guarded), [ResetCause::PowerOn]);
    guarded.run_until(TICKS_PER_SECOND / 10 + 1);
    assert_eq!(causes(&guarded), [ResetCause::PowerOn, ResetCause::Watchdog]);
}

#[test]
fn software_and_pin_resets_leave_their_flags() {
    let mut machine = machine(&store_word(0xE000_ED0C, 0x05FA_0004));
    machine.run_until(20);
    assert_eq!(causes(&machine)[..2], [ResetCause::PowerOn, ResetCause::Software]);
    assert_ne!(get(&mut machine.board, 0x4002_1094) & 1 << 28, 0);
    put(&mut machine.board, 0x4002_1094, 1 << 23);
    machine.pull_reset_pin();
    assert_eq!(get(&mut machine.board, 0x4002_1094), 1 << 26);
}

#[test]
fn backup_registers_outlive_resets_but_not_the_supply() {
    let mut machine = machine(SPIN);
    enable_backup(&mut machine);
    put(&mut machine.board, 0x4000_2500, 42);
    machine.pull_reset_pin();
    enable_backup(&mut machine);
    assert_eq!(get(&mut machine.board, 0x4000_2500), 42);
    machine.set_supply_v(1.6);
    machine.set_supply_v(3.3);
    enable_backup(&mut machine);
    assert_eq!(get(&mut machine.board, 0x4000_2500), 42, "a brown-out is not the end of the backup supply");
    machine.cut_power();
    machine.power_on();
    enable_backup(&mut machine);
    assert_eq!(get(&mut machine.board, 0x4000_2500), 0);
}

#[test]
fn a_brown_out_holds_the_device_and_costs_its_ram() {
    let mut machine = machine(SPIN);
    put(&mut machine.board, RAM_BASE, 0x1234_5678);
    machine.run_until(1_000);
    machine.set_supply_v(1.63);
    assert_eq!(machine.run_until(2_000), Stop::PoweredOff);
    assert_eq!(machine.now(), 2_000);
    machine.set_supply_v(3.3);
    assert_eq!(machine.run_until(3_000), Stop::Reached);
    assert_eq!(causes(&machine), [ResetCause::PowerOn, ResetCause::BrownOut]);
    assert_ne!(machine.board.ram_word(RAM_BASE), Some(0x1234_5678));
}

#[test]
fn a_supply_restored_while_off_starts_once_at_power_on() {
    let mut machine = machine(SPIN);
    machine.set_supply_v(1.0);
    machine.cut_power();
    machine.set_supply_v(3.3);
    // The computer at the USB cable keeps looking every millisecond; time never goes back.
    assert_eq!(machine.run_until(TICKS_PER_SECOND), Stop::PoweredOff);
    machine.power_on();
    assert_eq!(machine.run_until(TICKS_PER_SECOND + 10), Stop::Reached);
    assert!(machine.now() >= TICKS_PER_SECOND + 10);
    assert_eq!(machine.resets()[1..], [Reset { at: TICKS_PER_SECOND, cause: ResetCause::PowerOn }]);
}

#[test]
fn power_cut_in_an_erasure_leaves_a_torn_page() {
    let mut machine = machine(SPIN);
    start_erasure(&mut machine);
    machine.run_until(TICKS_PER_SECOND / 100);
    machine.cut_power();
    assert_eq!(machine.run_until(TICKS_PER_SECOND), Stop::PoweredOff);
    machine.power_on();
    let flash = machine.board.flash_array();
    assert!(flash.is_torn(BANK_BYTES) && flash.is_torn(BANK_BYTES + PAGE_BYTES - 8) && !flash.is_torn(0));
    start_erasure(&mut machine);
    machine.run_until(2 * TICKS_PER_SECOND);
    assert!(!machine.board.flash_array().has_torn());
    assert_eq!(machine.board.flash_array().bytes()[BANK_BYTES], 0xFF);
}

#[test]
fn reading_a_busy_bank_keeps_the_core_waiting_awake() {
    // `ldr r0, [pc]`, `ldr r1, [r0]`, literal at 12, then the code goes on behind it.
    let mut machine = machine(&[0x4801, 0x6801, 0xE7FE, 0xBF00, 0x0000, 0x0804]);
    start_erasure(&mut machine);
    machine.run_until(1_000);
    assert_eq!((machine.now(), machine.cpu.pc()), (1_000, 0x0800_000C));
    let done = 22 * TICKS_PER_SECOND / 1_000;
    machine.run_until(done + 100);
    assert!(machine.awake_ticks() >= done);
    assert_eq!(machine.cpu.state().r[1], u32::MAX, "the read has seen the erased page");
}

#[test]
fn a_jump_to_the_boot_loader_is_reported() {
    assert_eq!(machine(BOOT).run_until(1_000), Stop::BootLoader);
}

#[test]
fn the_device_clock_has_an_origin_and_can_be_preset() {
    let mut machine = machine(SPIN);
    assert_eq!(machine.device_clock_origin(), None);
    machine.run_until(500);
    put(&mut machine.board, 0x4002_1058, 1 << 3);
    put(&mut machine.board, 0x4000_0C00, 1);
    let started = machine.now();
    assert_eq!(machine.device_clock_origin(), Some(started));
    machine.preset_device_clock(u32::MAX);
    machine.run_until(started + 100);
    assert_eq!(u64::from(get(&mut machine.board, 0x4000_0C24)), machine.now() - started - 1);
}
