//! How well parts are known before calibration.

use super::document::Document;
use super::error::{KeyPath, SceneFileError};

/// Standard deviations of the parts of an uncalibrated head, from data sheets and drawings. Zero: known.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Tolerance {
    /// Positions of detectors, slits and emitters, each axis, and the slits' distances, metres.
    pub position_m: f64,
    /// Rotations of detectors and slits about each axis, radians.
    pub angle_rad: f64,
    /// Width of the slits, metres.
    pub slit_width_m: f64,
    /// Rotations of the emitters' axes, radians.
    pub emitter_angle_rad: f64,
    /// Intensity of the emitters, relative.
    pub emitter_gain_relative: f64,
    /// Gain of each electrode, relative.
    pub electrode_gain_relative: f64,
    /// Shape of the emitters' profiles, relative to the intensity on the axis.
    pub profile_relative: f64,
    /// Non-linearity of the detectors, metres.
    pub nonlinearity_m: f64,
    /// Thickness of the detectors' cover, metres.
    pub window_m: f64,
    /// Stray light of a cell, of both electrodes together, relative to its current with the tool at home.
    pub stray_relative: f64,
}

impl Default for Tolerance {
    /// Of the parts named in the shipped scenes, from data sheets, and of a milled head.
    fn default() -> Self {
        Self {
            position_m: 0.06e-3,
            angle_rad: 0.6_f64.to_radians(),
            slit_width_m: 0.012e-3,
            emitter_angle_rad: 2.0_f64.to_radians(),
            emitter_gain_relative: 0.3,
            electrode_gain_relative: 0.01,
            profile_relative: 0.05,
            nonlinearity_m: 0.06e-3,
            window_m: 0.15e-3,
            stray_relative: 0.03,
        }
    }
}

/// The section `[tolerance]`; `None` if the scene has none. Keys that it leaves out have their defaults.
pub(super) fn read(document: &Document<'_>) -> Result<Option<Tolerance>, SceneFileError> {
    if !document.has_section("tolerance") {
        return Ok(None);
    }
    let value = |key: &'static str, default: f64, unit: f64| {
        let path = KeyPath::section("tolerance", key);
        let Some(written) = document.number(path)? else {
            return Ok(default);
        };
        match document.find(path) {
            Some(entry) if written < 0.0 => Err(document.out_of_range(path, entry, "zero or more")),
            _ => Ok(written * unit),
        }
    };
    let default = Tolerance::default();
    let degree = 1_f64.to_radians();
    Ok(Some(Tolerance {
        position_m: value("position_mm", default.position_m, 1e-3)?,
        angle_rad: value("angle_deg", default.angle_rad, degree)?,
        slit_width_m: value("slit_width_mm", default.slit_width_m, 1e-3)?,
        emitter_angle_rad: value("emitter_angle_deg", default.emitter_angle_rad, degree)?,
        emitter_gain_relative: value("emitter_gain_relative", default.emitter_gain_relative, 1.0)?,
        electrode_gain_relative: value("electrode_gain_relative", default.electrode_gain_relative, 1.0)?,
        profile_relative: value("profile_relative", default.profile_relative, 1.0)?,
        nonlinearity_m: value("nonlinearity_mm", default.nonlinearity_m, 1e-3)?,
        window_m: value("window_mm", default.window_m, 1e-3)?,
        stray_relative: value("stray_relative", default.stray_relative, 1.0)?,
    }))
}
