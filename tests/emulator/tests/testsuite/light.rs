//! What ends the light, with the instants on the emulated pins, and what the board says afterwards.

use crate::common::light::{Bench, MS, Said};
use crate::common::trial::endings::{
    AT_ONCE_TICKS, Ending, HALTED_TICKS, find_function, find_instruction, hang, jump, until_lit_and_awake,
};
use crate::common::trial::words::FRAME_TICKS;
use crate::common::{dma_ticks, silicon};
use slitpose_emulator::faults::Fault;
use slitpose_emulator::memory::RAM_BASE;
use slitpose_emulator::peripherals::{TICKS_PER_SECOND, Ticks};
use slitpose_protocol::{BootTarget, ClockSource, Command, HardwareFault, Rejection, ResetCause};

/// How long the gates were on behind `event`; 0 if they were off already.
fn lit_for(bench: &mut Bench, event: Ticks) -> Ticks {
    bench.dark_since().saturating_sub(event)
}

/// The board is dark, says why it started, stays dark until a Start, and then lights.
fn assert_comes_back(bench: &mut Bench, cause: ResetCause) {
    let event = bench.rig.now();
    assert_eq!(bench.connect(), cause);
    bench.run_ms(20);
    let lit = bench.record().drives.iter().filter(|drive| drive.at > event && drive.gates != 0).count();
    assert_eq!(lit, 0, "dark until Start");
    assert_eq!(bench.gates(), 0);
    bench.light();
    bench.accept(&Command::Stop);
    assert_eq!(bench.gates(), 0);
    bench.assert_no_faults();
}

/// Lets time pass until the light is on, in phase `n`; gives the instant, and forgets what was before.
fn lit_in_phase(bench: &mut Bench, n: u64) -> Ticks {
    change_phase(bench, n);
    until_lit_and_awake(&mut bench.rig);
    bench.forget();
    bench.rig.now()
}

/// How long the gates went on behind `event`, of what is recorded since.
fn dark_after(bench: &mut Bench, event: Ticks) -> Ticks {
    bench.record().drives.iter().find(|drive| drive.gates == 0).expect("it goes dark").at - event
}

fn lit() -> Bench {
    let mut bench = Bench::quiet();
    bench.light();
    bench
}

fn us(ticks: Ticks) -> f64 {
    ticks as f64 * 1e6 / TICKS_PER_SECOND as f64
}

/// Lets time pass to another phase of frames, polls and the bus for each `n`.
fn change_phase(bench: &mut Bench, n: u64) {
    let next = bench.rig.now() + 3 * MS + 7_919 * n;
    bench.run_until(next);
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
        bench.run_ms(20);
        assert_eq!(bench.dark_since(), dark, "and stays dark");
        bench.light();
    }
    bench.assert_no_faults();
}

#[test]
fn a_closed_port_ends_the_light() {
    let mut bench = lit();
    for n in 0..3 {
        change_phase(&mut bench, n);
        let closed = bench.rig.now();
        bench.rig.set_open(false);
        bench.run_ms(499);
        assert!(bench.record().drives.iter().any(|drive| drive.gates != 0 && drive.at > closed + 498 * MS));
        bench.run_ms(5);
        let lit = bench.dark_since() - closed;
        println!("port closed: dark after {:.3} ms", us(lit) / 1e3);
        // A request of the bus until the board knows, 500 ms, and a poll of 1 ms.
        assert!(lit <= 502 * MS + MS / 2, "{lit}");
        bench.open();
        bench.run_ms(20);
        assert!(bench.events().iter().any(|text| text.contains("link had been closed")), "{:?}", bench.ear.said);
        assert_eq!(bench.gates(), 0, "dark until Start");
        bench.light();
    }
    // A port that is opened again in time changes nothing.
    bench.rig.set_open(false);
    bench.run_ms(400);
    bench.open();
    bench.forget();
    bench.run_ms(300);
    assert!(bench.record().drives.len() > 4 * 1_100);
    bench.assert_no_faults();
}

#[test]
fn a_panic_ends_the_light_at_once() {
    for function in ["panicking5panic", "panic_bounds_check", "panic_already_borrowed"] {
        let mut bench = lit();
        until_lit_and_awake(&mut bench.rig);
        let event = bench.rig.now();
        let address = find_function(&bench.image, function);
        jump(&mut bench.rig, address);
        bench.run_ms(1);
        let lit = bench.dark_since() - event;
        println!("{function}: dark after {lit} ticks, {:.2} µs", us(lit));
        assert!(lit <= AT_ONCE_TICKS, "{lit}");
        assert_comes_back(&mut bench, ResetCause::Panic);
    }
}

