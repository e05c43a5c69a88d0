//! Schedules on the emulated board: what is lit and sampled when, on the pins, against
//! [`Schedule`]'s instants; and what the words are, against the model of the optics.
//!
//! The emulated timers, transfers and converters have no latency of their own: every instant is
//! exact, and a tolerance of zero ticks is what is asserted unless stated. A real transfer
//! controller takes some ten ticks from request to write, and a few more when the bus is busy.

use crate::common::pins::{check_counters, check_pins, level_code, run, tick_offset, worst_codes};
use crate::common::talk::{MS, Talk};
use slitpose_firmware::pcb::wiring::highest_level;
use slitpose_firmware::pcb::{default_configuration, default_scaling};
use slitpose_protocol::{Command, Configuration, EmitterSet, Exposure, Level, Schedule};

/// Ticks from a frame's start on the pins to its tick in a batch: the program reads the clock just
/// after it lets the timer go, a load and a store over the slow bus; in 100 ns the tool moves 50 nm.
const MAX_OFFSET_TICKS: i64 = 17;

/// Rounding of a lit and of a dark conversion, half a code each, and light from before that has not
/// decayed, below a tenth at the default settling.
const MAX_CODES: f64 = 1.1;

fn slots(schedule: &mut Schedule, sets: &[&[usize]]) {
    schedule.slots = sets.iter().map(|set| EmitterSet::of(set)).collect();
}

const PAIRS: [&[usize]; 4] = [&[0, 3], &[1, 4], &[2, 5], &[]];
const SINGLES: [&[usize]; 7] = [&[0], &[1], &[2], &[3], &[4], &[5], &[]];
const ALL: [&[usize]; 1] = [&[0, 1, 2, 3, 4, 5]];

/// Runs `configuration` for `ms` and checks pins, counters and words.
fn check(bench: &mut Talk, name: &str, configuration: &Configuration, ms: u64) {
    let schedule = &configuration.schedule;
    let (scans, start) = run(bench, configuration, ms as f64);
    let frames = check_pins(bench.record(), configuration, start);
    check_counters(&scans, schedule);
    // At the Stop a frame may be sampled, but not yet read.
    let missing = frames as i64 - scans.len() as i64;
    assert!((0..=1).contains(&missing), "{name}: {frames} frames on the pins, {} scans", scans.len());
    let least = ms * 170_000 / u64::from(schedule.frame_ticks);
    assert!(scans.len() as u64 >= least.saturating_sub(1), "{name}: {} scans of {least}", scans.len());
    let offset = tick_offset(bench, &scans, start);
    assert!((0..=MAX_OFFSET_TICKS).contains(&offset), "{name}: {offset} ticks");
    let worst = worst_codes(&scans, configuration);
    println!(
        "{name}: {:.1} Hz, {} scans, tick − pins {offset}, {worst:.3} codes at most",
        schedule.frame_rate_hz(),
        scans.len()
    );
    assert!(worst <= MAX_CODES, "{name}: {worst} codes");
    bench.expect_neither_faults_nor_damage();
}

#[test]
fn the_default_schedule_is_exact_for_a_thousand_frames() {
    let mut bench = Talk::quiet();
    let configuration = default_configuration();
    check(&mut bench, "default", &configuration, 300);
    assert!(bench.ear.scans.len() >= 1_199);
}

#[test]
fn the_offset_of_the_clock_is_the_same_after_every_start() {
    let mut bench = Talk::quiet();
    let configuration = default_configuration();
    let mut offsets = Vec::new();
    for n in 0..100 {
        // Every start comes at another phase of everything else.
        let later = bench.rig.now() + 1_000 + 7_919 * n;
        bench.run_until(later);
        let (scans, start) = run(&mut bench, &configuration, 8.0);
        check_counters(&scans, &configuration.schedule);
        offsets.push(tick_offset(&mut bench, &scans, start));
    }
    let (least, most) = (offsets.iter().min().unwrap(), offsets.iter().max().unwrap());
    println!("tick of a frame − its start on the pins: {least} to {most}");
    assert!(*least >= 0 && *most <= MAX_OFFSET_TICKS, "{offsets:?}");
    assert_eq!(least, most, "two instructions with interrupts off always take as long");
    bench.expect_neither_faults_nor_damage();
}

