//! Which part of captures is solved, and how.

use std::collections::BTreeSet;
use std::path::PathBuf;

use slitpose_calibration::CalibrationFileError;
use slitpose_head::faults::{Fault, FaultError, Faults};
use slitpose_head::foreign::printable;
use slitpose_head::scene_file::SceneFileError;
use slitpose_model::SceneError;
use thiserror::Error;

use crate::capture::CaptureError;
use crate::pipeline::PipelineError;
use crate::solving::Solving;

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

/// Why captures cannot be solved again.
#[derive(Debug, Error)]
#[allow(missing_docs, reason = "the texts say what each is")]
pub enum PlaybackError {
    #[error(transparent)]
    Capture(#[from] CaptureError),
    #[error(transparent)]
    SceneFile(#[from] SceneFileError),
    #[error(transparent)]
    Calibration(#[from] CalibrationFileError),
    #[error(transparent)]
    Scene(#[from] SceneError),
    #[error(transparent)]
    Fault(#[from] FaultError),
    #[error(transparent)]
    Board(#[from] PipelineError),
    #[error("{} is no regular file, as a pipe is none, and a capture is read more than once; write it to a file first", path.display())]
    NotAFile { path: PathBuf },
    #[error("{} is given twice; name each capture once", path.display())]
    Twice { path: PathBuf },
    #[error(
        "{} holds no scan: {bytes} bytes of links, {packets} readable packets{}; \
         give a capture written by `run --record` or `simulate`", path.display(), named(topics)
    )]
    NoScan { path: PathBuf, bytes: u64, packets: u64, topics: BTreeSet<String> },
    #[error("there is no scan from {from_s} s after the beginning of {} on; begin earlier", path.display())]
    Beyond {
        path: PathBuf,
        /// The beginning asked for, seconds.
        from_s: f64,
    },
    #[error("{} has no times to cut it by, as bytes of a port have none; solve it whole", path.display())]
    Timeless { path: PathBuf },
    #[error("--to {to_s} s does not lie behind --from {from_s} s; give a later end")]
    Range {
        /// The beginning, seconds.
        from_s: f64,
        /// The end, seconds.
        to_s: f64,
    },
}

fn named(topics: &BTreeSet<String>) -> String {
    let topics: Vec<_> = topics.iter().map(|topic| printable(topic).at_most(100).to_string()).collect();
    if topics.is_empty() { String::new() } else { format!(", topics {}", topics.join(", ")) }
}
