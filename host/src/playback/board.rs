//! A board of a capture.

use slitpose_calibration::Head;

use crate::capture::Setup;
use crate::link::DeviceId;
use crate::pipeline::Pipeline;

use super::faulty::Faulty;
use super::host_clock::HostClock;

/// A board of a capture.
pub struct Board {
    /// `None` in the bytes of a port, which are of one board.
    pub device: Option<DeviceId>,
    /// Its head, as it is known.
    pub head: Head,
    /// What has become of its bytes so far.
    pub pipeline: Pipeline,
    pub(super) setup: Option<Box<Setup>>,
    pub(super) host_clock: HostClock,
    /// Nothing more can be made of it until its link was opened anew.
    pub(super) is_unusable: bool,
    pub(super) phase: Phase,
    /// Faults in its bytes, if any are injected.
    pub(super) faulty: Option<Box<Faulty>>,
    pub(super) seam: Seam,
    /// When the sessions began behind which a part can begin, seconds after the beginning.
    pub(super) sessions_s: Vec<f64>,
    /// Whether it has had a session.
    pub(super) has_begun: bool,
    /// Whether another has begun since its last bytes.
    pub(super) begins_anew: bool,
    /// Scans, bytes and readable packets under earlier settings.
    pub(super) earlier: [u64; 3],
    /// Settings behind which no bytes follow.
    pub(super) unused_settings: u64,
}

/// Where the bytes of a board are, relative to a part that is solved.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Phase {
    /// Only decoded.
    Before,
    /// Solved unheard.
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
    pub(super) fn new(
        device: Option<DeviceId>,
        setup: Option<Box<Setup>>,
        head: Head,
        pipeline: Pipeline,
        phase: Phase,
        faulty: Option<Box<Faulty>>,
    ) -> Self {
        let (host_clock, seam) = (HostClock::default(), Seam::default());
        Self {
            device,
            head,
            pipeline,
            setup,
            host_clock,
            is_unusable: false,
            phase,
            faulty,
            seam,
            sessions_s: Vec::new(),
            has_begun: false,
            begins_anew: false,
            earlier: [0; 3],
            unused_settings: 0,
        }
    }

    /// Scans, bytes and readable packets so far.
    pub(super) fn totals(&self) -> [u64; 3] {
        let counts = self.pipeline.counts();
        let [scans, bytes, packets] = self.earlier;
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
}
