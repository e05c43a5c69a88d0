//! Batches: consecutive scans in one packet.
//!
//! The scans of a batch are consecutive in sequence, exactly one frame apart in ticks,
//! and taken by one configuration at one set of emitter levels; so sequence, tick,
//! configuration and levels are sent once. A scan that differs begins another batch.
//!
//! Layout of `samples`: for each scan, little-endian u16 words,
//! `lit I_X1, lit I_X2` of cell 0, 1, …, then, if the schedule has a dark slot,
//! `dark I_X1, dark I_X2` of cell 0, 1, ….

use core::fmt::Debug;

use heapless::Vec;
use serde::{Deserialize, Serialize};
use thiserror::Error;

use crate::scan::{Levels, RawScan, WordPair};
use crate::schedule::{MAX_CELLS, Schedule};

/// Bytes of one [`WordPair`].
const PAIR_BYTES: usize = size_of::<WordPair>();

/// Bytes of the largest scan: [`MAX_CELLS`] cells, lit and dark.
pub const MAX_SCAN_BYTES: usize = 2 * MAX_CELLS * PAIR_BYTES;

/// Consecutive scans, as sent on the wire.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Batch<'a> {
    /// Number of the configuration of the scans, announced by
    /// [`Hello::configuration`](crate::Hello::configuration). Samples may only be read
    /// with the schedule of the same number.
    pub configuration: u16,
    /// Sequence number of the first scan.
    pub sequence: u64,
    /// Device tick of the first scan's frame start.
    pub tick: u64,
    /// Level of each emitter in all scans of the batch.
    pub levels: Levels,
    /// The words, in the layout above.
    #[serde(borrow)]
    pub samples: &'a [u8],
}

impl<'a> Batch<'a> {
    /// The scans of the batch, read by the schedule of the same configuration number.
    ///
    /// # Errors
    /// If the batch does not fit this schedule.
    pub fn scans(
        &self,
        schedule: &Schedule,
    ) -> Result<impl ExactSizeIterator<Item = RawScan> + Clone + Debug + use<'a>, BatchError> {
        let cells = usize::from(schedule.cells);
        if cells == 0 || self.levels.len() != cells {
            return Err(BatchError::Levels { levels: self.levels.len(), cells });
        }
        let scan_bytes = schedule.words_per_scan() * size_of::<u16>();
        if self.samples.is_empty() || !self.samples.len().is_multiple_of(scan_bytes) {
            return Err(BatchError::Length { bytes: self.samples.len(), scan_bytes });
        }
        let count = (self.samples.len() / scan_bytes) as u64;
        let elapsed = count.checked_mul(u64::from(schedule.frame_ticks));
        if self.sequence.checked_add(count).is_none() || elapsed.and_then(|e| self.tick.checked_add(e)).is_none() {
            return Err(BatchError::Counters { sequence: self.sequence, tick: self.tick });
        }
        let mut next = RawScan::new(cells, schedule.dark_slot().is_some());
        next.sequence = self.sequence;
        next.tick = self.tick;
        next.levels_mut().copy_from_slice(&self.levels);
        let frame_ticks = u64::from(schedule.frame_ticks);
        let read = move |samples: &[u8]| {
            let (lit, dark) = samples.split_at(cells * PAIR_BYTES);
            read_pairs(lit, next.lit_mut());
            if let Some(words) = next.dark_mut() {
                read_pairs(dark, words);
            }
            let scan = next;
            next.sequence += 1;
            next.tick += frame_ticks;
            scan
        };
        Ok(self.samples.chunks_exact(scan_bytes).map(read))
    }
}

fn read_pairs(samples: &[u8], pairs: &mut [WordPair]) {
    for (bytes, pair) in samples.chunks_exact(PAIR_BYTES).zip(pairs) {
        *pair = [u16::from_le_bytes([bytes[0], bytes[1]]), u16::from_le_bytes([bytes[2], bytes[3]])];
    }
}

/// Why a [`Batch`] does not belong to a schedule.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Error)]
#[allow(missing_docs, reason = "the texts say what each is")]
pub enum BatchError {
    #[error("batch with {levels} emitter levels, schedule with {cells} cells (1 to 16)")]
    Levels { levels: usize, cells: usize },
    #[error("batch of {bytes} sample bytes, one scan of the schedule takes {scan_bytes}")]
    Length { bytes: usize, scan_bytes: usize },
    #[error("batch starts at sequence {sequence}, tick {tick}: past the end of the counters")]
    Counters { sequence: u64, tick: u64 },
}

