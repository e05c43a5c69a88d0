//! From finished scans to batches, and the counts of scans taken and lost.

use slitpose_protocol::{BatchBuilder, HardwareFault, MAX_SCAN_BYTES, RawScan, Schedule, Stream};

use crate::exposure::AutomaticExposure;
use crate::hardware::{Acquisition, ScanError};
use crate::outbox::Outbox;
use crate::pose::Poser;

/// Largest number of scans in a batch. Four scans of six cells, lit and dark, make a
/// packet of some 220 bytes, of which 192 are samples; the first waits three frames.
pub const BATCH_SCANS: usize = 4;

/// A batch holds no more scans than this many milliseconds have frames (but one at
/// least): at low frame rates every scan goes out alone instead of waiting for the next.
pub const BATCH_SPAN_MS: u32 = 1;

/// Scans collected in one call, so that hardware that always has another scan cannot hold
/// the caller: 16 ms at 4 kHz.
const SCANS_PER_CALL: usize = 64;

/// Scans of one batch by `schedule`.
fn batch_scans(schedule: &Schedule) -> usize {
    let frames = schedule.tick_hz / 1_000 * BATCH_SPAN_MS / schedule.frame_ticks.max(1);
    (frames as usize).clamp(1, BATCH_SCANS)
}

#[derive(Debug)]
pub(crate) struct Collector {
    batch: BatchBuilder<{ BATCH_SCANS * MAX_SCAN_BYTES }>,
    /// Buffer of the next scan; always in the shape of the batch.
    scan: RawScan,
    /// Smallest sequence number the next scan can have: scans taken so far.
    taken: u64,
    last_tick: Option<u64>,
    lost: u64,
    overruns: u32,
    stream: Stream,
    /// Scans that the host wants in a batch at most.
    most: usize,
}

impl Collector {
    /// A collector without scans, prepared for scans of this configuration.
    pub fn new(configuration: u16, schedule: &Schedule) -> Self {
        let batch = BatchBuilder::new(configuration, schedule, batch_scans(schedule));
        Self {
            scan: batch.blank(),
            batch,
            taken: 0,
            last_tick: None,
            lost: 0,
            overruns: 0,
            stream: Stream::SCANS,
            most: BATCH_SCANS,
        }
    }

    /// Prepares the collector for scans of another configuration; the batch of the old one
    /// must have been flushed.
    pub fn configure(&mut self, configuration: u16, schedule: &Schedule) {
        self.batch = BatchBuilder::new(configuration, schedule, batch_scans(schedule));
        self.scan = self.batch.blank();
    }

    /// Moves finished scans into batches and full batches into the outbox.
    ///
    /// # Errors
    /// If the hardware cannot go on, or if its counters contradict themselves, so that its
    /// scans cannot be given a time.
    pub fn collect<M: AsRef<[u8]> + AsMut<[u8]>>(
        &mut self,
        hardware: &mut impl Acquisition,
        outbox: &mut Outbox<M>,
        poser: &mut Poser,
        mut exposure: Option<&mut AutomaticExposure>,
    ) -> Result<(), HardwareFault> {
        for _ in 0..SCANS_PER_CALL {
            match hardware.next_scan(&mut self.scan) {
                Ok(true) => {
                    self.take(outbox)?;
                    poser.take(&self.scan);
                    if let Some(exposure) = &mut exposure {
                        exposure.watch(&self.scan);
                    }
                }
                Ok(false) => break,
                Err(ScanError::Overrun) => {
                    self.overruns = self.overruns.saturating_add(1);
                    self.flush(outbox);
                }
                Err(ScanError::Fault(fault)) => return Err(fault),
            }
        }
        Ok(())
    }

    /// Sends the open batch, full or not.
    pub fn flush<M: AsRef<[u8]> + AsMut<[u8]>>(&mut self, outbox: &mut Outbox<M>) {
        if let Some(batch) = self.batch.batch() {
            outbox.push_batch(batch, self.batch.len());
        }
        self.batch.clear();
    }

    /// Scans until the open batch is full.
    pub fn scans_to_batch(&self) -> usize {
        self.batch_scans().saturating_sub(self.batch.len())
    }

    /// Scans in a full batch, or poses in a packet of them.
    pub fn batch_scans(&self) -> usize {
        (self.batch.len() + self.batch.remaining()).min(self.most)
    }

    /// Puts no more than so many scans in a batch, but one at least; the batch under way must have been flushed.
    pub fn set_most(&mut self, scans: u8) {
        self.most = usize::from(scans).max(1);
    }

    /// Which scans are sent; the batch under way must have been flushed.
    pub fn set_stream(&mut self, stream: Stream) {
        self.stream = stream;
    }

    /// Scans the hardware has taken, by the highest sequence number so far.
    pub fn taken(&self) -> u64 {
        self.taken
    }

    /// Scans taken that were never handed out.
    pub fn lost(&self) -> u64 {
        self.lost
    }

    pub fn overruns(&self) -> u32 {
        self.overruns
    }

    fn take<M: AsRef<[u8]> + AsMut<[u8]>>(&mut self, outbox: &mut Outbox<M>) -> Result<(), HardwareFault> {
        let missed = self.scan.sequence.checked_sub(self.taken);
        let taken = self.scan.sequence.checked_add(1);
        let (Some(missed), Some(taken)) = (missed, taken) else {
            return Err(HardwareFault::Counters);
        };
        self.lost += missed;
        self.taken = taken;
        let later = self.last_tick.is_none_or(|last| last < self.scan.tick);
        if !later || !self.batch.fits(&self.scan) {
            self.lost += 1;
            self.scan = self.batch.blank();
            return Err(HardwareFault::Counters);
        }
        self.last_tick = Some(self.scan.tick);
        if !self.stream.has_scan(self.scan.sequence) {
            self.flush(outbox);
            return Ok(());
        }
        if !self.batch.push(&self.scan) {
            self.flush(outbox);
            // An empty batch takes any scan of its shape.
            let _ = self.batch.push(&self.scan);
        }
        if self.scans_to_batch() == 0 {
            self.flush(outbox);
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pcb::default_configuration;

    #[test]
    fn a_batch_spans_a_millisecond_at_most() {
        let mut schedule = default_configuration().schedule;
        for (frame_rate_hz, scans) in [(7_000, 4), (4_000, 4), (2_000, 2), (1_001, 1), (10, 1)] {
            schedule.frame_ticks = schedule.tick_hz / frame_rate_hz;
            assert_eq!(batch_scans(&schedule), scans, "{frame_rate_hz} Hz");
        }
    }
}
