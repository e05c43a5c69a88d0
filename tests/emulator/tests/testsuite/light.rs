//! What ends the light, with the instants on the emulated pins, and what the board says afterwards.

use std::ops::RangeInclusive;

use crate::common::listener::Said;
use crate::common::talk::{FRAME_TICKS, MS, Talk};
use crate::common::{dma_ticks, silicon, us};
use slitpose_emulator::faults::Fault;
use slitpose_emulator::memory::{FLASH_BASE, RAM_BASE};
use slitpose_emulator::peripherals::Ticks;
use slitpose_emulator::rig::open_image;
use slitpose_protocol::{BootTarget, ClockSource, Command, HardwareFault, Rejection, ResetCause};

/// From an event of the supply or a fault to the gates: an exception's entry, some ten instructions from flash, and
/// whatever runs with interrupts off, 250 ticks at most.
const AT_ONCE_TICKS: Ticks = 500;

/// What a guard waits that sees that the schedule stands still: less than two slots of the default configuration.
const HALTED_TICKS: Ticks = 2 * 5_800;

/// The board is dark, says why it started, stays dark until a Start, and then lights.
fn assert_comes_back(bench: &mut Talk, cause: ResetCause) {
    let event = bench.rig.now();
    assert_eq!(bench.connect().reset_cause, cause);
    bench.run_ms(20.0);
    let lit = bench.record().drives.iter().filter(|drive| drive.at > event && drive.gates != 0).count();
    assert_eq!(lit, 0, "dark until Start");
    assert_eq!(bench.gates(), 0);
    bench.light();
    bench.accept(&Command::Stop);
    assert_eq!(bench.gates(), 0);
    bench.expect_neither_faults_nor_damage();
}

/// Lets time pass until the light is on, in phase `n`; gives the instant, and forgets what was before.
fn lit_in_phase(bench: &mut Talk, n: u64) -> Ticks {
    change_phase(bench, n);
    until_lit_and_awake(bench);
    bench.forget();
    bench.rig.now()
}

/// How long the gates went on behind `event`, of what is recorded since.
fn dark_after(bench: &mut Talk, event: Ticks) -> Ticks {
    bench.record().drives.iter().find(|drive| drive.gates == 0).expect("it goes dark").at - event
}

fn lit() -> Talk {
    let mut bench = Talk::quiet();
    bench.light();
    bench
}

/// Lets time pass to another phase of frames, polls and the bus for each `n`.
fn change_phase(bench: &mut Talk, n: u64) {
    bench.run_until(bench.rig.now() + 3 * MS + 7_919 * n);
}

#[test]
fn stop_is_done_before_its_reply() {
    let mut bench = lit();
    for n in 0..8 {
        change_phase(&mut bench, n);
        let asked = bench.rig.now();
        let replied = bench.accept(&Command::Stop);
        let dark = bench.dark_since();
        let (after, before) = (us(dark.saturating_sub(asked)), us(replied - dark));
        println!("Stop: dark {after:.0} µs after it was sent, {before:.0} µs before its reply is there");
        assert!(dark < replied);
        // A frame of the bus until the command is there, at the most; a poll under way; its carrying out.
        assert!(dark <= asked + 2 * MS);
        bench.run_ms(20.0);
        assert_eq!(bench.dark_since(), dark, "and stays dark");
        bench.light();
    }
    bench.expect_neither_faults_nor_damage();
}

/// Lets `event` happen while it is lit, checks for how long it stays so, and that the next start names `cause`.
fn ends(name: &str, event: impl Fn(&mut Talk), within: RangeInclusive<Ticks>, cause: ResetCause) -> Talk {
    let mut bench = lit();
    until_lit_and_awake(&mut bench);
    let begun = bench.rig.now();
    event(&mut bench);
    bench.run_ms(120.0);
    let lit = bench.dark_since().saturating_sub(begun);
    println!("{name}: dark after {lit} ticks, {:.2} µs", us(lit));
    assert!(within.contains(&lit), "{name}: {lit}");
    bench.rig.machine.set_supply_v(3.3);
    bench.run_ms(5.0);
    assert_comes_back(&mut bench, cause);
    bench
}

/// Sends the core to the function whose mangled name contains `name`.
fn jump_to(bench: &mut Talk, name: &str) {
    let image = open_image(None).expect("firmware/build makes it");
    let (_, function) = image.symbols().find(|(symbol, _)| symbol.contains(name)).expect("the image has it");
    jump(bench, function.address);
}

#[test]
fn a_panic_ends_the_light_at_once() {
    for function in ["panicking5panic", "panic_bounds_check", "panic_already_borrowed"] {
        ends(function, |bench| jump_to(bench, function), 0..=AT_ONCE_TICKS, ResetCause::Panic);
    }
}

