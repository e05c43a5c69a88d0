//! The frame and the point of the tool that poses speak of, if not the head's own: see [`View`]. The pipeline applies it to
//! each record, so all outputs agree.
//!
//! With base_from_tool (R, t), user_from_base (U, u) and the tip p in the tool frame:
//!
//! user_from_tip = (U·R, U·(R·p + t) + u).
//!
//! A perturbation t + δt, exp(δθ)·R of the pose moves it by U·(δt + δθ × R·p) and turns it by U·δθ, so the covariance
//! becomes J·C·Jᵀ with J = [U, −U·\[R·p\]×; 0, U], exactly. The same J transforms velocities. The tip's own covariance Σ
//! adds U·R·Σ·Rᵀ·Uᵀ to that of the position. A frame is a definition, and has no error.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use glam::{DMat3, DVec3};
use serde::Deserialize;
use slitpose_calibration::{compose, inverse};
use slitpose_head::foreign::printable;
use slitpose_head::platform;
use slitpose_head::text_file::{self, TextFileError};
use slitpose_model::{Estimate, Pose, Solution, Twist, TwistEstimate};
use thiserror::Error;

use crate::pipeline::Record;

pub use zero::FrameReport;
pub(crate) use zero::Viewer;

#[cfg(test)]
mod tests;
mod zero;

type Matrix6 = [[f64; 6]; 6];

/// The name that stands for the head's own frame.
pub const BASE: &str = "base";

/// Longest name of a frame.
const MAX_NAME: usize = 32;

/// Longest way from the base, or from the tool, millimetres: beyond it a file has other units.
const MAX_MM: f64 = 1e4;

/// A frame, and a point of the tool: its tip. It turns as the tool does.
#[derive(Clone, Debug, PartialEq)]
pub struct View {
    name: String,
    user_from_base: Pose,
    tip_m: DVec3,
    /// Of the tip in the tool frame, m².
    tip_covariance: DMat3,
}

impl Default for View {
    fn default() -> Self {
        Self { name: BASE.to_owned(), user_from_base: Pose::HOME, tip_m: DVec3::ZERO, tip_covariance: DMat3::ZERO }
    }
}

/// Why a frame cannot be used.
#[derive(Debug, Error)]
#[allow(missing_docs, reason = "the texts say what each is")]
pub enum FrameError {
    #[error("cannot read the frame {}; give a file that `slitpose zero` or `slitpose calibrate --tip` wrote, or the name of one in {}", printable(.0), .1.display())]
    Read(String, PathBuf, #[source] TextFileError),
    #[error("{} {}", printable(.0), .1)]
    Content(String, String),
    #[error("`{}` is no tip: give x,y,z in mm in the tool frame, such as 0,0,-80, or a file with a tip", printable(.0))]
    Tip(String),
}

/// The file of a frame or a tip, or of both.
#[derive(Default, Deserialize)]
#[serde(deny_unknown_fields)]
struct Text {
    name: Option<String>,
    user_from_base: Option<PoseText>,
    tip: Option<TipText>,
}

/// As the columns of a pose.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct PoseText {
    translation_mm: [f64; 3],
    #[serde(default)]
    rotation_rad: [f64; 3],
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct TipText {
    position_mm: [f64; 3],
    #[serde(default)]
    covariance_mm2: [[f64; 3]; 3],
}

impl Text {
    /// The file at a path, or of that name in the user's folder of frames.
    fn open(name: &str) -> Result<Self, FrameError> {
        let folder = folder();
        let own = folder.join(format!("{name}.toml"));
        let path = if Path::new(name).exists() || !is_name(name) { Path::new(name) } else { &own };
        let bytes = text_file::read(path).map_err(|source| FrameError::Read(name.to_owned(), folder, source))?;
        let refuse = |text: String| FrameError::Content(path.display().to_string(), text);
        let text = String::from_utf8(bytes).map_err(|_| refuse("is no text; give a frame in TOML".to_owned()))?;
        let text: Self = toml::from_str(&text).map_err(|error| {
            refuse(format!(
                "is no frame: {}; correct it, or let `slitpose zero` write one",
                printable(&error.to_string())
            ))
        })?;
        text.check().map_err(refuse)?;
        Ok(text)
    }

