//! A board on faulty silicon, from power-on to the end of its light: whether each word is the model's, and whether it
//! is dark in time and stays dark.

#![allow(dead_code, reason = "each program uses its part")]

use super::chain::Chain;
use slitpose_emulator::faults::{Fault, Faults};
use slitpose_emulator::image::Image;
use slitpose_emulator::memory::FLASH_BASE;
use slitpose_emulator::peripherals::{TICKS_PER_SECOND, Ticks};
use slitpose_emulator::rig::Rig;
use slitpose_emulator::world::{NoiseSource, World};
use slitpose_firmware::pcb::{default_configuration, default_scaling};
use slitpose_head::scene_file::{SceneFile, WIDE};
use slitpose_head::simulator::{Trajectory, TrajectoryKind};
use slitpose_model::{CompiledScene, Tier};
use slitpose_protocol::{AdcScaling, Command, RawScan, Schedule};

/// Dark between two starts, in seconds: shorter and longer than what makes a converter stale (1 ms), and longer than
/// a session that breaks.
const PAUSES_S: [f64; 3] = [0.5e-3, 5e-3, 50e-3];

/// How long it must stay dark, with its cause and without.
const DARK_TICKS: Ticks = 100 * MS;

#[derive(Clone, Copy, Debug)]
pub struct Plan {
    pub silicon: Faults,
    pub ending: Ending,
    /// Light before the end, in seconds, in four starts.
    pub seconds: f64,
    /// Seed of the tool's motion, and of when the light ends.
    pub seed: u64,
}

#[derive(Clone, Debug)]
pub struct Outcome {
    pub scans: usize,
    /// Those of which a word is not the model's.
    pub wrong: usize,
    /// Those whose tick is not that of their number.
    pub misplaced: usize,
    pub missing: u64,
    /// Furthest that a word's mean code is from the model's.
    pub worst_codes: f64,
    /// How long it was lit after its end.
    pub lit_ticks: Ticks,
    pub relit: bool,
    /// What the program did against the manuals before its end.
    pub faults: Vec<String>,
}

impl Plan {
    /// Lets a board with `image` live this life.
    ///
    /// # Errors
    /// Naming what is not as it must be.
    pub fn carry_out(&self, image: &Image) -> Result<Outcome, String> {
        let trajectory = || Trajectory::of_kind(TrajectoryKind::Smooth, self.seed, 20.0);
        let file = WIDE.read().expect("shipped");
        let mut chain = Chain::open_with(image, &file, trajectory(), NoiseSource::Off, self.silicon);
        for pause_s in PAUSES_S {
            command(&mut chain, &Command::Start)?;
            chain.run_for(self.seconds / 4.0);
            command(&mut chain, &Command::Stop)?;
            chain.run_for(pause_s);
        }
        command(&mut chain, &Command::Start)?;
        // Another phase of frames, polls and the bus for each seed.
        chain.run_for(self.seconds / 4.0 + (self.seed % 997) as f64 * 7.3e-6);
        // A host hears no answer from a core that stands still: what is against the manuals counts until here.
        let faults = chain.rig.faults();
        let (lit_ticks, relit) = self.end(&mut chain, image);

        let model = Model::new(&file, trajectory());
        let mut outcome = Outcome {
            scans: chain.scans.len(),
            wrong: 0,
            misplaced: 0,
            missing: 0,
            worst_codes: 0.0,
            lit_ticks,
            relit,
            faults,
        };
        for (_, scan) in &chain.scans {
            let off = difference(scan, &model.frame(scan.tick));
            outcome.wrong += usize::from(off > TOLERANCE_CODES);
            outcome.worst_codes = outcome.worst_codes.max(off);
        }
        for pair in chain.scans.windows(2) {
            let [(_, one), (_, next)] = pair else { unreachable!("two") };
            let numbers = next.sequence.wrapping_sub(one.sequence);
            outcome.missing += numbers.wrapping_sub(1);
            // Numbers go on over a pause, ticks do not.
            let goes_on = next.tick.wrapping_sub(one.tick) == numbers.wrapping_mul(FRAME_TICKS);
            outcome.misplaced += usize::from(!goes_on);
        }
        // The pauses.
        outcome.misplaced = outcome.misplaced.saturating_sub(PAUSES_S.len());
        outcome.judge(self)
    }

    /// Ends the light; gives for how long it went on, and whether there was light again.
    fn end(&self, chain: &mut Chain, image: &Image) -> (Ticks, bool) {
        const INSISTS_EVERY: Ticks = 20 * MS;
        chain.rig.machine().board.log_gates();
        until_lit_and_awake(&mut chain.rig);
        chain.rig.machine().board.take_gate_log();
        let event = chain.rig.now();
        let end = event + self.ending.most_ticks(self.silicon) + DARK_TICKS;
        self.ending.happen(&mut chain.rig, image);
        while chain.rig.now() < end {
            let next = (chain.rig.now() + INSISTS_EVERY).min(end);
            chain.rig.run_until(next);
            if chain.rig.machine().board.gates() != 0 {
                self.ending.insist(&mut chain.rig);
            }
        }
        let dark = match last_light(&mut chain.rig) {
            (Some(dark), false) => dark,
            _ => end,
        };
        let lit_ticks = dark - event;
        self.ending.pass(&mut chain.rig);
        // With its last words.
        chain.run_for(DARK_TICKS as f64 / TICKS_PER_SECOND as f64);
        let relit = chain.rig.machine().board.take_gate_log().iter().any(|edge| edge.gates != 0);
        (lit_ticks, relit)
    }
}

