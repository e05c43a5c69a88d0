//! The words that the image sends are those the model gives for where the tool was at the very
//! instants the schedule names, scan after scan.

use crate::common::chain::Chain;
use crate::common::inputs;
use crate::common::silicon;
use crate::common::trial::{FRAME_TICKS, Model, TOLERANCE_CODES, difference};
use slitpose_emulator::facts;
use slitpose_emulator::faults::{Fault, Faults};
use slitpose_emulator::machine::{Machine, Stop};
use slitpose_emulator::memory::FlashArray;
use slitpose_emulator::peripherals::Ticks;
use slitpose_emulator::rig::{open_image, request};
use slitpose_emulator::world::{NoiseSource, World};
use slitpose_firmware::pcb::default_configuration;
use slitpose_head::scene_file::WIDE;
use slitpose_head::simulator::{Trajectory, TrajectoryKind};
use slitpose_protocol::{Command, Decoder, MAX_MESSAGE_BYTES, Message, RawScan, Schedule};

const SEED: u64 = 11;

/// Whatever a start finds under way, the first words of its rings are its own.
#[test]
fn no_start_loses_or_shifts_a_scan() {
    let (file, runs) = (WIDE.read().expect("shipped"), 1_000_u32);
    let still = || Trajectory::of_kind(TrajectoryKind::Still, SEED, 1.0);
    let mut chain = Chain::open(&file, still(), NoiseSource::Off, silicon());
    let expected = Model::new(&file, still()).frame(0);
    for run in 0..runs {
        // At another instant of a frame, and of the bus, each time.
        let phase_s = f64::from(run) * 1_234.0 / 170e6;
        chain.scans.clear();
        chain.rig.send(Command::Start);
        chain.run_for(6e-3 + phase_s % 1e-3);
        chain.rig.send(Command::Stop);
        chain.run_for(4e-3 + phase_s % 0.7e-3);
        assert!(chain.scans.len() > 8, "run {run}: {} scans", chain.scans.len());
        for (_, scan) in &chain.scans {
            let off = difference(scan, &expected);
            assert!(off <= TOLERANCE_CODES, "run {run}, scan {}: {off} codes", scan.sequence);
        }
        for pair in chain.scans.windows(2) {
            let [(_, before), (_, after)] = pair else { continue };
            assert_eq!((after.sequence - before.sequence, after.tick - before.tick), (1, FRAME_TICKS), "run {run}");
        }
    }
    chain.run_for(0.6);
    let status = chain.status.expect("comes twice a second");
    assert_eq!((status.adc_overruns, status.scans_lost), (0, 0), "{status:?}");
    assert_eq!(chain.rig.faults(), Vec::<String>::new());
}

/// A world whose codes say when, where and in whose light they were taken.
#[derive(Debug, Default)]
struct Witness {
    gates: u8,
    levels: [u16; 2],
    /// Every change of the gates.
    edges: Vec<(Ticks, u8)>,
}

/// 12 bits that depend on all of what they are made of.
fn testimony(at: Ticks, adc: u8, channel: u8, gates: u8, levels: [u16; 2]) -> u16 {
    let facts = [u64::from(adc), channel.into(), gates.into(), levels[0].into(), levels[1].into()];
    let mixed = facts.iter().fold(at, |mixed, fact| (mixed ^ fact).wrapping_mul(0x9E37_79B9_7F4A_7C15).rotate_left(29));
    (mixed >> 40 & 0xFFF) as u16
}

impl World for Witness {
    fn drive(&mut self, at: Ticks, gates: u8, level_codes: [u16; 2]) {
        if gates != self.gates {
            self.edges.push((at, gates));
        }
        (self.gates, self.levels) = (gates, level_codes);
    }

    fn sample(&mut self, now: Ticks, adc: u8, channel: u8) -> u16 {
        testimony(now, adc, channel, self.gates, self.levels)
    }
}

/// A frame's tick is read from the clock right behind the start of the frames' timer, so it is a
/// few instructions late; in 100 ns the tool moves 50 nm.
const MAX_TICKS_LATE: u64 = 17;

/// Periods of the converters' clock in ticks.
const CLOCK_TICKS: f64 = 4.0;

/// What the schedule's times mean in periods of the converters' clock, by the data sheet.
fn conversion_ticks() -> Ticks {
    let clocks = facts::number("sampling_clocks_3") + facts::number("approximation_clocks_12_bits");
    (clocks * CLOCK_TICKS) as Ticks
}

