//! The columns of poses by name and value, for CSV and Parquet.

use slitpose_head::table::{SOLUTION_COLUMNS, SolutionRow};
#[cfg(feature = "parquet")]
use slitpose_model::{AXES, Pose, TwistEstimate};
use slitpose_tracking::clock::HostTime;
use slitpose_tracking::link::DeviceId;
use slitpose_tracking::pipeline::Record;

/// A record in the units of tables.
pub(super) struct Row<'a> {
    record: &'a Record,
    solution: SolutionRow,
    device: &'a str,
}

/// The last board in digits, which are the same for most rows.
#[derive(Default)]
pub(super) struct Device(DeviceId, String);

impl Device {
    pub(super) fn row<'a>(&'a mut self, record: &'a Record) -> Row<'a> {
        if self.0 != record.device || self.1.is_empty() {
            *self = Self(record.device, record.device.to_string());
        }
        Row { record, solution: SolutionRow::of(&record.solution), device: &self.1 }
    }
}

pub(super) type Getter<T> = Box<dyn Fn(&Row<'_>) -> T + Send>;

/// Reads the value of a row; `None`, or an empty word: it has none.
pub(super) enum Get {
    Integer(Getter<Option<u64>>),
    Number(Getter<Option<f64>>),
    Word(Box<dyn for<'a> Fn(&'a Row<'_>) -> &'a str + Send>),
    Flag(Getter<bool>),
}

pub(super) type Column = (String, Get);

fn integer(name: &str, get: impl Fn(&Row<'_>) -> Option<u64> + Send + 'static) -> Column {
    (name.to_owned(), Get::Integer(Box::new(get)))
}

fn number(name: impl Into<String>, get: impl Fn(&Row<'_>) -> Option<f64> + Send + 'static) -> Column {
    (name.into(), Get::Number(Box::new(get)))
}

fn word(name: &str, get: impl for<'a> Fn(&'a Row<'_>) -> &'a str + Send + 'static) -> Column {
    (name.to_owned(), Get::Word(Box::new(get)))
}

/// The columns of `solve`, and those of a stream. The host's time of the pose is empty while unknown.
pub(super) fn columns() -> Vec<Column> {
    let time = |name, get: fn(HostTime) -> u64| integer(name, move |row| row.record.host_time.map(get));
    let mut columns = vec![
        integer("seq", |row| Some(row.record.sequence)),
        number("device_time_s", |row| Some(row.record.device_time_s)),
        word("status", |row| row.solution.status),
    ];
    let numbers = SOLUTION_COLUMNS[1..].iter().take_while(|name| **name != "iterations").enumerate();
    columns.extend(numbers.map(|(at, name)| number(*name, move |row| row.solution.numbers[at])));
    columns.extend([
        integer("iterations", |row| Some(row.solution.iterations as u64)),
        integer("cells_used", |row| Some(row.solution.cells_used as u64)),
        word("free_directions", |row| &row.solution.free_directions),
        word("excluded_cells", |row| &row.solution.excluded_cells),
        word("verified", |row| row.solution.verified),
        word("reason", |row| row.solution.reason),
        ("simulated".to_owned(), Get::Flag(Box::new(|row| row.record.simulated))),
        word("device", |row| row.device),
        time("host_monotonic_ns", |time| time.monotonic_ns),
        time("host_utc_ns", |time| time.utc_ns),
        time("host_uncertainty_ns", |time| time.uncertainty_ns),
    ]);
    columns
}

/// Velocities, filtered poses and true poses, which CSV lacks.
#[cfg(feature = "parquet")]
pub(super) fn more_columns() -> Vec<Column> {
    let mut columns = Vec::new();
    for (prefix, from) in [("", 0), ("sigma_", 6)] {
        for (axis, name) in ["vx", "vy", "vz", "wx", "wy", "wz"].into_iter().enumerate() {
            let unit = if axis < 3 { "m_per_s" } else { "rad_per_s" };
            columns
                .push(number(format!("{prefix}{name}_{unit}"), move |row| motion(row.record.twist.ok()?, from + axis)));
        }
    }
    let mut poses = |prefix: &str, get: fn(&Record) -> Option<[f64; 6]>| {
        for (axis, name) in AXES.into_iter().enumerate() {
            let (unit, scale) = if axis < 3 { ("mm", 1e3) } else { ("rad", 1.0) };
            columns.push(number(format!("{prefix}{name}_{unit}"), move |row| Some(get(row.record)?[axis] * scale)));
        }
    };
    poses("filtered_", |record| Some(coordinates(&record.filtered?.estimate.pose)));
    poses("filtered_sigma_", |record| Some(record.filtered?.estimate.sigma()));
    poses("truth_", |record| record.truth.as_ref().map(coordinates));
    columns
}

#[cfg(feature = "parquet")]
fn coordinates(pose: &Pose) -> [f64; 6] {
    let (t, r) = (pose.translation_m, pose.rotation_rad());
    [t.x, t.y, t.z, r.x, r.y, r.z]
}

/// Linear and angular velocity, then their standard deviations.
#[cfg(feature = "parquet")]
fn motion(TwistEstimate { twist, covariance }: TwistEstimate, at: usize) -> Option<f64> {
    Some(match at {
        0..3 => twist.linear_m_per_s[at],
        3..6 => twist.angular_rad_per_s[at - 3],
        _ => covariance[at - 6][at - 6].sqrt(),
    })
}