impl Outcome {
    fn judge(self, plan: &Plan) -> Result<Self, String> {
        let most_ticks = plan.ending.most_ticks(plan.silicon);
        // A USB host that breaks sessions costs scans; nothing else may.
        let may_miss = plan.silicon.has(Fault::UsbHost);
        match &self {
            _ if self.scans == 0 => Err("no scan".to_owned()),
            Self { wrong, .. } if *wrong > 0 => Err(format!("{wrong} scans are {} codes off", self.worst_codes)),
            Self { misplaced, .. } if *misplaced > 0 => Err(format!("{misplaced} scans are not where they belong")),
            Self { missing, .. } if *missing > 0 && !may_miss => Err(format!("{missing} scans are missing")),
            Self { lit_ticks, .. } if *lit_ticks > most_ticks => {
                Err(format!("lit for {lit_ticks} of {most_ticks} ticks"))
            }
            Self { relit: true, .. } => Err("lit again".to_owned()),
            Self { faults, .. } if !faults.is_empty() => Err(faults.join("; ")),
            _ => Ok(self),
        }
    }
}

/// Says a command until it is accepted, however often a session breaks meanwhile.
fn command(chain: &mut Chain, command: &Command) -> Result<(), String> {
    for attempt in 0..2_000 {
        if attempt % 40 == 0 {
            chain.rig.send(command.clone());
        }
        chain.run_for(0.5e-3);
        if std::mem::take(&mut chain.replies).contains(&true) {
            return Ok(());
        }
    }
    Err(format!("{command:?} was never accepted"))
}

pub const MS: Ticks = TICKS_PER_SECOND / 1_000;

/// From an event of the supply or a fault to the gates: an exception's entry, some ten instructions from flash, and
/// whatever runs with interrupts off, 250 ticks at most.
pub const AT_ONCE_TICKS: Ticks = 500;

/// What a guard waits that sees that the schedule stands still: less than two slots of the default configuration.
pub const HALTED_TICKS: Ticks = 2 * 5_800;

/// A host that is gone is waited for 500 ms (firmware/README.md, "Emitter safety"). A closed port is known after a
/// request of the bus, a pulled cable after 3 ms without frames (USB 2.0, 7.1.7.6), both at the next poll, 1 ms.
const GONE_TICKS: Ticks = 505 * MS;

/// Supply at which the voltage detector reacts, and below which the brown-out reset holds the device, in volts.
const LOW_V: f64 = 2.8;
const BROWN_OUT_V: f64 = 1.6;
/// The supply as it should be, in volts.
const FULL_V: f64 = 3.3;

/// A way in which the light ends.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Ending {
    Stop,
    ClosedPort,
    PulledCable,
    LowSupply,
    BrownOut,
    ResetPin,
    Panic,
    Hang,
    Halt,
    DeadCrystal,
}

impl Ending {
    pub const ALL: [Self; 10] = [
        Self::Stop,
        Self::ClosedPort,
        Self::PulledCable,
        Self::LowSupply,
        Self::BrownOut,
        Self::ResetPin,
        Self::Panic,
        Self::Hang,
        Self::Halt,
        Self::DeadCrystal,
    ];

    /// Whether it can happen: a crystal that has never run cannot stop.
    pub fn is_possible(self, silicon: Faults) -> bool {
        self != Self::DeadCrystal || !silicon.has(Fault::HseDead)
    }

    /// Longest time that the light may go on.
    pub fn most_ticks(self, silicon: Faults) -> Ticks {
        match self {
            // A frame of the bus until the command is there, and a poll.
            Self::Stop if !silicon.has(Fault::UsbHost) => 2 * MS,
            // A command that is lost with its session is said again; a host that does not come back is gone.
            Self::Stop | Self::ClosedPort | Self::PulledCable => GONE_TICKS,
            Self::LowSupply if silicon.has(Fault::PvdSlow) => AT_ONCE_TICKS + MS / 10,
            Self::LowSupply | Self::Panic | Self::DeadCrystal => AT_ONCE_TICKS,
            Self::BrownOut | Self::ResetPin => 0,
            // The watchdog's 100 ms and 2 % of its clock.
            Self::Hang => 102 * MS,
            Self::Halt => HALTED_TICKS,
        }
    }

