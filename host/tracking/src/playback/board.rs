//! Which part of captures is solved, and how; and a board of a capture.

use std::collections::BTreeSet;
use std::path::PathBuf;

use slitpose_calibration::{CalibrationFileError, Head};
use slitpose_head::faults::{Fault, FaultError, Faults, Injector};
use slitpose_head::foreign::printable;
use slitpose_head::scene_file::SceneFileError;
use slitpose_model::SceneError;
use thiserror::Error;

use crate::capture::{CaptureError, Setup};
use crate::clock::{HostInstant, UtcWatch};
use crate::frame::View;
use crate::link::{DeviceId, Segment};
use crate::pipeline::{Pipeline, PipelineError};
use crate::solving::Solving;
use crate::telemetry::{BoardReport, BoardStatistics, LinkReport, LinkState};

/// A board of a capture.
pub struct Board {
    /// `None` in the bytes of a port, which are of one board.
    pub device: Option<DeviceId>,
    /// Its head, as it is known.
    pub head: Head,
    /// What has become of its bytes so far.
    pub pipeline: Pipeline,
    pub(super) setup: Option<Box<Setup>>,
    pub(super) phase: Phase,
    /// Faults in its bytes, if any are injected.
    pub(super) faulty: Option<Box<Faulty>>,
    pub(super) utc: UtcWatch,
    /// Nothing more can be made of it until its link was opened anew.
    pub(super) is_unusable: bool,
    /// Whether another session has begun since its last bytes.
    pub(super) begins_anew: bool,
    pub(super) past: Past,
}

/// What outlives the settings of a board.
#[derive(Default)]
pub(super) struct Past {
    pub(super) seam: Seam,
    /// When the sessions began behind which a part can begin, seconds after the beginning.
    pub(super) sessions_s: Vec<f64>,
    pub(super) has_begun: bool,
    /// Scans, bytes and readable packets under earlier settings.
    pub(super) earlier: [u64; 3],
    pub(super) unused_settings: u64,
}

/// Where the bytes of a board are, relative to a part that is solved.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Phase {
    Before,
    WarmUp,
    Within,
    Behind,
}

/// What the poses of a board depended on at both ends of a part: see [`Pipeline::state`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Seam {
    /// Before the first bytes of the part; `None` if there was no hello yet, or none of its bytes lie in the part.
    pub before: Option<u64>,
    /// Behind its last bytes.
    pub behind: Option<u64>,
}

impl Board {
    /// Scans, bytes and readable packets so far.
    pub(super) fn totals(&self) -> [u64; 3] {
        let counts = self.pipeline.counts();
        let [scans, bytes, packets] = self.past.earlier;
        [scans + counts.scans, bytes + counts.decoder.bytes, packets + counts.decoder.packets]
    }

    /// Whether its last settings apply to no bytes.
    pub(super) fn is_unused(&self) -> bool {
        self.setup.is_some() && self.pipeline.counts().decoder.bytes == 0
    }

    /// The name of the board in messages.
    pub fn name(&self) -> String {
        self.device.map_or_else(|| "capture".to_owned(), |device| format!("board {device}"))
    }

    /// The report at `now`, by the `statistics` of its items. What a capture has to say of its link it has said.
    pub fn report(&self, statistics: &mut BoardStatistics, now: HostInstant) -> BoardReport {
        let link = LinkReport { state: LinkState::Ended, since_utc_ns: now.utc_ns, ..LinkReport::default() };
        BoardReport { link, ..statistics.report(&self.pipeline.counts(), self.pipeline.health(), now) }
    }
}

/// Injects faults into the segments of one board.
pub(super) struct Faulty {
    injector: Injector,
    bytes: Vec<u8>,
    segment: Segment,
}

impl Faulty {
    /// As `choice` asks, for a head with so many cells; `None` if it asks for none.
    pub(super) fn of(choice: &Choice, cells: usize) -> Result<Option<Box<Self>>, FaultError> {
        let injector = Injector::of_recording(&Faults::new(choice.faults.clone(), cells)?);
        let faulty = |injector| Box::new(Self { injector, bytes: Vec::new(), segment: Segment::default() });
        Ok(injector.map(faulty))
    }

    /// What comes of `segment`; each of its bytes that is passed on has the instant of the read that completed its
    /// packet.
    pub(super) fn pass(&mut self, segment: &Segment) -> &Segment {
        self.segment.clear();
        self.segment.opened = segment.opened;
        self.segment.asked.extend_from_slice(&segment.asked);
        for (bytes, at) in segment.chunks() {
            self.bytes.clear();
            // Recordings refuse faults that break the link.
            self.injector.push(bytes, &mut self.bytes);
            self.segment.push(&self.bytes, at);
        }
        &self.segment
    }

    /// What was held back to the end.
    pub(super) fn finish(&mut self) -> &Segment {
        self.segment.clear();
        self.bytes.clear();
        self.injector.finish(&mut self.bytes);
        self.segment.push(&self.bytes, None);
        &self.segment
    }
}

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
    /// The frame of the poses; `None`: that of the head.
    pub view: Option<&'static View>,
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
    Beyond { path: PathBuf, from_s: f64 },
    #[error("{} has no times to cut it by, as bytes of a port have none; solve it whole", path.display())]
    Timeless { path: PathBuf },
    #[error("--to {to_s} s does not lie behind --from {from_s} s; give a later end")]
    Range { from_s: f64, to_s: f64 },
}

fn named(topics: &BTreeSet<String>) -> String {
    let topics: Vec<_> = topics.iter().map(|topic| printable(topic).at_most(100).to_string()).collect();
    if topics.is_empty() { String::new() } else { format!(", topics {}", topics.join(", ")) }
}
