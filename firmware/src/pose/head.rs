//! A head as the board holds it: compiled on the host, a few kilobytes, checked.
//!
//! ```text
//! head = magic u32 ‖ version u16 ‖ payload bytes u16 ‖ checksum u32 ‖ payload
//! ```
//! little endian. The checksum is CRC-32/ISO-HDLC of version, length and payload. The payload is, one after the other,
//! the [postcard](https://postcard.jamesmunns.com/wire-format) values of [`Readout`], of [`CompactFrame`] and, for each
//! cell, of [`CompactPart`]: no text, no units, nothing to be compiled. It is read a cell at a time, because the board's
//! stack has no room for a second solver.

use heapless::Vec;
use postcard::take_from_bytes;
use serde::{Deserialize, Serialize};
use slitpose_model::{BOARD_CELLS, CompactFrame, CompactPart, CompactPlan, Pair, Photocurrents, Reading, Solver};
use slitpose_protocol::{AdcScaling, Hashes, Level, RawScan, Schedule};
use thiserror::Error;

pub use crate::settings::HEAD_BYTES;

const MAGIC: u32 = u32::from_le_bytes(*b"head");

/// Raised when the payload changes.
const VERSION: u16 = 4;

const HEADER_BYTES: usize = 12;
const CRC: crc::Crc<u32> = crc::Crc::<u32>::new(&crc::CRC_32_ISO_HDLC);

/// The solver of the board.
pub type HeadSolver = Solver<f32, CompactPlan<f32>>;

/// What the board needs of a head to solve poses of its own scans.
#[derive(Clone, Debug)]
pub struct Head {
    /// From words to currents.
    pub readout: Readout,
    /// From currents to poses, the exposures of its cells those of the schedule.
    pub solver: HeadSolver,
}

/// From the words of a scan to photocurrents.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Readout {
    /// Hashes of the scene and the calibration that the head was compiled from.
    pub hashes: Hashes,
    /// The schedule that it was compiled for; with any other duration of a frame it serves as well.
    pub schedule: Schedule,
    /// Which words are saturated.
    pub scaling: AdcScaling,
    /// One a cell.
    pub stages: Vec<CellStage, BOARD_CELLS>,
}

/// From the words of a cell to its currents.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
pub struct CellStage {
    /// Photocurrent at nominal drive per step of a word, amperes; zero if the cell does not measure.
    pub amperes_per_word: f32,
    /// Word without light, for schedules without a dark slot.
    pub zero_word: f32,
}

/// Why bytes are no head.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
pub enum HeadError {
    /// They are something else, or damaged.
    #[error("this is no head, or it is damaged: make it anew")]
    Damaged,
    /// Another version of the firmware.
    #[error("the head has version {theirs}, this firmware reads {VERSION}: make host and firmware from one source")]
    Version {
        /// Of the head.
        theirs: u16,
    },
    /// It has too many cells or too much else.
    #[error("the head takes more than {HEAD_BYTES} bytes: leave cells out")]
    TooLong,
}

impl Head {
    /// Writes the head to the start of `bytes`, and gives its part of them.
    ///
    /// # Errors
    /// [`HeadError::TooLong`] if they do not suffice.
    pub fn encode<'b>(&self, bytes: &'b mut [u8; HEAD_BYTES]) -> Result<&'b [u8], HeadError> {
        let (header, room) = bytes.split_at_mut(HEADER_BYTES);
        let mut length = 0;
        append(&self.readout, room, &mut length)?;
        append(&self.solver.frame(), room, &mut length)?;
        for part in self.solver.parts() {
            append(&part, room, &mut length)?;
        }
        let payload = &room[..length];
        header[..4].copy_from_slice(&MAGIC.to_le_bytes());
        header[4..6].copy_from_slice(&VERSION.to_le_bytes());
        header[6..8].copy_from_slice(&(length as u16).to_le_bytes());
        let sum = checksum(&header[4..8], payload);
        header[8..12].copy_from_slice(&sum.to_le_bytes());
        Ok(&bytes[..HEADER_BYTES + length])
    }

    /// Reads the head at the start of `bytes`, for programs with room for a second solver. A board reads it by
    /// [`PoseSolver::load`](super::PoseSolver::load), in place.
    ///
    /// # Errors
    /// If there is none that this version reads.
    pub fn decode(bytes: &[u8]) -> Result<Self, HeadError> {
        let mut solver = HeadSolver::without_cells();
        let readout = read(payload(bytes)?, &mut solver)?;
        Ok(Self { readout, solver })
    }
}

