//! A board on the bench: what its host hears, and every change of its emitter pins and every
//! instant at which a converter holds a sample.

use super::talk::Listener;
pub use super::talk::Said;
pub use super::trial::endings::MS;
use super::{dma_ticks, silicon};
use slitpose_emulator::image::Image;
use slitpose_emulator::machine::Stop;
use slitpose_emulator::peripherals::{TICKS_PER_SECOND, Ticks};
use slitpose_emulator::rig::{Rig, WORLD_TIER, open_image};
use slitpose_emulator::world::{NoiseSource, OpticsWorld, World};
use slitpose_head::front_end::Stage;
use slitpose_head::scene_file::{SceneFile, Shipped};
use slitpose_head::simulator::{Trajectory, TrajectoryKind};
use slitpose_model::{CompiledScene, Pair, Pose, Reading};
use slitpose_protocol::{AdcScaling, Command, Configuration, Level, RawScan, Rejection, ResetCause, Schedule, Status};

/// Breaks of links by which every scan may be lost: what becomes of scans is no concern of these tests.
const MANY_BREAKS: u64 = 1_000;

/// Gates and level codes from `at` on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Drive {
    pub at: Ticks,
    pub gates: u8,
    pub levels: [u16; 2],
}

/// A converter holds the sample of an input.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Hold {
    pub at: Ticks,
    pub adc: u8,
    pub channel: u8,
}

/// A world that remembers what the board does to it.
#[derive(Debug)]
pub struct Recorder {
    world: OpticsWorld,
    now: Drive,
    pub drives: Vec<Drive>,
    pub holds: Vec<Hold>,
    pub records_holds: bool,
}

impl World for Recorder {
    fn drive(&mut self, at: Ticks, gates: u8, levels: [u16; 2]) {
        self.now = Drive { at, gates, levels };
        self.drives.push(self.now);
        self.world.drive(at, gates, levels);
    }

    fn sample(&mut self, at: Ticks, adc: u8, channel: u8) -> u16 {
        if self.records_holds {
            self.holds.push(Hold { at, adc, channel });
        }
        self.world.sample(at, adc, channel)
    }
}

/// A board, its host and a record of its pins.
pub struct Bench {
    pub rig: Rig<Recorder>,
    pub image: Image,
    pub scene: SceneFile,
    pub scaling: AdcScaling,
    pub ear: Listener,
}

pub fn wide() -> SceneFile {
    Shipped::named("wide").expect("it is shipped").read().expect("it is valid")
}

pub fn still() -> Trajectory {
    Trajectory::of_kind(TrajectoryKind::Still, 0, 0.0)
}

impl Bench {
    /// A board that has introduced itself, in front of a tool at rest at home, without noise.
    pub fn quiet() -> Self {
        Self::new(still(), NoiseSource::Off)
    }

    pub fn new(trajectory: Trajectory, noise: NoiseSource) -> Self {
        let image = open_image(None).expect("firmware/build makes it");
        let scene = wide();
        let world =
            OpticsWorld::new(&scene, trajectory, WORLD_TIER, noise, silicon()).expect("the board is made for it");
        let now = Drive { at: 0, gates: 0, levels: [0; 2] };
        let recorder = Recorder { world, now, drives: Vec::new(), holds: Vec::new(), records_holds: false };
        let mut bench = Self {
            rig: Rig::power_on(&image, recorder, silicon()),
            image,
            scene,
            scaling: slitpose_firmware::pcb::default_scaling(),
            ear: Listener::default(),
        };
        assert_eq!(bench.connect(), ResetCause::PowerOn);
        bench
    }

    /// Lets the host find the board and open its port; gives why the board started.
    pub fn connect(&mut self) -> ResetCause {
        // What was on its way when the board went is half a packet.
        self.listen();
        self.ear.forget_board();
        while self.rig.machine().device_clock_origin().is_none() {
            self.run_ms(1);
        }
        let origin = self.rig.machine().device_clock_origin().expect("the board has started its clock");
        self.rig.machine().board.world.world.set_origin(origin);
        let end = self.rig.now() + TICKS_PER_SECOND;
        while !self.rig.machine().board.usb_host.is_configured() {
            self.run_ms(1);
            assert!(self.rig.now() < end, "the board does not enumerate");
        }
        // A port that was open is opened again by the host itself.
        self.run_ms(5);
        self.rig.set_open(false);
        self.run_ms(5);
        self.open();
        for _ in 0..100 {
            self.run_ms(1);
            if let Some(hello) = self.ear.hello() {
                return hello.reset_cause;
            }
        }
        panic!("no hello: {:?}", self.ear.said);
    }

