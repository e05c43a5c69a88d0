//! Heads compiled for boards that solve poses themselves.

use slitpose_firmware::pose::{CellStage, HEAD_BYTES, Head, HeadError, Readout};
use slitpose_model::{CompactError, Solver};
use slitpose_protocol::{AdcScaling, Hashes, Schedule};
use thiserror::Error;

use crate::front_end::Stage;
use crate::scene_file::SceneFile;

/// Why there is no head for a board.
#[derive(Debug, Error)]
pub enum BoardHeadError {
    /// A cell has what boards do not compute.
    #[error(transparent)]
    Compact(#[from] CompactError),
    /// It is too long.
    #[error(transparent)]
    TooLong(#[from] HeadError),
}

/// The bytes of [`compile`]'s head, as they are sent to the board.
pub fn encode(
    file: &SceneFile,
    schedule: &Schedule,
    scaling: &AdcScaling,
    hashes: Hashes,
) -> Result<Vec<u8>, BoardHeadError> {
    Ok(compile(file, schedule, scaling, hashes)?.encode(&mut [0; HEAD_BYTES])?.to_vec())
}

/// The head of `file` for a board that runs `schedule` with `scaling`, `hashes` those of what it is compiled from.
pub fn compile(
    file: &SceneFile,
    schedule: &Schedule,
    scaling: &AdcScaling,
    hashes: Hashes,
) -> Result<Head, CompactError> {
    let stage = Stage::new(file, schedule, scaling);
    let scene = Stage::weighted_scene(file, schedule, scaling);
    let solver = Solver::compact(&scene)?.with_exposures(&stage.exposures_s());
    let stages = (0..scene.cells.len()).map(|cell| {
        let (amperes_per_word, zero_word) = stage.line(cell);
        CellStage { amperes_per_word: amperes_per_word as f32, zero_word: zero_word as f32 }
    });
    let readout = Readout { hashes, schedule: schedule.clone(), scaling: *scaling, stages: stages.collect() };
    Ok(Head { readout, solver })
}

#[cfg(test)]
mod tests {
    use slitpose_model::Tier;
    use slitpose_protocol::{
        Command, Decoder, HeadPart, MAX_MESSAGE_BYTES, MAX_REQUEST_BYTES, Message, PoseRecord, Request, Stream, Truth,
        encode,
    };

    use super::*;
    use crate::scene_file::WIDE;
    use crate::simulator::{SimulatedBoard, Trajectory, TrajectoryKind};

    fn send(board: &mut SimulatedBoard, command: Command) {
        board.write(encode(&Request { number: 1, command }, &mut [0; MAX_REQUEST_BYTES]).expect("fits"));
    }

    /// A simulated board is a board: with a head it solves poses, and sends what it is asked for.
    #[test]
    fn a_simulated_board_solves_its_scans() {
        let file = WIDE.read().expect("shipped");
        let smooth = Trajectory::of_kind(TrajectoryKind::Smooth, 5, 1.0);
        let mut board = SimulatedBoard::new(&file, smooth, Tier::Exact { tolerance: 1e-6 }, 5).expect("runs");
        let mut decoder = Decoder::<MAX_MESSAGE_BYTES>::new();
        let mut bytes = Vec::new();
        board.transmit(&mut bytes);
        let mut hello = None;
        let mut rest = &bytes[..];
        while let Some(message) = decoder.next::<Message<'_>>(&mut rest) {
            if let Ok(Message::Hello(said)) = message {
                hello = Some((said.schedule, said.scaling));
            }
        }
        let (schedule, scaling) = hello.expect("said at once");
        let head = compile(&file, &schedule, &scaling, Hashes::default()).expect("slits and cosines");
        let mut room = [0; HEAD_BYTES];
        let whole = head.encode(&mut room).expect("six cells fit");
        HeadPart::all(whole).for_each(|part| send(&mut board, Command::Head(part)));
        send(&mut board, Command::Stream(Stream { scans: 0, poses: 1 }));
        send(&mut board, Command::Start);
        bytes.clear();
        (0..400).for_each(|_| board.step(&mut bytes));
        let (mut truths, mut poses) = (Vec::<Truth>::new(), Vec::<(u64, PoseRecord)>::new());
        let mut rest = &bytes[..];
        while let Some(message) = decoder.next::<Message<'_>>(&mut rest) {
            match message.expect("undamaged") {
                Message::Truth(truth) => truths.push(truth),
                Message::Poses(found) => {
                    assert_eq!(found.missed, 0);
                    poses.extend(found.iter(schedule.frame_ticks).map(|(sequence, _, record)| (sequence, record)));
                }
                Message::Batch(_) => panic!("scans were not asked for"),
                _ => {}
            }
        }
        assert!(poses.len() > 380, "{}", poses.len());
        for (sequence, record) in &poses {
            let truth = truths.iter().find(|truth| truth.sequence == *sequence).expect("of every scan");
            let off =
                (0..3).map(|i| (f64::from(record.translation_m[i]) - truth.translation_m[i]).powi(2)).sum::<f64>();
            // σ is 2 µm; of the first frames, whose motion is unknown, up to 25.
            assert!(off.sqrt() < if *sequence < 8 { 150e-6 } else { 15e-6 }, "frame {sequence}: {}", off.sqrt());
        }
    }

    /// Heads as calibrations find them: what is sent has room in the board's memory.
    #[test]
    fn calibrated_heads_fit_a_board() {
        let configuration = slitpose_firmware::pcb::default_configuration();
        for number in [1, 4] {
            let path = format!("{}/../../tests/data/heads/calibrated_{number}.toml", env!("CARGO_MANIFEST_DIR"));
            let file = SceneFile::open(&path).expect("a scene");
            let scaling = slitpose_firmware::pcb::default_scaling();
            let bytes = super::encode(&file, &configuration.schedule, &scaling, Hashes::default()).expect("computed");
            println!("calibrated_{number}: {} bytes", bytes.len());
            assert!((3_000..HEAD_BYTES).contains(&bytes.len()));
            let head = Head::decode(&bytes).expect("whole");
            assert_eq!(head.encode(&mut [0; HEAD_BYTES]).expect("room"), bytes);
        }
    }

    #[test]
    fn what_the_board_does_not_compute_is_named() {
        let mut file = WIDE.read().expect("shipped");
        let configuration = slitpose_firmware::pcb::default_configuration();
        file.scene.cells[3].effects.source_diameter_m = 0.3e-3;
        let refused =
            compile(&file, &configuration.schedule, &slitpose_firmware::pcb::default_scaling(), Hashes::default());
        let text = refused.expect_err("an extended source").to_string();
        assert!(text.contains("cell 3") && text.contains("an emitter that is no point"), "{text}");
    }
}
