//! Poses that the board has solved itself.
//!
//! A packet holds the poses of consecutive scans, or of every nth, one record each. Every [`COVARIANCE_PACKETS`]th
//! packet, and each in which a variance is no longer what was told of it, also holds the covariance of its last pose:
//! over some milliseconds it hardly changes unless the tool is fast, or a cell goes dark.
//!
//! | byte of a record | is |
//! |---|---|
//! | 0 | [`PoseStatus`] |
//! | 1 | zero |
//! | 2, 3 | cells used, bit k for cell k |
//! | 4, 5 | cells left out because they contradict all others |
//! | 6, 7 | device time from the start of the frame to the pose, in units of [`READY_TICKS`] |
//! | 8 to 19 | translation of `base_from_tool` at the reference instant, metres |
//! | 20 to 35 | its rotation, unit quaternion x, y, z, w |
//! | 36 to 39 | χ² |
//!
//! Integers and `f32` are little endian. Without a pose translation and rotation are NaN.

use heapless::Vec;
use serde::{Deserialize, Serialize};

/// Bytes of one record.
pub const POSE_BYTES: usize = 40;

/// Packets from one covariance to the next.
pub const COVARIANCE_PACKETS: u8 = 4;

/// Device ticks in a unit of [`PoseRecord::ready`].
pub const READY_TICKS: u32 = 64;

/// Relative change of a variance that is told at once.
const CHANGE: f32 = 0.1;

/// Elements of the lower triangle of a covariance, row by row.
pub const TRIANGLE: usize = 21;

/// Poses at equal distances, as sent on the wire.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Poses<'a> {
    /// Number of the configuration of their scans.
    pub configuration: u16,
    /// Sequence number of the first scan.
    pub sequence: u64,
    /// Device tick of the first scan's frame start.
    pub tick: u64,
    /// Scans from one pose to the next.
    pub every: u8,
    /// Scans of this configuration that were not solved, because newer ones had come meanwhile or the head was replaced.
    /// Those that lie between two packets are counted by the second.
    pub missed: u32,
    /// [Number](crate::Hashes::number) of the head that solved them.
    pub head: u32,
    /// Covariance of the last pose: of (δt, δθ) in the base frame, m², m·rad, rad²; lower triangle, row by row.
    pub covariance: Option<[f32; TRIANGLE]>,
    /// The records, in the layout above.
    #[serde(borrow)]
    pub records: &'a [u8],
}

impl<'a> Poses<'a> {
    /// The poses with the sequence number and tick of their scans, of which `frame_ticks` lie between two. Bytes that
    /// are no whole record are left out.
    pub fn iter(&self, frame_ticks: u32) -> impl Iterator<Item = (u64, u64, PoseRecord)> + Clone + use<'a> {
        let (sequence, tick, every) = (self.sequence, self.tick, u64::from(self.every));
        let (records, _) = self.records.as_chunks();
        (0..).zip(records).map(move |(number, record)| {
            let scans = every * number;
            let ticks = scans.saturating_mul(frame_ticks.into());
            (sequence.saturating_add(scans), tick.saturating_add(ticks), PoseRecord::read(record))
        })
    }
}

/// What came of one scan.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[repr(u8)]
pub enum PoseStatus {
    /// A pose from all cells, and the data fit it.
    Converged = 0,
    /// Some cells are saturated, faint or missing; the others decide.
    FewerCells = 1,
    /// A cell contradicted all others and was left out.
    CellExcluded = 2,
    /// The residuals are larger than the noise explains.
    Misfit = 3,
    /// Several distinct poses explain the data.
    Ambiguous = 4,
    /// The data leave directions free.
    Unobservable = 5,
    /// Too few cells see enough light.
    TooDark = 6,
    /// No pose near the data was found.
    Diverged = 7,
    /// A status of a newer firmware.
    Unknown = 255,
}

impl PoseStatus {
    /// Whether there is a pose.
    pub fn has_pose(self) -> bool {
        matches!(self, Self::Converged | Self::FewerCells | Self::CellExcluded | Self::Misfit)
    }

    fn of(byte: u8) -> Self {
        const ALL: [PoseStatus; 8] = [
            PoseStatus::Converged,
            PoseStatus::FewerCells,
            PoseStatus::CellExcluded,
            PoseStatus::Misfit,
            PoseStatus::Ambiguous,
            PoseStatus::Unobservable,
            PoseStatus::TooDark,
            PoseStatus::Diverged,
        ];
        ALL.get(usize::from(byte)).copied().unwrap_or(Self::Unknown)
    }
}

