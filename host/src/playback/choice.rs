//! Which part of captures is solved, and how.

use std::path::PathBuf;

use slitpose_head::faults::{Fault, Faults};

use crate::solving::Solving;

use super::PlaybackError;

/// Which part of captures is solved, and how.
#[derive(Clone, Debug, Default)]
pub struct Choice {
    /// Scene file, or the name of a shipped scene, also if it is not the one of the capture.
    pub scene: Option<String>,
    /// Calibration, or `none`: the head is as its scene says. `None`: as it was known in the recording.
    pub calibration: Option<PathBuf>,
    /// Equations and filter, where they are not to be those of the recording.
    pub solving: Solving,
    /// Begin this long after the beginning, seconds.
    pub from_s: Option<f64>,
    /// End this long after the beginning, seconds.
    pub to_s: Option<f64>,
    /// End after so much time of the board's clock, seconds.
    pub duration_s: Option<f64>,
    /// Whether the cells of the heads are monitored.
    pub is_watched: bool,
    /// What is made of the scans.
    pub yields: Yields,
    /// Faults that are injected into the bytes of each board.
    pub faults: Vec<Fault>,
}

/// What is made of scans.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum Yields {
    /// Poses. From the beginning of a part on they are found from nothing.
    #[default]
    Poses,
    /// Poses as if the captures were solved from their beginning. All that comes before the part is decoded; of that, so
    /// many seconds before the part are solved, unheard. Whether that was enough is shown by
    /// [`Playback::seams`](super::Playback::seams).
    PosesOfPart {
        /// How much before the part is solved, seconds.
        warm_up_s: f64,
    },
    /// Photocurrents, unsolved.
    Currents,
}

impl Choice {
    pub(super) fn check(&self) -> Result<(), PlaybackError> {
        Faults::check_recording(&self.faults)?;
        match (self.from_s, self.to_s) {
            (Some(from_s), Some(to_s)) if to_s <= from_s => Err(PlaybackError::Range { from_s, to_s }),
            _ => Ok(()),
        }
    }
}
