//! A scene without a board: what a frame would say where the tool is dragged to.

use axum::extract::ws::Utf8Bytes;
use slitpose_calibration::Head;
use slitpose_design::map::{NoiseOf, Outlook};
use slitpose_model::{Pose, SceneError};

use super::frame::Optics;
use super::hub::text_of;

/// A head to look at.
pub(crate) struct SceneView {
    outlook: Outlook,
    optics: Optics,
}

impl SceneView {
    /// Of `head`.
    ///
    /// # Errors
    /// If its scene cannot be computed.
    pub(crate) fn of(head: &Head) -> Result<Self, SceneError> {
        Ok(Self { outlook: Outlook::of(head.clone())?, optics: Optics::of(head)? })
    }

    /// The frame, number `n`, with the tool at rest at `pose`; accuracy is the Cramér–Rao bound, and absent where the scene
    /// states no noise.
    pub(super) fn frame(&self, n: u64, pose: &Pose) -> Option<Utf8Bytes> {
        let (readings, solution) = self.outlook.frame_at(pose);
        let mut frame = self.optics.solved(0, n, &solution, &readings);
        if self.outlook.noise == NoiseOf::Nothing {
            frame.forget_accuracy();
        }
        text_of(&frame)
    }
}
