//! The columns of poses by name and value: those of `solve`, and of a stream for CSV and Parquet.

use std::borrow::Cow;

use slitpose_model::{AXES, Outcome, Pose, Solution};
#[cfg(feature = "parquet")]
use slitpose_model::{Estimate, TwistEstimate};
use slitpose_tracking::clock::HostTime;
use slitpose_tracking::link::DeviceId;
use slitpose_tracking::pipeline::Record;

/// A solution, and of one from a stream its record and the board in digits.
pub(crate) struct PoseRow<'a> {
    solution: &'a Solution,
    record: Option<&'a Record>,
    device: &'a str,
}

impl<'a> PoseRow<'a> {
    pub(crate) fn of(solution: &'a Solution) -> Self {
        Self { solution, record: None, device: "" }
    }
}

/// The last board in digits, which are the same for most rows.
#[derive(Default)]
pub(super) struct Device(DeviceId, String);

impl Device {
    pub(super) fn row<'a>(&'a mut self, record: &'a Record) -> PoseRow<'a> {
        if self.0 != record.device || self.1.is_empty() {
            *self = Self(record.device, record.device.to_string());
        }
        PoseRow { solution: &record.solution, record: Some(record), device: &self.1 }
    }
}

pub(super) type Getter<T> = Box<dyn Fn(&PoseRow<'_>) -> T + Send + Sync>;

type WordGetter = Box<dyn for<'a> Fn(&'a PoseRow<'_>) -> Cow<'a, str> + Send + Sync>;

/// Reads the value of a row; `None`, or an empty word: it has none.
pub(crate) enum Get {
    Integer(Getter<Option<u64>>),
    Number(Getter<Option<f64>>),
    Word(WordGetter),
    Flag(Getter<bool>),
}

/// Its name, and how its values are read.
pub(crate) type PoseColumn = (String, Get);

fn integer(name: &str, get: impl Fn(&PoseRow<'_>) -> Option<u64> + Send + Sync + 'static) -> PoseColumn {
    (name.to_owned(), Get::Integer(Box::new(get)))
}

fn number(name: impl Into<String>, get: impl Fn(&PoseRow<'_>) -> Option<f64> + Send + Sync + 'static) -> PoseColumn {
    (name.into(), Get::Number(Box::new(get)))
}

fn word(name: &str, get: impl for<'a> Fn(&'a PoseRow<'_>) -> Cow<'a, str> + Send + Sync + 'static) -> PoseColumn {
    (name.to_owned(), Get::Word(Box::new(get)))
}

/// Six columns, in millimetres and radians, of what has a value in metres or radians along each axis.
fn along_axes(prefix: &str, get: fn(&PoseRow<'_>) -> Option<[f64; 6]>) -> impl Iterator<Item = PoseColumn> {
    AXES.into_iter().enumerate().map(move |(axis, name)| {
        let (unit, scale) = if axis < 3 { ("mm", 1e3) } else { ("rad", 1.0) };
        number(format!("{prefix}{name}_{unit}"), move |row| Some(get(row)?[axis] * scale))
    })
}

/// The columns of `solve` behind that of the row.
pub(crate) fn solution_columns() -> Vec<PoseColumn> {
    let finite = |value: &f64| value.is_finite();
    let mut columns = vec![word("status", |row| row.solution.outcome.as_str().into())];
    columns.extend(along_axes("", |row| Some(coordinates(&row.solution.estimate.as_ref()?.pose))));
    columns.extend(along_axes("sigma_", |row| Some(row.solution.estimate.as_ref()?.sigma())));
    columns.extend([
        number("condition", move |row| row.solution.condition().filter(finite)),
        number("chi2", move |row| Some(row.solution.chi2).filter(finite)),
        // Refinement steps.
        integer("iterations", |row| Some(row.solution.iterations as u64)),
        integer("cells_used", |row| Some(row.solution.cells_used.count() as u64)),
        // Coordinates that an unobservable pose leaves open, joined by `;`.
        word("free_directions", |row| match row.solution.outcome {
            Outcome::Unobservable(directions) => directions.to_string().into(),
            _ => "".into(),
        }),
        // Those that contradict all others, joined by `;`.
        word("excluded_cells", |row| row.solution.excluded.to_string().into()),
        // How well redundancy checked the pose: `well`, `weakly` or `not`.
        word("verified", |row| row.solution.verified().as_str().into()),
        // Why a pose is degraded.
        word("reason", |row| match row.solution.outcome {
            Outcome::Degraded(reason) => reason.as_str().into(),
            _ => "".into(),
        }),
    ]);
    columns
}

/// The columns of `solve`, and those of a stream. The host's time of the pose is empty while unknown.
pub(super) fn columns() -> Vec<PoseColumn> {
    let time = |name, get: fn(HostTime) -> u64| integer(name, move |row| row.record?.host_time.map(get));
    let mut columns = vec![
        integer("seq", |row| Some(row.record?.sequence)),
        number("device_time_s", |row| Some(row.record?.device_time_s)),
    ];
    columns.extend(solution_columns());
    columns.extend([
        ("simulated".to_owned(), Get::Flag(Box::new(|row| row.record.is_some_and(|record| record.simulated)))),
        word("device", |row| row.device.into()),
        time("host_monotonic_ns", |time| time.monotonic_ns),
        time("host_utc_ns", |time| time.utc_ns),
        time("host_uncertainty_ns", |time| time.uncertainty_ns),
    ]);
    columns
}

/// Velocities, filtered poses and true poses, which CSV lacks.
#[cfg(feature = "parquet")]
pub(super) fn more_columns() -> Vec<PoseColumn> {
    let mut columns = Vec::new();
    for (prefix, from) in [("", 0), ("sigma_", 6)] {
        for (axis, name) in ["vx", "vy", "vz", "wx", "wy", "wz"].into_iter().enumerate() {
            let unit = if axis < 3 { "m_per_s" } else { "rad_per_s" };
            columns.push(number(format!("{prefix}{name}_{unit}"), move |row| {
                motion(row.record?.twist.ok()?, from + axis)
            }));
        }
    }
    fn filtered<'a>(row: &'a PoseRow<'_>) -> Option<&'a Estimate> {
        Some(&row.record?.filtered.as_ref()?.estimate)
    }
    columns.extend(along_axes("filtered_", |row| Some(coordinates(&filtered(row)?.pose))));
    columns.extend(along_axes("filtered_sigma_", |row| Some(filtered(row)?.sigma())));
    columns.extend(along_axes("truth_", |row| row.record?.truth.as_ref().map(coordinates)));
    columns
}

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
