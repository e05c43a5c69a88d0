//! Measurements on a head, read for its calibration.

use std::path::Path;

use slitpose_calibration::{CalibrateError, Calibration, Constraint, Data, Row, measured_noise, read_tracked, tables};
use slitpose_head::front_end::{Stage, TimingError, configuration};
use slitpose_head::scene_file::SceneFile;
use slitpose_head::simulator::Electronics;
use slitpose_head::table::is_capture;
use thiserror::Error;

pub use crate::capture::ReadingsError;
use crate::capture::{Readings, readings};

/// How well the tip of a tool stays in a cone, and a tool returns to a stop: metres and radians.
const CONTACT: [f64; 2] = [3e-6, 100e-6];

/// How true the steps of a stage are, and how little its carriage turns: metres and radians.
const STAGE: [f64; 2] = [1e-6, 20e-6];

/// Standard deviations of an instrument that states none, each axis: metres and radians.
const INSTRUMENT: [f64; 2] = [2e-6, 20e-6];

/// Ratio of measured to stated noise, or its inverse, from which it is said.
const OTHER_NOISE: f64 = 1.3;

/// The files with measurements on a head, by what is known of their poses: tables, or captures where no poses are needed.
#[derive(Clone, Debug)]
pub struct Measurements {
    /// Readings at poses that another instrument measured; the first ones may be poses alone, by a clock of their own.
    pub known: Vec<String>,
    /// The captures that belong to those.
    pub known_captures: Vec<String>,
    /// Readings of free motion.
    pub free: Vec<String>,
    /// Readings while one point of the tool rests in a cone.
    pub pivot: Vec<String>,
    /// Readings at known steps along a line.
    pub stage: Vec<String>,
    /// Readings of several returns to one pose.
    pub rest: Vec<String>,
    /// Whether the instrument's frame and marker are at unknown places, and not those of the scene.
    pub has_own_frames: bool,
    /// Standard deviations of the instrument's poses, each axis: metres and radians.
    pub known_sigmas: [f64; 2],
}

impl Default for Measurements {
    fn default() -> Self {
        Self {
            known: Vec::new(),
            known_captures: Vec::new(),
            free: Vec::new(),
            pivot: Vec::new(),
            stage: Vec::new(),
            rest: Vec::new(),
            has_own_frames: false,
            known_sigmas: INSTRUMENT,
        }
    }
}

/// Why measurements cannot be read.
#[derive(Debug, Error)]
#[allow(missing_docs, reason = "the texts say what each is")]
pub enum MeasurementsError {
    #[error(transparent)]
    Data(#[from] CalibrateError),
    #[error(transparent)]
    Readings(#[from] ReadingsError),
    #[error(transparent)]
    Timing(#[from] TimingError),
    #[error(
        "--known-capture {capture} is one more than the tables of --known; give --known with the instrument's poses of each capture"
    )]
    NoPosesOfCapture { capture: String },
}

impl Measurements {
    /// Reads all of them, of the head of `file`, which may have been calibrated before (`start`); `say` is told what is
    /// remarkable.
    ///
    /// # Errors
    /// Files that cannot be read, or are of another head.
    pub fn read(
        &self,
        file: &SceneFile,
        start: Option<&Calibration>,
        say: &mut dyn FnMut(&str),
    ) -> Result<Data, MeasurementsError> {
        let known = if self.has_own_frames { Constraint::KnownInOwnFrames } else { Constraint::Known };
        let mut data = Data::default();
        if let Some(capture) = self.known_captures.get(self.known.len()) {
            return Err(MeasurementsError::NoPosesOfCapture { capture: capture.clone() });
        }
        let (tracked, listed) = self.known.split_at(self.known_captures.len());
        for (table, capture) in tracked.iter().zip(&self.known_captures) {
            let rows = read_capture(file, capture, &mut data, say)?;
            read_tracked(file, start, [table, capture], rows, known, self.known_sigmas, &mut data)?;
        }
        for (files, constraint, sigmas) in [
            (listed, known, self.known_sigmas),
            (&self.free, Constraint::Free, CONTACT),
            (&self.pivot, Constraint::Pivot, CONTACT),
            (&self.stage, Constraint::Stage, STAGE),
            (&self.rest, Constraint::Rest, CONTACT),
        ] {
            for name in files {
                read(file, name, constraint, sigmas, &mut data, say)?;
            }
        }
        with_noise(file, &mut data)?;
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
    let has_poses = matches!(constraint, Constraint::Known | Constraint::KnownInOwnFrames | Constraint::Stage);
    if has_poses || !is_capture(Path::new(name)) {
        return Ok(tables::read(file, name, constraint, sigmas, data)?);
    }
    let rows = read_capture(file, name, data, say)?;
    data.add(name, constraint, sigmas, tables::thinned(rows));
    Ok(())
}

/// The frames of a capture, whose noise is then that of the data.
fn read_capture(
    file: &SceneFile,
    name: &str,
    data: &mut Data,
    say: &mut dyn FnMut(&str),
) -> Result<Vec<Row>, MeasurementsError> {
    let Readings { rows, noise } = readings(Path::new(name), file)?;
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

/// Tables of a scene that has no [noise] have the noise of the board that it asks for.
fn with_noise(file: &SceneFile, data: &mut Data) -> Result<(), TimingError> {
    if data.noise.is_none()
        && file.scene.noise.is_none()
        && let Some(front_end) = file.front_end
    {
        let configuration = configuration(file)?;
        let scaling = Electronics::new(&file.scene, &front_end).scaling();
        data.noise = Stage::weighted_scene(file, &configuration.schedule, &scaling).noise;
    }
    Ok(())
}