/// Collects scans into a [`Batch`]; `BYTES` is the capacity for samples.
///
/// ```
/// use slitpose_protocol::*;
///
/// let schedule = Schedule {
///     tick_hz: 1_000_000, frame_ticks: 250, slots: [EmitterSet::of(&[0]), EmitterSet::DARK].into_iter().collect(),
///     slot_ticks: 30, settling_ticks: 13, conversion_ticks: 1, oversampling: 4, cells: 1,
/// };
/// let mut builder = BatchBuilder::<1024>::new(7, &schedule, 4);
/// let mut scan = builder.blank();
/// scan.lit_mut()[0] = [12_000, 9_000];
/// assert!(builder.push(&scan) && !builder.push(&scan), "the next scan has the next number and tick");
///
/// let mut packet = [0; MAX_MESSAGE_BYTES];
/// let mut bytes = encode(&Message::Batch(builder.batch().unwrap()), &mut packet)?;
/// let mut decoder = Decoder::<MAX_MESSAGE_BYTES>::new();
/// let Some(Ok(Message::Batch(batch))) = decoder.next(&mut bytes) else { panic!("a batch") };
/// assert_eq!(batch.scans(&schedule).unwrap().next().unwrap().lit()[0], [12_000, 9_000]);
/// # Ok::<(), EncodeError>(())
/// ```
#[derive(Debug, Clone)]
pub struct BatchBuilder<const BYTES: usize> {
    configuration: u16,
    frame_ticks: u32,
    limit: usize,
    first: RawScan,
    scans: usize,
    samples: Vec<u8, BYTES>,
}

impl<const BYTES: usize> BatchBuilder<BYTES> {
    const ROOM_FOR_ONE: () = assert!(BYTES >= MAX_SCAN_BYTES, "room for one scan at least");

    /// An empty batch for scans of one configuration, full at `limit` scans (at least
    /// one) or when `BYTES` are used.
    pub fn new(configuration: u16, schedule: &Schedule, limit: usize) -> Self {
        let () = Self::ROOM_FOR_ONE;
        Self {
            configuration,
            frame_ticks: schedule.frame_ticks,
            limit: limit.max(1),
            first: RawScan::new(usize::from(schedule.cells), schedule.dark_slot().is_some()),
            scans: 0,
            samples: Vec::new(),
        }
    }

    /// Number of scans held.
    pub fn len(&self) -> usize {
        self.scans
    }

    /// Whether no scan is held.
    pub fn is_empty(&self) -> bool {
        self.scans == 0
    }

    /// Number of scans until the batch should be sent.
    pub fn remaining(&self) -> usize {
        self.limit.saturating_sub(self.scans)
    }

    /// Whether the batch should be sent without waiting for more.
    pub fn is_full(&self) -> bool {
        self.scans >= self.limit
    }

    /// A scan of zeros with the shape of this batch.
    pub fn blank(&self) -> RawScan {
        RawScan::new(self.first.cells(), self.first.has_dark())
    }

    /// Whether `scan` has the shape of this batch.
    pub fn fits(&self, scan: &RawScan) -> bool {
        scan.cells() == self.first.cells() && scan.has_dark() == self.first.has_dark()
    }

    /// Whether `scan` can be added: right shape, room left, and, unless the batch is
    /// empty, next in sequence, one frame later, same levels.
    pub fn continues(&self, scan: &RawScan) -> bool {
        if !self.fits(scan) {
            return false;
        }
        if self.is_empty() {
            return true;
        }
        let held = self.scans as u64;
        let elapsed = held.saturating_mul(u64::from(self.frame_ticks));
        !self.is_full()
            && self.samples.capacity() - self.samples.len() >= self.samples.len() / self.scans
            && self.first.sequence.checked_add(held) == Some(scan.sequence)
            && self.first.tick.checked_add(elapsed) == Some(scan.tick)
            && self.first.levels() == scan.levels()
    }

    /// Adds `scan` if it [`continues`](Self::continues) the batch, and returns whether
    /// it did. If not, the caller sends the batch, clears it and pushes again.
    #[must_use]
    pub fn push(&mut self, scan: &RawScan) -> bool {
        if !self.continues(scan) {
            return false;
        }
        if self.is_empty() {
            self.first = *scan;
        }
        for pair in scan.lit().iter().chain(scan.dark().into_iter().flatten()) {
            let [first, second] = pair.map(u16::to_le_bytes);
            // `continues` has checked the capacity.
            let _ = self.samples.extend_from_slice(&[first[0], first[1], second[0], second[1]]);
        }
        self.scans += 1;
        true
    }

