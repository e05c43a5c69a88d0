//! What the board keeps without supply, and what a cut of the supply costs.

use std::num::NonZeroU32;

use crate::common::listener::Introduction;
use crate::common::talk::{MS, Talk};
use slitpose_emulator::memory::FLASH_BASE;
use slitpose_emulator::peripherals::Ticks;

use slitpose_firmware::pcb::default_configuration;
use slitpose_firmware::pcb::default_scaling;
use slitpose_firmware::pose::{HEAD_BYTES, Head};
use slitpose_head::board_head;
use slitpose_head::scene_file::WIDE;
use slitpose_protocol::{
    Command, Configuration, Hashes, HeadPart, Level, Rejection, ResetCause, SettingsSource, Stream,
};

/// From power-on to a serial port that listens, with much in hand: the clock starts within 1 ms.
const BOOT_MS: f64 = 10.0;

/// Settings that can be told from all others: `n` stands in the hashes, the frame and the levels.
fn settings(n: u64) -> (Configuration, Hashes) {
    let mut configuration = default_configuration();
    configuration.schedule.frame_ticks = 42_500 + n as u32;
    configuration.levels.fill(Level(0x4000 + n as u16));
    (configuration, Hashes { scene: Some(n), calibration: Some(!n) })
}

/// The settings the board says it has, if they are whole; 0: the defaults.
fn number(hello: &Introduction) -> u64 {
    let n = u64::from(hello.schedule.frame_ticks - 42_500);
    let hashes = if n == 0 { Hashes::default() } else { settings(n).1 };
    assert_eq!(hello.hashes, hashes, "hashes and configuration of one record");
    n
}

/// Starts to talk by the serial port, behind a start of the board.
fn greet(talk: &mut Talk) -> Introduction {
    talk.run_ms(BOOT_MS);
    assert_eq!(talk.ask(Command::Hello), Ok(()));
    talk.ear.hello().expect("asked for").clone()
}

fn prepare(talk: &mut Talk, n: u64) -> Command {
    let (configuration, hashes) = settings(n);
    assert_eq!(talk.ask(Command::Configure(configuration)), Ok(()));
    Command::Store(hashes)
}

#[test]
fn what_is_stored_outlives_the_supply_and_is_in_force_at_start() {
    let mut talk = Talk::at_usb();
    let store = prepare(&mut talk, 7);
    let full_scale_pa = NonZeroU32::new(6_600_000).expect("not zero");
    let is = |hello: &Introduction, full_scale_a: f64| (hello.scaling.full_scale_a() / full_scale_a - 1.0).abs() < 1e-6;
    assert_eq!(talk.ask(Command::FullScale { full_scale_pa }), Ok(()));
    assert!(talk.ear.hello().is_some_and(|hello| is(hello, 6.6e-6)), "in force at once");
    assert_eq!(talk.ask(store), Ok(()));
    assert_eq!(talk.ear.hello().map(number), Some(7), "said at once");
    talk.cut_supply();
    let hello = talk.connect();
    assert_eq!((number(&hello), hello.configuration, hello.reset_cause), (7, 0, ResetCause::PowerOn));
    assert!(is(&hello, 6.6e-6), "{hello:?}");
    assert_eq!(talk.ask(Command::Start), Ok(()));
    assert!(talk.is_acquiring());
    assert!(talk.ear.scans.iter().all(|scan| scan.levels() == &settings(7).0.levels[..]));
    talk.settle_account(0);
    // The reset pin, and a start of its own.
    talk.rig.machine.pull_reset_pin();
    talk.forget_board();
    let hello = talk.connect();
    assert_eq!((number(&hello), hello.reset_cause), (7, ResetCause::Pin));
    assert_eq!(talk.ask(Command::Forget), Ok(()));
    assert_eq!(talk.ear.hello().map(|hello| hello.hashes), Some(Hashes::default()));
    talk.cut_supply();
    let hello = talk.connect();
    assert!(number(&hello) == 0 && is(&hello, 10e-6), "{hello:?}");
    talk.expect_no_faults();
}

