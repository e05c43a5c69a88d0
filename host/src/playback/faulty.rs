//! Faults in the bytes of a recorded board.

use slitpose_head::faults::{FaultError, Faults, Injector};

use super::Choice;
use crate::link::Segment;

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