#[test]
fn a_fault_ends_the_light_at_once() {
    // UDF, a permanently undefined instruction; then an address where nothing is.
    for address in [None, Some(0x6000_0000)] {
        let mut bench = lit();
        until_lit_and_awake(&mut bench.rig);
        let event = bench.rig.now();
        let address = address.unwrap_or_else(|| find_instruction(&mut bench.rig, 0xDEFE));
        jump(&mut bench.rig, address);
        bench.run_ms(1);
        let lit = bench.dark_since() - event;
        println!("jump to {address:#010x}: dark after {lit} ticks, {:.2} µs", us(lit));
        assert!(lit <= AT_ONCE_TICKS, "{lit}");
        assert!(bench.rig.machine().cpu.last_fault().is_some());
        assert_comes_back(&mut bench, ResetCause::Panic);
    }
}

#[test]
fn a_stack_that_overflows_ends_the_light_and_the_next_start_says_so() {
    // At the frame of an interrupt; at the first instruction of a function.
    for function in [None, Some("make_core")] {
        let mut bench = lit();
        until_lit_and_awake(&mut bench.rig);
        let address = function.map(|name| find_function(&bench.image, name));
        let cpu = &mut bench.rig.machine().cpu;
        let mut state = cpu.state();
        state.r[13] = RAM_BASE + 16;
        state.r[15] = address.unwrap_or(state.r[15]);
        cpu.set_state(&state);
        let event = bench.rig.now();
        bench.run_ms(2);
        let lit = bench.dark_since() - event;
        println!("{function:?}: dark after {lit} ticks, {:.2} µs", us(lit));
        assert!(lit <= if function.is_some() { AT_ONCE_TICKS } else { MS + AT_ONCE_TICKS }, "{lit}");
        assert_comes_back(&mut bench, ResetCause::StackOverflow);
    }
}

#[test]
fn the_watchdog_ends_the_light_of_a_program_that_hangs() {
    let mut bench = lit();
    until_lit_and_awake(&mut bench.rig);
    let event = bench.rig.now();
    hang(&mut bench.rig);
    bench.forget();
    bench.run_ms(120);
    let resets = bench.rig.machine().resets().len();
    let reset = bench.rig.machine().resets()[resets - 1].at;
    let dark = bench.dark_since();
    println!("hang: dark and reset after {:.2} ms", us(dark - event) / 1e3);
    assert!(dark <= reset);
    // 100 ms from the last time it was fed, up to a poll of 1 ms before; its counter counts in
    // steps of 32 periods of 32 kHz at the most, and as many are left over.
    assert!((98 * MS..=102 * MS).contains(&(reset - event)), "{}", reset - event);
    // Until then the schedule runs on by itself, on its frame.
    let edges: Vec<_> = bench.record().drives.iter().filter(|drive| drive.gates == 0b00_1001).collect();
    assert!(edges.len() > 390);
    assert!(edges.windows(2).all(|pair| (pair[1].at - pair[0].at).abs_diff(FRAME_TICKS) <= dma_ticks()));
    assert_comes_back(&mut bench, ResetCause::Watchdog);
}

#[test]
fn a_debugger_that_halts_the_board_leaves_it_dark_and_lets_it_go_on() {
    let mut bench = lit();
    let mut longest = 0;
    for n in 0..20 {
        let event = lit_in_phase(&mut bench, n);
        // Less than the watchdog waits.
        bench.rig.machine().halt_until(event + 50 * MS);
        assert_eq!(bench.gates(), 0, "halted in the dark");
        longest = longest.max(dark_after(&mut bench, event));
        bench.run_ms(50);
        let scans = bench.scans();
        assert!(scans.len() >= 190, "it goes on: {}", scans.len());
        let words = *scans.last().expect("scans");
        let strange = scans.iter().filter(|scan| (scan.lit(), scan.dark()) != (words.lit(), words.dark()));
        assert_eq!(strange.count(), 0, "no frame with half of its light is handed out");
    }
    println!("halted: dark after {longest} ticks at most");
    assert!(longest < HALTED_TICKS, "{longest}");
    bench.assert_no_faults();
    until_lit_and_awake(&mut bench.rig);
    let event = bench.rig.now();
    bench.rig.machine().halt_until(event + 150 * MS);
    assert_eq!(bench.gates(), 0);
    bench.run_ms(5);
    assert_comes_back(&mut bench, ResetCause::Watchdog);
}

