//! The keys of a scene file: which there are, where they stand, and what may be wrong there.

use std::fmt;

use slitpose_model::{AZIMUTHAL_TERMS, MAX_CELLS, MAX_CONVERTER, MAX_NONLINEARITY, MAX_PROFILE_KNOTS, RADIAL_TERMS};
use thiserror::Error;

use super::SHIPPED;
use super::settings::{MAX_OVERSAMPLING, WIDEST_BITS};
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

/// What a value is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// A text.
    Text,
    /// One of these words.
    OneOf(&'static [&'static str]),
    /// A finite number.
    Number,
    /// A whole number from the first to the second.
    Whole(u64, u64),
    /// So many numbers, and what they are.
    Vector(usize, &'static str),
    /// At most so many numbers.
    List(usize),
    /// So many rows of so many numbers, and what these are.
    Matrix(usize, usize, &'static str),
    /// At most so many pairs of numbers.
    Pairs(usize),
    /// Lists of the numbers of cells.
    Slots,
}

/// Numbers of numbers in words.
const WORDS: [&str; 7] = ["no", "one", "two", "three", "four", "five", "six"];

impl fmt::Display for Kind {
    /// What to give.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match *self {
            Self::Text => f.write_str("a text in quotes"),
            Self::OneOf(words) => write!(f, "\"{}\"", words.join("\" or \"")),
            Self::Number => f.write_str("a number"),
            Self::Whole(least, most) => write!(f, "a whole number from {least} to {most}"),
            Self::Vector(count, what) => write!(f, "{} numbers{what}", WORDS[count]),
            Self::List(most) => write!(f, "a list of at most {most} numbers"),
            Self::Matrix(rows, columns, what) => {
                write!(f, "{} rows of {} numbers{what}", WORDS[rows], WORDS[columns])
            }
            Self::Pairs(most) => write!(f, "at most {most} pairs of numbers, [[degrees, relative intensity], …]"),
            Self::Slots => f.write_str("slots of emitter numbers, e.g. [[0, 2, 4], [1, 3, 5], []]"),
        }
    }
}

/// A key with its value.
#[derive(Clone, Copy, Debug)]
pub struct Key {
    /// Its name, which ends in the unit.
    pub name: &'static str,
    /// What its value is.
    pub kind: Kind,
    /// What it means, and what is so without it.
    pub meaning: &'static str,
}

/// Some keys that belong together.
#[derive(Clone, Copy, Debug)]
pub struct Section {
    /// Its name.
    pub name: &'static str,
    /// What it describes.
    pub meaning: &'static str,
    /// Its keys.
    pub keys: &'static [Key],
}

const fn key(name: &'static str, kind: Kind, meaning: &'static str) -> Key {
    Key { name, kind, meaning }
}

const fn section(name: &'static str, meaning: &'static str, keys: &'static [Key]) -> Section {
    Section { name, meaning, keys }
}

/// Three numbers of an axis each.
const XYZ: Kind = Kind::Vector(3, ", [x, y, z]");

/// Keys of a `[[cell]]` itself: five, or the cell whose detector it reads the second axis of.
pub const OWN: [Key; 6] = [
    key("detector_mm", XYZ, "centre of the detector's active area, base frame; needed"),
    key("x_axis", XYZ, "direction of the detector from electrode X1 to X2, unit vector, base frame; needed"),
    key("normal", XYZ, "direction from the detector to slit and emitter, unit vector, base frame; needed"),
    key("emitter_mm", XYZ, "place of the emitter, tool frame; needed"),
    key("emitter_axis", XYZ, "direction in which it shines, unit vector, tool frame; needed"),
    key(
        "second_axis_of",
        Kind::Whole(0, MAX_CELLS as u64 - 1),
        "the earlier cell whose two-axis detector this one reads across; in place of all other keys",
    ),
];

/// How many of the sections, from the first on, a cell may override key by key.
pub const PER_CELL: usize = 6;

/// The three ways to give an emitter's profile, exactly one of which is needed.
pub(super) const PROFILES: [&str; 3] = ["half_angle_deg", "profile_exponent", "profile"];

