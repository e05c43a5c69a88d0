//! Heads compiled for boards that solve poses themselves.

use slitpose_firmware::pose::{CellStage, HEAD_BYTES, Head, HeadError, Readout};
use slitpose_model::{CompactError, Solver};
use slitpose_protocol::{AdcScaling, Hashes, Schedule};
use thiserror::Error;

use crate::front_end::Stage;
use crate::scene_file::SceneFile;

/// Why there is no head for a board.
#[derive(Debug, Error)]
#[allow(missing_docs, reason = "the texts say what each is")]
pub enum BoardHeadError {
    #[error(transparent)]
    Compact(#[from] CompactError),
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
    use super::*;
    use crate::scene_file::WIDE;

    /// Heads as calibrations find them: what is sent has room in the board's memory.
    #[test]
    fn calibrated_heads_fit_a_board() {
        let configuration = slitpose_firmware::pcb::default_configuration();
        for number in [1, 4] {
            let path = format!("{}/../../tests/data/heads/calibrated_{number}.toml", env!("CARGO_MANIFEST_DIR"));
            let file = SceneFile::open(&path).expect("a scene");
            let scaling = slitpose_firmware::pcb::default_scaling();
            let bytes = encode(&file, &configuration.schedule, &scaling, Hashes::default()).expect("computed");
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