/// Whatever a start finds under way, the first words of its rings are its own.
#[test]
fn no_start_loses_or_shifts_a_scan() {
    let mut talk = Talk::at_usb();
    let mut words = None;
    for run in 0..1_000_u64 {
        // At another instant of a frame, and of the bus, each time.
        let phase = run * 1_234;
        talk.ear.clear();
        talk.rig.send(Command::Start);
        talk.run_until(talk.rig.now() + 6 * MS + phase % MS);
        talk.rig.send(Command::Stop);
        talk.run_until(talk.rig.now() + 4 * MS + phase % (7 * MS / 10));
        assert!(talk.ear.scans.len() > 8, "run {run}: {} scans", talk.ear.scans.len());
        check_counters(&talk.ear.scans, &default_configuration().schedule);
        for scan in &talk.ear.scans {
            let seen = (scan.lit().to_vec(), scan.dark().map(<[_]>::to_vec));
            assert_eq!(seen, *words.get_or_insert_with(|| seen.clone()), "run {run}, scan {}", scan.sequence);
        }
    }
    let status = talk.settle_account(0);
    assert_eq!((status.adc_overruns, status.scans_lost), (0, 0), "{status:?}");
    talk.expect_no_faults();
}

#[test]
fn layouts() {
    let mut bench = Talk::quiet();
    for (name, sets, frame_ticks, relative) in [
        ("singles and dark", &SINGLES[..], 42_500, 1.0),
        ("singles and dark, back to back", &SINGLES[..], 40_600, 1.0),
        ("all at once", &ALL[..], 42_500, 1.0),
        ("all at once, back to back", &ALL[..], 8_500, 1.0),
        ("pairs without dark", &PAIRS[..3], 42_500, 1.0),
        ("pairs without dark, back to back", &PAIRS[..3], 17_400, 1.0),
        // Slots without a tick in hand and a rest of one: while the last words are moved, all off and the gates of the
        // next frame both wait, and must not change places.
        ("pairs without dark, a short rest", &PAIRS[..3], 17_287, 1.0),
        ("dark first", &[PAIRS[3], PAIRS[0], PAIRS[1], PAIRS[2]][..], 42_500, 1.0),
        ("dark in the middle", &[PAIRS[0], PAIRS[3], PAIRS[1], PAIRS[2]][..], 42_500, 1.0),
        ("pairs, back to back", &PAIRS[..], 23_200, 1.0),
        ("dimmed", &PAIRS[..], 42_500, 0.5),
    ] {
        let mut configuration = default_configuration();
        slots(&mut configuration.schedule, sets);
        configuration.schedule.frame_ticks = frame_ticks;
        match frame_ticks {
            8_500 => configuration.schedule.slot_ticks = frame_ticks,
            17_287 => configuration.schedule.slot_ticks = shortest_slot(&configuration.schedule),
            _ => {}
        }
        let level = Level((relative * f64::from(Level::NOMINAL.0)) as u16);
        configuration.levels.iter_mut().for_each(|of| *of = level);
        check(&mut bench, name, &configuration, 50);
    }
}

#[test]
fn oversampling() {
    let mut bench = Talk::quiet();
    for oversampling in [1, 2, 4, 8, 16] {
        let mut configuration = default_configuration();
        let schedule = &mut configuration.schedule;
        schedule.oversampling = oversampling;
        schedule.slot_ticks = shortest_slot(schedule);
        schedule.frame_ticks = schedule.frame_ticks.max(4 * schedule.slot_ticks);
        check(&mut bench, &format!("oversampling {oversampling}"), &configuration, 50);
    }
}

#[test]
fn conversion_times() {
    let mut bench = Talk::quiet();
    // The least settling that conversion time 2612 allows is longer than the default's.
    for (conversion_ticks, settling_ticks) in [(148, 2_210), (240, 2_210), (420, 2_210), (1_040, 2_210), (2_612, 2_571)]
    {
        let mut configuration = default_configuration();
        let schedule = &mut configuration.schedule;
        schedule.conversion_ticks = conversion_ticks;
        schedule.settling_ticks = settling_ticks;
        schedule.slot_ticks = shortest_slot(schedule);
        schedule.frame_ticks = schedule.frame_ticks.max(4 * schedule.slot_ticks);
        check(&mut bench, &format!("conversions of {conversion_ticks} ticks"), &configuration, 50);
    }
}

#[test]
fn few_cells_and_few_frames() {
    let mut bench = Talk::quiet();
    let sets: [&[&[usize]]; 5] =
        [&[&[0], &[]], &[&[0, 1], &[]], &[&[0], &[1], &[2]], &[&[], &[0, 3], &[1], &[2]], &[&[0, 1, 2, 3, 4]]];
    for (cells, sets) in (1..).zip(sets) {
        let mut configuration = default_configuration();
        slots(&mut configuration.schedule, sets);
        configuration.schedule.cells = cells;
        configuration.levels.truncate(cells.into());
        check(&mut bench, &format!("{cells} cells"), &configuration, 50);
    }
    let mut configuration = default_configuration();
    configuration.schedule.frame_ticks = 17_000_000;
    check(&mut bench, "rare", &configuration, 450);
}

