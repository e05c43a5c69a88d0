//! The words that the image sends are those the model gives for where the tool was at the very
//! instants the schedule names, scan after scan.

use crate::common::chain::Chain;
use crate::common::talk::FRAME_TICKS;
use crate::common::{inputs, silicon};
use slitpose_emulator::facts;
use slitpose_emulator::faults::{Fault, Faults};
use slitpose_emulator::machine::{Machine, Stop};
use slitpose_emulator::memory::FlashArray;
use slitpose_emulator::peripherals::Ticks;
use slitpose_emulator::rig::{open_image, request};
use slitpose_emulator::world::{NoiseSource, World};
use slitpose_firmware::pcb::{default_configuration, default_scaling};
use slitpose_head::scene_file::{SceneFile, WIDE};
use slitpose_head::simulator::{Trajectory, TrajectoryKind};
use slitpose_model::{CompiledScene, Tier};
use slitpose_protocol::{AdcScaling, Command, Decoder, MAX_MESSAGE_BYTES, Message, RawScan, Schedule};

const SEED: u64 = 11;

/// Furthest a mean code may be from the model's. Each conversion is rounded to a whole code, so
/// their mean is off by up to ½ when all four fall to one side. The rest is how far the emulated
/// light is from the optics at the instant: it is linear within 35 µs (0.01 code), and what reaches
/// a cell from the emitter of another is taken to 1e-3.
const TOLERANCE_CODES: f64 = 0.5 + 0.02;

/// What words should be, from optics, schedule and scaling alone.
struct Model {
    own: CompiledScene<f64>,
    stray: CompiledScene<f64>,
    trajectory: Trajectory,
    schedule: Schedule,
    scaling: AdcScaling,
    time_constant_ticks: f64,
    half_dark_a: Vec<f64>,
}

/// A mean code of I_X1 and of I_X2.
type Codes = [f64; 2];

impl Model {
    fn new(file: &SceneFile, trajectory: Trajectory) -> Self {
        let plan = |tolerance| CompiledScene::compile(&file.scene, Tier::Exact { tolerance }).expect("shipped");
        let schedule = default_configuration().schedule;
        let tau_s = file.front_end.expect("the default has one").time_constant_s;
        Self {
            own: plan(1e-6),
            stray: plan(1e-3),
            trajectory,
            scaling: default_scaling(),
            time_constant_ticks: tau_s * f64::from(schedule.tick_hz),
            half_dark_a: file.scene.cells.iter().map(|cell| 0.5 * cell.detector.dark_current_a).collect(),
            schedule,
        }
    }

    /// Photocurrents of `cell` from the emitters of `slot` with the tool where it is at `tick`.
    fn light(&self, cell: usize, slot: usize, tick: f64) -> [f64; 2] {
        let pose = self.trajectory.pose(tick / f64::from(self.schedule.tick_hz));
        self.schedule.slots[slot].emitters().fold([0.0; 2], |sum, emitter| {
            let plan = if emitter == cell { &self.own } else { &self.stray };
            let pair = plan.crosstalk(cell, emitter, &pose);
            [sum[0] + pair.i_x1_a, sum[1] + pair.i_x2_a]
        })
    }

    /// The mean code of the conversions of `cell` in `slot` of the frame that starts at `tick`.
    ///
    /// x after an edge the low-pass shows the light of τ ago, less exp(−x/τ) of it, and exp(−x/τ)
    /// of what the slot before had left. That is exact for light that changes linearly, but for
    /// the change in the vanishing part; what its curvature adds, the tool's acceleration of
    /// 40 m/s² for τ² = 2 µs², is 0.1 nm.
    fn codes(&self, cell: usize, slot: usize, tick: u64) -> Codes {
        let Schedule { slot_ticks, conversion_ticks, oversampling, .. } = self.schedule;
        let tau = self.time_constant_ticks;
        let start = tick as f64 + slot as f64 * f64::from(slot_ticks);
        let first = tick as f64 + self.schedule.first_sample_ticks(slot, cell).expect("in the schedule") as f64;
        // Ahead of slot 0 it has been dark for long.
        let before = if slot > 0 { self.light(cell, slot - 1, start - tau) } else { [0.0; 2] };
        let mut mean = [0.0; 2];
        for conversion in 0..oversampling {
            let at = first + f64::from(conversion * conversion_ticks as u16);
            let rest = (-(at - start) / tau).exp();
            let light = self.light(cell, slot, at - tau);
            for electrode in 0..2 {
                let current = light[electrode] * (1.0 - rest) + before[electrode] * rest + self.half_dark_a[cell];
                let code = self.scaling.zero_code + current / self.scaling.amperes_per_code;
                mean[electrode] += code / f64::from(oversampling);
            }
        }
        mean
    }

    /// Mean codes of a frame that starts at `tick`: lit and dark, cell by cell.
    fn frame(&self, tick: u64) -> [Vec<Codes>; 2] {
        let dark = self.schedule.dark_slot().expect("the default has one");
        let cells = || 0..usize::from(self.schedule.cells);
        let lit = |cell| self.schedule.lit_slot(cell).expect("every cell is lit");
        [
            cells().map(|cell| self.codes(cell, lit(cell), tick)).collect(),
            cells().map(|cell| self.codes(cell, dark, tick)).collect(),
        ]
    }
}

/// Largest difference between the mean codes of a scan and `expected`.
fn difference(scan: &RawScan, expected: &[Vec<Codes>; 2]) -> f64 {
    let oversampling = 4.0;
    let words = [scan.lit(), scan.dark().expect("dark words")];
    let pairs = words.iter().zip(expected).flat_map(|(words, expected)| words.iter().zip(expected));
    pairs
        .flat_map(|(words, codes)| words.iter().zip(codes))
        .map(|(&word, code)| (f64::from(word) / oversampling - code).abs())
        .fold(0.0, f64::max)
}

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
