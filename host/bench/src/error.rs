//! What can go wrong at a virtual bench.

use std::path::PathBuf;

use slitpose_head::foreign::printable;
use slitpose_head::front_end::TimingError;
use slitpose_head::scene_file::SceneFileError;
use slitpose_head::table::OutputError;
use slitpose_model::SceneError;
use thiserror::Error;

/// Why there is no bench.
#[derive(Debug, Error)]
pub enum BenchError {
    /// The scene.
    #[error(transparent)]
    SceneFile(#[from] SceneFileError),
    /// The optics.
    #[error(transparent)]
    Scene(#[from] SceneError),
    /// The electronics.
    #[error(transparent)]
    Timing(#[from] TimingError),
    /// A head that hardly has a usable pose.
    #[error(
        "seed {seed}, {table}: none of {tries} poses of the workspace has every spot on its detector and every current \
         within the converters' range; give another --seed, a smaller [workspace], or smaller tolerances"
    )]
    Dark {
        /// The table that was to be made.
        table: &'static str,
        /// Poses that were tried.
        tries: usize,
        /// The head.
        seed: u64,
    },
    /// A folder that holds something.
    #[error("{} holds files already, which may have been measured; give a new folder", printable(&folder.to_string_lossy()))]
    NotEmpty {
        /// The folder.
        folder: PathBuf,
    },
    /// A file that cannot be written.
    #[error(transparent)]
    Output(#[from] OutputError),
}