/// A run of the default configuration: the scans, with the instants at which their first slot's gates came on, and the
/// tick of power at which the device clock was zero.
fn witness(silicon: Faults, seed: u64, seconds: f64) -> (Vec<(RawScan, Ticks)>, Ticks) {
    let mut flash = FlashArray::erased();
    open_image(None).expect("an image").load_into(&mut flash);
    let mut machine = Machine::new(flash, Witness::default()).with_faults(silicon, seed);
    let run = |machine: &mut Machine<Witness>, seconds: f64| {
        assert_eq!(machine.run_until(machine.now() + (seconds * 170e6) as Ticks), Stop::Reached);
    };
    run(&mut machine, 0.4);
    machine.board.usb_host.set_dtr(true, machine.now());
    machine.board.usb_host.send(&request(1, Command::Start), machine.now());
    machine.board.outside_changed();
    run(&mut machine, seconds);
    let schedule = default_configuration().schedule;
    let bytes: Vec<u8> = machine.board.usb_host.take_received().into_iter().flat_map(|(_, bytes)| bytes).collect();
    let (mut decoder, mut rest) = (Decoder::<MAX_MESSAGE_BYTES>::new(), &bytes[..]);
    let mut scans = Vec::new();
    while let Some(message) = decoder.next::<Message<'_>>(&mut rest) {
        let Message::Batch(batch) = message.expect("undamaged") else { continue };
        scans.extend(batch.scans(&schedule).expect("of the default schedule"));
    }
    let first = schedule.slots[0].0 as u8;
    let starts = machine.board.world.edges.iter().filter(|edge| edge.1 == first).map(|edge| edge.0);
    let origin = machine.device_clock_origin().expect("started");
    (scans.into_iter().zip(starts).collect(), origin)
}

/// The word of `cell` in `slot`, if its first sample is held `first` ticks behind the start of the slot at `start`.
fn witnessed(wired: &[[u8; 6]; 2], schedule: &Schedule, first: Ticks, slot: usize, cell: usize) -> [u16; 2] {
    let conversions =
        cell as u64 * u64::from(schedule.oversampling)..(cell as u64 + 1) * u64::from(schedule.oversampling);
    [1_u8, 2].map(|adc| {
        let instants = conversions.clone().map(|n| first + n * conversion_ticks());
        let channel = wired[usize::from(adc) - 1][cell];
        instants.map(|at| testimony(at, adc, channel, schedule.slots[slot].0 as u8, [2048; 2])).sum()
    })
}

/// Whether the words of `scan`, whose first slot's gates came on at `start`, were held `settling` ticks behind the start
/// of each slot.
fn is_held(scan: &RawScan, start: Ticks, settling: Ticks, wired: &[[u8; 6]; 2]) -> bool {
    let schedule = default_configuration().schedule;
    let first = |slot: usize| start + slot as u64 * u64::from(schedule.slot_ticks) + settling;
    let dark = schedule.dark_slot().expect("the default has one");
    (0..6).all(|cell| {
        let slot = schedule.lit_slot(cell).expect("lit");
        let dark = [scan.dark().expect("dark words")[cell], witnessed(wired, &schedule, first(dark), dark, cell)];
        scan.lit()[cell] == witnessed(wired, &schedule, first(slot), slot, cell) && dark[0] == dark[1]
    })
}

/// Counted from the edge of the gates on the pins: no offset is looked for. The emulator's trigger takes two periods of
/// the converters' clock, in whole ticks. A board's takes 2.125 (DS12288, Table 66), so that its samples are half a tick
/// later than this, and up to another four, as the trigger waits for an edge of that clock: see
/// [`on_silicon_every_sample_is_late_by_the_same_few_ticks`].
#[test]
fn every_conversion_is_held_at_its_tick_in_its_light() {
    let Schedule { settling_ticks, frame_ticks, conversion_ticks: asked, .. } = default_configuration().schedule;
    assert_eq!(u64::from(asked), conversion_ticks());
    let (scans, origin) = witness(Faults::default(), 1, 1.0);
    let wired = inputs();
    let late = (origin + scans[0].0.tick).wrapping_sub(scans[0].1);
    assert!(late <= MAX_TICKS_LATE, "labelled {late} ticks late");
    for (n, (scan, start)) in (0..).zip(&scans) {
        assert_eq!(scan.sequence, n);
        assert_eq!(*start, scans[0].1 + n * u64::from(frame_ticks), "the gates of frame {n}");
        // The same in all frames of a run.
        assert_eq!(origin + scan.tick - start, late, "frame {n}");
        assert!(is_held(scan, *start, settling_ticks.into(), &wired), "frame {n}: {scan:?}");
    }
    println!("{} scans, labelled {late} ticks late", scans.len());
    assert!(scans.len() > 3_900);
}

/// With fault trigger-phase: half a tick more than two clocks, and the way to the next edge of a clock of four ticks.
#[test]
fn on_silicon_every_sample_is_late_by_the_same_few_ticks() {
    let settling = u64::from(default_configuration().schedule.settling_ticks);
    let beyond = (facts::number("t_LATR_ckmode_11") - 2.0) * CLOCK_TICKS;
    let may_be_late = beyond..=beyond + CLOCK_TICKS;
    assert_eq!(may_be_late, 0.5..=4.5);
    let wired = inputs();
    for seed in 1..=6 {
        let (scans, _) = witness([Fault::TriggerPhase].into_iter().collect(), seed, 0.05);
        let held = |late: &u64| is_held(&scans[0].0, scans[0].1, settling + late, &wired);
        let late = (0..=5).find(held).expect("held a few ticks late");
        println!("seed {seed}: samples {late} ticks late");
        assert!(may_be_late.contains(&(late as f64)), "seed {seed}: {late} ticks");
        assert!(scans.len() > 150);
        // A frame and a slot are whole periods of the converters' clock.
        assert!(scans.iter().all(|(scan, start)| is_held(scan, *start, settling + late, &wired)), "seed {seed}");
    }
}