#[test]
fn storing_costs_no_scan_although_pages_are_erased() {
    let mut talk = Talk::at_usb();
    assert_eq!(talk.ask(Command::Start), Ok(()));
    let mut erasures = 0;
    for n in 1..=100 {
        let number = talk.rig.send(Command::Store(Hashes { scene: Some(n), calibration: None }));
        let begun = talk.rig.now();
        assert_eq!(talk.answer(number, 60), Ok(()));
        // A record is written in some 2 ms, a page erased in 22.
        erasures += u32::from(talk.rig.now() - begun > 15 * MS);
    }
    println!("{erasures} erasures");
    assert!(erasures >= 2);
    talk.run_ms(20.0);
    assert_eq!(talk.ear.gaps, []);
    let status = talk.settle_account(0);
    assert_eq!((status.scans_lost, status.scans_dropped, status.adc_overruns), (0, 0, 0));
    talk.expect_no_faults();
}

/// Says Store, and cuts the supply `after` the memory has become busy. `None`: lets it be done,
/// and gives how long the memory was busy.
fn store(talk: &mut Talk, n: u64, after: Option<Ticks>) -> Ticks {
    let command = prepare(talk, n);
    let number = talk.rig.send(command);
    let begin = loop {
        if talk.rig.machine.board.flash.next_event() != Ticks::MAX {
            break talk.rig.now();
        }
        assert_eq!(talk.ear.replies(number), [], "the memory has not been busy");
        talk.run_until(talk.rig.now() + 2_000);
    };
    match after {
        Some(after) => {
            talk.run_until(begin + after);
            talk.cut_supply();
        }
        None => {
            let mut end = begin;
            while talk.ear.replies(number).is_empty() {
                let done = talk.rig.machine.board.flash.next_event();
                end = if done == Ticks::MAX { end } else { done };
                talk.run_until(talk.rig.now() + 2_000);
                assert!(talk.rig.now() < begin + 60 * MS, "no reply");
            }
            assert_eq!(talk.ear.replies(number), [Ok(())]);
            return end - begin;
        }
    }
    0
}

#[test]
fn settings_that_the_board_does_not_start_with_are_passed_over_and_told() {
    let mut talk = Talk::at_uart();
    store(&mut talk, 1, None);
    for failed in 0..4 {
        // Into the handler of faults, within the first second.
        let cpu = &mut talk.rig.machine.cpu;
        let mut state = cpu.state();
        state.r[15] = FLASH_BASE | 0x00FF_FFF0;
        cpu.set_state(&state);
        talk.rig.run_for(1e-3);
        talk.forget_board();
        let found = number(&greet(&mut talk));
        // The fourth start is the first after three failed ones.
        assert_eq!(found, if failed < 2 { 1 } else { 0 }, "after {} failed starts", failed + 1);
        let expected = if failed < 2 { SettingsSource::Stored } else { SettingsSource::PassedOver };
        assert_eq!(talk.next_status().settings, expected);
    }
    talk.run_ms(1_100.0);
    // A start that went well: the settings are there, and used again at the next.
    talk.rig.machine.pull_reset_pin();
    talk.forget_board();
    assert_eq!(number(&greet(&mut talk)), 1);
    talk.expect_no_faults();
}

#[test]
fn a_cut_of_the_supply_leaves_the_old_settings_or_the_new() {
    const CUTS: u64 = 40;
    let mut talk = Talk::at_uart();
    let writing = store(&mut talk, 1, None);
    let (mut n, mut kept) = (1, 1);
    let mut erasing = 0;
    // (torn, old, new) behind cuts of a write, and of an erasure with the write behind it.
    let mut seen = [(0, 0, 0); 2];
    for step in 0..CUTS {
        // A torn record makes the next Store erase the other page.
        for (part, duration) in [writing, erasing].into_iter().enumerate() {
            if duration == 0 {
                continue;
            }
            n += 1;
            store(&mut talk, n, Some(duration * step / CUTS));
            let array = &talk.rig.machine.board.flash.array;
            let is_torn = !array.torn.is_empty() || !array.refusing.is_empty();
            let found = number(&greet(&mut talk));
            assert!(found == kept || found == n, "{found} instead of {kept} or {n}, cut {step} of part {part}");
            let (torn, old, new) = &mut seen[part];
            *torn += u32::from(is_torn);
            *old += u32::from(found == kept);
            *new += u32::from(found == n);
            kept = found;
        }
        n += 1;
        let took = store(&mut talk, n, None);
        erasing = erasing.max(took);
        kept = n;
    }
    println!("write {writing}, erase and write {erasing} ticks; (torn, old, new): {seen:?}");
    assert!(erasing > 20 * MS, "no Store erased");
    for (torn, old, new) in seen {
        // A write is whole when its last double word is, of which each takes some 8 %; the words
        // behind what an erasure has torn are not looked at.
        assert!(torn >= 30 && old >= 30 && old + new >= CUTS as u32 - 1, "{seen:?}");
    }
    talk.cut_supply();
    assert_eq!(number(&greet(&mut talk)), kept);
    let resets = talk.rig.machine.resets().to_vec();
    let by_itself = resets.iter().filter(|reset| reset.cause != slitpose_emulator::peripherals::ResetCause::PowerOn);
    assert_eq!(by_itself.count(), 0, "torn words do not reset the board");
    talk.expect_no_faults();
}