    /// Opens the port; half a packet that was left on the line belongs to nobody.
    pub fn open(&mut self) {
        self.listen();
        self.ear.begin_session();
        self.ear.breaks += MANY_BREAKS;
        self.rig.set_open(true);
    }

    /// Lets time pass and takes what comes.
    pub fn run_ms(&mut self, ms: u64) {
        let end = self.rig.now() + ms * MS;
        self.run_until(end);
    }

    pub fn run_until(&mut self, end: Ticks) {
        let stop = self.rig.run_until(end);
        assert!(matches!(stop, Stop::Reached | Stop::PoweredOff), "{stop:?}");
        self.listen();
    }

    pub fn listen(&mut self) {
        for (at, bytes) in self.rig.take_packets() {
            self.ear.hear(at, &bytes);
        }
    }

    /// Sends a command and waits for its reply; gives when that was over, and what it said.
    pub fn ask(&mut self, command: &Command) -> (Ticks, Result<(), Rejection>) {
        let number = self.rig.send(command.clone());
        let end = self.rig.now() + 100 * MS;
        while self.rig.now() < end {
            let next = self.rig.now() + MS / 10;
            self.run_until(next);
            if let Some(reply) = self.ear.said.iter().rev().find_map(|(at, said)| match said {
                Said::Reply(reply) if reply.number == number => Some((*at, reply.outcome)),
                _ => None,
            }) {
                return reply;
            }
        }
        panic!("no reply within 100 ms");
    }

    pub fn accept(&mut self, command: &Command) -> Ticks {
        let (at, outcome) = self.ask(command);
        assert_eq!(outcome, Ok(()), "{command:?}");
        at
    }

    pub fn forget(&mut self) {
        self.ear.clear();
        self.record().drives.clear();
        self.record().holds.clear();
    }

    pub fn record(&mut self) -> &mut Recorder {
        &mut self.rig.machine().board.world
    }

    pub fn gates(&mut self) -> u8 {
        self.record().now.gates
    }

    pub fn scans(&self) -> Vec<RawScan> {
        self.ear.scans.clone()
    }

    pub fn ask_status(&mut self) -> Status {
        self.ear.status = None;
        let end = self.rig.now() + 600 * MS;
        while self.ear.status.is_none() && self.rig.now() < end {
            self.run_ms(1);
        }
        self.last_status()
    }

    pub fn last_status(&self) -> Status {
        self.ear.status.expect("a status comes twice a second")
    }

    pub fn events(&self) -> Vec<&str> {
        self.ear.events()
    }

    /// The instant since which all gates have been off.
    pub fn dark_since(&mut self) -> Ticks {
        assert_eq!(self.gates(), 0, "lit");
        let drives = &self.record().drives;
        let last_lit = drives.iter().rposition(|drive| drive.gates != 0).expect("it was lit");
        drives[last_lit + 1].at
    }

    /// Starts, and lets a few frames pass.
    pub fn light(&mut self) {
        self.accept(&Command::Start);
        self.run_ms(5);
        assert!(self.record().drives.iter().rev().take(8).any(|drive| drive.gates != 0), "it lights");
    }

    /// The program has kept to the manuals.
    pub fn assert_no_faults(&self) {
        let faults = self.rig.faults();
        assert!(faults.is_empty(), "{faults:#?}");
        assert_eq!(self.ear.damaged(), 0, "the line is clean");
    }
}