#[test]
fn a_fault_ends_the_light_at_once() {
    // UDF, a permanently undefined instruction; then an address where nothing is.
    for address in [None, Some(0x6000_0000)] {
        let happens = |bench: &mut Talk| {
            let address = address.unwrap_or_else(|| find_instruction(bench, 0xDEFE));
            jump(bench, address);
        };
        let bench = ends("fault", happens, 0..=AT_ONCE_TICKS, ResetCause::Panic);
        assert!(bench.rig.machine.cpu.last_fault().is_some());
    }
}

#[test]
fn a_stack_that_overflows_ends_the_light_and_the_next_start_says_so() {
    // At the frame of an interrupt; at the first instruction of a function.
    for (function, most) in [(None, MS + AT_ONCE_TICKS), (Some("make_core"), AT_ONCE_TICKS)] {
        let happens = |bench: &mut Talk| {
            function.into_iter().for_each(|function| jump_to(bench, function));
            let cpu = &mut bench.rig.machine.cpu;
            let mut state = cpu.state();
            state.r[13] = RAM_BASE + 16;
            cpu.set_state(&state);
        };
        ends("stack", happens, 0..=most, ResetCause::StackOverflow);
    }
}

#[test]
fn the_watchdog_ends_the_light_of_a_program_that_hangs() {
    let happens = |bench: &mut Talk| {
        hang(bench);
        bench.forget();
        bench.run_ms(98.0);
        // Until then the schedule runs on by itself, on its frame.
        let edges: Vec<_> = bench.record().drives.iter().filter(|drive| drive.gates == 0b00_1001).collect();
        assert!(edges.len() > 390);
        assert!(edges.windows(2).all(|pair| (pair[1].at - pair[0].at).abs_diff(FRAME_TICKS) <= dma_ticks()));
    };
    // 100 ms from the last time it was fed, up to a poll of 1 ms before; its counter counts in steps of 32 periods of
    // 32 kHz at the most, and as many are left over. The last frame may be dark at its end.
    ends("hang", happens, 98 * MS - FRAME_TICKS..=102 * MS, ResetCause::Watchdog);
}

#[test]
fn a_debugger_that_halts_the_board_leaves_it_dark_and_lets_it_go_on() {
    let mut bench = lit();
    let mut longest = 0;
    for n in 0..20 {
        let event = lit_in_phase(&mut bench, n);
        // Less than the watchdog waits.
        bench.rig.machine.halt_until(event + 50 * MS);
        assert_eq!(bench.gates(), 0, "halted in the dark");
        longest = longest.max(dark_after(&mut bench, event));
        bench.run_ms(50.0);
        let scans = &bench.ear.scans;
        assert!(scans.len() >= 190, "it goes on: {}", scans.len());
        let words = *scans.last().expect("scans");
        let strange = scans.iter().filter(|scan| (scan.lit(), scan.dark()) != (words.lit(), words.dark()));
        assert_eq!(strange.count(), 0, "no frame with half of its light is handed out");
    }
    println!("halted: dark after {longest} ticks at most");
    assert!(longest < HALTED_TICKS, "{longest}");
    bench.expect_neither_faults_nor_damage();
    until_lit_and_awake(&mut bench);
    let event = bench.rig.now();
    bench.rig.machine.halt_until(event + 150 * MS);
    assert_eq!(bench.gates(), 0);
    bench.run_ms(5.0);
    assert_comes_back(&mut bench, ResetCause::Watchdog);
}

#[test]
fn a_crystal_that_stops_ends_the_light_at_once_and_the_next_start_does_without() {
    if silicon().has(Fault::HseDead) {
        return;
    }
    let mut bench =
        ends("crystal", |bench| bench.rig.machine.board.stop_crystal(), 0..=AT_ONCE_TICKS, ResetCause::Panic);
    assert_eq!(bench.next_status().clock, ClockSource::CrystalFailed);
    assert!(bench.ear.events().iter().any(|text| text.contains("crystal did not start")), "{:?}", bench.ear.events());
}

#[test]
fn a_falling_supply_ends_the_light_within_microseconds() {
    let mut bench = lit();
    let mut longest = 0;
    for n in 0..20 {
        let event = lit_in_phase(&mut bench, n);
        bench.rig.machine.set_supply_v(2.8);
        bench.run_ms(5.0);
        let lit = dark_after(&mut bench, event);
        longest = longest.max(lit);
        assert!(lit <= AT_ONCE_TICKS + if silicon().has(Fault::PvdSlow) { MS / 10 } else { 0 }, "{lit}");
        assert!(bench.record().drives.iter().all(|drive| drive.gates == 0 || drive.at < event + lit), "and stays dark");
        assert!(bench.ear.events().iter().any(|text| text.contains("supply")), "{:?}", bench.ear.said);
        bench.rig.machine.set_supply_v(3.3);
        bench.run_ms(5.0);
        assert_eq!(bench.gates(), 0, "dark until Start");
        bench.light();
    }
    println!("supply of 2.8 V: dark after {longest} ticks at most, {:.2} µs", us(longest));
    bench.expect_neither_faults_nor_damage();
}

