//! The keys of a scene file: which there are, where they stand, and what may be wrong there.

use std::fmt;

use thiserror::Error;

use super::SHIPPED;
use crate::foreign::printable;
use crate::text_file::TextFileError;

/// Why a scene cannot be had from a file.
#[derive(Debug, Error)]
#[allow(missing_docs, reason = "the texts say what each is")]
pub enum SceneFileError {
    #[error(
        "cannot read scene `{}`; {}give a scene file or a shipped scene ({})",
        printable(.0),
        meant(.0),
        SHIPPED.map(|shipped| shipped.name).join(", ")
    )]
    Read(String, #[source] TextFileError),
    #[error("{0}: {1}")]
    Content(FilePlace, String),
}

/// The shipped scene whose name is spelt almost like `argument`.
fn meant(argument: &str) -> String {
    let nearest = nearest(argument, &SHIPPED.map(|shipped| shipped.name));
    nearest.map_or_else(String::new, |name| format!("did you mean `{name}`? Otherwise "))
}

/// The known key that is spelled almost like `key`: two letters in five may differ.
pub fn nearest<'a>(key: &str, known: &[&'a str]) -> Option<&'a str> {
    let distance = |candidate: &str| strsim::damerau_levenshtein(key, candidate);
    let best = known.iter().copied().min_by_key(|candidate| distance(candidate))?;
    (5 * distance(best) <= 2 * best.chars().count()).then_some(best)
}

/// A place in a file, as editors jump to it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct FilePlace {
    /// The file's path or the shipped scene's name.
    pub file: String,
    /// Line, from 1.
    pub line: usize,
    /// Column in characters, from 1.
    pub column: usize,
}

impl FilePlace {
    /// The place of a byte offset in `text`.
    pub fn of(file: &str, text: &str, offset: usize) -> Self {
        let before = text.get(..offset).unwrap_or(text);
        let line_start = before.rfind('\n').map_or(0, |newline| newline + 1);
        Self {
            file: file.to_owned(),
            line: before.matches('\n').count() + 1,
            column: before[line_start..].chars().count() + 1,
        }
    }
}

impl fmt::Display for FilePlace {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}:{}:{}", printable(&self.file), self.line, self.column)
    }
}

/// A key of the scene file, in the words of the file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct KeyPath {
    /// The cell's number; `None`: not of a cell.
    pub cell: Option<usize>,
    /// The section; empty at the top level, `cell` for keys of `[[cell]]` itself.
    pub section: &'static str,
    /// The key.
    pub key: &'static str,
}

impl KeyPath {
    pub(super) const fn top(key: &'static str) -> Self {
        Self::section("", key)
    }

    pub(super) const fn section(section: &'static str, key: &'static str) -> Self {
        Self { cell: None, section, key }
    }

    pub(super) const fn of_cell(cell: usize, section: &'static str, key: &'static str) -> Self {
        Self { cell: Some(cell), section, key }
    }

    /// Where to add it, in words.
    pub(super) fn home(&self) -> String {
        match (self.cell, self.section) {
            (_, "") => "the top of the file".to_owned(),
            (Some(cell), "cell") => format!("[[cell]] number {cell}"),
            (Some(_), section) => format!("[{section}], or to the cell's own `{section}` table"),
            (None, section) => format!("[{section}]"),
        }
    }

    /// The unit of its value in SI: the end of a key says which one it is.
    pub(super) fn unit(&self) -> f64 {
        match self.key.rsplit_once('_') {
            Some((_, "mm")) => 1e-3,
            Some((_, "deg")) => 1_f64.to_radians(),
            _ => 1.0,
        }
    }
}

impl fmt::Display for KeyPath {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if let Some(cell) = self.cell {
            write!(f, "cell {cell}, ")?;
        }
        match self.section {
            "" | "cell" => f.write_str(self.key),
            section => write!(f, "{section}.{}", self.key),
        }
    }
}

/// Keys of a `[[cell]]` itself: five, or the cell whose detector it reads the second axis of.
const OWN: [&str; 6] = ["detector_mm", "x_axis", "normal", "emitter_mm", "emitter_axis", "second_axis_of"];

/// How many of the sections, from the first on, a cell may override key by key.
pub(super) const PER_CELL: usize = 6;

/// The three ways to give an emitter's profile, exactly one of which is needed.
pub(super) const PROFILES: [&str; 3] = ["half_angle_deg", "profile_exponent", "profile"];

/// Sections with their keys.
pub(super) const SECTIONS: [(&str, &str); 12] = [
    (
        "detector",
        "part length_mm width_mm responsivity_a_per_w dark_current_a interelectrode_ohm saturation_a \
         faint_a nonlinearity_mm electrode_gain",
    ),
    ("slit", "distance_mm width_mm length_mm diameter_mm focal_length_mm offset_mm tilt_deg thickness_mm mount"),
    (
        "emitter",
        "part radiant_intensity_w_per_sr source_diameter_mm half_angle_deg profile_exponent profile \
         profile_radial profile_azimuthal",
    ),
    ("window", "thickness_mm refractive_index"),
    ("stray", "current_a centre_mm linear_a_per_mm quadratic_a_per_mm2"),
    ("converter", "full_scale_a curve_1_a curve_2_a"),
    ("noise", "bandwidth_hz temperature_k adc_a"),
    (
        "front_end",
        "full_scale_a adc_bits raw_noise_lsb oversampling time_constant_s settling_s conversion_s \
         frame_rate_hz",
    ),
    ("uncertainty", "emitter_gain_relative electrode_gain_relative position_mm"),
    (
        "tolerance",
        "position_mm angle_deg slit_width_mm emitter_angle_deg light_level_relative \
         emitter_drift_relative emitter_drift_minutes emitter_gain_relative \
         electrode_gain_relative profile_relative nonlinearity_mm window_mm stray_relative",
    ),
    ("lighting", "slots"),
    ("workspace", "half_extent_mm half_extent_deg"),
];

/// Keys at the top level, sections included.
pub(super) fn top() -> Vec<&'static str> {
    ["name"].into_iter().chain(SECTIONS.iter().map(|(section, _)| *section)).chain(["cell"]).collect()
}

/// Keys of a `[[cell]]`: its own, and the sections whose keys it may override.
pub(super) fn of_cell() -> Vec<&'static str> {
    OWN.into_iter().chain(SECTIONS[..PER_CELL].iter().map(|(section, _)| *section)).collect()
}
