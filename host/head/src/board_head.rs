//! Heads compiled for boards that solve poses themselves.

use slitpose_firmware::pose::{CellStage, Head, Readout};
use slitpose_model::{CompactError, Solver};
use slitpose_protocol::{AdcScaling, Hashes, Schedule};

use crate::front_end::Stage;
use crate::scene_file::SceneFile;

/// The head of `file` for a board that runs `schedule` with `scaling`, `hashes` those of what it is compiled from.
///
/// # Errors
/// If a cell has what the board does not compute.
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
