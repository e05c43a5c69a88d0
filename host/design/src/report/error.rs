//! Why there is no report.

use slitpose_model::{Outcome, SceneError};
use thiserror::Error;

use slitpose_head::front_end::TimingError;

/// Why a scene cannot be studied.
#[derive(Debug, Error)]
pub enum ReportError {
    /// The optics.
    #[error(transparent)]
    Scene(#[from] SceneError),
    /// A head without a pose to give.
    #[error(
        "scene `{scene}` with its {cells} cells gives no pose at home: {}; \
         a study of poses needs a head that has one, such as the shipped scene `wide`", outcome.as_str()
    )]
    NoPose {
        /// The scene.
        scene: String,
        /// How many cells it has.
        cells: usize,
        /// The outcome at home.
        outcome: Outcome,
    },
    /// A workspace in which cells are dark nearly everywhere.
    #[error(
        "all cells of scene `{scene}` see light in {found} of {tried} poses of its workspace, {wanted} are wanted; \
         make [workspace] smaller, or give --poses {found}"
    )]
    TooFewLit {
        /// The scene.
        scene: String,
        /// Poses with all cells lit.
        found: usize,
        /// Poses tried.
        tried: usize,
        /// Poses wanted.
        wanted: usize,
    },
    /// A front end that cannot run.
    #[error(transparent)]
    Timing(#[from] TimingError),
}
