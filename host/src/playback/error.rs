//! Why captures cannot be solved again.

use std::collections::BTreeSet;
use std::path::PathBuf;

use slitpose_calibration::CalibrationFileError;
use slitpose_head::faults::FaultError;
use slitpose_head::foreign::printable;
use slitpose_head::scene_file::SceneFileError;
use slitpose_model::SceneError;
use thiserror::Error;

use crate::capture::CaptureError;
use crate::pipeline::PipelineError;

/// Why captures cannot be solved again.
#[derive(Debug, Error)]
pub enum PlaybackError {
    /// A file that cannot be read.
    #[error(transparent)]
    Capture(#[from] CaptureError),
    /// The scene that was asked for, or that of the capture.
    #[error(transparent)]
    SceneFile(#[from] SceneFileError),
    /// The calibration.
    #[error(transparent)]
    Calibration(#[from] CalibrationFileError),
    /// The optics of the scene.
    #[error(transparent)]
    Scene(#[from] SceneError),
    /// A fault that cannot be injected.
    #[error(transparent)]
    Fault(#[from] FaultError),
    /// A board that does not suit the scene.
    #[error(transparent)]
    Board(#[from] PipelineError),
    /// Captures are read more than once.
    #[error("{} is no regular file, as a pipe is none, and a capture is read more than once; write it to a file first", path.display())]
    NotAFile {
        /// What was given.
        path: PathBuf,
    },
    /// Its scans would count twice.
    #[error("{} is given twice; name each capture once", path.display())]
    Twice {
        /// The file.
        path: PathBuf,
    },
    /// A capture without a single scan.
    #[error(
        "{} holds no scan: {bytes} bytes of links, {packets} readable packets{}; \
         give a capture written by `run --record` or `simulate`", path.display(), named(topics)
    )]
    NoScan {
        /// The file.
        path: PathBuf,
        /// Bytes that came over links.
        bytes: u64,
        /// Packets in them.
        packets: u64,
        /// Names of the first topics.
        topics: BTreeSet<String>,
    },
    /// Nothing of the capture lies in the part that was asked for.
    #[error("there is no scan from {from_s} s after the beginning of {} on; begin earlier", path.display())]
    Beyond {
        /// The file.
        path: PathBuf,
        /// The beginning asked for, seconds.
        from_s: f64,
    },
    /// A part of bytes that have no times.
    #[error("{} has no times to cut it by, as bytes of a port have none; solve it whole", path.display())]
    Timeless {
        /// The file.
        path: PathBuf,
    },
    /// A range of time that holds nothing.
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
