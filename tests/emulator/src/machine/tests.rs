//! Power, resets and time, with programs of a few instructions.

use super::*;
use crate::board::Board;
use crate::cpu::{Bus, Size};
use crate::memory::{BANK_BYTES, PAGE_BYTES};
use crate::peripherals::TICKS_PER_SECOND;

/// `b .`
const SPIN: &[u16] = &[0xE7FE];
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
