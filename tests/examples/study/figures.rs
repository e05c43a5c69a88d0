//! Figures of the image, from the linker and the emulator, as a Markdown table.
//!
//! Device times follow from the emulator's cycle table; ratio and the host's share are of the
//! machine this runs on.

#[path = "../../emulator/tests/testsuite/common/chain.rs"]
mod chain;

use std::time::Instant;

use chain::Chain;
use slitpose_emulator::faults::Faults;
use slitpose_emulator::peripherals::{TICKS_PER_SECOND, Ticks};
use slitpose_emulator::rig::{Link, Rig, WORLD_TIER, open_image};
use slitpose_emulator::world::NoiseSource;
use slitpose_firmware::pcb::default_configuration;
use slitpose_head::scene_file::{SceneFile, WIDE};
use slitpose_head::simulator::{Trajectory, TrajectoryKind};
use slitpose_protocol::{Command, Configuration, Decoder, Exposure, Hashes, MAX_MESSAGE_BYTES, Message, Schedule};
use slitpose_tests::consistency::Sorted;
use slitpose_tracking::pipeline::{Item, Pipeline, PipelineError, SceneMatch};

/// Device seconds over which latency is looked at, and for which a load or a rate is held.
const LATENCY_S: f64 = 4.0;
const HOLD_S: f64 = 1.0;

/// Step in which the highest frame rate is looked for, in ticks of a frame.
const RATE_STEP_TICKS: u32 = 100;

pub fn print() {
    let file = WIDE.read().expect("shipped");
    let image = open_image(None).expect("an image");
    println!("| figure | value | conditions |\n|---|---|---|");
    let row = |figure: &str, value: String, conditions: &str| println!("| {figure} | {value} | {conditions} |");

    row("image in flash", format!("{} bytes", image.flash_bytes()), "all that is programmed");
    row("static RAM", format!("{} bytes", image.static_ram_bytes()), "of 131 072; rings, queue, tasks");
    row(
        "stack at most",
        format!("{} bytes", exercise(&file)),
        "every command, new levels, a closed port, damaged bytes",
    );
    boot(&file, &row);
    start(&file, &row);
    for rate_hz in [1_000, 2_000, 4_000] {
        let (load, lost) = held(&file, 170_000_000 / rate_hz, HOLD_S);
        row(&format!("processor load, {rate_hz} Hz"), percent(load), &format!("1 s, {lost} scans lost"));
    }
    let least = least_frame_ticks(&default_configuration().schedule);
    let (load, lost) = held(&file, least, HOLD_S);
    let rate = format!("processor load, {:.0} Hz", hertz(least));
    row(&rate, percent(load), &format!("no idle rest at all; 1 s, {lost} scans lost"));
    let sustained = (least..=42_500).step_by(RATE_STEP_TICKS as usize).find(|&ticks| held(&file, ticks, HOLD_S).1 == 0);
    let sustained = sustained.expect("4 kHz at the latest");
    row("highest frame rate without loss", format!("{:.0} Hz", hertz(sustained)), "default slots, 1 s");
    latency(&file, &row);
}

fn smooth() -> Trajectory {
    Trajectory::of_kind(TrajectoryKind::Smooth, 1, 60.0)
}

fn opened(file: &SceneFile) -> Chain {
    Chain::open(file, smooth(), NoiseSource::Seeded(1), Faults::default())
}

fn percent(share: f64) -> String {
    format!("{:.1} %", 100.0 * share)
}

fn hertz(frame_ticks: u32) -> f64 {
    TICKS_PER_SECOND as f64 / f64::from(frame_ticks)
}

fn milliseconds(ticks: Ticks) -> String {
    format!("{:.3} ms", ticks as f64 * 1e3 / TICKS_PER_SECOND as f64)
}

fn least_frame_ticks(schedule: &Schedule) -> u32 {
    schedule.slots.len() as u32 * schedule.slot_ticks
}