    fn check(&self) -> Result<(), String> {
        if let Some(name) = self.name.as_ref().filter(|name| !is_name(name) || *name == BASE) {
            return Err(format!(
                "has the name `{}`; give letters, digits, `-` and `_`, {MAX_NAME} at most, and not `{BASE}`",
                printable(name)
            ));
        }
        let frame = self.user_from_base.as_ref().map(|pose| (pose.translation_mm, "user_from_base.translation_mm"));
        let tip = self.tip.as_ref().map(|tip| (tip.position_mm, "tip.position_mm"));
        for (values, key) in frame.into_iter().chain(tip) {
            if let Some(value) = beyond(values, MAX_MM) {
                return Err(format!("says {key} = {value}; give millimetres, up to {MAX_MM} from the origin"));
            }
        }
        let turn = self.user_from_base.as_ref().and_then(|pose| beyond(pose.rotation_rad, std::f64::consts::TAU));
        if let Some(value) = turn {
            return Err(format!("says user_from_base.rotation_rad = {value}; give a rotation vector in radians"));
        }
        let covariance = self.tip.as_ref().map_or(DMat3::ZERO, TipText::covariance);
        if covariance.is_finite() && (0..3).all(|k| covariance.col(k)[k] >= 0.0) {
            return Ok(());
        }
        Err("says tip.covariance_mm2, which is no covariance; give finite numbers, those of the diagonal not below 0, or leave it out".to_owned())
    }
}

impl TipText {
    /// Symmetric, also where digits are missing.
    fn covariance(&self) -> DMat3 {
        let half = DMat3::from_cols_array_2d(&self.covariance_mm2) * 0.5e-6;
        half + half.transpose()
    }
}

/// The first number that is larger than `most`, or none at all.
fn beyond(values: [f64; 3], most: f64) -> Option<f64> {
    values.into_iter().find(|value| value.is_nan() || value.abs() > most)
}

/// Names have no signs that CSV, or a file system, would take for something else.
fn is_name(name: &str) -> bool {
    (1..=MAX_NAME).contains(&name.len()) && name.chars().all(|c| c.is_ascii_alphanumeric() || "-_".contains(c))
}

/// Where frames with names are.
pub fn folder() -> PathBuf {
    platform::user_folder().unwrap_or_default().join("slitpose").join("frames")
}

fn matrix(of: impl Fn(usize, usize) -> f64) -> Matrix6 {
    std::array::from_fn(|row| std::array::from_fn(|column| of(row, column)))
}

impl View {
    /// The frame of `frame`, a file or a name, and the tip of `tip`, a file or x,y,z in millimetres, or else the tip that
    /// the frame's file has; `None` if both are those of the head. It lives as long as the program, because records refer
    /// to it.
    pub fn open(frame: Option<&str>, tip: Option<&str>) -> Result<Option<&'static Self>, FrameError> {
        let mut view = Self::default();
        let mut at = None;
        if let Some(name) = frame.filter(|name| *name != BASE) {
            let text = Text::open(name)?;
            let Some(pose) = text.user_from_base else {
                let reason = "holds no user_from_base; give it with --tip if it holds a tip";
                return Err(FrameError::Content(name.to_owned(), reason.to_owned()));
            };
            let stem = Path::new(name).file_stem().and_then(|stem| stem.to_str()).filter(|stem| is_name(stem));
            view.name = text.name.or_else(|| stem.map(str::to_owned)).unwrap_or_else(|| "user".to_owned());
            let [translation_mm, rotation_rad] = [pose.translation_mm, pose.rotation_rad].map(DVec3::from_array);
            view.user_from_base = Pose::from_vectors(translation_mm * 1e-3, rotation_rad);
            at = text.tip;
        }
        if let Some(tip) = tip {
            let numbers: Option<Vec<f64>> = tip.split(',').map(|number| number.trim().parse().ok()).collect();
            let numbers = numbers.and_then(|numbers| <[f64; 3]>::try_from(numbers).ok());
            at = match numbers.filter(|numbers| beyond(*numbers, MAX_MM).is_none()) {
                Some(position_mm) => Some(TipText { position_mm, covariance_mm2: [[0.0; 3]; 3] }),
                None if tip.contains(',') => None,
                None => Text::open(tip)?.tip,
            };
            at.as_ref().ok_or_else(|| FrameError::Tip(tip.to_owned()))?;
        }
        if let Some(at) = at {
            (view.tip_m, view.tip_covariance) = (DVec3::from_array(at.position_mm) * 1e-3, at.covariance());
        }
        Ok((view != Self::default()).then(|| view.kept()))
    }