/// Head `n`, to be told from all others by its hashes.
fn head(n: u64) -> Head {
    let (configuration, hashes) = settings(n);
    let wide = WIDE.read().expect("shipped");
    board_head::compile(&wide, &configuration.schedule, &default_scaling(), hashes).expect("slits and cosines")
}

/// Number of the head by which the board solves poses, nobody having sent it one since its start.
fn solving(talk: &mut Talk) -> Option<u32> {
    assert_eq!(talk.ask(Command::Stream(Stream { scans: 0, poses: 1 })), Ok(()));
    talk.ear.heads.clear();
    assert_eq!(talk.ask(Command::Start), Ok(()));
    talk.run_ms(20.0);
    assert_eq!(talk.ask(Command::Stop), Ok(()));
    let heads = &talk.ear.heads;
    assert!(heads.windows(2).all(|pair| pair[0] == pair[1]));
    assert!(heads.is_empty() || heads.len() >= 10, "{}", heads.len());
    heads.first().copied()
}

/// Sends head `n`, and says Store. `None`: until it is kept, and gives how long that took.
fn store_head(talk: &mut Talk, n: u64, after: Option<Ticks>) -> Ticks {
    let command = prepare(talk, n);
    talk.rig.send_head(&head(n));
    let (number, begin) = (talk.rig.send(command), talk.rig.now());
    if let Some(after) = after {
        talk.run_until(begin + after);
        talk.cut_supply();
        return after;
    }
    assert!(talk.wait_for(300, |talk| !talk.ear.replies(number).is_empty()), "no reply");
    assert_eq!(talk.ear.replies(number), [Ok(())]);
    talk.rig.now() - begin
}

/// A head and its settings come into force together, whenever the supply is cut, and poses come by themselves.
#[test]
fn a_cut_of_the_supply_leaves_the_old_head_or_the_new_with_its_settings() {
    const CUTS: u64 = 24;
    let mut talk = Talk::solving_at_uart();
    assert_eq!(solving(&mut talk), None, "a new board has no head");
    let took = store_head(&mut talk, 1, None);
    let (mut kept, mut old, mut new) = (1, 0, 0);
    for step in 0..=CUTS {
        let n = 2 + step;
        store_head(&mut talk, n, Some(took * step / CUTS));
        let found = number(&greet(&mut talk));
        assert!(found == kept || found == n, "{found} instead of {kept} or {n}, cut {step}");
        assert_eq!(solving(&mut talk), Some(settings(found).1.number()), "cut {step}");
        old += u32::from(found == kept);
        new += u32::from(found == n);
        kept = found;
    }
    println!("a head is kept in {} ms; old {old}, new {new}", took / MS);
    assert!(old >= 20 && new >= 1, "{old} {new}");
    // Without a head in force none is kept.
    talk.rig.send(Command::Head(HeadPart { offset: 0, total: 0, bytes: [].into_iter().collect() }));
    assert_eq!(talk.ask(Command::Store(settings(kept).1)), Ok(()));
    talk.cut_supply();
    assert_eq!(number(&greet(&mut talk)), kept);
    assert_eq!(solving(&mut talk), None);
    // Of a head that is half sent nothing is kept.
    talk.rig.send_head(&head(kept));
    let whole = head(kept);
    let mut bytes = [0; HEAD_BYTES];
    let part = HeadPart::all(whole.encode(&mut bytes).expect("room")).next().expect("parts");
    talk.rig.send(Command::Head(part));
    let refused = talk.ask(Command::Store(settings(kept).1));
    assert_eq!(refused, Err(Rejection::Malformed { kind: 9 }));
    talk.expect_no_faults();
}
