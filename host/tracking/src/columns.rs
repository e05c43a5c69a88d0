//! The quantities of a scan, in one table for all outputs: NDJSON writes objects, CSV and `solve` write columns,
//! Python makes arrays, and the help lists them. A quantity is added by one row of [`COLUMNS`], at its end.

use glam::{DQuat, DVec3};
use serde::Serialize;
use slitpose_model::{
    AXES, Cells, DegradedReason, Directions, Estimate, Filtered, NoTwist, Outcome, Pose, Solution, TwistEstimate,
    Verified, rotation_log,
};

use crate::clock::HostTime;
use crate::frame::View;
use crate::link::DeviceId;
use crate::pipeline::{Outcomes, Record};

type Matrix6 = [[f64; 6]; 6];

/// A solution and, if it is of a stream, its record.
#[derive(Clone, Copy, Debug)]
pub struct Row<'a> {
    /// Of one scan, or of one row of currents.
    pub solution: &'a Solution,
    /// Of a stream.
    pub record: Option<&'a Record>,
}

impl<'a> From<&'a Record> for Row<'a> {
    fn from(record: &'a Record) -> Self {
        Self { solution: &record.solution, record: Some(record) }
    }
}

impl<'a> From<&'a Solution> for Row<'a> {
    fn from(solution: &'a Solution) -> Self {
        Self { solution, record: None }
    }
}