/// Sections with their keys.
#[rustfmt::skip]
pub const SECTIONS: [Section; 12] = [
    section("detector", "position-sensitive detectors", &[
        key("part", Kind::Text, "name of the part"),
        key("length_mm", Kind::Number, "active length, between the electrodes; needed"),
        key("width_mm", Kind::Number, "active width; needed"),
        key("responsivity_a_per_w", Kind::Number, "photocurrent by optical power; needed"),
        key("dark_current_a", Kind::Number, "of both electrodes together; default 0"),
        key("interelectrode_ohm", Kind::Number, "resistance between the electrodes, for Johnson noise; default: none of it"),
        key("saturation_a", Kind::Number, "photocurrent from which on a reading is saturated; default: never"),
        key("faint_a", Kind::Number, "photocurrent below which a cell is flagged faint; default 50e-9"),
        key("nonlinearity_mm", Kind::List(MAX_NONLINEARITY), "measured position minus true position, as a polynomial: coefficients of 1, ξ, ξ², … of the true position ξ in half lengths; default: none"),
        key("electrode_gain", Kind::Vector(2, ", those of I_X1 and I_X2"), "gain of I_X1 and of I_X2; default [1, 1]"),
    ]),
    section("slit", "what the light passes through: a slit, or a round hole with or without a lens", &[
        key("distance_mm", Kind::Number, "from the detector's surface to the middle of the mask; needed"),
        key("width_mm", Kind::Number, "of a slit, along the detector; needed without diameter_mm"),
        key("length_mm", Kind::Number, "of a slit, across the detector; needed without diameter_mm"),
        key("diameter_mm", Kind::Number, "of a round hole; in place of width_mm and length_mm"),
        key("focal_length_mm", Kind::Number, "of a thin lens in the round hole; default: no lens"),
        key("offset_mm", Kind::Vector(2, ", [x, y]"), "centre of the slit along x and y of the cell; default [0, 0]"),
        key("tilt_deg", XYZ, "rotation vector of the slit in the cell; default [0, 0, 0]: parallel, its length along y"),
        key("thickness_mm", Kind::Number, "of the mask; default 0"),
        key("mount", Kind::OneOf(&["base", "tool"]), "what the slit is fixed to; default \"base\""),
    ]),
    section("emitter", "infrared emitters", &[
        key("part", Kind::Text, "name of the part"),
        key("radiant_intensity_w_per_sr", Kind::Number, "on the axis; needed"),
        key("source_diameter_mm", Kind::Number, "of a round, evenly bright source; default 0: a point"),
        key("half_angle_deg", Kind::Number, "angle to the axis at half intensity, of a power of the cosine; this, profile_exponent or profile is needed"),
        key("profile_exponent", Kind::Number, "that power itself"),
        key("profile", Kind::Pairs(MAX_PROFILE_KNOTS), "measured profile: angle to the axis in degrees, intensity relative to the axis"),
        key("profile_radial", Kind::Vector(RADIAL_TERMS, ""), "terms of a correction that depends on the angle to the axis; calibrations find them"),
        key("profile_azimuthal", Kind::Vector(AZIMUTHAL_TERMS, ""), "terms of one that depends on the direction around the axis; calibrations find them"),
    ]),
    section("window", "plane cover on the detectors; default: none", &[
        key("thickness_mm", Kind::Number, "needed"),
        key("refractive_index", Kind::Number, "needed"),
    ]),
    section("stray", "light that reaches a detector by reflections; default: none", &[
        key("current_a", Kind::Number, "its photocurrent with the tool at home; default 0"),
        key("centre_mm", Kind::Number, "where on the detector its centre lies; default 0"),
        key("linear_a_per_mm", Kind::Matrix(2, 3, ", by t_x, t_y, t_z"), "change of both electrodes' currents with the tool's translation"),
        key("quadratic_a_per_mm2", Kind::Matrix(2, 6, ", by t_x², t_y², t_z², t_x·t_y, t_y·t_z, t_z·t_x"), "change with t_x², t_y², t_z², t_x·t_y, t_y·t_z, t_z·t_x"),
    ]),
    section("converter", "curves of the analog-to-digital converters; default: straight", &[
        key("full_scale_a", Kind::Number, "current at the top code; needed"),
        key("curve_1_a", Kind::List(MAX_CONVERTER), "read minus true current of I_X1, as a polynomial: coefficients of 1, i, i², … of i = 2·current/full_scale_a − 1"),
        key("curve_2_a", Kind::List(MAX_CONVERTER), "the same of I_X2"),
    ]),
    section("noise", "noise given directly, for tables and `solve`; default: none, or that of the front end", &[
        key("bandwidth_hz", Kind::Number, "of shot and Johnson noise; needed"),
        key("temperature_k", Kind::Number, "of the detectors; needed"),
        key("adc_a", Kind::Number, "rms of the converters, in current; needed"),
    ]),
    section("front_end", "electronics, from which noise and timing of boards follow; default: ideal", &[
        key("full_scale_a", Kind::Number, "electrode current at the top code; needed"),
        key("adc_bits", Kind::Whole(1, WIDEST_BITS), "of one conversion; needed"),
        key("raw_noise_lsb", Kind::Number, "rms of one conversion in its steps; default 0"),
        key("oversampling", Kind::Whole(1, MAX_OVERSAMPLING), "conversions summed to one result; default 1"),
        key("time_constant_s", Kind::Number, "of detector and amplifier together, first order; default 0"),
        key("settling_s", Kind::Number, "from switching the emitters to the first conversion; default 0"),
        key("conversion_s", Kind::Number, "duration of one conversion; default 0"),
        key("frame_rate_hz", Kind::Number, "passes through all slots per second; needed"),
    ]),
    section("uncertainty", "what a calibration has not settled, 1 σ; default: all is known", &[
        key("emitter_gain_relative", Kind::Number, "of each emitter; default 0"),
        key("electrode_gain_relative", Kind::Number, "of each electrode; default 0"),
        key("position_mm", Kind::Number, "of each position of light; default 0"),
    ]),
    section("tolerance", "how well parts are known before calibration, 1 σ, and how light changes after it; 0: known", &[
        key("position_mm", Kind::Number, "of detectors, slits and emitters, each axis; default 0.06"),
        key("angle_deg", Kind::Number, "of detectors and slits, each axis; default 0.6"),
        key("slit_width_mm", Kind::Number, "default 0.012"),
        key("emitter_angle_deg", Kind::Number, "of the emitters' axes; default 2"),
        key("light_level_relative", Kind::Number, "of all light together, in use; default 0.1"),
        key("emitter_drift_relative", Kind::Number, "of single emitters, in use; default 0.01 for a calibrated head"),
        key("emitter_drift_minutes", Kind::Number, "time in which they drift by that much; default 120"),
        key("emitter_gain_relative", Kind::Number, "intensity of each emitter; default 0.3"),
        key("electrode_gain_relative", Kind::Number, "default 0.01"),
        key("profile_relative", Kind::Number, "shape of the emitters' profiles; default 0.05"),
        key("nonlinearity_mm", Kind::Number, "of the detectors; default 0.06"),
        key("window_mm", Kind::Number, "thickness of the cover; default 0.15"),
        key("stray_relative", Kind::Number, "stray light, by the current with the tool at home; default 0.03"),
    ]),
    section("lighting", "which emitters are lit together; default: each alone, then none", &[
        key("slots", Kind::Slots, "the emitters of each slot of a frame, in their order; [] is the dark slot"),
    ]),
    section("workspace", "the box of poses that maps, checks and calibrations are about", &[
        key("half_extent_mm", XYZ, "greatest translation along x, y, z"),
        key("half_extent_deg", XYZ, "greatest components of the rotation vector"),
    ]),
];

/// Names of the keys at the top level, sections included.
pub(super) fn top() -> Vec<&'static str> {
    ["name"].into_iter().chain(SECTIONS.iter().map(|section| section.name)).chain(["cell"]).collect()
}

/// Names of the keys of a `[[cell]]`: its own, and the sections whose keys it may override.
pub(super) fn of_cell() -> Vec<&'static str> {
    OWN.iter().map(|key| key.name).chain(SECTIONS[..PER_CELL].iter().map(|section| section.name)).collect()
}
