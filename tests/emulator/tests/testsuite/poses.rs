//! The image that solves poses: every frame, at 4 kHz, beside its scans.

use crate::common::chain::Chain;
use crate::common::silicon;
use slitpose_emulator::rig::open_pose_image;
use slitpose_emulator::world::NoiseSource;
use slitpose_firmware::pose::{HEAD_BYTES, Head};
use slitpose_head::board_head;
use slitpose_head::scene_file::{SceneFile, WIDE};
use slitpose_head::simulator::{Trajectory, TrajectoryKind};
use slitpose_protocol::{Command, HEAD_PART_BYTES, Hashes, HeadPart};

const SEED: u64 = 17;

/// A board with the image that solves poses, its port open, and the head of `scene` sent to it.
fn chain(scene: &SceneFile, trajectory: Trajectory, noise: NoiseSource) -> (Chain, Head) {
    let image = open_pose_image().expect("an image");
    let mut chain = Chain::open_with(&image, scene, trajectory, noise, silicon());
    let (schedule, scaling) = (chain.schedule.clone().expect("a hello"), chain.scaling.expect("a hello"));
    let hashes = Hashes { scene: Some(scene.hash), calibration: None };
    let head = board_head::compile(scene, &schedule, &scaling, hashes).expect("a head for the board");
    chain.rig.send(Command::Ping { token: 1 });
    chain.run_for(0.01);
    println!("pinged {:?} {:?}", chain.replies, chain.rig.machine().resets());
    chain.rig.send(Command::Start);
    chain.run_for(0.1);
    println!("started {:?} {:?} scans {}", chain.replies, chain.rig.machine().resets(), chain.scans.len());
    send(&mut chain, &head);
    (chain, head)
}

fn send(chain: &mut Chain, head: &Head) {
    let mut bytes = [0; HEAD_BYTES];
    let bytes = head.encode(&mut bytes).expect("room");
    println!("a head of {} bytes", bytes.len());
    for (index, part) in bytes.chunks(HEAD_PART_BYTES).enumerate() {
        chain.rig.send(Command::Head(HeadPart {
            offset: (index * HEAD_PART_BYTES) as u16,
            total: bytes.len() as u16,
            bytes: part.iter().copied().collect(),
        }));
        chain.run_for(2e-3);
    }
    let machine = chain.rig.machine();
    println!(
        "sp {:x} pc {:x} resets {:?} fault {:?}",
        machine.cpu.min_sp(),
        machine.cpu.pc(),
        machine.resets(),
        machine.cpu.last_fault()
    );
    assert!(chain.replies.iter().all(|&accepted| accepted), "{:?}", chain.replies);
}

#[test]
fn every_frame_of_ten_seconds_is_solved_on_the_board() {
    let file = WIDE.read().expect("shipped");
    let seconds: u32 = std::env::var("SECS").ok().and_then(|s| s.parse().ok()).unwrap_or(10);
    println!("seed {SEED}");
    let trajectory = Trajectory::of_kind(TrajectoryKind::Smooth, SEED, 20.0);
    let (mut chain, head) = chain(&file, trajectory, NoiseSource::Off);
    chain.rig.send(Command::Start);
    for _ in 0..seconds {
        chain.run_for(1.0);
        println!("{:?}", chain.status);
    }
    println!("scans {} poses {} missed {}", chain.scans.len(), chain.poses.len(), chain.missed);
    let mut ready: Vec<u32> = chain.poses.iter().map(|(_, (_, _, pose))| u32::from(pose.ready) * 64).collect();
    let last = chain.schedule.as_ref().unwrap().last_sample_ticks() as u32;
    ready.sort_unstable();
    let us = |t: u32| (t - last) as f64 / 170.0;
    println!(
        "exposure to pose: min {} median {} max {}",
        us(ready[0]),
        us(ready[ready.len() / 2]),
        us(ready[ready.len() - 1])
    );
    for (_, (n, _, p)) in chain.poses.iter().take(8) {
        println!("{n} {p:?}");
    }
    let _ = head;
}