fn at_frame(frame_ticks: u32) -> Configuration {
    let mut configuration = default_configuration();
    configuration.schedule.frame_ticks = frame_ticks;
    configuration
}

/// Drives the board through everything it can be asked, and gives its deepest stack.
fn exercise(file: &SceneFile) -> u32 {
    let mut chain = opened(file);
    let automatic = Configuration { exposure: Exposure::Automatic, ..default_configuration() };
    let hashes = Hashes { scene: Some(1), calibration: Some(2) };
    for command in [
        Command::Hello,
        Command::Start,
        Command::Ping { token: 1 },
        Command::Identify { seconds: 1 },
        Command::Configure(at_frame(23_200)),
        Command::Configure(automatic),
        Command::Store(hashes),
        Command::Forget,
        Command::Stop,
        Command::Start,
    ] {
        chain.rig.send(command);
        chain.run_for(0.1);
    }
    chain.rig.send_bytes(&[0x55; 300]);
    chain.run_for(0.01);
    chain.rig.set_open(false);
    chain.run_for(0.7);
    chain.rig.set_open(true);
    chain.rig.send(Command::Start);
    chain.run_for(1.0);
    assert!(chain.replies.len() == 11 && chain.replies.iter().all(|&accepted| accepted), "{:?}", chain.replies);
    chain.rig.stack_bytes()
}

/// Load of the core and scans lost while frames of `frame_ticks` run for `seconds`.
fn held(file: &SceneFile, frame_ticks: u32, seconds: f64) -> (f64, u64) {
    let mut chain = opened(file);
    chain.rig.send(Command::Configure(at_frame(frame_ticks)));
    chain.run_for(0.01);
    chain.rig.send(Command::Start);
    chain.run_for(0.1);
    let (awake, since) = (chain.rig.machine().awake_ticks(), chain.rig.now());
    chain.run_for(seconds);
    let load = (chain.rig.machine().awake_ticks() - awake) as f64 / (chain.rig.now() - since) as f64;
    let came = chain.scans.len() as u64;
    let counted = chain.scans.last().map_or(0, |(_, scan)| scan.sequence + 1);
    // Those that have not come by the end are late, not lost, unless the board falls behind.
    let due =
        ((chain.rig.now() - chain.origin - chain.scans[0].1.tick) / u64::from(frame_ticks)).saturating_sub(counted);
    let behind = if due > 64 { due } else { 0 };
    (load, counted - came + behind)
}

fn boot(file: &SceneFile, row: &impl Fn(&str, String, &str)) {
    let image = open_image(None).expect("an image");
    let mut rig =
        Rig::boot(&image, file, smooth(), NoiseSource::Off, Faults::default()).expect("a head").with_link(Link::Uart);
    let origin = rig.machine().device_clock_origin().expect("started");
    row("power to clock", milliseconds(origin), "oscillator, PLL, settings; until the device clock starts");
    let hello = first_hello(&mut rig, true);
    row(
        "power to hello, serial port",
        milliseconds(hello),
        "end of its last byte; asked as soon as the clock runs, then every ms",
    );
    let mut rig = Rig::boot(&image, file, smooth(), NoiseSource::Off, Faults::default()).expect("a head");
    rig.set_open(true);
    let hello = first_hello(&mut rig, false);
    row(
        "power to hello, USB",
        milliseconds(hello),
        "port opened at once; resets and waits of the host's enumeration included",
    );
}

/// Tick at which the first hello is over.
fn first_hello(rig: &mut Rig, asks: bool) -> Ticks {
    let mut decoder = Decoder::<MAX_MESSAGE_BYTES>::new();
    loop {
        if asks {
            rig.send(Command::Hello);
        }
        rig.run_for(1e-3);
        assert!(rig.now() < TICKS_PER_SECOND, "no hello");
        for (at, bytes) in rig.take_packets() {
            let mut rest = &bytes[..];
            while let Some(message) = decoder.next::<Message<'_>>(&mut rest) {
                if let Ok(Message::Hello(_)) = message {
                    return at;
                }
            }
        }
    }
}