/// One pose.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PoseRecord {
    /// What came of the scan.
    pub status: PoseStatus,
    /// The cells whose currents entered, bit k for cell k.
    pub cells_used: u16,
    /// Cells left out because they contradict all others.
    pub excluded: u16,
    /// Device time from the start of the frame to the pose, in units of [`READY_TICKS`].
    pub ready: u16,
    /// Translation of `base_from_tool`, metres.
    pub translation_m: [f32; 3],
    /// Its rotation, unit quaternion x, y, z, w.
    pub rotation_xyzw: [f32; 4],
    /// Sum of the squared whitened residuals.
    pub chi2: f32,
}

impl PoseRecord {
    /// In the layout above.
    pub fn write(&self) -> [u8; POSE_BYTES] {
        let mut bytes = [0; POSE_BYTES];
        bytes[0] = self.status as u8;
        for (place, value) in bytes[2..8].chunks_exact_mut(2).zip([self.cells_used, self.excluded, self.ready]) {
            place.copy_from_slice(&value.to_le_bytes());
        }
        let numbers = self.translation_m.iter().chain(&self.rotation_xyzw).chain([&self.chi2]);
        for (place, value) in bytes[8..].chunks_exact_mut(4).zip(numbers) {
            place.copy_from_slice(&value.to_le_bytes());
        }
        bytes
    }

    /// From the layout above.
    pub fn read(bytes: &[u8; POSE_BYTES]) -> Self {
        let half = |at: usize| u16::from_le_bytes([bytes[at], bytes[at + 1]]);
        let number = |i: usize| {
            let at = 8 + 4 * i;
            f32::from_le_bytes([bytes[at], bytes[at + 1], bytes[at + 2], bytes[at + 3]])
        };
        Self {
            status: PoseStatus::of(bytes[0]),
            cells_used: half(2),
            excluded: half(4),
            ready: half(6),
            translation_m: [0, 1, 2].map(number),
            rotation_xyzw: [3, 4, 5, 6].map(number),
            chi2: number(7),
        }
    }
}

/// Collects poses into a packet; `BYTES` is the capacity for records.
#[derive(Debug, Clone)]
pub struct PosesBuilder<const BYTES: usize> {
    sequence: u64,
    tick: u64,
    every: u8,
    covariance: Option<[f32; TRIANGLE]>,
    told: [f32; TRIANGLE],
    /// Packets since the last covariance.
    packets: u8,
    records: Vec<u8, BYTES>,
}

impl<const BYTES: usize> Default for PosesBuilder<BYTES> {
    fn default() -> Self {
        Self {
            sequence: 0,
            tick: 0,
            every: 1,
            covariance: None,
            told: [0.0; TRIANGLE],
            packets: 0,
            records: Vec::new(),
        }
    }
}

impl<const BYTES: usize> PosesBuilder<BYTES> {
    /// Number of poses.
    pub fn len(&self) -> usize {
        self.records.len() / POSE_BYTES
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.records.is_empty()
    }

    /// Appends the pose of scan `sequence`, whose frame began at `tick`; `false`, and nothing changed, if it does not
    /// follow the last one or there is no room.
    #[must_use]
    pub fn push(
        &mut self,
        (sequence, tick): (u64, u64),
        record: &PoseRecord,
        covariance: Option<&[f32; TRIANGLE]>,
    ) -> bool {
        if self.records.is_empty() {
            (self.sequence, self.tick, self.covariance) = (sequence, tick, None);
        } else if sequence != self.sequence + u64::from(self.every) * self.len() as u64 {
            return false;
        }
        if self.records.extend_from_slice(&record.write()).is_err() {
            return false;
        }
        if let Some(covariance) = covariance
            && (self.packets == 0 || self.covariance.is_some() || has_changed(&self.told, covariance))
        {
            self.covariance = Some(*covariance);
            self.told = *covariance;
        }
        true
    }

    /// The packet of scans of configuration number `configuration`, with the count of scans that were `missed` and the
    /// number of the `head`; `None` if there is no pose.
    pub fn poses(&self, configuration: u16, missed: u32, head: u32) -> Option<Poses<'_>> {
        (!self.is_empty()).then_some(Poses {
            configuration,
            sequence: self.sequence,
            tick: self.tick,
            every: self.every,
            missed,
            head,
            covariance: self.covariance,
            records: &self.records,
        })
    }

    /// From now on of every `every`th scan; the packet under way must have been taken.
    pub fn set_every(&mut self, every: u8) {
        self.every = every;
    }

    /// Forgets all poses: the next packet begins.
    pub fn clear(&mut self) {
        self.packets = (self.packets + 1) % COVARIANCE_PACKETS;
        self.records.clear();
    }
}

