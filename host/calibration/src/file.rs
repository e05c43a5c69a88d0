//! The calibration file: TOML with a hash over everything below it.

use std::fmt::Write as _;
use std::path::Path;

use schemars::generate::SchemaSettings;
use schemars::{JsonSchema, Schema};
use serde::Deserialize;
use slitpose_head::foreign::printable;
use slitpose_head::scene_file::{SceneFile, fnv1a_64};
use slitpose_head::text_file::{self, TextFileError};
use slitpose_model::{ModelError, SceneError};
use thiserror::Error;

use crate::parameter::Quantity;
use crate::pose_error::{COEFFICIENTS, PoseError};
use crate::prior::{Parameter, Parameters};
use crate::{Calibration, Coverage, LightTrend, Statistics};

const FORMAT: u32 = 1;

/// Why a calibration cannot be used.
#[derive(Debug, Error)]
#[allow(missing_docs, reason = "the texts say what each is")]
pub enum CalibrationFileError {
    #[error("cannot read the calibration {}; give a file that `slitpose calibrate` wrote", printable(.0))]
    Read(String, #[source] TextFileError),
    #[error("{} {}", printable(.0), .1)]
    Content(String, String),
    #[error("{} describes a head that cannot be; calibrate again", printable(.0))]
    Impossible(String, #[source] SceneError),
}

/// Calibration of a head.
#[derive(Deserialize, JsonSchema)]
#[schemars(title = "Calibration of slitpose")]
struct Text {
    format: u32,
    id: String,
    date: Option<String>,
    scene: SceneText,
    statistics: Statistics,
    #[serde(default)]
    weak: Vec<String>,
    #[serde(default)]
    frames: Vec<Frames>,
    #[serde(default)]
    light: Vec<LightTrend>,
    covered: Option<Coverage>,
    converter: ConverterText,
    cell: Vec<CellText>,
    pose_error: PoseErrorText,
    correlation: CorrelationText,
}

#[derive(Deserialize, JsonSchema)]
struct SceneText {
    name: String,
    hash: String,
    text: String,
}

#[derive(Deserialize, JsonSchema)]
struct ConverterText {
    full_scale_a: f64,
    parameters: Vec<Entry>,
}

#[derive(Deserialize, JsonSchema)]
struct CellText {
    model_error_relative: f64,
    model_error_m: f64,
    model_error_reach: Option<f64>,
    parameters: Vec<Entry>,
}

/// Name, value, σ, prior, its σ, unit.
#[derive(Deserialize, JsonSchema)]
struct Entry(String, f64, f64, f64, f64, #[allow(dead_code, reason = "for people")] String);

#[derive(Deserialize, JsonSchema)]
struct CorrelationText {
    rows: Vec<Vec<f64>>,
}

#[derive(Deserialize, JsonSchema)]
struct PoseErrorText {
    length_scale_m: f64,
    coefficients: Vec<Vec<f64>>,
}

/// Where an instrument's frames lie in those of the head.
#[derive(Clone, Debug, PartialEq, Deserialize, JsonSchema)]
pub struct Frames {
    /// The data that found them.
    pub file: String,
    /// Base frame from the instrument's frame: translation in metres, rotation vector in radians.
    pub base_from_reference: [f64; 6],
    /// Standard deviations of it.
    pub base_from_reference_sigma: [f64; 6],
    /// Tool frame from the instrument's marker.
    pub tool_from_marker: [f64; 6],
    /// Standard deviations of it.
    pub tool_from_marker_sigma: [f64; 6],
}

/// The JSON Schema of a calibration file.
pub fn file_schema() -> Schema {
    SchemaSettings::draft2020_12().into_generator().into_root_schema_for::<Text>()
}

impl Calibration {
    /// Reads a calibration file.
    pub fn open(path: &Path) -> Result<Self, CalibrationFileError> {
        let file = || path.display().to_string();
        let bytes = text_file::read(path).map_err(|source| CalibrationFileError::Read(file(), source))?;
        Self::from_bytes(&file(), &bytes)
    }

    /// Reads a calibration from the bytes of a file; `origin` names it in messages.
    pub fn from_bytes(origin: &str, bytes: &[u8]) -> Result<Self, CalibrationFileError> {
        let refuse = |text: String| CalibrationFileError::Content(origin.to_owned(), text);
        let content = |what: String| {
            refuse(format!("is no calibration: {}; give a file that `slitpose calibrate` wrote", printable(&what)))
        };
        let text = std::str::from_utf8(bytes).map_err(|error| content(error.to_string()))?;
        let first = text.lines().next().unwrap_or_default();
        let stated = first.strip_prefix("hash = \"").and_then(|rest| rest.strip_suffix('"'));
        let stated = stated.and_then(|digits| u64::from_str_radix(digits, 16).ok());
        let stated = stated.ok_or_else(|| content("its first line is no hash".to_owned()))?;
        let rest = text.get(first.len() + 1..).unwrap_or_default();
        let parsed: Text = toml::from_str(rest).map_err(|error| content(error.to_string()))?;
        if parsed.format != FORMAT {
            return Err(refuse(format!(
                "has format {}, this program reads format {FORMAT}; use the version of slitpose that wrote it, or calibrate \
                 again",
                parsed.format
            )));
        }
        let found = fnv1a_64(rest.as_bytes());
        if found != stated {
            return Err(refuse(format!(
                "states the hash {stated:016x}, its text has {found:016x}: it was changed or cut; take a copy of the original"
            )));
        }
        Self::of_text(parsed, origin, text, stated).map_err(content)
    }

    fn of_text(parsed: Text, origin: &str, source: &str, hash: u64) -> Result<Self, String> {
        let mut entries = Vec::new();
        let of_cells = parsed.cell.iter().enumerate().map(|(k, cell)| (Some(k), &cell.parameters));
        for (cell, list) in of_cells.chain([(None, &parsed.converter.parameters)]) {
            for Entry(name, value, sigma, prior, prior_sigma, _) in list {
                let quantity = Quantity::named(name).ok_or_else(|| format!("there is no parameter `{name}`"))?;
                let numbers = [*value, *sigma, *prior, *prior_sigma];
                if numbers.iter().any(|number| !number.is_finite()) || *prior_sigma <= 0.0 {
                    return Err(format!("the numbers of `{name}` are not finite and positive"));
                }
                let [value, sigma, prior, prior_sigma] = numbers;
                entries.push(Parameter { cell, quantity, prior, prior_sigma, value, sigma });
            }
        }
        for (cell, reach) in parsed.cell.iter().map(|cell| cell.model_error_reach).enumerate() {
            if reach.is_some_and(|reach| !(reach > 0.0 && reach.is_finite())) {
                return Err(format!("model_error_reach of cell {cell} is not finite and positive"));
            }
        }
        let count = entries.len();
        let square = parsed.correlation.rows.iter().enumerate().all(|(row, values)| values.len() == row);
        if parsed.correlation.rows.len() != count || !square {
            return Err(format!("the correlations are not a triangle of {count} rows"));
        }
        let coefficients = parsed.pose_error.coefficients;
        if coefficients.len() != COEFFICIENTS || coefficients.iter().enumerate().any(|(k, row)| row.len() != k + 1) {
            return Err(format!("pose_error.coefficients are not a triangle of {COEFFICIENTS} rows"));
        }
        let mut full = vec![0.0; COEFFICIENTS * COEFFICIENTS];
        for (i, row) in coefficients.iter().enumerate() {
            for (j, &value) in row.iter().enumerate() {
                full[i * COEFFICIENTS + j] = value;
                full[j * COEFFICIENTS + i] = value;
            }
        }
        let hex = parsed.scene.hash.as_str();
        let scene_hash = u64::from_str_radix(hex, 16).map_err(|_| format!("scene.hash `{hex}` is no hash"))?;
        Ok(Self {
            id: parsed.id,
            date: parsed.date,
            origin: origin.to_owned(),
            source: source.to_owned(),
            hash,
            scene_name: parsed.scene.name,
            scene_source: parsed.scene.text,
            scene_hash,
            statistics: parsed.statistics,
            weak: parsed.weak,
            frames: parsed.frames,
            light: parsed.light,
            covered: parsed.covered,
            parameters: Parameters { entries, full_scale_a: parsed.converter.full_scale_a },
            correlation: parsed.correlation.rows,
            model_errors: parsed
                .cell
                .iter()
                .map(|cell| ModelError {
                    relative: cell.model_error_relative,
                    position_m: cell.model_error_m,
                    current_a: 0.0,
                    reach: cell.model_error_reach,
                })
                .collect(),
            pose_error: PoseError { length_scale_m: parsed.pose_error.length_scale_m, coefficients: full },
        })
    }

    /// Renews text and hash from the numbers.
    pub(crate) fn write(&mut self) {
        let mut rest = String::new();
        // Writing to a string cannot fail.
        let _ = self.write_text(&mut rest);
        self.hash = fnv1a_64(rest.as_bytes());
        self.source = format!("hash = \"{:016x}\"\n{rest}", self.hash);
    }

    fn write_text(&self, out: &mut String) -> std::fmt::Result {
        writeln!(out, "format = {FORMAT}\nid = \"{}\"", self.id)?;
        if let Some(date) = &self.date {
            writeln!(out, "date = {}", toml::Value::from(date.as_str()))?;
        }
        writeln!(out, "weak = {}", toml::Value::from(self.weak.clone()))?;
        writeln!(out, "\n[scene]\nname = {}", toml::Value::from(self.scene_name.as_str()))?;
        writeln!(out, "hash = \"{:016x}\"", self.scene_hash)?;
        writeln!(out, "text = {}", toml::Value::from(self.scene_source.as_str()))?;
        let Statistics {
            rows,
            readings,
            readings_rejected,
            poses_rejected,
            chi2,
            redundancy,
            held_out_m,
            held_out_rad,
        } = self.statistics;
        writeln!(out, "\n[statistics]\nrows = {rows}\nreadings = {readings}")?;
        writeln!(out, "readings_rejected = {readings_rejected}\nposes_rejected = {poses_rejected}")?;
        writeln!(out, "chi2 = {chi2:.3}\nredundancy = {redundancy:.3}")?;
        for (key, value) in [("held_out_m", held_out_m), ("held_out_rad", held_out_rad)] {
            if let Some(value) = value {
                writeln!(out, "{key} = {value:.3e}")?;
            }
        }
        for frames in &self.frames {
            writeln!(out, "\n[[frames]]\nfile = {}", toml::Value::from(frames.file.as_str()))?;
            for (key, values) in [
                ("base_from_reference", frames.base_from_reference),
                ("base_from_reference_sigma", frames.base_from_reference_sigma),
                ("tool_from_marker", frames.tool_from_marker),
                ("tool_from_marker_sigma", frames.tool_from_marker_sigma),
            ] {
                writeln!(out, "{key} = {values:?}")?;
            }
        }
        for LightTrend { file, change, change_sigma, warm_up } in &self.light {
            writeln!(out, "\n[[light]]\nfile = {}", toml::Value::from(file.as_str()))?;
            writeln!(out, "change = {change:.2e}\nchange_sigma = {change_sigma:.1e}")?;
            if let Some(warm_up) = warm_up {
                writeln!(out, "warm_up = {warm_up}")?;
            }
        }
        if let Some(Coverage { lower, upper, share, outside_m, outside_rad }) = &self.covered {
            writeln!(out, "\n[covered]\nlower = {lower:?}\nupper = {upper:?}\nshare = {share:.2e}")?;
            for (key, value) in [("outside_m", outside_m), ("outside_rad", outside_rad)] {
                value.map_or(Ok(()), |value| writeln!(out, "{key} = {value:.2e}"))?;
            }
        }
        writeln!(out, "\n# Parameters: name, deviation from the scene, its sigma, the same before, unit.")?;
        for (number, error) in self.model_errors.iter().enumerate() {
            writeln!(out, "[[cell]]\nmodel_error_relative = {:e}", error.relative)?;
            writeln!(out, "model_error_m = {:e}", error.position_m)?;
            error.reach.map_or(Ok(()), |reach| writeln!(out, "model_error_reach = {reach:e}"))?;
            self.write_parameters(out, Some(number))?;
        }
        writeln!(out, "[converter]\nfull_scale_a = {:e}", self.parameters.full_scale_a)?;
        self.write_parameters(out, None)?;
        writeln!(out, "[pose_error]\nlength_scale_m = {:e}", self.pose_error.length_scale_m)?;
        writeln!(out, "coefficients = [")?;
        for (i, row) in self.pose_error.coefficients.chunks_exact(COEFFICIENTS).enumerate() {
            write!(out, "[")?;
            row[..=i].iter().try_for_each(|value| write!(out, "{value:.6e},"))?;
            writeln!(out, "],")?;
        }
        writeln!(
            out,
            "]\n\n# Of the parameters, in the order of the file: row k has k numbers, the diagonal left out."
        )?;
        writeln!(out, "[correlation]\nrows = [")?;
        for row in &self.correlation {
            write!(out, "[")?;
            row.iter().try_for_each(|value| write!(out, "{},", digits(*value)))?;
            writeln!(out, "],")?;
        }
        writeln!(out, "]")
    }

    fn write_parameters(&self, out: &mut String, cell: Option<usize>) -> std::fmt::Result {
        writeln!(out, "parameters = [")?;
        for entry in self.parameters.entries.iter().filter(|entry| entry.cell == cell) {
            let Parameter { quantity, prior, prior_sigma, value, sigma, .. } = entry;
            let unit = quantity.unit();
            writeln!(out, "[\"{quantity}\", {value:e}, {sigma:.4e}, {prior:e}, {prior_sigma:e}, \"{unit}\"],")?;
        }
        writeln!(out, "]\n")
    }

    /// Refuses another scene than the calibrated one.
    pub(crate) fn require_scene(&self, file: &SceneFile) -> Result<(), CalibrationFileError> {
        let same = file.hash == self.scene_hash && file.scene.cells.len() == self.model_errors.len();
        if same {
            return Ok(());
        }
        let text = format!(
            "calibrates the scene `{}` with hash {:016x}, but {} has hash {:016x}; give the scene it was made with, or \
             calibrate this one",
            printable(&self.scene_name),
            self.scene_hash,
            printable(&file.origin),
            file.hash
        );
        Err(CalibrationFileError::Content(self.origin.clone(), text))
    }
}

/// A correlation with five digits after the point.
fn digits(value: f64) -> String {
    if value.abs() < 5e-6 { "0.0".to_owned() } else { format!("{value:.5}") }
}
