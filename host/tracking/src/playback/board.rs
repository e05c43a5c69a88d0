//! A board of a capture.

use slitpose_calibration::Head;
use slitpose_head::faults::{FaultError, Faults, Injector};

use super::Choice;
use super::files::HostClock;
use crate::capture::Setup;
use crate::link::{DeviceId, Segment};
use crate::pipeline::Pipeline;

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