#[test]
fn each_emitter_has_its_level() {
    let mut bench = Talk::quiet();
    // Multiples of a DAC code, so that they are exact; opposite emitters differ.
    let levels = [0x8000, 0x4000, 0xc000, 0x6000, 0xf000, 0x2000].map(Level);
    for (name, sets) in [("pairs", &PAIRS[..]), ("singles", &SINGLES[..]), ("pairs without dark", &PAIRS[..3])] {
        let mut configuration = default_configuration();
        slots(&mut configuration.schedule, sets);
        configuration.levels.copy_from_slice(&levels);
        check(&mut bench, &format!("levels, {name}"), &configuration, 50);
    }
}

/// The light of home with cells 3 and 4 faint: levels settle where light is in range, and neither those on the wire nor those
/// on the lines go beyond what the hardware allows.
#[test]
fn automatic_exposure_settles_within_the_range_and_the_highest_level() {
    let mut bench = Talk::quiet();
    let mut configuration = default_configuration();
    configuration.exposure = Exposure::Automatic;
    configuration.levels = [0xf000, 0x8000, 0x8000, 0x2000, 0x1000, 0x8000].map(Level).into_iter().collect();
    bench.accept(&Command::Configure(configuration.clone()));
    bench.forget();
    bench.accept(&Command::Start);
    bench.run_ms(300.0);
    bench.accept(&Command::Stop);
    bench.run_ms(5.0);
    let (scans, highest) = (bench.ear.scans.clone(), highest_level(&configuration.schedule));
    let settled = &scans[scans.len() - 400..];
    assert!(settled.iter().all(|scan| scan.levels() == settled[0].levels()), "100 ms without a change");
    assert_ne!(scans[0].levels(), settled[0].levels());
    println!("levels {:04x?}", settled[0].levels());
    for (cell, [x1, x2]) in settled[0].lit().iter().enumerate() {
        let zero = default_scaling().zero_code * f64::from(configuration.schedule.oversampling);
        let share = [x1, x2].map(|&word| (f64::from(word) / zero - 1.0).abs()).into_iter().fold(0.0, f64::max);
        assert!(share < 0.85 && (share > 0.3 || settled[0].levels()[cell] == highest), "cell {cell}: {share}");
    }
    assert!(scans.iter().all(|scan| scan.levels().iter().all(|&level| level <= highest)));
    let most = level_code(highest);
    assert!(bench.record().drives.iter().all(|drive| drive.levels.iter().all(|&code| code <= most)));
    // A change of levels costs the frame under way, and no other.
    let lost: u64 = scans.windows(2).map(|pair| pair[1].sequence - pair[0].sequence - 1).sum();
    assert!(lost < 8, "{lost}");
    bench.expect_neither_faults_nor_damage();
}

fn shortest_slot(schedule: &Schedule) -> u32 {
    let conversions = u32::from(schedule.cells) * u32::from(schedule.oversampling);
    schedule.settling_ticks + conversions * schedule.conversion_ticks
}

/// Layouts at their shortest slots, and frames, in ticks, at which the board loses nothing for a
/// second: what a search found and a few per cent, or the slots themselves where they are longer.
fn fastest() -> Vec<(&'static str, Configuration, u32)> {
    let of = |sets: &[&[usize]], change: fn(&mut Schedule)| {
        let mut configuration = default_configuration();
        slots(&mut configuration.schedule, sets);
        change(&mut configuration.schedule);
        let cells = configuration.schedule.cells;
        configuration.levels.truncate(cells.into());
        configuration.schedule.slot_ticks = shortest_slot(&configuration.schedule);
        configuration
    };
    let keep = |_: &mut Schedule| {};
    let one = |schedule: &mut Schedule| schedule.oversampling = 1;
    let quick = |schedule: &mut Schedule| {
        (schedule.settling_ticks, schedule.oversampling) = (107, 1);
    };
    let quick_cell = |schedule: &mut Schedule| {
        (schedule.settling_ticks, schedule.oversampling) = (107, 1);
        schedule.cells = 1;
    };
    vec![
        ("pairs and dark", of(&PAIRS, keep), 23_048),
        ("pairs and dark, one conversion", of(&PAIRS, one), 16_000),
        ("singles and dark", of(&SINGLES, keep), 40_334),
        ("pairs without dark", of(&PAIRS[..3], keep), 17_286),
        ("all at once", of(&ALL, keep), 9_800),
        ("pairs and dark, no settling", of(&PAIRS, quick), 16_000),
        ("all at once, no settling", of(&ALL, quick), 9_800),
        ("one cell, no settling", of(&[&[0]], quick_cell), 8_500),
    ]
}

