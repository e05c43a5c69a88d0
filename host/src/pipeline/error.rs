//! Why a board cannot be used.

use slitpose_model::SceneError;
use slitpose_protocol::schema::SchemaMismatch;
use slitpose_protocol::{ScalingError, ScheduleError};
use thiserror::Error;

use crate::link::Versions;
use slitpose_head::foreign::printable;

/// Why the pipeline cannot go on.
#[derive(Debug, Error)]
pub enum PipelineError {
    /// Board and host lay messages out differently.
    #[error("board `{}` and this program disagree on the protocol: {versions}", printable(board))]
    Schema {
        /// The board.
        board: String,
        /// Both versions.
        versions: Versions,
        /// The message that differs.
        source: SchemaMismatch,
    },
    /// The schedule in the hello contradicts itself.
    #[error("board `{}` announces a schedule that contradicts itself; update its firmware", printable(board))]
    Schedule {
        /// The board.
        board: String,
        /// The contradiction.
        source: ScheduleError,
    },
    /// The scaling in the hello cannot be used.
    #[error("board `{}` announces an ADC scaling that cannot be used; update its firmware", printable(board))]
    Scaling {
        /// The board.
        board: String,
        /// The fault of the scaling.
        source: ScalingError,
    },
    /// The board has another number of cells than the scene.
    #[error(
        "board `{}` samples {board_cells} cells, scene `{scene}` has {scene_cells}; give the scene of this head",
        printable(board)
    )]
    Cells {
        /// The board.
        board: String,
        /// The board's number of cells.
        board_cells: usize,
        /// The scene.
        scene: String,
        /// The scene's number of cells.
        scene_cells: usize,
    },
    /// The board belongs to another scene.
    #[error(
        "board `{}` belongs to the scene with hash {board_hash:016x}, but `{scene}` has {scene_hash:016x}; \
         give the scene it belongs to with --scene",
        printable(board)
    )]
    SceneHash {
        /// The board.
        board: String,
        /// Hash of the scene stored on the board.
        board_hash: u64,
        /// The scene in use.
        scene: String,
        /// Hash of the scene in use.
        scene_hash: u64,
    },
    /// The board belongs to another calibration.
    #[error(
        "board `{}` belongs to the calibration with hash {board_hash:016x}, but {} has {calibration_hash:016x}; give the \
         calibration it belongs to with --calibration, or store this one with `slitpose device set --scene … --calibration …`",
        printable(board),
        printable(calibration)
    )]
    CalibrationHash {
        /// The board.
        board: String,
        /// Hash of the calibration stored on the board.
        board_hash: u64,
        /// File of the calibration in use.
        calibration: String,
        /// Hash of the calibration in use.
        calibration_hash: u64,
    },
    /// The scene cannot be compiled.
    #[error(transparent)]
    Scene(#[from] SceneError),
}