/// Reads the value of a row; `None`, or an empty word or set: it has none. SI units.
#[derive(Clone, Copy)]
#[allow(missing_docs, reason = "values are named by what they are")]
pub enum Get {
    Integer(fn(&Row<'_>) -> Option<u64>),
    Count(fn(&Row<'_>) -> usize),
    Number(fn(&Row<'_>) -> Option<f64>),
    Flag(fn(&Row<'_>) -> bool),
    /// One of these words, if they are known beforehand.
    Word(fn() -> Vec<&'static str>, fn(&Row<'_>) -> &'static str),
    Device(fn(&Row<'_>) -> DeviceId),
    Directions(fn(&Row<'_>) -> Directions),
    Cells(fn(&Row<'_>) -> Cells),
    Translation(fn(&Row<'_>) -> Option<DVec3>),
    Rotation(fn(&Row<'_>) -> Option<DQuat>),
    /// In tables the standard deviations.
    Covariance(for<'a> fn(&'a Row<'a>) -> Option<&'a Matrix6>),
    /// Between the coordinates of such a covariance.
    Correlation(for<'a> fn(&'a Row<'a>) -> Option<&'a Matrix6>),
    Velocity(fn(&Row<'_>) -> Option<DVec3>),
    AngularVelocity(fn(&Row<'_>) -> Option<DVec3>),
    /// Of linear and angular velocity.
    TwistSigma(fn(&Row<'_>) -> Option<[f64; 6]>),
}

/// A quantity.
#[derive(Clone, Copy)]
pub struct Column {
    /// Its key in NDJSON, behind the names of the objects it is in and dots; empty: it follows from others.
    pub key: &'static str,
    /// Its name in tables; of several columns, what their names begin with.
    pub name: &'static str,
    /// Its unit in NDJSON; in tables names end in units.
    pub unit: &'static str,
    /// What it is.
    pub meaning: &'static str,
    /// Whether NDJSON writes `null` where it has no value, and does not leave it out. Of the first one in an object:
    /// the same of the object.
    pub is_null: bool,
    /// Whether it is of streams only.
    pub is_of_stream: bool,
    /// Its place among the columns of tables on whose order other programs rely.
    rank: u8,
    /// Its value.
    pub get: Get,
}

/// A field of a table.
#[derive(Clone, Copy, Debug)]
pub enum Field<'a> {
    /// A whole number, or none.
    Integer(Option<u64>),
    /// A number, or none.
    Number(Option<f64>),
    /// A word, or none if it is empty.
    Word(&'a str),
    /// Yes or no.
    Flag(bool),
}

const VELOCITY_AXES: [&str; 6] = ["vx", "vy", "vz", "wx", "wy", "wz"];

/// Why a pose is degraded, in the order of their numbers in Python, from 1.
const REASONS: [DegradedReason; 6] = [
    DegradedReason::FewerCells,
    DegradedReason::CellExcluded,
    DegradedReason::Misfit,
    DegradedReason::Unfinished,
    DegradedReason::Uncalibrated,
    DegradedReason::Doubted,
];

/// Why a pose has no velocity, by the numbers of [`no_twist`].
pub const NO_TWIST: [&str; 3] = ["", "start", "jump"];

/// The number of the reason for which a pose has no velocity; zero: it has one, or there is no pose.
pub fn no_twist(twist: &Result<TwistEstimate, NoTwist>) -> usize {
    match twist {
        Ok(_) | Err(NoTwist::NoPose) => 0,
        Err(NoTwist::Start) => 1,
        Err(NoTwist::Jump) => 2,
    }
}

const fn solution(
    key: &'static str,
    name: &'static str,
    unit: &'static str,
    meaning: &'static str,
    get: Get,
) -> Column {
    Column { key, name, unit, meaning, is_null: false, is_of_stream: false, rank: u8::MAX, get }
}

const fn stream(key: &'static str, name: &'static str, unit: &'static str, meaning: &'static str, get: Get) -> Column {
    Column { is_of_stream: true, ..solution(key, name, unit, meaning, get) }
}

impl Column {
    const fn or_null(self) -> Self {
        Self { is_null: true, ..self }
    }

    const fn ranked(self, rank: u8) -> Self {
        Self { rank, ..self }
    }
}

fn estimate<'a>(row: &'a Row<'_>) -> Option<&'a Estimate> {
    row.solution.estimate.as_ref()
}

fn time(row: &Row<'_>, get: fn(HostTime) -> u64) -> Option<u64> {
    row.record?.host_time.map(get)
}

fn twist<'a>(row: &'a Row<'_>) -> Option<&'a TwistEstimate> {
    row.record?.twist.as_ref().ok()
}

fn filtered<'a>(row: &'a Row<'_>) -> Option<&'a Filtered> {
    row.record?.filtered.as_ref()
}

fn filtered_twist<'a>(row: &'a Row<'_>) -> Option<&'a TwistEstimate> {
    filtered(row)?.twist.as_ref().ok()
}

fn truth<'a>(row: &'a Row<'_>) -> Option<&'a Pose> {
    row.record?.truth.as_ref()
}

fn finite(value: f64) -> Option<f64> {
    Some(value).filter(|value| value.is_finite())
}

fn deviations(matrix: &Matrix6) -> [f64; 6] {
    std::array::from_fn(|axis| matrix[axis][axis].sqrt())
}

/// Two different coordinates each.
fn pairs() -> impl Iterator<Item = (usize, usize)> {
    (0..6).flat_map(|i| (i + 1..6).map(move |j| (i, j)))
}

/// All quantities, in the order of NDJSON. Those of one object stand together.
#[rustfmt::skip]
pub static COLUMNS: [Column; 40] = [
    stream("seq", "seq", "", "number of the scan, counted by the board", Get::Integer(|row| Some(row.record?.sequence))).ranked(0),
    stream("device", "device", "", "id of the board", Get::Device(|row| row.record.map_or_else(DeviceId::default, |record| record.device))).ranked(15),
    stream("device_time_s", "device_time_s", "s", "instant of the pose by the board's clock", Get::Number(|row| Some(row.record?.device_time_s))).ranked(1),
    stream("host_monotonic_ns", "host_monotonic_ns", "ns", "the same by the host's CLOCK_MONOTONIC", Get::Integer(|row| time(row, |time| time.monotonic_ns))).ranked(16),
    stream("host_utc_ns", "host_utc_ns", "ns", "the same by UTC, since 1970", Get::Integer(|row| time(row, |time| time.utc_ns))).ranked(17),
    stream("host_uncertainty_ns", "host_uncertainty_ns", "ns", "greatest error of both", Get::Integer(|row| time(row, |time| time.uncertainty_ns))).ranked(18),
    solution("status", "status", "", "whether there is a pose, and how good; else why not", Get::Word(|| Outcomes::default().by_name().map(|(name, _)| name).into(), |row| row.solution.outcome.as_str())).ranked(2),
    solution("reason", "reason", "", "why a pose is degraded", Get::Word(|| std::iter::once("").chain(REASONS.map(DegradedReason::as_str)).collect(), |row| match row.solution.outcome {
        Outcome::Degraded(reason) => reason.as_str(),
        _ => "",
    })).ranked(13),
    solution("reason", "free_directions", "", "coordinates that an unobservable pose leaves open, joined by `;`", Get::Directions(|row| match row.solution.outcome {
        Outcome::Unobservable(directions) => directions,
        _ => Directions::default(),
    })).ranked(10),
    solution("translation_m", "", "m", "translation of base_from_tool", Get::Translation(|row| Some(estimate(row)?.pose.translation_m))).or_null().ranked(3),
    solution("rotation_xyzw", "", "", "its rotation: quaternion x, y, z, w; in tables a rotation vector", Get::Rotation(|row| Some(estimate(row)?.pose.rotation))).or_null().ranked(4),
    solution("covariance", "sigma_", "m, rad", "covariance of (dt, dr) in the base frame, row-major: m², m·rad, rad²; in tables standard deviations", Get::Covariance(|row| Some(&estimate(row)?.covariance))).or_null().ranked(5),
    solution("cells_used", "cells_used", "", "number of cells that entered", Get::Count(|row| row.solution.cells_used.count())).ranked(9),
    solution("chi2", "chi2", "", "sum of the squared normalised residuals", Get::Number(|row| finite(row.solution.chi2))).or_null().ranked(7),
    solution("redundancy", "redundancy", "", "data minus unknowns", Get::Count(|row| row.solution.redundancy)),
    solution("verified", "verified", "", "how well redundancy checked the pose: `well`, `weakly` or `not`", Get::Word(|| [Verified::Not, Verified::Weakly, Verified::Well].map(Verified::as_str).into(), |row| row.solution.verified().as_str())).ranked(12),
    solution("unnoticed_sigmas", "unnoticed_sigmas", "σ", "external reliability: greatest shift of the pose by one undetected outlier; none if unbounded", Get::Number(|row| finite(row.solution.unnoticed_sigmas))),
    solution("excluded_cells", "excluded_cells", "", "cells that contradict all others, in tables joined by `;`", Get::Cells(|row| row.solution.excluded)).ranked(11),
    stream("twist.linear_m_per_s", "", "m/s", "velocity in the base frame", Get::Velocity(|row| Some(twist(row)?.twist.linear_m_per_s))).or_null(),
    stream("twist.angular_rad_per_s", "", "rad/s", "angular velocity in the base frame", Get::AngularVelocity(|row| Some(twist(row)?.twist.angular_rad_per_s))),
    stream("twist.sigma", "sigma_", "m/s, rad/s", "standard deviations of both", Get::TwistSigma(|row| Some(deviations(&twist(row)?.covariance)))),
    stream("no_twist", "no_twist", "", "why a pose has no velocity: `start` (too few poses yet) or `jump` (the tool is not where its motion led)", Get::Word(|| NO_TWIST.into(), |row| NO_TWIST[row.record.map_or(0, |record| no_twist(&record.twist))])),
    stream("filtered.translation_m", "filtered_", "m", "as above, filtered over many scans", Get::Translation(|row| Some(filtered(row)?.estimate.pose.translation_m))),
    stream("filtered.rotation_xyzw", "filtered_", "", "as above", Get::Rotation(|row| Some(filtered(row)?.estimate.pose.rotation))),
    stream("filtered.covariance", "filtered_sigma_", "m, rad", "as above", Get::Covariance(|row| Some(&filtered(row)?.estimate.covariance))),
    stream("filtered.twist.linear_m_per_s", "filtered_", "m/s", "as above", Get::Velocity(|row| Some(filtered_twist(row)?.twist.linear_m_per_s))).or_null(),
    stream("filtered.twist.angular_rad_per_s", "filtered_", "rad/s", "as above", Get::AngularVelocity(|row| Some(filtered_twist(row)?.twist.angular_rad_per_s))),
    stream("filtered.twist.sigma", "filtered_sigma_", "m/s, rad/s", "as above", Get::TwistSigma(|row| Some(deviations(&filtered_twist(row)?.covariance)))),
    stream("filtered.no_twist", "filtered_no_twist", "", "as above", Get::Word(|| NO_TWIST.into(), |row| NO_TWIST[filtered(row).map_or(0, |filtered| no_twist(&filtered.twist))])),
    stream("filtered.lag_s", "filtered_lag_s", "s", "time after which half of a small step has come through the filter", Get::Number(|row| Some(filtered(row)?.lag_s))),
    stream("filtered.frames", "filtered_frames", "", "scans since the motion last started anew", Get::Integer(|row| Some(filtered(row)?.frames.into()))),
    stream("light_level", "light_level", "", "brightness of all light relative to scene or calibration; none where it is taken for known", Get::Number(|row| row.record?.light_level)),
    stream("simulated", "simulated", "", "whether the currents were computed, not measured", Get::Flag(|row| row.record.is_some_and(|record| record.simulated))).ranked(14),
    stream("truth.translation_m", "truth_", "m", "true pose of simulated boards", Get::Translation(|row| Some(truth(row)?.translation_m))),
    stream("truth.rotation_xyzw", "truth_", "", "as above", Get::Rotation(|row| Some(truth(row)?.rotation))),
    solution("", "condition", "", "condition number of the scaled normal equations; in tables only, because it takes longer than a line of NDJSON", Get::Number(|row| row.solution.condition().and_then(finite))).ranked(6),
    solution("iterations", "iterations", "", "refinement steps", Get::Count(|row| row.solution.iterations)).ranked(8),
    stream("frame", "frame", "", "frame of pose, velocity and truth, if it was chosen; else the head's base", Get::Word(Vec::new, |row| row.record.and_then(|record| record.view).map_or("", View::name))),
    stream("", "correlation_", "", "of the coordinates of the pose, by its covariance", Get::Correlation(|row| Some(&estimate(row)?.covariance))),
    stream("", "filtered_correlation_", "", "as above", Get::Correlation(|row| Some(&filtered(row)?.estimate.covariance))),
];

/// The columns of tables: first those on whose order other programs rely. `is_stream`: with those of streams.
pub fn of_tables(is_stream: bool) -> Vec<&'static Column> {
    let mut columns: Vec<_> = COLUMNS.iter().filter(|column| is_stream || !column.is_of_stream).collect();
    columns.sort_by_key(|column| column.rank);
    columns
}

/// The keys of an object of NDJSON, each with the first of its columns; of one that is an object itself also all of its columns, and
/// how many bytes of their keys lead there. `behind`: how many lead to this one.
pub fn entries<'a>(
    columns: &'a [&'static Column],
    behind: usize,
) -> impl Iterator<Item = (&'static str, &'static Column, Option<(&'a [&'static Column], usize)>)> {
    let mut rest = columns;
    std::iter::from_fn(move || {
        let (&first, others) = rest.split_first()?;
        let key = &first.key[behind..];
        let Some((name, _)) = key.split_once('.') else {
            rest = others;
            return Some((key, first, None));
        };
        let path = &first.key[..=behind + name.len()];
        let (inner, others) = rest.split_at(rest.iter().take_while(|column| column.key.starts_with(path)).count());
        rest = others;
        Some((name, first, Some((inner, path.len()))))
    })
}

impl Column {
    /// The names of its columns in tables, with units.
    pub fn names(&self) -> Vec<String> {
        let name = self.name;
        let unit = |axis: usize| if axis < 3 { "mm" } else { "rad" };
        let pose = |axis: usize| format!("{name}{}_{}", AXES[axis], unit(axis));
        let speed = |axis: usize| format!("{name}{}_{}_per_s", VELOCITY_AXES[axis], if axis < 3 { "m" } else { "rad" });
        match self.get {
            Get::Translation(_) => (0..3).map(pose).collect(),
            Get::Rotation(_) => (3..6).map(pose).collect(),
            Get::Covariance(_) => (0..6).map(pose).collect(),
            Get::Correlation(_) => pairs().map(|(i, j)| format!("{name}{}_{}", AXES[i], AXES[j])).collect(),
            Get::Velocity(_) => (0..3).map(speed).collect(),
            Get::AngularVelocity(_) => (3..6).map(speed).collect(),
            Get::TwistSigma(_) => (0..6).map(speed).collect(),
            _ => vec![name.to_owned()],
        }
    }

    /// Passes the value of `row` to `put`: a field for each of its [names](Self::names).
    pub fn put(&self, row: &Row<'_>, put: &mut impl FnMut(Field<'_>)) {
        fn numbers<const N: usize>(put: &mut impl FnMut(Field<'_>), values: Option<[f64; N]>, scale: f64) {
            (0..N).for_each(|k| put(Field::Number(values.map(|values| values[k] * scale))));
        }
        match self.get {
            Get::Integer(get) => put(Field::Integer(get(row))),
            Get::Count(get) => put(Field::Integer(Some(get(row) as u64))),
            Get::Number(get) => put(Field::Number(get(row))),
            Get::Flag(get) => put(Field::Flag(get(row))),
            Get::Word(_, get) => put(Field::Word(get(row))),
            Get::Device(get) => get(row).with_digits(|digits| put(Field::Word(digits))),
            Get::Directions(get) => put(Field::Word(&get(row).to_string())),
            Get::Cells(get) => put(Field::Word(&get(row).to_string())),
            Get::Translation(get) => numbers(put, get(row).map(|t| t.to_array()), 1e3),
            Get::Rotation(get) => numbers(put, get(row).map(|r| rotation_log(r).to_array()), 1.0),
            Get::Covariance(get) => {
                let sigma = get(row).map(deviations);
                numbers(put, sigma.map(|[x, y, z, ..]| [x, y, z]), 1e3);
                numbers(put, sigma.map(|[.., x, y, z]| [x, y, z]), 1.0);
            }
            Get::Correlation(get) => {
                let matrix = get(row);
                for (i, j) in pairs() {
                    put(Field::Number(matrix.map(|m| m[i][j] / (m[i][i] * m[j][j]).sqrt()).and_then(finite)));
                }
            }
            Get::Velocity(get) | Get::AngularVelocity(get) => numbers(put, get(row).map(|v| v.to_array()), 1.0),
            Get::TwistSigma(get) => numbers(put, get(row), 1.0),
        }
    }
}

/// The columns of tables of scans, written as CSV.
pub struct CsvRows(Vec<&'static Column>);

impl Default for CsvRows {
    fn default() -> Self {
        Self(of_tables(true))
    }
}

impl CsvRows {
    /// Appends the header to `line`.
    pub fn header(&self, line: &mut Vec<u8>) {
        let names: Vec<String> = self.0.iter().flat_map(|column| column.names()).collect();
        line.extend_from_slice(names.join(",").as_bytes());
        line.push(b'\n');
    }

    /// Appends the row of `record` to `line`; numbers read back to the same bits.
    pub fn row(&self, record: &Record, line: &mut Vec<u8>) {
        let (row, begin) = (Row::from(record), line.len());
        // Writing numbers and words to memory cannot fail.
        fn json(line: &mut Vec<u8>, value: &impl Serialize) {
            let _ = serde_json::to_writer(line, value);
        }
        // Each behind a comma. None needs quotes.
        let mut put = |field: Field<'_>| {
            line.push(b',');
            match field {
                Field::Integer(value) => value.iter().for_each(|value| json(line, value)),
                Field::Number(value) => value.iter().for_each(|value| json(line, value)),
                Field::Word(word) => line.extend_from_slice(word.as_bytes()),
                Field::Flag(flag) => json(line, &flag),
            }
        };
        self.0.iter().for_each(|column| column.put(&row, &mut put));
        line.push(b'\n');
        line.remove(begin);
    }
}