/// Whether a variance of `now` is another than that of `before`.
fn has_changed(before: &[f32; TRIANGLE], now: &[f32; TRIANGLE]) -> bool {
    // The diagonal.
    [0, 2, 5, 9, 14, 20].into_iter().any(|i| (now[i] - before[i]).abs() > CHANGE * before[i])
}

#[cfg(test)]
mod tests {
    use super::*;

    fn record(status: PoseStatus) -> PoseRecord {
        PoseRecord {
            status,
            cells_used: 0x1234,
            excluded: 0x8001,
            ready: 0xfedc,
            translation_m: [1.0, -2.0, 3.5],
            rotation_xyzw: [0.5, -0.5, 0.25, 1.0],
            chi2: 7.0,
        }
    }

    #[test]
    fn a_packet_holds_consecutive_poses_and_the_last_covariance() {
        let mut builder = PosesBuilder::<{ 2 * POSE_BYTES }>::default();
        assert_eq!(builder.poses(1, 0, 0), None);
        assert!(builder.push((7, 700), &record(PoseStatus::Converged), Some(&[1.0; TRIANGLE])));
        assert!(!builder.push((9, 900), &record(PoseStatus::Converged), None), "a gap");
        assert!(builder.push((8, 800), &record(PoseStatus::Diverged), None));
        assert!(!builder.push((9, 900), &record(PoseStatus::Converged), None), "no room");
        let poses = builder.poses(3, 5, 9).unwrap();
        assert_eq!((poses.configuration, poses.missed, poses.head), (3, 5, 9));
        assert_eq!(poses.covariance, Some([1.0; TRIANGLE]));
        let expected = [(7, 700, record(PoseStatus::Converged)), (8, 800, record(PoseStatus::Diverged))];
        assert!(poses.iter(100).eq(expected), "{poses:?}");
        let mut newer = record(PoseStatus::Converged).write();
        newer[0] = 8;
        assert_eq!(PoseRecord::read(&newer), record(PoseStatus::Unknown));
        for packet in 1..=COVARIANCE_PACKETS {
            builder.clear();
            assert!(builder.push((30, 3000), &record(PoseStatus::Converged), Some(&[1.05; TRIANGLE])));
            let covariance = builder.poses(3, 5, 9).unwrap().covariance;
            assert_eq!(covariance, (packet == COVARIANCE_PACKETS).then_some([1.05; TRIANGLE]), "packet {packet}");
        }
    }

    #[test]
    fn a_variance_that_changes_is_told_at_once() {
        let mut builder = PosesBuilder::<{ 2 * POSE_BYTES }>::default();
        let mut packet = |variances: [f32; 2], last: f32| {
            for (sequence, variance) in (0..).zip(variances) {
                let mut covariance = [variance; TRIANGLE];
                covariance[20] = last;
                assert!(builder.push((sequence, 0), &record(PoseStatus::Converged), Some(&covariance)));
            }
            let covariance = builder.poses(0, 0, 0).unwrap().covariance;
            builder.clear();
            covariance.map(|covariance| (covariance[0], covariance[20]))
        };
        assert_eq!(packet([1.0, 1.05], 1.0), Some((1.05, 1.0)));
        assert_eq!(packet([1.1, 1.0], 1.05), None);
        assert_eq!(packet([1.1, 1.1], 1.2), Some((1.1, 1.2)));
        assert_eq!(packet([1.1, 0.9], 1.2), Some((0.9, 1.2)));
    }

    #[test]
    fn a_packet_of_every_third_pose_says_which() {
        let mut builder = PosesBuilder::<{ 2 * POSE_BYTES }>::default();
        builder.set_every(3);
        assert!(builder.push((6, 600), &record(PoseStatus::Converged), None));
        assert!(!builder.push((7, 700), &record(PoseStatus::Converged), None));
        assert!(builder.push((9, 900), &record(PoseStatus::Converged), None));
        let poses = builder.poses(3, 0, 0).unwrap();
        assert!(poses.iter(100).map(|(sequence, tick, _)| (sequence, tick)).eq([(6, 600), (9, 900)]));
    }
}