    /// The scans held, as sent on the wire; `None` when empty.
    pub fn batch(&self) -> Option<Batch<'_>> {
        (!self.is_empty()).then(|| Batch {
            configuration: self.configuration,
            sequence: self.first.sequence,
            tick: self.first.tick,
            levels: self.first.levels().iter().copied().collect(),
            samples: &self.samples,
        })
    }

    /// Empties the batch.
    pub fn clear(&mut self) {
        self.scans = 0;
        self.samples.clear();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{EmitterSet, Level};

    fn one_cell() -> Schedule {
        Schedule {
            tick_hz: 1_000_000,
            frame_ticks: 250,
            slots: Vec::from_array([EmitterSet::of(&[0]), EmitterSet::DARK]),
            slot_ticks: 50,
            settling_ticks: 10,
            conversion_ticks: 1,
            oversampling: 1,
            cells: 1,
        }
    }

    fn scan(sequence: u64) -> RawScan {
        let mut scan = RawScan::new(1, true);
        scan.sequence = sequence;
        scan.tick = 250 * sequence;
        scan.lit_mut()[0] = [sequence as u16, 2];
        scan
    }

    #[test]
    fn only_what_follows_joins() {
        let mut builder = BatchBuilder::<MAX_SCAN_BYTES>::new(7, &one_cell(), 3);
        assert!(builder.batch().is_none());
        assert!(builder.push(&scan(5)));

        assert!(!builder.push(&scan(7)), "gap in sequence");
        let mut late = scan(6);
        late.tick += 1;
        assert!(!builder.push(&late), "gap in time");
        let mut brighter = scan(6);
        brighter.levels_mut()[0] = Level::NOMINAL;
        assert!(!builder.push(&brighter), "other level");

        assert_eq!(builder.remaining(), 2);
        assert!(builder.push(&scan(6)));
        assert!(builder.push(&scan(7)));
        assert_eq!(builder.remaining(), 0);
        assert!(builder.is_full());
        assert!(!builder.push(&scan(8)), "full");

        let batch = builder.batch().unwrap();
        assert_eq!((batch.configuration, batch.sequence, batch.tick), (7, 5, 1_250));
        let scans = batch.scans(&one_cell()).unwrap();
        assert_eq!(scans.len(), 3);
        assert!(scans.eq([scan(5), scan(6), scan(7)]));

        builder.clear();
        for (cells, has_dark, fits) in [(1, true, true), (2, true, false), (1, false, false), (2, false, false)] {
            assert_eq!(builder.fits(&RawScan::new(cells, has_dark)), fits);
            assert_eq!(builder.clone().push(&RawScan::new(cells, has_dark)), fits);
        }
        assert!(builder.push(&scan(8)));
    }

    #[test]
    fn room_ends_a_batch_too() {
        let mut builder = BatchBuilder::<MAX_SCAN_BYTES>::new(0, &one_cell(), usize::MAX);
        let room = (MAX_SCAN_BYTES / 8) as u64;
        for sequence in 0..room {
            assert!(builder.push(&scan(sequence)));
        }
        assert!(!builder.push(&scan(room)));
        assert_eq!(builder.len() as u64, room);
    }

    #[test]
    fn a_batch_of_another_schedule_is_refused() {
        let mut builder = BatchBuilder::<MAX_SCAN_BYTES>::new(0, &one_cell(), 4);
        assert!(builder.push(&scan(0)));
        let batch = builder.batch().unwrap();
        let mut schedule = one_cell();
        schedule.cells = 2;
        let error = BatchError::Levels { levels: 1, cells: 2 };
        assert_eq!(batch.scans(&schedule).unwrap_err(), error);
        schedule.cells = 0;
        let error = BatchError::Levels { levels: 0, cells: 0 };
        assert_eq!(Batch { levels: Levels::new(), ..batch.clone() }.scans(&schedule).unwrap_err(), error);
        let cut = Batch { samples: &batch.samples[..7], ..batch.clone() };
        let error = BatchError::Length { bytes: 7, scan_bytes: 8 };
        assert_eq!(cut.scans(&one_cell()).unwrap_err(), error);
        // One scan: neither the next sequence number nor the end of its frame may overflow.
        for (sequence, tick) in [(u64::MAX, 0), (0, u64::MAX - 249)] {
            let last = Batch { sequence, tick, ..batch.clone() };
            assert_eq!(last.scans(&one_cell()).unwrap_err(), BatchError::Counters { sequence, tick });
        }
        let last = Batch { sequence: u64::MAX - 1, tick: u64::MAX - 250, ..batch };
        assert_eq!(last.scans(&one_cell()).unwrap().len(), 1);
    }
}