#[test]
fn a_crystal_that_stops_ends_the_light_at_once_and_the_next_start_does_without() {
    let mut bench = lit();
    if silicon().has(Fault::HseDead) {
        return;
    }
    assert_eq!(bench.ask_status().clock, ClockSource::Crystal);
    until_lit_and_awake(&mut bench.rig);
    bench.forget();
    let event = bench.rig.now();
    bench.rig.machine().board.stop_crystal();
    bench.run_ms(50);
    let lit = dark_after(&mut bench, event);
    assert!(lit <= AT_ONCE_TICKS, "{lit}");
    assert_comes_back(&mut bench, ResetCause::Panic);
    assert_eq!(bench.ask_status().clock, ClockSource::CrystalFailed);
    assert!(bench.events().iter().any(|text| text.contains("crystal did not start")), "{:?}", bench.events());
}

#[test]
fn a_falling_supply_ends_the_light_within_microseconds() {
    let mut bench = lit();
    let mut longest = 0;
    for n in 0..20 {
        let event = lit_in_phase(&mut bench, n);
        bench.rig.machine().set_supply_v(2.8);
        bench.run_ms(5);
        let lit = dark_after(&mut bench, event);
        longest = longest.max(lit);
        assert!(lit <= Ending::LowSupply.most_ticks(silicon()), "{lit}");
        assert!(bench.record().drives.iter().all(|drive| drive.gates == 0 || drive.at < event + lit), "and stays dark");
        assert!(bench.events().iter().any(|text| text.contains("supply")), "{:?}", bench.ear.said);
        bench.rig.machine().set_supply_v(3.3);
        bench.run_ms(5);
        assert_eq!(bench.gates(), 0, "dark until Start");
        bench.light();
    }
    println!("supply of 2.8 V: dark after {longest} ticks at most, {:.2} µs", us(longest));
    bench.assert_no_faults();
}

#[test]
fn a_brown_out_lets_the_pins_float_at_once() {
    // Where the backup registers are kept the board knows that it had been running.
    for (volts, cause) in [(1.6, ResetCause::BrownOut), (0.0, ResetCause::PowerOn)] {
        let mut bench = lit();
        until_lit_and_awake(&mut bench.rig);
        let event = bench.rig.now();
        bench.rig.machine().set_supply_v(volts);
        let lit = lit_for(&mut bench, event);
        println!("supply of {volts} V: dark after {lit} ticks");
        assert_eq!(lit, 0);
        bench.run_ms(50);
        assert_eq!(bench.gates(), 0);
        bench.rig.machine().set_supply_v(3.3);
        bench.run_ms(5);
        assert_comes_back(&mut bench, cause);
    }
}

#[test]
fn the_reset_pin_ends_the_light_at_once() {
    let mut bench = lit();
    until_lit_and_awake(&mut bench.rig);
    let event = bench.rig.now();
    bench.rig.machine().pull_reset_pin();
    let lit = lit_for(&mut bench, event);
    assert_eq!(lit, 0);
    assert_comes_back(&mut bench, ResetCause::Pin);
}

#[test]
fn a_reboot_is_done_in_the_dark_and_after_its_reply() {
    let mut bench = lit();
    let asked = bench.rig.now();
    let replied = bench.accept(&Command::Reboot(BootTarget::Firmware));
    let dark = bench.dark_since();
    bench.run_ms(150);
    let reset = bench.rig.machine().resets().last().expect("it starts").at;
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
    let mut bench = Bench::quiet();
    bench.rig.machine().set_supply_v(2.8);
    bench.run_ms(5);
    bench.forget();
    for _ in 0..3 {
        let (_, outcome) = bench.ask(&Command::Start);
        assert_eq!(outcome, Err(Rejection::Hardware(HardwareFault::Supply)));
        bench.run_ms(5);
    }
    assert!(bench.record().drives.iter().all(|drive| drive.gates == 0), "nothing lights");
    let status = bench.ask_status();
    assert!(!status.acquiring && (status.supply_v - 2.8).abs() < 0.02, "{status:?}");
    // Above the detector's threshold and hysteresis, 3.00 V.
    bench.rig.machine().set_supply_v(3.1);
    bench.run_ms(1);
    bench.light();
    bench.forget();
    bench.run_ms(100);
    assert!(bench.scans().len() >= 395, "{}", bench.scans().len());
    let heard = bench.ear.said.iter().filter(|(_, said)| matches!(said, Said::Event(..))).count();
    assert_eq!(heard, 0);
    bench.assert_no_faults();
}
