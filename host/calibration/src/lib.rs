//! From parts with tolerances to a head whose parameters are known, and how well.
//!
//! [`calibrate`] takes a scene and [`Data`] and gives a [`Calibration`]: what it makes of the scene, and what it leaves open
//! in each pose. Read in this order:
//! * `parameter`, `prior`: what a head may deviate in, and by how much before anything is measured;
//! * `data`, `tables`: what was measured, and what is known of the poses;
//! * `plausibility`, `start`: wrong data are refused, first poses found;
//! * `state`, `light`, `normal`, `adjust`: derivatives, normal equations without the poses, steps, outliers, model errors;
//! * `engine`: all of it in order; `discrepancy`, `pose_error`, `findings`: what came of it, and what tolerances cost
//!   without it;
//! * `file`: how it is stored; `head`: what solves with it, or without any; `reading`: whether it still holds.
//!
//! Readings are currents above dark, SI units throughout. Parameters are deviations from the scene; inside the adjustment
//! they are counted in standard deviations of their priors.

#![forbid(unsafe_code)]

mod adjust;
mod data;
mod discrepancy;
mod engine;
mod file;
mod findings;
mod head;
mod light;
mod normal;
mod parameter;
mod plausibility;
mod pose_error;
mod prior;
mod reading;
mod start;
mod state;
pub mod tables;

use schemars::JsonSchema;
use serde::Deserialize;
use slitpose_head::scene_file::{SceneFile, Workspace};
use slitpose_model::{CompiledScene, ModelError, Pose, Scene, Tier};

pub use data::{Constraint, Data, Group, Knowledge, Row, compose, half_extents, inverse, median, pose_of, values_of};
pub use engine::{CalibrateError, Calibrated, Progress, Request, calibrate};
pub use file::{CalibrationFileError, Frames, file_schema};
pub use findings::{Coverage, Direction};
pub use head::{Basis, Head, uncalibrated};
pub use light::LightTrend;
pub use parameter::Quantity;
pub use plausibility::{Implausible, Reports, check_poses, other_reading};
pub use pose_error::{KnownPoses, PartCost, PartCosts, PoseRms, part_costs};
pub use prior::{Parameter, draw};
pub use reading::{CellValidity, Validity, measured_noise, validity};
pub use start::align;
pub use state::Residual;

use pose_error::PoseError;
use prior::Parameters;

/// The parameters of one head, from measurements on it.
///
/// ```
/// use slitpose_calibration::Calibration;
/// let error = Calibration::from_bytes("head.toml", b"format = 1").unwrap_err().to_string();
/// assert!(error.contains("head.toml"), "{error}");
/// ```
#[derive(Clone, Debug, PartialEq)]
pub struct Calibration {
    /// A word that tells calibrations apart.
    pub id: String,
    /// When the data were taken, if that is known.
    pub date: Option<String>,
    origin: String,
    source: String,
    hash: u64,
    scene_name: String,
    scene_source: String,
    scene_hash: u64,
    /// How well the data fit.
    pub statistics: Statistics,
    /// What the data left open, in words.
    pub weak: Vec<String>,
    /// Where the frames of instruments lie.
    pub frames: Vec<Frames>,
    /// How the light changed while files were taken.
    pub light: Vec<LightTrend>,
    /// What known poses cover; `None`: there were none.
    pub covered: Option<Coverage>,
    parameters: Parameters,
    /// Below the diagonal, row by row.
    correlation: Vec<Vec<f64>>,
    /// What each cell does beyond the model.
    pub model_errors: Vec<ModelError>,
    pose_error: PoseError,
}

/// How well the data fit.
#[derive(Clone, Copy, Debug, Default, PartialEq, Deserialize, JsonSchema)]
pub struct Statistics {
    /// Rows of readings, of all files.
    pub rows: usize,
    /// Readings of single cells that entered.
    pub readings: usize,
    /// Readings that contradict all others.
    pub readings_rejected: usize,
    /// Poses of the instrument that contradict all others.
    pub poses_rejected: usize,
    /// Sum of the squared normalised residuals, of priors, too.
    pub chi2: f64,
    /// Its expectation.
    pub redundancy: f64,
    /// Root-mean-square distance from the instrument's translations, of rows left out in turn, metres; `None`: too few
    /// rows, or none of them gave a pose.
    pub held_out_m: Option<f64>,
    /// The same of the rotation angle, radians.
    pub held_out_rad: Option<f64>,
}

impl Calibration {
    /// The file it was read from, for messages.
    pub fn origin(&self) -> &str {
        &self.origin
    }

    /// The text of the file.
    pub fn source(&self) -> &str {
        &self.source
    }

    /// Hash of the file's text.
    pub fn hash(&self) -> u64 {
        self.hash
    }

    /// The scene it was made with.
    pub fn scene_file(&self) -> Result<SceneFile, slitpose_head::scene_file::SceneFileError> {
        SceneFile::parse(&self.scene_name, &self.scene_source)
    }

    /// Names it by its numbers: eight hexadecimal digits.
    fn name_by_parameters(&mut self) {
        let values: Vec<u8> = self.parameters.entries.iter().flat_map(|entry| entry.value.to_le_bytes()).collect();
        self.id = format!("{:08x}", slitpose_head::scene_file::fnv1a_64(&values) >> 32);
    }

    /// All parameters.
    pub fn parameters(&self) -> &[Parameter] {
        &self.parameters.entries
    }

    /// The calibrated optics of the head that `file` describes.
    pub fn apply(&self, file: &SceneFile) -> Result<Scene, CalibrationFileError> {
        self.require_scene(file)?;
        let mut scene = self.parameters.scene(&file.scene);
        for (cell, error) in scene.cells.iter_mut().zip(&self.model_errors) {
            cell.effects.model_error = *error;
        }
        CompiledScene::<f64>::compile(&scene, Tier::Paper)
            .map_err(|source| CalibrationFileError::Impossible(self.origin.clone(), source))?;
        Ok(scene)
    }

    /// What the calibration left open of poses over a `workspace`, apart from where base and tool frame lie: root mean square
    /// of three axes together, metres and radians. Noise and model errors of a frame come on top.
    pub fn open_apart_from_frames(&self, workspace: &Workspace) -> [f64; 2] {
        self.pose_error.apart_from_frames(workspace)
    }

    /// Covariance of the error (δt, δθ) of a pose that the calibration left: m², m·rad, rad². It is the same at every
    /// visit of a pose; noise and model error of the frame come on top, and are in the covariance of a solution.
    pub fn pose_covariance(&self, pose: &Pose) -> [[f64; 6]; 6] {
        self.pose_error.covariance(pose)
    }
}