/// Reads the head of `payload` into `solver`.
///
/// # Errors
/// If it was written by somebody else; `solver` is then unusable.
pub(super) fn read(payload: &[u8], solver: &mut HeadSolver) -> Result<Readout, HeadError> {
    let (readout, rest) = take_from_bytes::<Readout>(payload).map_err(|_| HeadError::Damaged)?;
    let (frame, mut rest) = take_from_bytes::<CompactFrame<f32>>(rest).map_err(|_| HeadError::Damaged)?;
    solver.begin(&frame);
    for _ in 0..readout.stages.len() {
        rest = push(rest, &frame, solver)?;
    }
    let is_whole = rest.is_empty()
        && readout.stages.len() == usize::from(readout.schedule.cells)
        && readout.schedule.validate().is_ok();
    if is_whole { Ok(readout) } else { Err(HeadError::Damaged) }
}

/// Reads one cell; gives what follows it.
#[inline(never)]
fn push<'b>(bytes: &'b [u8], frame: &CompactFrame<f32>, solver: &mut HeadSolver) -> Result<&'b [u8], HeadError> {
    let (part, rest) = take_from_bytes::<CompactPart<f32>>(bytes).map_err(|_| HeadError::Damaged)?;
    if solver.push(frame, &part) { Ok(rest) } else { Err(HeadError::Damaged) }
}

/// Writes `value` to `room` behind `length` bytes.
fn append(value: &impl Serialize, room: &mut [u8], length: &mut usize) -> Result<(), HeadError> {
    let room = room.get_mut(*length..).unwrap_or_default();
    *length += postcard::to_slice(value, room).map_err(|_| HeadError::TooLong)?.len();
    Ok(())
}

impl Readout {
    /// Whether scans of `schedule` are what it was compiled for.
    pub fn fits(&self, schedule: &Schedule) -> bool {
        Schedule { frame_ticks: self.schedule.frame_ticks, ..schedule.clone() } == self.schedule
    }

    /// The photocurrents of a scan, above dark, at nominal drive. A cell whose emitter was off has none.
    pub fn photocurrents(&self, scan: &RawScan) -> Photocurrents<f32> {
        let dark = scan.dark();
        let cells = self.stages.iter().zip(scan.lit()).zip(scan.levels()).enumerate();
        let readings = cells.map(|(cell, ((stage, lit), level))| {
            if level.0 == 0 || stage.amperes_per_word == 0.0 {
                return Reading::Missing;
            }
            if lit.iter().any(|&word| self.scaling.is_saturated(word, self.schedule.oversampling)) {
                return Reading::Saturated;
            }
            let amperes = stage.amperes_per_word * (f32::from(Level::NOMINAL.0) / f32::from(level.0));
            let current = |electrode: usize| {
                let lit = lit[electrode];
                let above = match dark {
                    // Exact: words have 16 bits.
                    Some(dark) => (i32::from(lit) - i32::from(dark[cell][electrode])) as f32,
                    None => f32::from(lit) - stage.zero_word,
                };
                above * amperes
            };
            Reading::Light(Pair { i_x1_a: current(0), i_x2_a: current(1) })
        });
        Photocurrents { cells: readings.collect() }
    }
}

/// The payload of the head at the start of `bytes`.
///
/// # Errors
/// If it is damaged, or of another version.
pub(super) fn payload(bytes: &[u8]) -> Result<&[u8], HeadError> {
    let (header, rest) = bytes.split_first_chunk::<HEADER_BYTES>().ok_or(HeadError::Damaged)?;
    let word = |at: usize| u32::from_le_bytes([header[at], header[at + 1], header[at + 2], header[at + 3]]);
    let half = |at: usize| u16::from_le_bytes([header[at], header[at + 1]]);
    let (magic, version, length) = (word(0), half(4), usize::from(half(6)));
    let payload = rest.get(..length).ok_or(HeadError::Damaged)?;
    if magic != MAGIC || word(8) != checksum(&header[4..8], payload) {
        return Err(HeadError::Damaged);
    }
    if version != VERSION {
        return Err(HeadError::Version { theirs: version });
    }
    Ok(payload)
}

fn checksum(start: &[u8], payload: &[u8]) -> u32 {
    let mut digest = CRC.digest();
    digest.update(start);
    digest.update(payload);
    digest.finalize()
}

#[cfg(test)]
pub(super) mod tests {
    use slitpose_model::{CompiledScene, Noise, Pose, Scene, Tier};
    use slitpose_protocol::WordPair;

    use super::*;
    use crate::pcb::{default_configuration, default_scaling};

    /// Photocurrent of a step of a word.
    const STEP_A: f64 = -0.62e-9;

    /// Six cells in a ring: that of the examples in `slitpose-model`.
    pub(in crate::pose) fn scene() -> Scene {
        let noise = Noise { shot_bandwidth_hz: 1e5, johnson_bandwidth_hz: 1e5, temperature_k: 300.0, adc_a: 2e-9 };
        Scene { noise: Some(noise), ..include!("../../../model/doc/ring.rs") }
    }

