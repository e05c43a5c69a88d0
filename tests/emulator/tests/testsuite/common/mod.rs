//! What the tests of the whole board share.

use self::listener::Listener;
use self::talk::Talk;
use slitpose_emulator::board::Board;
use slitpose_emulator::cpu::Size;
use slitpose_emulator::facts::{self, bits};
use slitpose_emulator::faults::{Fault, Faults};
use slitpose_emulator::peripherals::{TICKS_PER_SECOND, Ticks};
use slitpose_firmware::pcb::pins::{Row, rows};
use slitpose_firmware::pose::Head;
use slitpose_head::board_head;
use slitpose_head::scene_file::{SceneFile, WIDE};
use slitpose_head::simulator::{Trajectory, TrajectoryKind};
use slitpose_protocol::Hashes;

pub mod listener;
pub mod pins;
pub mod talk;

/// The variable that gives the silicon its faults: names, or `all`. Without it there are none.
const SILICON: &str = "SLITPOSE_SILICON";

/// Whether an event follows from a fault of the silicon that the tests run on.
pub fn is_of_silicon(text: &str) -> bool {
    silicon().has(Fault::HseDead) && text.contains("crystal")
}

/// Ticks by which a DMA transfer may come late: behind three others of its controller.
pub fn dma_ticks() -> u64 {
    if silicon().has(Fault::DmaLatency) { 4 * 60 } else { 0 }
}

/// Ticks by which the converters may see a trigger late: three to their clock's edge, and an eighth of a clock.
pub fn trigger_ticks() -> u64 {
    if silicon().has(Fault::TriggerPhase) { 4 } else { 0 }
}

pub fn us(ticks: Ticks) -> f64 {
    ticks as f64 * 1e6 / TICKS_PER_SECOND as f64
}

pub fn silicon() -> Faults {
    match std::env::var(SILICON) {
        Ok(faults) if !faults.is_empty() => {
            Faults::of_silicon(&faults).unwrap_or_else(|error| panic!("{SILICON}: {error}"))
        }
        _ => Faults::default(),
    }
}

/// Whether only the image that solves poses drives the pin.
pub fn is_for_poses(signal: &Row) -> bool {
    signal.note.ends_with("image with poses")
}

pub fn pin(signal: &str) -> &'static str {
    rows("signal").find(|row| row.name == signal).unwrap_or_else(|| panic!("no signal is called `{signal}`")).pin
}

/// Index of the port (0: A) and number of `pin`.
pub fn port_and_number(pin: &str) -> (u32, u32) {
    let port = pin.as_bytes()[1] - b'A';
    (port.into(), pin[2..].parse().expect("a number"))
}

/// Inputs of ADC1 and ADC2 by cell.
pub fn inputs() -> [[u8; 6]; 2] {
    let input = |electrode: usize, cell: usize| {
        let pin = pin(&format!("I_X{electrode} of cell {cell}"));
        bits(&format!("ADC{electrode}_IN_{pin}")) as u8
    };
    [1, 2].map(|electrode| std::array::from_fn(|cell| input(electrode, cell)))
}

pub fn level_line(emitter: usize) -> usize {
    let lines = ["level line of emitters 0 to 2", "level line of emitters 3 to 5"];
    let holds = |signal: &str| {
        let range = signal.strip_prefix("level line of emitters ").and_then(|range| range.split_once(" to "));
        let (first, last) = range.expect("a range");
        (first.parse().expect("a number")..=last.parse().expect("a number")).contains(&emitter)
    };
    let line = lines.iter().position(|line| holds(line)).expect("each emitter is on a line");
    // The first line is that of DAC1.
    assert!(pin(lines[line]) == facts::fact(["DAC1_OUT1", "DAC2_OUT1"][line]).value);
    line
}

/// The register at `offset` from `base`, both facts, and `more`.
pub fn register(board: &mut Board, base: &str, offset: &str, more: u32) -> u32 {
    read(board, bits(base) + bits(offset) + more)
}

/// The channel of DMA1, from 0, that serves `request`; its multiplexer channel has the same number.
pub fn channel_of(board: &mut Board, request: &str) -> usize {
    let number = bits(&format!("LL_DMAMUX_REQ_{request}"));
    let base = bits("DMAMUX1_BASE");
    let span = bits("DMAMUX1_Channel1_BASE") - base;
    let channel = (0..8).find(|&channel| read(board, base + span * channel) == number);
    channel.unwrap_or_else(|| panic!("no channel serves {request}, {number}")) as usize
}

fn read(board: &mut Board, address: u32) -> u32 {
    board.read(address, Size::Word).expect("it answers")
}

/// Of noise and motion.
pub const SEED: u64 = 17;

pub fn smooth() -> Trajectory {
    Trajectory::of_kind(TrajectoryKind::Smooth, SEED, 20.0)
}

/// The head `wide`.
pub fn scene() -> SceneFile {
    WIDE.read().expect("shipped")
}

/// The head `wide` with all that a calibration has found of its parts: tests/data/heads.
pub fn calibrated() -> SceneFile {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../data/heads/calibrated_1.toml");
    SceneFile::open(path).expect("a scene")
}

/// The head of `scene` for the schedule in force at the board that `ear` hears.
pub fn head_of(ear: &Listener, scene: &SceneFile) -> Head {
    let hashes = Hashes { scene: Some(scene.hash), calibration: None };
    let scaling = ear.hello().expect("a hello").scaling;
    board_head::compile(scene, ear.schedule(), &scaling, hashes).expect("a head for the board")
}

/// Pin PA8, which toggles with each pose.
pub fn is_ready_high(talk: &mut Talk) -> bool {
    talk.rig.machine.board.ports[0].driven_high() & 1 << 8 != 0
}
