//! The best head within bounds: `slitpose scene optimise`.
//!
//! A candidate is a scene text: [`Quantity`]s are set in the scene that the search began with, and what is evaluated is
//! what is printed. [`Search::run`] looks at candidates spread over the bounds, and goes on from the best of them by
//! Nelder and Mead's simplex (1965): limits make kinks, where derivatives lead nowhere.

mod limits;
mod quantity;
mod score;
mod search;
mod text;

use slitpose_head::scene_file::SceneFileError;
use slitpose_model::SceneError;
use thiserror::Error;

pub use limits::{Excess, Excesses, Limit, Limits};
pub use quantity::{Free, Quantity};
pub use score::{Demand, Goal, Judge, Score};
pub use search::{Found, Search};

/// Why there is nothing to optimise.
#[derive(Debug, Error)]
pub enum OptimiseError {
    /// A scene that cannot be read, or a candidate of the search.
    #[error(transparent)]
    File(#[from] SceneFileError),
    /// A scene that cannot be computed.
    #[error(transparent)]
    Scene(#[from] SceneError),
    /// A search without anything to change.
    #[error("nothing is free to change; give it with --free, such as --free slit_width --free roll")]
    NothingFree,
    /// The scene's text.
    #[error("{origin}: {message}")]
    Text {
        /// The file.
        origin: String,
        /// What is wrong.
        message: String,
    },
    /// A quantity that needs a section.
    #[error(
        "{origin} has no [front_end], so there is no full scale to choose; leave full_scale out, or add the section"
    )]
    NoFrontEnd {
        /// The file.
        origin: String,
    },
}

#[cfg(test)]
mod tests;