    pub(in crate::pose) fn head() -> Head {
        let solver = HeadSolver::compact(&scene()).expect("fits").with_exposures(&[1e-5, 2e-5, 3e-5, 1e-5, 2e-5, 3e-5]);
        let stage = CellStage { amperes_per_word: STEP_A as f32, zero_word: 16_000.0 };
        let readout = Readout {
            hashes: Hashes { scene: Some(1), calibration: None },
            schedule: default_configuration().schedule,
            scaling: default_scaling(),
            stages: [stage; 6].into_iter().collect(),
        };
        Head { readout, solver }
    }

    /// What the converters give with the tool at rest at `pose`.
    pub(in crate::pose) fn scan(pose: &Pose, sequence: u64) -> RawScan {
        let plan = CompiledScene::<f64>::compile(&scene(), Tier::Exact { tolerance: 1e-6 }).expect("valid");
        let mut scan = RawScan::new(6, true);
        (scan.sequence, scan.tick) = (sequence, 42_500 * sequence);
        scan.levels_mut().fill(Level::NOMINAL);
        scan.dark_mut().expect("dark words").fill([16_124; 2]);
        for (cell, words) in scan.lit_mut().iter_mut().enumerate() {
            let pair = plan.photocurrents(cell, pose);
            *words = [pair.i_x1_a, pair.i_x2_a].map(|current| (16_124.0 + current / STEP_A).round() as u16);
        }
        scan
    }

    fn bytes() -> std::vec::Vec<u8> {
        head().encode(&mut [0; HEAD_BYTES]).expect("room").to_vec()
    }

    #[test]
    fn a_head_is_read_as_it_was_written() {
        let bytes = bytes();
        let read = Head::decode(&bytes).expect("whole");
        assert_eq!(read.encode(&mut [0; HEAD_BYTES]).expect("room"), bytes);
        assert_eq!(read.readout.hashes, head().readout.hashes);
        // What follows in the memory is of no interest.
        let followed = [&bytes[..], &[0xff; 9]].concat();
        assert!(Head::decode(&followed).is_ok());
    }

    #[test]
    fn a_flipped_bit_and_a_missing_end_are_noticed_everywhere() {
        let whole = bytes();
        for at in 0..whole.len() {
            let mut flipped = whole.clone();
            flipped[at] ^= 1 << (at % 8);
            assert!(Head::decode(&flipped).is_err(), "byte {at}");
            assert_eq!(Head::decode(&whole[..at]).err(), Some(HeadError::Damaged), "{at} bytes");
        }
    }

    #[test]
    fn heads_of_other_versions_are_told_apart_from_damage() {
        let mut other = bytes();
        other[4] += 1;
        let (length, version) = (u16::from_le_bytes([other[6], other[7]]), VERSION + 1);
        let sum = checksum(&other[4..8], &other[HEADER_BYTES..HEADER_BYTES + usize::from(length)]);
        other[8..12].copy_from_slice(&sum.to_le_bytes());
        assert_eq!(Head::decode(&other).err(), Some(HeadError::Version { theirs: version }));
    }

    #[test]
    fn words_become_currents_at_nominal_drive() {
        let readout = head().readout;
        let mut scan = RawScan::new(6, true);
        scan.levels_mut().copy_from_slice(&[
            Level::NOMINAL,
            Level(0x4000),
            Level(0),
            Level::NOMINAL,
            Level::NOMINAL,
            Level::NOMINAL,
        ]);
        let words: [WordPair; 6] =
            [[15_000, 14_000], [15_000, 14_000], [15_000; 2], [128, 15_000], [129, 15_000], [16_200; 2]];
        scan.lit_mut().copy_from_slice(&words);
        scan.dark_mut().expect("dark words").fill([16_000, 16_100]);
        let cells = readout.photocurrents(&scan).cells;
        let light = |first: f32, second: f32| Reading::Light(Pair { i_x1_a: first, i_x2_a: second });
        let step = STEP_A as f32;
        assert_eq!(cells[0], light(-1_000.0 * step, -2_100.0 * step));
        // Driven at half: twice the current at nominal drive.
        assert_eq!(cells[1], light(-1_000.0 * (step * 2.0), -2_100.0 * (step * 2.0)));
        assert_eq!(cells[2], Reading::Missing);
        // 32 codes of four conversions.
        assert_eq!((cells[3], cells[4]), (Reading::Saturated, light(-15_871.0 * step, -1_100.0 * step)));
        assert_eq!(cells[5], light(200.0 * step, 100.0 * step));
        let mut without_dark = RawScan::new(6, false);
        without_dark.levels_mut().fill(Level::NOMINAL);
        without_dark.lit_mut().fill([15_000; 2]);
        assert_eq!(readout.photocurrents(&without_dark).cells[0], light(-1_000.0 * step, -1_000.0 * step));
    }
}
