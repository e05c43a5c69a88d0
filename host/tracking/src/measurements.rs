//! Measurements on a head, read for its calibration.

use std::collections::VecDeque;
use std::path::{Path, PathBuf};

use slitpose_calibration::{CalibrateError, Constraint, Data, Knowledge, Row, measured_noise, tables};
use slitpose_head::front_end::{Stage, TimingError};
use slitpose_head::scene_file::SceneFile;
use slitpose_head::simulator::table_noise;
use slitpose_head::table::is_capture;
use slitpose_model::{Cell, Noise, Reading, Tier};
use thiserror::Error;

use crate::capture::{CaptureError, CaptureReader, Entry};
use crate::link::Segment;
use crate::pipeline::{Item, Pipeline, PipelineError, SceneMatch};

/// How well the tip of a tool stays in a cone, and a tool returns to a stop: metres and radians.
pub(crate) const CONTACT: [f64; 2] = [3e-6, 100e-6];

/// How true the steps of a stage are, and how little its carriage turns: metres and radians.
const STAGE: [f64; 2] = [1e-6, 20e-6];

/// Standard deviations of an instrument that states none, each axis: metres and radians.
const INSTRUMENT: [f64; 2] = [2e-6, 20e-6];

/// The tool rests for this long before the note that marks it, nanoseconds.
const REST_NS: u64 = 250_000_000;

/// Ratio of measured to stated noise, or its inverse, from which it is said.
const OTHER_NOISE: f64 = 1.3;

/// The files with measurements on a head, by what is known of their poses: tables, or captures where no poses are needed.
#[derive(Clone, Debug, Default)]
pub struct Measurements {
    /// Readings at poses that another instrument measured.
    pub known: Vec<String>,
    /// Readings of free motion.
    pub free: Vec<String>,
    /// Readings while one point of the tool rests in a cone.
    pub pivot: Vec<String>,
    /// Readings at known steps along a line; of captures, those at notes such as `step 1.25 mm`.
    pub stage: Vec<String>,
    /// Readings of several returns to one pose; of captures with notes `stop`, those at the notes.
    pub rest: Vec<String>,
    /// Whether the instrument's frame and marker are at unknown places, and not those of the scene.
    pub has_own_frames: bool,
    /// Standard deviations of the instrument's poses, each axis: metres and radians; `None`: as usual, 2 µm and 20 µrad.
    pub known_sigmas: Option<[f64; 2]>,
}

