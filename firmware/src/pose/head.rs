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

/// Bytes of the longest head.
pub const HEAD_BYTES: usize = 4 * 1024;

const MAGIC: u32 = u32::from_le_bytes(*b"head");

/// Raised when the payload changes.
const VERSION: u16 = 1;

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

    /// The head in `bytes`, which may be followed by others.
    ///
    /// # Errors
    /// If there is none that this firmware reads.
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