    /// Lets it happen to a board that runs `image`.
    pub fn happen<W: World>(self, rig: &mut Rig<W>, image: &Image) {
        match self {
            Self::Stop => {
                rig.send(Command::Stop);
            }
            Self::ClosedPort => rig.set_open(false),
            Self::PulledCable => rig.set_cable(false),
            Self::LowSupply => rig.machine().set_supply_v(LOW_V),
            Self::BrownOut => rig.machine().set_supply_v(BROWN_OUT_V),
            Self::ResetPin => rig.machine().pull_reset_pin(),
            Self::Panic => jump(rig, find_function(image, "panic_bounds_check")),
            Self::Hang => hang(rig),
            Self::Halt => {
                let end = rig.now() + 150 * MS;
                rig.machine().halt_until(end);
            }
            Self::DeadCrystal => rig.machine().board.stop_crystal(),
        }
    }

    /// What the host says again until the board has heard it.
    pub fn insist<W: World>(self, rig: &mut Rig<W>) {
        if self == Self::Stop {
            rig.send(Command::Stop);
        }
    }

    /// The cause is gone: supply, port and cable are as they were.
    pub fn pass<W: World>(self, rig: &mut Rig<W>) {
        rig.machine().set_supply_v(FULL_V);
        match self {
            Self::ClosedPort => rig.set_open(true),
            Self::PulledCable => rig.set_cable(true),
            _ => {}
        }
    }
}

/// Lets time pass until the core is awake in thread mode and a gate is on, so that the event that comes next finds the
/// light on.
pub fn until_lit_and_awake<W: World>(rig: &mut Rig<W>) {
    let end = rig.now() + 100 * MS;
    while rig.now() < end {
        let before = rig.machine().cpu.instructions();
        rig.run_until(rig.now() + 1);
        let cpu = &rig.machine().cpu;
        if cpu.instructions() != before && cpu.exception() == 0 && rig.machine().board.gates() != 0 {
            return;
        }
    }
    panic!("never lit and awake");
}

/// Lets the main loop end in a loop of its own, `B .`; interrupts go on.
pub fn hang<W: World>(rig: &mut Rig<W>) {
    let address = find_instruction(rig, 0xE7FE);
    jump(rig, address);
}

/// Sends the core to `address`.
pub fn jump<W: World>(rig: &mut Rig<W>, address: u32) {
    let cpu = &mut rig.machine().cpu;
    let mut state = cpu.state();
    state.r[15] = address;
    cpu.set_state(&state);
}

/// Address of an instruction `half` in the image. It is jumped to, so that where it stands does not matter.
pub fn find_instruction<W: World>(rig: &mut Rig<W>, half: u16) -> u32 {
    let code = rig.machine().board.flash_array().bytes();
    let offset = code.chunks_exact(2).position(|bytes| bytes == half.to_le_bytes());
    FLASH_BASE + 2 * offset.expect("the image has one") as u32
}

/// Address of the function whose mangled name contains `name`.
pub fn find_function(image: &Image, name: &str) -> u32 {
    let mut symbols = image.symbols().filter(|(symbol, _)| symbol.contains(name));
    symbols.next().expect("the image has it").1.address
}

/// When the gates were last lit, by the log since it was last taken, and whether they are now.
pub fn last_light<W: World>(rig: &mut Rig<W>) -> (Option<Ticks>, bool) {
    let edges = rig.machine().board.take_gate_log();
    let is_lit = rig.machine().board.gates() != 0;
    (edges.iter().rev().find(|edge| edge.gates == 0).map(|edge| edge.at), is_lit)
}

/// Ticks from one frame to the next in the default configuration.
pub const FRAME_TICKS: u64 = 42_500;

/// Furthest a mean code may be from the model's. Each conversion is rounded to a whole code, so
/// their mean is off by up to ½ when all four fall to one side. The rest is how far the emulated
/// light is from the optics at the instant: it is linear within 35 µs (0.01 code), and what reaches
/// a cell from the emitter of another is taken to 1e-3.
pub const TOLERANCE_CODES: f64 = 0.5 + 0.02;

/// What words should be, from optics, schedule and scaling alone.
pub struct Model {
    own: CompiledScene<f64>,
    stray: CompiledScene<f64>,
    trajectory: Trajectory,
    schedule: Schedule,
    scaling: AdcScaling,
    time_constant_ticks: f64,
    half_dark_a: Vec<f64>,
}

/// A mean code of I_X1 and of I_X2.
pub type Codes = [f64; 2];

impl Model {
    pub fn new(file: &SceneFile, trajectory: Trajectory) -> Self {
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
    pub fn frame(&self, tick: u64) -> [Vec<Codes>; 2] {
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
pub fn difference(scan: &RawScan, expected: &[Vec<Codes>; 2]) -> f64 {
    let oversampling = 4.0;
    let words = [scan.lit(), scan.dark().expect("dark words")];
    let pairs = words.iter().zip(expected).flat_map(|(words, expected)| words.iter().zip(expected));
    pairs
        .flat_map(|(words, codes)| words.iter().zip(codes))
        .map(|(&word, code)| (f64::from(word) / oversampling - code).abs())
        .fold(0.0, f64::max)
}