/// Why measurements cannot be read.
#[derive(Debug, Error)]
#[allow(missing_docs, reason = "the texts say what each is")]
pub enum MeasurementsError {
    #[error(transparent)]
    Data(#[from] CalibrateError),
    #[error(transparent)]
    Capture(#[from] CaptureError),
    #[error("{}", path.display())]
    Board { path: PathBuf, source: PipelineError },
    #[error("{} holds several boards, and a calibration is of one head; give a capture of that head alone", path.display())]
    SeveralBoards { path: PathBuf },
    #[error("{} holds no scan; give a capture written by `run --record` or `simulate`", path.display())]
    NoScan { path: PathBuf },
    #[error(
        "{} has no note such as `step 1.25 mm`, taken while the tool rests at that step; give such a capture, or a table with step_mm", path.display()
    )]
    NoSteps { path: PathBuf },
    #[error(transparent)]
    Timing(#[from] TimingError),
}

impl Measurements {
    /// Reads all of them, of the head of `file`; `say` is told what is remarkable.
    ///
    /// # Errors
    /// Files that cannot be read, or are of another head.
    pub fn read(&self, file: &SceneFile, say: &mut dyn FnMut(&str)) -> Result<Data, MeasurementsError> {
        let known_sigmas = self.known_sigmas.unwrap_or(INSTRUMENT);
        let known = if self.has_own_frames { Constraint::KnownInOwnFrames } else { Constraint::Known };
        let mut data = Data::default();
        for (files, constraint, sigmas) in [
            (&self.known, known, known_sigmas),
            (&self.free, Constraint::Free, CONTACT),
            (&self.pivot, Constraint::Pivot, CONTACT),
            (&self.stage, Constraint::Stage, STAGE),
            (&self.rest, Constraint::Rest, CONTACT),
        ] {
            for name in files {
                read(file, name, constraint, sigmas, &mut data, say)?;
            }
        }
        if data.noise.is_none() {
            data.noise = table_noise(file)?;
        }
        Ok(data)
    }
}

/// Adds a table, or a capture where no poses are needed.
fn read(
    file: &SceneFile,
    name: &str,
    constraint: Constraint,
    sigmas: [f64; 2],
    data: &mut Data,
    say: &mut dyn FnMut(&str),
) -> Result<(), MeasurementsError> {
    let has_poses = matches!(constraint, Constraint::Known | Constraint::KnownInOwnFrames);
    if has_poses || !is_capture(Path::new(name)) {
        return Ok(tables::read(file, name, constraint, sigmas, data)?);
    }
    let marks = marks(Path::new(name), constraint)?;
    let rows = match &marks[..] {
        [] if constraint == Constraint::Stage => return Err(MeasurementsError::NoSteps { path: name.into() }),
        [] => tables::thinned(read_capture(file, name, None, data, say)?),
        _ => at_rest(name, &marks, &read_capture(file, name, Some(&marks), data, say)?, say),
    };
    data.add(name, constraint, sigmas, rows);
    Ok(())
}

/// An instant at which a note says that the tool rests.
struct Mark {
    text: String,
    /// On the time line of the capture.
    at_ns: u64,
    knowledge: Knowledge,
}

/// The notes of a capture that mark rows of `constraint`: `step 1.25 mm` of a stage, `stop` of a tool that has returned.
fn marks(path: &Path, constraint: Constraint) -> Result<Vec<Mark>, MeasurementsError> {
    let knowledge = |text: &str| match constraint {
        Constraint::Stage => {
            let step_mm: f64 = text.strip_prefix("step ")?.strip_suffix("mm")?.trim().parse().ok()?;
            step_mm.is_finite().then_some(Knowledge::Step(step_mm * 1e-3))
        }
        Constraint::Rest => (text == "stop").then_some(Knowledge::Nothing),
        _ => None,
    };
    let mut found = Vec::new();
    if !matches!(constraint, Constraint::Stage | Constraint::Rest) {
        return Ok(found);
    }
    let (mut reader, mut segment) = (CaptureReader::open(path)?, Segment::default());
    while let Some(entry) = reader.next(&mut segment)? {
        if let Entry::Note { stamp_ns, text, .. } = entry
            && let Some(knowledge) = knowledge(text.trim())
        {
            found.push(Mark { text, at_ns: stamp_ns, knowledge });
        }
    }
    Ok(found)
}

/// One row for each mark: the mean of the frames just before it, which are `rows`, with the place of their mark as id.
fn at_rest(name: &str, marks: &[Mark], rows: &[Row], say: &mut dyn FnMut(&str)) -> Vec<Row> {
    let mut found = Vec::new();
    for (place, mark) in marks.iter().enumerate() {
        let id = place.to_string();
        let of_mark: Vec<Row> = rows.iter().filter(|row| row.id == id).cloned().collect();
        // Halves of the same length.
        let half = of_mark.len() / 2;
        let [first, second] = [&of_mark[..half], &of_mark[of_mark.len() - half..]].map(tables::mean);
        let (Some(first), Some(second)) = (first, second) else {
            say(&format!("{name}: no frames at the note `{}`; left out", mark.text));
            continue;
        };
        if !tables::is_at_rest(&first, &second) {
            say(&format!("{name}: the tool moved at the note `{}`; left out: note it when the tool rests", mark.text));
            continue;
        }
        found.extend(tables::mean(&of_mark).map(|mean| Row { knowledge: mark.knowledge, ..mean }));
    }
    found
}

/// The frames of a capture, whose noise is then that of the data; with `marks`, those at rest before them alone.
fn read_capture(
    file: &SceneFile,
    name: &str,
    marks: Option<&[Mark]>,
    data: &mut Data,
    say: &mut dyn FnMut(&str),
) -> Result<Vec<Row>, MeasurementsError> {
    let (rows, noise) = readings(Path::new(name), file, marks)?;
    data.noise = noise.map(|stated| match measured_noise(&rows, &file.scene, &stated) {
        None => stated,
        Some(ratio) => {
            if !(OTHER_NOISE.recip()..OTHER_NOISE).contains(&ratio) {
                say(&format!("{name}: its noise is {ratio:.1} times what the scene says; counted as it is"));
            }
            stated.averaged(ratio.powi(-2))
        }
    });
    Ok(rows)
}

/// Photocurrents of one scan, not yet at one instant.
struct Exposed {
    sequence: u64,
    time_s: f64,
    pairs: Vec<Option<[f64; 2]>>,
}

/// Reads the capture at `path` of the head of `file`: its rows, and the noise of one frame.
///
/// Cells are exposed one after the other; their currents are carried to the reference instant of the frame with the
/// slope between the frames before and after. Frames at a gap are left out, and those that are not just before one of the
/// marks, whose place is then their id.
fn readings(
    path: &Path,
    file: &SceneFile,
    marks: Option<&[Mark]>,
) -> Result<(Vec<Row>, Option<Noise>), MeasurementsError> {
    let mut reader = CaptureReader::open(path)?;
    // Nothing is solved.
    let mut pipeline = Pipeline::new(file.clone(), Tier::Paper, SceneMatch::Required);
    let (mut segment, mut device, mut noise) = (Segment::default(), None, None);
    let (mut exposed, mut rows) = (VecDeque::<Exposed>::new(), Vec::new());
    while let Some(entry) = reader.next(&mut segment)? {
        let (of, at_ns) = match entry {
            Entry::Setup(_) | Entry::Note { .. } => continue,
            Entry::Hello { device, .. } => (Some(device), None),
            Entry::Link { device, log_ns, .. } => (device, Some(log_ns)),
        };
        let is_before =
            |at_ns, mark: &Mark| mark.at_ns.checked_sub(at_ns).is_some_and(|before_ns| before_ns <= REST_NS);
        let is_of = |mark: &Mark| at_ns.is_some_and(|at_ns| is_before(at_ns, mark));
        let place = marks.map(|marks| marks.iter().position(is_of));
        if *device.get_or_insert(of) != of {
            return Err(MeasurementsError::SeveralBoards { path: path.to_owned() });
        }
        let received = pipeline.receive(&segment, |item| {
            if let Item::Hello(hello) = item {
                noise = Stage::weighted_scene(file, &hello.schedule, &hello.scaling).noise;
            }
            Ok(())
        });
        received.map_err(|source| MeasurementsError::Board { path: path.to_owned(), source })?;
        while let Some((scan, currents)) = pipeline.take_currents() {
            let of_cell = |(reading, cell): (&Reading, &Cell)| match reading {
                Reading::Light(pair) if pair.total_a() > cell.detector.faint_a => Some([pair.i_x1_a, pair.i_x2_a]),
                _ => None,
            };
            let pairs = currents.cells.iter().zip(&file.scene.cells).map(of_cell).collect();
            let follows = |last: &Exposed| last.sequence + 1 == scan.sequence && last.time_s < scan.device_time_s;
            if !exposed.back().is_some_and(follows) {
                exposed.clear();
            }
            exposed.push_back(Exposed { sequence: scan.sequence, time_s: scan.device_time_s, pairs });
            if let (Some(offsets), [before, at, after]) = (pipeline.exposures_of(&scan), &*exposed.make_contiguous()) {
                match place {
                    None => rows.push(at_reference(before, at, after, &offsets)),
                    Some(Some(place)) => {
                        let id = place.to_string();
                        rows.push(Row { id, ..at_reference(before, at, after, &offsets) });
                    }
                    Some(None) => {}
                }
                exposed.pop_front();
            }
        }
    }
    if rows.is_empty() { Err(MeasurementsError::NoScan { path: path.to_owned() }) } else { Ok((rows, noise)) }
}

/// The readings of `at` at the reference instant; `offsets` are those of the exposures, in frames.
fn at_reference(before: &Exposed, at: &Exposed, after: &Exposed, offsets: &[f64]) -> Row {
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