/// Runs `configuration` for `ms` from a Start on, then stops; gives the scans and the tick at which
/// the first frame began on the pins.
pub fn run(bench: &mut Bench, configuration: &Configuration, ms: u64) -> (Vec<RawScan>, Ticks) {
    bench.accept(&Command::Configure(configuration.clone()));
    bench.forget();
    bench.record().records_holds = true;
    bench.accept(&Command::Start);
    bench.run_ms(ms);
    let schedule = &configuration.schedule;
    let period = if schedule.slots.len() == 1 { schedule.frame_ticks } else { schedule.slot_ticks };
    let zero = bench.rig.machine().board.timers[0].origin().expect("the frame timer runs");
    bench.accept(&Command::Stop);
    // What the link still holds.
    bench.run_ms(5);
    bench.record().records_holds = false;
    let lit_slots = configuration.schedule.slots.iter().enumerate().find(|(_, set)| !set.is_dark());
    let (slot, set) = lit_slots.expect("a schedule has light");
    let lit = bench.record().drives.iter().find(|drive| drive.gates != 0).expect("it lights");
    assert_eq!(lit.gates, set.0 as u8, "the first lit slot comes first");
    let seen = lit.at - slot as u64 * u64::from(configuration.schedule.slot_ticks);
    // The first update of the timer, which starts at the end of a period.
    let start = zero + u64::from(period);
    assert!((0..=dma_ticks()).contains(&(seen - start)), "{} ticks from the timer to the pins", seen - start);
    (bench.scans(), start)
}

/// Checks that `scans` follow one another one frame apart and none is missing.
pub fn check_counters(scans: &[RawScan], schedule: &Schedule) {
    for pair in scans.windows(2) {
        assert_eq!(pair[1].sequence, pair[0].sequence + 1, "sequence");
        assert_eq!(pair[1].tick, pair[0].tick + u64::from(schedule.frame_ticks), "tick of {}", pair[1].sequence);
    }
}

/// Ticks from the pins' first edge to the tick of the first scan: the same for all scans, as their
/// ticks and the pins' frames both are one frame apart.
pub fn tick_offset(bench: &mut Bench, scans: &[RawScan], start: Ticks) -> i64 {
    let origin = bench.rig.machine().device_clock_origin().expect("the clock runs");
    (origin + scans[0].tick) as i64 - start as i64
}

/// Light on `cell` in its slot, for a level of its own emitter of 1.
pub fn light_on(
    plan: &CompiledScene<f64>,
    schedule: &Schedule,
    cell: usize,
    levels: &[Level],
    pose: &Pose,
) -> Pair<f64> {
    let slot = schedule.lit_slot(cell).expect("each cell is lit");
    let mut sum = Pair::<f64>::default();
    for emitter in schedule.slots[slot].emitters() {
        let pair = plan.crosstalk(cell, emitter, pose);
        let share = levels[emitter].relative() / levels[cell].relative();
        sum.i_x1_a += share * pair.i_x1_a;
        sum.i_x2_a += share * pair.i_x2_a;
    }
    sum
}

/// The largest difference between what the host's front end makes of `scans` and the light of the
/// model on each cell, a tool at rest at home, in codes of one conversion.
pub fn worst_codes(bench: &Bench, scans: &[RawScan], configuration: &Configuration) -> f64 {
    let Configuration { schedule, .. } = configuration;
    let stage = Stage::new(&bench.scene, schedule, &bench.scaling);
    let plan = CompiledScene::<f64>::compile(&bench.scene.scene, WORLD_TIER).expect("the scene is valid");
    let cells = usize::from(schedule.cells);
    let expected: Vec<_> =
        (0..cells).map(|cell| light_on(&plan, schedule, cell, scans[0].levels(), &Pose::HOME)).collect();
    let mut worst: f64 = 0.0;
    for scan in scans {
        let currents = stage.photocurrents(scan);
        for (cell, expected) in expected.iter().enumerate() {
            let Reading::Light(seen) = currents.cells[cell] else {
                panic!("scan {}, cell {cell}: {:?}", scan.sequence, currents.cells[cell]);
            };
            let code_a = bench.scaling.amperes_per_code.abs() / scan.levels()[cell].relative();
            let differences = [seen.i_x1_a - expected.i_x1_a, seen.i_x2_a - expected.i_x2_a];
            worst = differences.iter().map(|a| (a / code_a).abs()).fold(worst, f64::max);
        }
    }
    worst
}
