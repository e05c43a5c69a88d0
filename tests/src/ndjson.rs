//! The objects that `run` and `replay` print, one a line, held to what other programs rely on.

use glam::DQuat;
use serde_json::{Map, Value};
use slitpose_model::{Estimate, Pose};

const WITH_POSE: [&str; 2] = ["converged", "degraded"];

const WITHOUT_POSE: [&str; 4] = ["ambiguous", "unobservable", "too_dark", "diverged"];

/// A unit quaternion is one to the rounding of its four components and of their squares.
const UNIT: f64 = 8.0 * f64::EPSILON;

/// One object.
#[derive(Clone, Debug)]
pub struct Line {
    /// `seq`.
    pub sequence: u64,
    /// `device_time_s`.
    pub device_time_s: f64,
    /// `status`.
    pub status: String,
    /// `translation_m`, `rotation_xyzw` and `covariance`.
    pub estimate: Option<Estimate>,
    /// `cells_used`.
    pub cells_used: u64,
    /// `truth`.
    pub truth: Option<Pose>,
}

impl Line {
    /// The pose and the true one, where both are known.
    pub fn beside_truth(&self) -> Option<(Estimate, Pose)> {
        Some((self.estimate?, self.truth?))
    }
}

/// Reads all lines of a simulated run.
pub fn parse(text: &str) -> Vec<Line> {
    parse_lines(text, true)
}

pub fn parse_measured(text: &str) -> Vec<Line> {
    let lines = parse_lines(text, false);
    assert!(lines.iter().all(|line| line.truth.is_none()), "a measured pose with a truth");
    lines
}

/// Asserts that `count` scans follow each other from number `first` on, one frame apart.
pub fn assert_complete(lines: &[Line], first: u64, count: usize, rate_hz: f64) {
    assert_eq!(lines.len(), count);
    let start_s = lines[0].device_time_s;
    for (i, line) in lines.iter().enumerate() {
        assert_eq!(line.sequence, first + i as u64);
        // Instants are exact in ticks of 6 ns.
        assert!((line.device_time_s - start_s - i as f64 / rate_hz).abs() < 1e-9, "{line:?}");
    }
}

fn parse_lines(text: &str, simulated: bool) -> Vec<Line> {
    assert!(text.is_empty() || text.ends_with('\n'), "the last line is cut off");
    text.lines().map(|line| parse_line(line, simulated).unwrap_or_else(|fault| panic!("{fault}: {line}"))).collect()
}

fn parse_line(text: &str, simulated: bool) -> Result<Line, String> {
    let object: Map<String, Value> = serde_json::from_str(text).map_err(|error| error.to_string())?;
    let get = |key: &str| object.get(key).ok_or_else(|| format!("no `{key}`"));
    let status = get("status")?.as_str().ok_or("`status` is no text")?.to_owned();
    let has_pose = WITH_POSE.contains(&status.as_str());
    if !has_pose && !WITHOUT_POSE.contains(&status.as_str()) {
        return Err(format!("unknown status `{status}`"));
    }
    if get("simulated")? != &Value::Bool(simulated) {
        return Err(format!("`simulated` is not {simulated}"));
    }
    let estimate = if has_pose {
        let pose = pose(get("translation_m")?, get("rotation_xyzw")?)?;
        Some(Estimate { pose, covariance: covariance(get("covariance")?)? })
    } else {
        for key in ["translation_m", "rotation_xyzw", "covariance"] {
            if !get(key)?.is_null() {
                return Err(format!("`{key}` in spite of status `{status}`"));
            }
        }
        None
    };
    let truth = match object.get("truth") {
        None => None,
        Some(truth) => {
            let part = |key: &str| truth.get(key).ok_or_else(|| format!("no truth.{key}"));
            Some(pose(part("translation_m")?, part("rotation_xyzw")?)?)
        }
    };
    Ok(Line {
        sequence: get("seq")?.as_u64().ok_or("`seq` is no count")?,
        device_time_s: get("device_time_s")?.as_f64().ok_or("`device_time_s` is no number")?,
        cells_used: get("cells_used")?.as_u64().ok_or("`cells_used` is no count")?,
        status,
        estimate,
        truth,
    })
}

fn numbers<const N: usize>(value: &Value) -> Result<[f64; N], String> {
    // JSON knows no NaN and no infinity: they would stand here as null.
    let numbers: Option<Vec<f64>> = value.as_array().and_then(|array| array.iter().map(Value::as_f64).collect());
    numbers.and_then(|numbers| numbers.try_into().ok()).ok_or_else(|| format!("not {N} numbers: {value}"))
}

fn pose(translation_m: &Value, rotation_xyzw: &Value) -> Result<Pose, String> {
    let rotation = DQuat::from_array(numbers(rotation_xyzw)?);
    if (rotation.length_squared() - 1.0).abs() > UNIT {
        return Err(format!("rotation of length {}", rotation.length()));
    }
    Ok(Pose { rotation, translation_m: numbers(translation_m)?.into() })
}

fn covariance(value: &Value) -> Result<[[f64; 6]; 6], String> {
    let flat: [f64; 36] = numbers(value)?;
    let matrix: [[f64; 6]; 6] = std::array::from_fn(|i| std::array::from_fn(|j| flat[6 * i + j]));
    for i in 0..6 {
        if matrix[i][i] <= 0.0 {
            return Err(format!("variance {i} is {}", matrix[i][i]));
        }
        if (0..i).any(|j| matrix[i][j].to_bits() != matrix[j][i].to_bits()) {
            return Err(format!("covariance is not symmetric in row {i}"));
        }
    }
    Ok(matrix)
}