    /// For as long as the program runs. There is one at its start, and one more for each zero that a person sets.
    fn kept(self) -> &'static Self {
        Box::leak(Box::new(self))
    }

    /// The name of the frame.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// The transform from the head's base frame.
    pub fn user_from_base(&self) -> &Pose {
        &self.user_from_base
    }

    /// The tip in the tool frame, metres.
    pub fn tip_m(&self) -> DVec3 {
        self.tip_m
    }

    /// user_from_tip of base_from_tool.
    pub fn pose(&self, base_from_tool: &Pose) -> Pose {
        compose(&self.user_from_base, &self.base_from_tip(base_from_tool))
    }

    fn base_from_tip(&self, base_from_tool: &Pose) -> Pose {
        compose(base_from_tool, &Pose { translation_m: self.tip_m, ..Pose::HOME })
    }

    /// base_from_tool of user_from_tip.
    pub fn base_from_tool(&self, user_from_tip: &Pose) -> Pose {
        let tip_from_tool = Pose { translation_m: -self.tip_m, ..Pose::HOME };
        compose(&compose(&inverse(&self.user_from_base), user_from_tip), &tip_from_tool)
    }

    /// J·C·Jᵀ, where the tip is at `arm_m` from the tool's origin, in axes of the base.
    fn covariance(&self, covariance: &Matrix6, arm_m: DVec3) -> Matrix6 {
        let u = DMat3::from_quat(self.user_from_base.rotation);
        // Of x × arm.
        let turned = u * DMat3::from_cols(DVec3::X.cross(arm_m), DVec3::Y.cross(arm_m), DVec3::Z.cross(arm_m));
        let jacobian = |row: usize, column: usize| match (row < 3, column < 3) {
            (true, false) => turned.col(column - 3)[row],
            (false, true) => 0.0,
            _ => u.col(column % 3)[row % 3],
        };
        let half = matrix(|row, column| (0..6).map(|k| jacobian(row, k) * covariance[k][column]).sum());
        // Both halves have the same bits.
        matrix(|row, column| (0..6).map(|k| half[row.min(column)][k] * jacobian(row.max(column), k)).sum())
    }

    /// The pose of the tip in the user's frame, with its covariance and that of the tip.
    pub fn estimate(&self, estimate: &Estimate) -> Estimate {
        let pose = self.pose(&estimate.pose);
        let mut covariance = self.covariance(&estimate.covariance, estimate.pose.rotation * self.tip_m);
        if self.tip_covariance != DMat3::ZERO {
            let u = DMat3::from_quat(pose.rotation);
            let of_tip = (u * self.tip_covariance * u.transpose()).to_cols_array_2d();
            (0..3).for_each(|i| (0..3).for_each(|j| covariance[i][j] += of_tip[i.max(j)][i.min(j)]));
        }
        Estimate { pose, covariance }
    }

    /// The covariance of an estimate in this frame, turned back into axes of the base; for pictures: it stays that of the tip.
    pub fn covariance_in_base(&self, estimate: &Estimate) -> Matrix6 {
        Self { user_from_base: inverse(&self.user_from_base), ..Self::default() }
            .covariance(&estimate.covariance, DVec3::ZERO)
    }

    /// The velocity of the tip in the user's frame, of a tool turned by that of `base_from_tool`. The error of that rotation
    /// adds 8 µm/s to σ at 5 rad/s, a tip of 80 mm and 20 µrad: less than a hundredth.
    fn twist(&self, estimate: &TwistEstimate, base_from_tool: &Pose) -> TwistEstimate {
        let Twist { linear_m_per_s: v, angular_rad_per_s: w } = estimate.twist;
        let (u, arm_m) = (self.user_from_base.rotation, base_from_tool.rotation * self.tip_m);
        let twist = Twist { linear_m_per_s: u * (v + w.cross(arm_m)), angular_rad_per_s: u * w };
        TwistEstimate { twist, covariance: self.covariance(&estimate.covariance, arm_m) }
    }

    /// Puts the pose of a solution into the user's frame.
    pub fn apply(&self, solution: &mut Solution) {
        solution.estimate = solution.estimate.as_ref().map(|estimate| self.estimate(estimate));
    }

    /// Puts poses, velocities and truth of a record into the user's frame.
    pub fn see(&'static self, record: &mut Record) {
        if let (Ok(twist), Some(estimate)) = (&mut record.twist, &record.solution.estimate) {
            *twist = self.twist(twist, &estimate.pose);
        }
        self.apply(&mut record.solution);
        if let Some(filtered) = &mut record.filtered {
            if let Ok(twist) = &mut filtered.twist {
                *twist = self.twist(twist, &filtered.estimate.pose);
            }
            filtered.estimate = self.estimate(&filtered.estimate);
        }
        record.truth = record.truth.as_ref().map(|truth| self.pose(truth));
        record.view = Some(self);
    }

    /// The text of a file with frame and tip.
    pub fn to_text(&self, remark: &str) -> String {
        let mut text = format!("# {remark}\n");
        // Writing to a String cannot fail.
        if self.name != BASE {
            let (t, r) = (self.user_from_base.translation_m * 1e3, self.user_from_base.rotation_rad());
            let _ = write!(
                text,
                "name = \"{}\"\n[user_from_base]\ntranslation_mm = {:?}\nrotation_rad = {:?}\n",
                self.name,
                t.to_array(),
                r.to_array()
            );
        }
        if self.tip_m != DVec3::ZERO {
            let rows = (self.tip_covariance * 1e6).to_cols_array_2d();
            let position_mm = (self.tip_m * 1e3).to_array();
            let _ = write!(text, "[tip]\nposition_mm = {position_mm:?}\ncovariance_mm2 = {rows:?}\n");
        }
        text
    }

    /// The head's frame with a tip, which has this covariance.
    pub fn with_tip(tip_m: DVec3, tip_covariance: DMat3) -> Self {
        Self { tip_m, tip_covariance, ..Self::default() }
    }
}
