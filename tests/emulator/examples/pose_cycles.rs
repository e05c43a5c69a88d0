//! What poses cost on the board: load, latency, and in which functions the cycles go, while it follows a tool at 4 kHz
//! and sends scans and poses over USB. In the emulator, with the silicon's latencies.
//!
//! ```text
//! firmware/build && cargo run --release -p slitpose-emulator --example pose_cycles
//! ```

use std::collections::BTreeMap;

use slitpose_emulator::faults::Faults;
use slitpose_emulator::image::Image;
use slitpose_emulator::machine::Stop;
use slitpose_emulator::peripherals::Ticks;
use slitpose_emulator::rig::{Rig, open_pose_image};
use slitpose_emulator::world::NoiseSource;
use slitpose_firmware::pcb::{default_configuration, default_scaling};
use slitpose_head::board_head;
use slitpose_head::scene_file::SceneFile;
use slitpose_head::simulator::{Trajectory, TrajectoryKind};
use slitpose_protocol::{Command, Hashes, Stream};

const FUNCTIONS: usize = 40;

/// Frames noted, instruction by instruction.
const FRAMES: u64 = 400;

fn main() {
    let scene = std::env::args().nth(1).unwrap_or_else(|| "wide".to_owned());
    let skip: f64 = std::env::args().nth(2).map_or(0.1, |seconds| seconds.parse().expect("seconds"));
    let file = SceneFile::open(&scene).expect("a scene");
    let image = open_pose_image().expect("an image");
    let schedule = default_configuration().schedule;
    let head =
        board_head::compile(&file, &schedule, &default_scaling(), Hashes::default()).expect("a head for the board");
    let trajectory = Trajectory::of_kind(TrajectoryKind::Smooth, 17, 20.0);
    let mut rig = Rig::boot(&image, &file, trajectory, NoiseSource::Seeded(17), Faults::default()).expect("a board");
    rig.set_open(true);
    rig.run_for(0.1);
    rig.send_head(&head);
    let stream = std::env::args().nth(3).unwrap_or_else(|| "both".to_owned());
    rig.send(Command::Stream(Stream { scans: u16::from(stream != "pose"), poses: u8::from(stream != "raw") }));
    rig.run_for(1e-3);
    rig.send(Command::Start);
    rig.run_for(skip);
    let (mut profile, began) = (Profile::default(), rig.now());
    let end = began + FRAMES * Ticks::from(schedule.frame_ticks);
    let awake = rig.machine.awake_ticks();
    while rig.now() < end {
        let (pc, now) = (rig.machine.cpu.pc(), rig.now());
        let before = rig.machine.awake_ticks();
        assert_eq!(rig.run_until(now + 1), Stop::Reached);
        let spent = rig.machine.awake_ticks() - before;
        if spent > 0 {
            let at = profile.entry(pc).or_default();
            *at = (at.0 + 1, at.1 + spent);
        }
    }
    let spent = rig.machine.awake_ticks() - awake;
    println!("stack {} bytes at most", rig.stack_bytes());
    println!("load {:.1} %, {} cycles a frame", 100.0 * spent as f64 / (end - began) as f64, spent / FRAMES);
    println!("{:>8} {:>7}  function", "cycles", "calls");
    for (cycles, calls, name) in functions(&profile, &image).iter().take(FUNCTIONS) {
        println!("{:8.0} {:7.2}  {name}", *cycles as f64 / FRAMES as f64, *calls as f64 / FRAMES as f64);
    }
}

/// Times and cycles at each instruction.
type Profile = BTreeMap<u32, (u64, Ticks)>;

/// What the functions of `image` took, without those they call, dearest first: cycles, calls and name, as in the source; what
/// stands in no function has none. What the compiler has inlined counts for where it was put.
fn functions(profile: &Profile, image: &Image) -> Vec<(Ticks, u64, String)> {
    // A function's symbol has the lowest bit set: Thumb code.
    let functions: BTreeMap<u32, (u32, &str)> = image
        .symbols()
        .filter(|(_, symbol)| symbol.bytes > 0 && symbol.address & 1 == 1)
        .map(|(name, symbol)| (symbol.address & !1, (symbol.bytes, name)))
        .collect();
    let mut costs: BTreeMap<Option<u32>, (Ticks, u64, String)> = BTreeMap::new();
    for (&pc, &(times, cycles)) in profile {
        let around = functions.range(..=pc).next_back().filter(|(start, (bytes, _))| pc - **start < *bytes);
        let cost = costs.entry(around.map(|(start, _)| *start)).or_insert_with(|| {
            let name = around.map(|(_, (_, name))| format!("{:#}", rustc_demangle::demangle(name)));
            (0, 0, name.unwrap_or_default())
        });
        cost.0 += cycles;
        cost.1 += if around.is_some_and(|(start, _)| *start == pc) { times } else { 0 };
    }
    let mut costs: Vec<_> = costs.into_values().collect();
    costs.sort_by_key(|cost| std::cmp::Reverse(cost.0));
    costs
}
