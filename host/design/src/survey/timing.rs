//! How the lighting slots fill the frame.

use serde::Serialize;

use slitpose_head::scene_file::SceneFile;

/// Durations of slots and frame.
#[derive(Clone, Copy, Debug, Serialize)]
pub(crate) struct Timing {
    /// Lighting slots in a frame, the dark one included.
    pub slots: usize,
    /// Duration of one slot.
    pub slot_s: f64,
    /// Duration of all slots.
    pub busy_s: f64,
    /// Duration of a frame.
    pub frame_s: f64,
}

impl Timing {
    pub(super) fn of(file: &SceneFile) -> Option<Self> {
        let front_end = file.front_end?;
        let slot_s = front_end.slot_duration_s(file.scene.cells.len());
        let slots = file.lighting.slots.len();
        Some(Self { slots, slot_s, busy_s: slots as f64 * slot_s, frame_s: front_end.frame_period_s() })
    }
}