#[derive(Debug)]
struct Outcome {
    scans: u64,
    missing: u64,
    dropped: u64,
    overruns: u32,
    /// By the board's own account, of its last half second.
    load_permille: u16,
    /// By the emulator's, of all the time.
    awake_permille: f64,
}

fn outcome(bench: &mut Talk, configuration: &Configuration, ms: u64) -> Outcome {
    bench.accept(&Command::Configure(configuration.clone()));
    let before = bench.next_status();
    bench.forget();
    bench.accept(&Command::Start);
    let (awake, since) = (bench.rig.machine.awake_ticks(), bench.rig.now());
    bench.run_ms(ms as f64);
    let awake = bench.rig.machine.awake_ticks() - awake;
    let awake_permille = 1e3 * awake as f64 / (bench.rig.now() - since) as f64;
    let load_permille = bench.ear.status.expect("a status comes twice a second").cpu_load_permille;
    bench.accept(&Command::Stop);
    let after = bench.next_status();
    let scans = bench.ear.scans.clone();
    let numbers = scans.last().map_or(0, |last| last.sequence + 1 - scans[0].sequence);
    let outcome = Outcome {
        scans: scans.len() as u64,
        // The board's own count would include what the Stop before has cut off.
        missing: numbers - scans.len() as u64,
        dropped: after.scans_dropped - before.scans_dropped,
        overruns: after.adc_overruns - before.adc_overruns,
        load_permille,
        awake_permille,
    };
    if outcome.missing == 0 {
        check_counters(&scans, &configuration.schedule);
    }
    outcome
}

#[test]
fn the_fastest_frames_lose_nothing_for_a_second() {
    let mut bench = Talk::quiet();
    for (name, mut configuration, frame_ticks) in fastest() {
        configuration.schedule.frame_ticks = frame_ticks;
        let rate_hz = configuration.schedule.frame_rate_hz();
        let outcome = outcome(&mut bench, &configuration, 1_000);
        println!("{name}: {rate_hz:.0} Hz, {outcome:?}");
        assert_eq!((outcome.missing, outcome.dropped, outcome.overruns), (0, 0, 0), "{name}");
        assert!(outcome.scans as f64 >= 0.999 * rate_hz, "{name}: {outcome:?}");
        assert!(outcome.load_permille < 900, "{name}: {outcome:?}");
        // Of one half second and of two: what differs is the start, some milliseconds.
        assert!((f64::from(outcome.load_permille) - outcome.awake_permille).abs() < 20.0, "{name}: {outcome:?}");
    }
    bench.expect_neither_faults_nor_damage();
}

#[test]
fn the_default_slots_cost_more_of_the_core_the_faster_they_follow() {
    let mut bench = Talk::quiet();
    let mut before = 0.0;
    for frame_ticks in [170_000, 85_000, 42_500, 23_200] {
        let mut configuration = default_configuration();
        configuration.schedule.frame_ticks = frame_ticks;
        let outcome = outcome(&mut bench, &configuration, 1_000);
        println!("default slots at {:.0} Hz: {outcome:?}", configuration.schedule.frame_rate_hz());
        assert_eq!((outcome.missing, outcome.dropped, outcome.overruns), (0, 0, 0));
        assert!(outcome.awake_permille > before && outcome.awake_permille < 500.0);
        before = outcome.awake_permille;
    }
}

/// Frames of all cells at 20 kHz are more than the bus takes away.
#[test]
fn what_is_too_fast_is_lost_and_counted_but_the_board_stays_in_hand() {
    let mut bench = Talk::quiet();
    let mut configuration = default_configuration();
    slots(&mut configuration.schedule, &ALL);
    configuration.schedule.frame_ticks = 8_500;
    let lossy = outcome(&mut bench, &configuration, 700);
    println!("{:.0} Hz: {lossy:?}", configuration.schedule.frame_rate_hz());
    assert!(lossy.missing > 0 && lossy.scans > 0, "{lossy:?}");
    assert_eq!(bench.gates(), 0, "it obeys a Stop");
    assert_eq!(bench.rig.machine.resets().len(), 1, "no watchdog");
    check(&mut bench, "default, afterwards", &default_configuration(), 50);
}