fn start(file: &SceneFile, row: &impl Fn(&str, String, &str)) {
    let mut chain = opened(file);
    chain.run_for(0.1);
    chain.rig.machine().board.log_gates();
    let sent = chain.rig.now();
    chain.rig.send(Command::Start);
    chain.run_for(0.01);
    let lit = chain.rig.machine().board.take_gate_log().iter().find(|edge| edge.gates != 0).expect("lit").at;
    row(
        "Start to first light",
        milliseconds(lit - sent),
        "from the host's write; converters are calibrated at the first",
    );
    row("Start to first scan", milliseconds(chain.scans[0].0 - sent), "end of the packet with its batch of four");
}

fn quantiles(values: Vec<f64>) -> String {
    let values = Sorted::of(values);
    format!("{:.3} / {:.3} / {:.3} ms", values.at(0.5), values.at(0.99), values.most())
}

fn latency(file: &SceneFile, row: &impl Fn(&str, String, &str)) {
    let mut chain = opened(file);
    let begun_instructions = chain.rig.machine().cpu.instructions();
    chain.rig.send(Command::Start);
    let begun = Instant::now();
    chain.run_for(LATENCY_S);
    let wall_s = begun.elapsed().as_secs_f64();
    let instructions = chain.rig.machine().cpu.instructions() - begun_instructions;
    let lost = chain.scans.windows(2).filter(|pair| pair[1].1.sequence != pair[0].1.sequence + 1).count();
    assert_eq!(lost, 0);

    let schedule = default_configuration().schedule;
    let last_hold = (0..usize::from(schedule.cells))
        .filter_map(|cell| schedule.first_sample_ticks(schedule.lit_slot(cell)?, cell))
        .map(|first| first + u64::from(schedule.oversampling - 1) * u64::from(schedule.conversion_ticks))
        .max()
        .expect("lit");
    let ms = |ticks: Ticks| ticks as f64 * 1e3 / TICKS_PER_SECOND as f64;
    let board: Vec<f64> =
        chain.scans.iter().map(|(at, scan)| ms(at - (chain.origin + scan.tick + last_hold))).collect();
    let host = solve_times_ms(file, &chain);
    let sum = board.iter().zip(&host).map(|(board, host)| board + host).collect();
    let share = |value: &str| format!("{value}; {LATENCY_S} s at 4 kHz: {} scans", board.len());
    row(
        "light to USB: median / p99 / max",
        quantiles(board.clone()),
        &share("last lit hold to the end of the packet that completes the batch"),
    );
    row(
        "bytes to pose: median / p99 / max",
        quantiles(host),
        "decode and solve on this machine, exact optics 1e-6; a batch's scans one after another",
    );
    row(
        "light to pose: median / p99 / max",
        quantiles(sum),
        "sum of the two, scan by scan; at most 2 ms for 99 % are asked for",
    );
    row("device time by wall time", format!("{:.2}", LATENCY_S / wall_s), "4 kHz, smooth motion, noise");
    row("emulated instructions", format!("{:.1} million a second", instructions as f64 / wall_s / 1e6), "the same");
}

/// For each scan, how long the host takes from the packet that completes its batch to its pose.
fn solve_times_ms(file: &SceneFile, chain: &Chain) -> Vec<f64> {
    let mut pipeline = Pipeline::new(file.clone(), WORLD_TIER, SceneMatch::Required);
    let mut times = Vec::new();
    for (_, bytes) in &chain.packets {
        let begun = Instant::now();
        let take = |item: Item<'_>| {
            if let Item::Pose(_) = item {
                times.push(begun.elapsed().as_secs_f64() * 1e3);
            }
            Ok::<_, PipelineError>(())
        };
        pipeline.push(bytes, take).expect("suits");
    }
    assert_eq!(times.len(), chain.scans.len());
    times
}
