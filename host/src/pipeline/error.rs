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
        /// Which message.
        source: SchemaMismatch,
    },
    /// The schedule in the hello contradicts itself.
    #[error("board `{}` announces a schedule that contradicts itself; update its firmware", printable(board))]
    Schedule {
        /// The board.
        board: String,
        /// What disagrees.
        source: ScheduleError,
    },
    /// The scaling in the hello cannot be used.
    #[error("board `{}` announces an ADC scaling that cannot be used; update its firmware", printable(board))]
    Scaling {
        /// The board.
        board: String,
        /// What is wrong.
        source: ScalingError,
    },
    /// Another number of cells.
    #[error(
        "board `{}` samples {board_cells} cells, scene `{scene}` has {scene_cells}; give the scene of this head",
        printable(board)
    )]
    Cells {
        /// The board.
        board: String,
        /// Its cells.
        board_cells: usize,
        /// The scene.
        scene: String,
        /// Its cells.
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
        /// Hash of the scene stored on it.
        board_hash: u64,
        /// The scene in use.
        scene: String,
        /// Its hash.
        scene_hash: u64,
    },
    /// The scene cannot be compiled.
    #[error(transparent)]
    Scene(#[from] SceneError),
}