#[test]
fn a_brown_out_lets_the_pins_float_at_once() {
    // Where the backup registers are kept the board knows that it had been running.
    for (volts, cause) in [(1.6, ResetCause::BrownOut), (0.0, ResetCause::PowerOn)] {
        ends("brown-out", |bench| bench.rig.machine.set_supply_v(volts), 0..=0, cause);
    }
    ends("reset pin", |bench| bench.rig.machine.pull_reset_pin(), 0..=0, ResetCause::Pin);
}

#[test]
fn a_reboot_is_done_in_the_dark_and_after_its_reply() {
    let mut bench = lit();
    let asked = bench.rig.now();
    let replied = bench.accept(&Command::Reboot(BootTarget::Firmware));
    let dark = bench.dark_since();
    bench.run_ms(150.0);
    let reset = bench.rig.machine.resets().last().expect("it starts").at;
    println!(
        "Reboot: dark after {:.0} µs, reply after {:.0} µs, reset after {:.0} µs",
        us(dark.saturating_sub(asked)),
        us(replied - asked),
        us(reset - asked)
    );
    assert!(dark < replied && replied < reset);
    assert!(dark <= asked + 2 * MS);
    assert!(reset <= asked + 102 * MS, "100 ms for the reply to be taken");
    assert_eq!(bench.dark_since(), dark);
    assert_comes_back(&mut bench, ResetCause::Software);
}

#[test]
fn a_low_supply_refuses_the_start() {
    let mut bench = Talk::quiet();
    bench.rig.machine.set_supply_v(2.8);
    bench.run_ms(5.0);
    bench.forget();
    for _ in 0..3 {
        let outcome = bench.ask(Command::Start);
        assert_eq!(outcome, Err(Rejection::Hardware(HardwareFault::Supply)));
        bench.run_ms(5.0);
    }
    assert!(bench.record().drives.iter().all(|drive| drive.gates == 0), "nothing lights");
    let status = bench.next_status();
    assert!(!status.acquiring && (status.supply_v - 2.8).abs() < 0.02, "{status:?}");
    assert!(status.clock == ClockSource::Crystal || silicon().has(Fault::HseDead), "{status:?}");
    // Above the detector's threshold and hysteresis, 3.00 V.
    bench.rig.machine.set_supply_v(3.1);
    bench.run_ms(1.0);
    bench.light();
    bench.forget();
    bench.run_ms(100.0);
    assert!(bench.ear.scans.len() >= 395, "{}", bench.ear.scans.len());
    let heard = bench.ear.said.iter().filter(|(_, said)| matches!(said, Said::Event(..))).count();
    assert_eq!(heard, 0);
    bench.expect_neither_faults_nor_damage();
}

/// Lets time pass until the core is awake in thread mode and a gate is on, so that the event that comes next finds the
/// light on.
fn until_lit_and_awake(bench: &mut Talk) {
    let rig = &mut bench.rig;
    let end = rig.now() + 100 * MS;
    while rig.now() < end {
        let before = rig.machine.cpu.instructions();
        rig.run_until(rig.now() + 1);
        let cpu = &rig.machine.cpu;
        if cpu.instructions() != before && cpu.state().xpsr & 0x1ff == 0 && rig.machine.board.gates() != 0 {
            return;
        }
    }
    panic!("never lit and awake");
}

/// Lets the main loop end in a loop of its own, `B .`; interrupts go on.
fn hang(bench: &mut Talk) {
    let address = find_instruction(bench, 0xE7FE);
    jump(bench, address);
}

fn jump(bench: &mut Talk, address: u32) {
    let cpu = &mut bench.rig.machine.cpu;
    let mut state = cpu.state();
    state.r[15] = address;
    cpu.set_state(&state);
}

/// Address of an instruction `half` in the image. It is jumped to, so that where it stands does not matter.
fn find_instruction(bench: &mut Talk, half: u16) -> u32 {
    let code = bench.rig.machine.board.flash.array.bytes();
    let offset = code.chunks_exact(2).position(|bytes| bytes == half.to_le_bytes());
    FLASH_BASE + 2 * offset.expect("the image has one") as u32
}
