//! What this build makes of two simulated seconds: a hash of what the board sends and one of the poses. They are the same in
//! every build on one machine; `tests/builds` compares them. Between machines that is not promised: their mathematical
//! functions round otherwise.
//!
//! `cargo run --release -p slitpose-head --example poses_of_this_build`

use std::fmt::Write;

use slitpose_head::front_end::{self, Stage};
use slitpose_head::scene_file::{SceneFile, WIDE, fnv1a_64};
use slitpose_head::simulator::{SimulatedBoard, Trajectory, TrajectoryKind};
use slitpose_model::{Solver, Tier, Tracker};
use slitpose_protocol::{Command, Decoder, MAX_MESSAGE_BYTES, Message};

const SEED: u64 = 5;
const DURATION_S: f64 = 2.0;
const TIER: Tier = Tier::Exact { tolerance: 1e-6 };
const FILTER_S: f64 = 5e-3;

fn main() {
    let file = WIDE.read().expect("a shipped scene");
    let bytes = sent(&file);
    let (poses, text) = poses(&file, &bytes);
    println!("bytes {:016x}, {poses} filtered poses {:016x}", fnv1a_64(&bytes), fnv1a_64(text.as_bytes()));
}

fn sent(file: &SceneFile) -> Vec<u8> {
    let configuration = front_end::configuration(file).expect("a board runs the scene");
    let scans = configuration.schedule.frame_rate_hz() * DURATION_S;
    let trajectory = Trajectory::of_kind(TrajectoryKind::Smooth, SEED, DURATION_S);
    let mut board = SimulatedBoard::new(file, trajectory, TIER, SEED).expect("a board runs the scene");
    board.ask(1, Command::Start);
    let mut bytes = Vec::new();
    (0..scans as usize).for_each(|_| board.step(&mut bytes));
    bytes
}

/// How many poses there are, and all that the tracker says of each scan: a number's text has each of its bits.
fn poses(file: &SceneFile, mut bytes: &[u8]) -> (usize, String) {
    let mut decoder = Decoder::<MAX_MESSAGE_BYTES>::new();
    let (mut session, mut poses, mut text) = (None, 0, String::new());
    while let Some(message) = decoder.next::<Message<'_>>(&mut bytes) {
        match message.expect("undamaged") {
            Message::Hello(hello) => {
                let stage = Stage::new(file, &hello.schedule, &hello.scaling);
                let scene = Stage::weighted_scene(file, &hello.schedule, &hello.scaling);
                let solver =
                    Solver::new(&scene, TIER).expect("a scene that compiles").with_exposures(&stage.exposures_s());
                let tracker = Tracker::new(solver, hello.schedule.frame_rate_hz().recip()).with_filter(FILTER_S);
                session = Some((hello.schedule, stage, tracker));
            }
            Message::Batch(batch) => {
                let (schedule, stage, tracker) = session.as_mut().expect("hello first");
                for scan in batch.scans(schedule).expect("readable") {
                    let tracked = tracker.track(scan.sequence, &stage.photocurrents(&scan));
                    poses += usize::from(tracked.filtered.is_some());
                    writeln!(text, "{tracked:?}").expect("text grows");
                }
            }
            _ => {}
        }
    }
    (poses, text)
}
