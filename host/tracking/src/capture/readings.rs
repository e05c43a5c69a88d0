//! The photocurrents of a capture, for calibration.

use std::path::{Path, PathBuf};

use slitpose_calibration::{Knowledge, Row};
use slitpose_model::{Cell, Noise, Reading};
use slitpose_protocol::{Decoder, Hello, MAX_MESSAGE_BYTES, Message, RawScan, Schedule};
use thiserror::Error;

use super::{CaptureError, CaptureReader, Entry};
use crate::link::Segment;
use crate::pipeline::{PipelineError, SceneMatch, check};
use slitpose_head::front_end::Stage;
use slitpose_head::scene_file::SceneFile;

/// Why a capture gives no readings.
#[derive(Debug, Error)]
#[allow(missing_docs, reason = "the texts say what each is, and no other crate can name them")]
pub enum ReadingsError {
    #[error(transparent)]
    Capture(#[from] CaptureError),
    #[error("{}", path.display())]
    Board { path: PathBuf, source: PipelineError },
    #[error("{} holds several boards, and a calibration is of one head; give a capture of that head alone", path.display())]
    SeveralBoards { path: PathBuf },
    #[error("{} holds no scan; give a capture written by `run --record` or `simulate`", path.display())]
    NoScan { path: PathBuf },
}

/// Readings of one board, with the noise of one frame.
pub struct Readings {
    /// Photocurrents, a row per reading.
    pub rows: Vec<Row>,
    /// Noise of one frame; `None` if there are too few scans to measure it.
    pub noise: Option<Noise>,
}

/// Photocurrents of one scan, not yet at one instant.
struct Scan {
    sequence: u64,
    time_s: f64,
    pairs: Vec<Option<[f64; 2]>>,
}

/// Reads the capture at `path` of the head of `file`.
///
/// Cells are exposed one after the other; their currents are carried to the reference instant of the frame with the
/// slope between the frames before and after. Frames at a gap are left out.
pub fn read(path: &Path, file: &SceneFile) -> Result<Readings, ReadingsError> {
    let mut reader = CaptureReader::open(path)?;
    let (mut segment, mut decoder) = (Segment::default(), Decoder::<MAX_MESSAGE_BYTES>::new());
    let (mut device, mut board, mut rows) = (None, None::<Board<'_>>, Vec::new());
    while let Some(entry) = reader.next(&mut segment)? {
        let of = match entry {
            Entry::Setup(_) => continue,
            Entry::Hello { device, .. } => Some(device),
            Entry::Link { device, .. } => device,
        };
        if *device.get_or_insert(of) != of {
            return Err(ReadingsError::SeveralBoards { path: path.to_owned() });
        }
        for (mut bytes, _) in segment.chunks() {
            while let Some(message) = decoder.next::<Message>(&mut bytes) {
                match message {
                    Ok(Message::Hello(hello)) => {
                        check(file, SceneMatch::Required, &hello)
                            .map_err(|source| ReadingsError::Board { path: path.to_owned(), source })?;
                        board = Board::of(file, &hello);
                    }
                    Ok(Message::Batch(batch)) => {
                        let Some(board) = &mut board else { continue };
                        // A batch that does not fit its schedule is damaged.
                        let scans = batch.scans(&board.schedule).into_iter().flatten();
                        scans.for_each(|scan| rows.extend(board.take(&scan)));
                    }
                    _ => {}
                }
            }
        }
    }
    match board {
        Some(Board { noise, .. }) if !rows.is_empty() => Ok(Readings { rows, noise }),
        _ => Err(ReadingsError::NoScan { path: path.to_owned() }),
    }
}

/// A board since its last hello.
struct Board<'a> {
    file: &'a SceneFile,
    stage: Stage,
    schedule: Schedule,
    noise: Option<Noise>,
    /// Exposure of each cell after the reference instant, in frames.
    offsets: Vec<f64>,
    /// Up to two scans that follow each other.
    before: Vec<Scan>,
}

impl<'a> Board<'a> {
    /// `None` if its schedule cannot be run, or has other cells.
    fn of(file: &'a SceneFile, hello: &Hello<'_>) -> Option<Self> {
        let schedule = hello.schedule.clone();
        schedule.validate().ok()?;
        if usize::from(schedule.cells) != file.scene.cells.len() {
            return None;
        }
        let stage = Stage::new(file, &schedule, &hello.scaling);
        let rate_hz = schedule.frame_rate_hz();
        Some(Self {
            file,
            noise: Stage::weighted_scene(file, &schedule, &hello.scaling).noise,
            offsets: stage.exposures_s().iter().map(|offset_s| offset_s * rate_hz).collect(),
            stage,
            schedule,
            before: Vec::new(),
        })
    }

    /// The scan before `scan`, if its neighbours are there.
    fn take(&mut self, scan: &RawScan) -> Option<Row> {
        let currents = self.stage.photocurrents(scan);
        let of_cell = |(reading, cell): (&Reading, &Cell)| match reading {
            Reading::Light(pair) if pair.total_a() > cell.detector.faint_a => Some([pair.i_x1_a, pair.i_x2_a]),
            _ => None,
        };
        let pairs = currents.cells.iter().zip(&self.file.scene.cells).map(of_cell).collect();
        let ticks = scan.tick as f64 + self.schedule.reference_ticks();
        let time_s = ticks / f64::from(self.schedule.tick_hz);
        let scan = Scan { sequence: scan.sequence, time_s, pairs };
        if self.before.last().is_some_and(|last| last.sequence + 1 != scan.sequence) {
            self.before.clear();
        }
        let row = match self.before.as_slice() {
            [before, at] => Some(at_reference(before, at, &scan, &self.offsets)),
            _ => None,
        };
        if row.is_some() {
            self.before.remove(0);
        }
        self.before.push(scan);
        row
    }
}

/// The readings of `at` at the reference instant; `offsets` are those of the exposures, in frames.
fn at_reference(before: &Scan, at: &Scan, after: &Scan, offsets: &[f64]) -> Row {
    let reading = |cell: usize| {
        let [before, at, after] = [before.pairs[cell]?, at.pairs[cell]?, after.pairs[cell]?];
        Some([0, 1].map(|k| at[k] - offsets[cell] * 0.5 * (after[k] - before[k])))
    };
    Row {
        id: at.sequence.to_string(),
        readings: (0..offsets.len()).map(reading).collect(),
        frames: 1.0,
        time_s: Some([at.time_s; 2]),
        knowledge: Knowledge::Nothing,
    }
}
