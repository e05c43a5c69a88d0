//! Captures of simulated boards, in memory.

use std::ops::Range;

use glam::{DQuat, DVec3};
use slitpose_head::front_end;
use slitpose_head::scene_file::SceneFile;
use slitpose_head::simulator::{SimulatedBoard, Trajectory};
use slitpose_model::{Pose, Tier};
use slitpose_protocol::{AdcScaling, Command, DELIMITER, Decoder, MAX_MESSAGE_BYTES, Message, RawScan, Schedule};
use slitpose_tracking::pipeline::{Counts, Item, Pipeline, PipelineError, Record, SceneMatch};

/// What streams are solved to by default.
pub const STREAM: Tier = Tier::Exact { tolerance: 1e-6 };

/// What a simulated board sends while it takes `scans` scans.
pub fn capture(file: &SceneFile, trajectory: Trajectory, tier: Tier, seed: u64, scans: usize) -> Vec<u8> {
    let configuration = front_end::configuration(file).unwrap_or_else(|error| panic!("{error}"));
    let mut board = SimulatedBoard::new(file, trajectory, tier, seed).unwrap_or_else(|error| panic!("{error}"));
    let mut bytes = Vec::new();
    board.ask(1, Command::Configure(configuration));
    board.ask(2, Command::Start);
    for _ in 0..scans {
        board.step(&mut bytes);
    }
    board.ask(3, Command::Stop);
    board.step(&mut bytes);
    bytes
}

pub fn pipeline(file: &SceneFile, tier: Tier) -> Pipeline {
    Pipeline::new(file.clone(), tier, SceneMatch::Required)
}

/// Solves a capture as `replay` does.
pub fn solve(file: &SceneFile, tier: Tier, bytes: &[u8]) -> (Vec<Record>, Counts) {
    let mut pipeline = pipeline(file, tier);
    let mut records = Vec::new();
    let pushed = pipeline.push(bytes, |item| {
        if let Item::Pose(record) = item {
            records.push(*record);
        }
        Ok::<_, PipelineError>(())
    });
    pushed.unwrap_or_else(|error| panic!("{error}"));
    (records, pipeline.counts())
}

#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Packet {
    /// Its bytes, delimiter included.
    pub bytes: Range<usize>,
    /// The scans it holds, by sequence number; empty for anything but a batch.
    pub scans: Range<u64>,
}

/// The packets of an undamaged capture, in order.
pub fn packets(bytes: &[u8]) -> Vec<Packet> {
    let mut packets = Vec::new();
    let mut schedule = None;
    let mut decoder = Decoder::<MAX_MESSAGE_BYTES>::new();
    let mut start = 0;
    for (at, _) in bytes.iter().enumerate().filter(|(_, byte)| **byte == DELIMITER) {
        let range = start..at + 1;
        start = at + 1;
        let mut rest = &bytes[range.clone()];
        let scans = match decoder.next::<Message<'_>>(&mut rest) {
            // A delimiter on its own.
            None => continue,
            Some(Ok(Message::Hello(hello))) => {
                schedule = Some(hello.schedule);
                0..0
            }
            Some(Ok(Message::Batch(batch))) => {
                let scans = batch.scans(schedule.as_ref().expect("hello first")).expect("readable batch");
                batch.sequence..batch.sequence + scans.len() as u64
            }
            Some(other) => {
                other.expect("undamaged");
                0..0
            }
        };
        packets.push(Packet { bytes: range, scans });
    }
    packets
}

/// What an undamaged capture of one configuration says.
#[derive(Clone, Debug)]
pub struct Decoded {
    /// When each cell is lit and sampled.
    pub schedule: Schedule,
    /// What a word is worth.
    pub scaling: AdcScaling,
    pub scans: Vec<RawScan>,
    pub truths: Vec<Pose>,
}

/// Reads an undamaged capture.
pub fn decode(mut bytes: &[u8]) -> Decoded {
    let mut decoder = Decoder::<MAX_MESSAGE_BYTES>::new();
    let (mut hello, mut scans, mut truths) = (None, Vec::new(), Vec::new());
    while let Some(message) = decoder.next::<Message<'_>>(&mut bytes) {
        match message.expect("undamaged") {
            Message::Hello(latest) => hello = Some((latest.schedule, latest.scaling)),
            Message::Batch(batch) => {
                let (schedule, _) = hello.as_ref().expect("hello first");
                scans.extend(batch.scans(schedule).expect("readable batch"));
            }
            Message::Truth(truth) => truths.push(Pose {
                rotation: DQuat::from_array(truth.rotation_xyzw),
                translation_m: DVec3::from_array(truth.translation_m),
            }),
            _ => {}
        }
    }
    let (schedule, scaling) = hello.expect("a hello");
    Decoded { schedule, scaling, scans, truths }
}
