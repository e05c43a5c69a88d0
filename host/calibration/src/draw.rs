//! A head drawn from the tolerances of its parts.

use slitpose_head::scene_file::SceneFile;
use slitpose_model::{Scene, SceneError};

use crate::{Parameter, Quantity, prior};

/// A head whose parts deviate from the scene of `file` by chance, as its tolerances say: its optics, and every parameter
/// as it is, with a standard deviation of zero. `normal` gives standard normal numbers.
///
/// # Errors
/// Those of [`slitpose_model::Plan::compile`].
pub fn draw(file: &SceneFile, mut normal: impl FnMut() -> f64) -> Result<(Scene, Vec<Parameter>), SceneError> {
    let mut parameters = prior::parameters(file)?;
    for entry in &mut parameters.entries {
        entry.value = entry.prior + entry.prior_sigma * normal();
        // Light adds; a scene's own may be less.
        if matches!(entry.quantity, Quantity::Stray(_)) && entry.prior > 0.0 {
            entry.value = entry.value.abs();
        }
        entry.sigma = 0.0;
    }
    Ok((parameters.scene(&file.scene), parameters.entries))
}
