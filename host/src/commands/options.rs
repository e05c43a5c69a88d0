//! Options that several verbs share.

use std::path::{Path, PathBuf};

use clap::{Args, ValueEnum};
use glam::DVec3;
use slitpose_calibration::Head;
use slitpose_head::scene_file::SceneFile;
use slitpose_model::{Pose, Tier};

use super::CommandError;

/// Streams are solved to a tolerance below their noise.
pub(super) const DEFAULT_TOLERANCE: f64 = 1e-6;

/// A number of millimetres or degrees beyond this is a slip of units: 1000 km.
const MOST: f64 = 1e9;

/// How exactly the optics are evaluated.
#[derive(Args, Clone, Copy, Debug)]
pub(super) struct TierOptions {
    /// Equations as printed in the source paper, or integrated over the spot
    #[arg(long, value_enum)]
    tier: Option<TierName>,
    /// Relative error of the exact tier's integrals; given alone it means the exact tier
    #[arg(long, value_name = "T", value_parser = parse_tolerance)]
    tolerance: Option<f64>,
}

/// What the head is known by.
#[derive(Args, Clone, Debug)]
pub(super) struct CalibrationOption {
    /// Calibration of the head, as `slitpose calibrate` wrote it; or none: the head is as its scene says
    #[arg(long, value_name = "FILE")]
    calibration: Option<PathBuf>,
}

impl CalibrationOption {
    /// The file, if one was given.
    pub(super) fn file(&self) -> Option<&Path> {
        self.calibration.as_deref().filter(|path| *path != NOT_CALIBRATED)
    }

    /// Whether a file or none was given.
    pub(super) fn is_given(&self) -> bool {
        self.calibration.is_some()
    }

    /// The head of `file` by the calibration given, else by `usual`.
    pub(super) fn head<E: Into<CommandError>>(
        &self,
        file: SceneFile,
        usual: impl FnOnce(SceneFile) -> Result<Head, E>,
    ) -> Result<Head, CommandError> {
        head_by(self.calibration.as_deref(), file, usual)
    }

    /// The head of `file` by the calibration given, else as its scene says, whatever its tolerances.
    pub(super) fn head_as_drawn(&self, file: SceneFile) -> Result<Head, CommandError> {
        self.head(file, |file| Ok::<_, CommandError>(file.into()))
    }
}

/// In place of a calibration: the head is as its scene says.
const NOT_CALIBRATED: &str = "none";

/// The head of `file` by `calibration` if given, else by `usual`.
pub(super) fn head_by<E: Into<CommandError>>(
    calibration: Option<&Path>,
    file: SceneFile,
    usual: impl FnOnce(SceneFile) -> Result<Head, E>,
) -> Result<Head, CommandError> {
    match calibration {
        None => usual(file).map_err(Into::into),
        Some(path) if path == NOT_CALIBRATED => Ok(file.into()),
        Some(path) => Ok(Head::open_calibrated(file, path)?),
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum TierName {
    /// Equations (1) to (6) of De La Cruz et al. 2018
    Paper,
    /// Integrated over the spot
    Exact,
}

impl TierOptions {
    /// The tier asked for; exact to `default_tolerance` if nothing is asked.
    pub(super) fn tier(self, default_tolerance: f64) -> Tier {
        self.tier_or(Tier::Exact { tolerance: default_tolerance })
    }

    /// The tier asked for; what is not asked for is as `usual`, or as usual for streams.
    pub(super) fn tier_or(self, usual: Tier) -> Tier {
        let usual_tolerance = match usual {
            Tier::Exact { tolerance } => tolerance,
            Tier::Paper => DEFAULT_TOLERANCE,
        };
        match (self.tier, self.tolerance) {
            (Some(TierName::Paper), _) => Tier::Paper,
            (Some(TierName::Exact), tolerance) => Tier::Exact { tolerance: tolerance.unwrap_or(usual_tolerance) },
            (None, Some(tolerance)) => Tier::Exact { tolerance },
            (None, None) => usual,
        }
    }
}

/// A number that `is_possible`, else `hint`.
pub(super) fn parse_number(
    text: &str,
    is_possible: impl Fn(f64) -> bool,
    hint: &'static str,
) -> Result<f64, &'static str> {
    text.parse().ok().filter(|&number| is_possible(number)).ok_or(hint)
}

fn parse_tolerance(text: &str) -> Result<f64, &'static str> {
    parse_number(text, |tolerance| tolerance > 0.0 && tolerance < 1.0, "give a number between 0 and 1, such as 1e-10")
}

/// A pose as the command line gives it: millimetres, then a rotation vector in degrees.
pub(super) fn parse_pose(text: &str) -> Result<Pose, &'static str> {
    let numbers: Option<Vec<f64>> = text.split(',').map(|number| number.trim().parse().ok()).collect();
    match numbers.as_deref() {
        Some(&[tx, ty, tz, rx, ry, rz]) if numbers.iter().flatten().all(|number| number.abs() <= MOST) => {
            let degrees = DVec3::new(rx, ry, rz);
            Ok(Pose::from_vectors(DVec3::new(tx, ty, tz) * 1e-3, degrees * (std::f64::consts::PI / 180.0)))
        }
        _ => Err("give six numbers, tx,ty,tz in mm and rx,ry,rz in degrees, such as 1.5,0,-2,0,10,0"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_pose_is_six_finite_numbers() {
        let pose = parse_pose("1, 2,-3,0,0,90").unwrap();
        assert_eq!(pose.translation_m, DVec3::new(1e-3, 2e-3, -3e-3));
        assert!((pose.rotation_rad().z - std::f64::consts::FRAC_PI_2).abs() < 1e-15);
        for text in ["", "1,2,3", "1,2,3,4,5,6,7", "1,2,3,4,5,x", "nan,0,0,0,0,0", "inf,0,0,0,0,0", "1e12,0,0,0,0,0"] {
            assert!(parse_pose(text).is_err(), "`{text}` was taken for a pose");
        }
    }

    #[test]
    fn a_tolerance_lies_between_zero_and_one() {
        assert_eq!(parse_tolerance("1e-6"), Ok(1e-6));
        for text in ["0", "1", "-1e-3", "nan", "tight"] {
            assert!(parse_tolerance(text).is_err(), "`{text}` was taken for a tolerance");
        }
    }
}
