//! A board that solves poses of a tool that moves.

use super::chain::Chain;
use super::silicon;
use slitpose_emulator::faults::Faults;
use slitpose_emulator::rig::open_pose_image;
use slitpose_emulator::world::NoiseSource;
use slitpose_firmware::pose::Head;
use slitpose_head::board_head;
use slitpose_head::scene_file::{SceneFile, WIDE};
use slitpose_head::simulator::{Trajectory, TrajectoryKind};
use slitpose_protocol::Hashes;

/// Of noise and motion.
pub const SEED: u64 = 17;

/// Of the tool.
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

/// The head of `scene` for the schedule that the board starts with.
pub fn head_of(chain: &Chain, scene: &SceneFile) -> Head {
    let (schedule, scaling) = (chain.schedule.as_ref().expect("a hello"), chain.scaling.expect("a hello"));
    let hashes = Hashes { scene: Some(scene.hash), calibration: None };
    board_head::compile(scene, schedule, &scaling, hashes).expect("a head for the board")
}

/// A board with the image that solves poses, its port open, and the head of `scene` sent to it.
pub fn chain(scene: &SceneFile, noise: NoiseSource) -> Chain {
    chain_of(scene, noise, silicon())
}

/// The same with `faults`.
pub fn chain_of(scene: &SceneFile, noise: NoiseSource, faults: Faults) -> Chain {
    println!("seed {SEED}");
    let image = open_pose_image().expect("an image");
    let mut chain = Chain::open_with(&image, scene, smooth(), noise, faults);
    let head = head_of(&chain, scene);
    chain.rig.send_head(&head);
    chain.run_for(1e-3);
    assert!(!chain.replies.is_empty() && chain.replies.iter().all(|&accepted| accepted), "{:?}", chain.replies);
    chain
}

/// Pin PA8, which toggles with each pose.
pub fn is_ready_high(chain: &mut Chain) -> bool {
    chain.rig.machine().board.driven_high(0) & 1 << 8 != 0
}
