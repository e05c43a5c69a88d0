//! Columns that become numpy arrays; rotation vectors and quaternions, as the command computes them.

use glam::{DQuat, DVec3};
use numpy::{Element, IntoPyArray, PyArray, PyArray2, PyArrayMethods, PyReadonlyArray2};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use slitpose_model::{
    AXES, DegradedReason, Filtered, Outcome, Pose, Solution, TwistEstimate, Verified, rotation_exp, rotation_log,
};
use slitpose_tracking::link::DeviceId;
use slitpose_tracking::pipeline::{Outcomes, Record};

/// The numbers of `verified`.
pub(crate) const VERIFIED: [Verified; 3] = [Verified::Not, Verified::Weakly, Verified::Well];

/// Why a pose is degraded, in the order of the numbers, from 1.
const REASONS: [DegradedReason; 6] = [
    DegradedReason::FewerCells,
    DegradedReason::CellExcluded,
    DegradedReason::Misfit,
    DegradedReason::Unfinished,
    DegradedReason::Uncalibrated,
    DegradedReason::Doubted,
];

/// The words for them; nothing for zero.
pub(crate) fn reasons() -> Vec<&'static str> {
    std::iter::once("").chain(REASONS.map(|reason| reason.as_str())).collect()
}

/// `values` as an array of this shape, without a copy.
pub(crate) fn matrix<T: Element, D: numpy::ndarray::Dimension>(
    py: Python<'_>,
    values: Vec<T>,
    shape: impl numpy::ndarray::IntoDimension<Dim = D>,
) -> PyResult<Bound<'_, PyArray<T, D>>> {
    values.into_pyarray(py).reshape(shape)
}

/// A dictionary of arrays that is being filled.
pub(crate) struct Columns<'py> {
    pub(crate) dict: Bound<'py, PyDict>,
    pub(crate) rows: usize,
}

impl<'py> Columns<'py> {
    pub(crate) fn new(py: Python<'py>, rows: usize) -> Self {
        Self { dict: PyDict::new(py), rows }
    }

    /// A column with one value a row.
    pub(crate) fn put<T: Element>(&self, name: &str, values: Vec<T>) -> PyResult<()> {
        self.dict.set_item(name, values.into_pyarray(self.dict.py()))
    }

    /// A column with an array of this shape in each row; of an empty shape with one value.
    pub(crate) fn put_shaped<T: Element>(&self, name: &str, values: Vec<T>, shape: &[usize]) -> PyResult<()> {
        let shape = [&[self.rows], shape].concat();
        self.dict.set_item(name, values.into_pyarray(self.dict.py()).reshape(shape)?)
    }
}

/// Columns with their types and, of arrays, their shapes: what a struct of vectors needs to become a dictionary.
macro_rules! columns {
    ($(#[$about:meta])* $name:ident { $($column:ident: $type:ty $([$($length:expr),*])?,)* }) => {
        $(#[$about])*
        #[derive(Default)]
        pub(crate) struct $name { $($column: Vec<$type>,)* }

        impl $name {
            /// Puts all of them, the names behind `prefix`.
            pub(crate) fn put(self, columns: &Columns<'_>, prefix: &str) -> PyResult<()> {
                $(columns.put_shaped(&format!("{prefix}{}", stringify!($column)), self.$column, &[$($($length),*)?])?;)*
                Ok(())
            }
        }
    };
}

columns!(
    /// Solutions, one a row. What a row lacks is NaN, or zero in columns of integers.
    SolutionColumns {
        status: u8,
        reason: u8,
        free_directions: u8,
        translation_m: f64 [3],
        rotation_xyzw: f64 [4],
        covariance: f64 [6, 6],
        condition: f64,
        chi2: f64,
        redundancy: u16,
        iterations: u16,
        cells_used: u16,
        excluded_cells: u16,
        verified: u8,
        unnoticed_sigmas: f64,
    }
);

impl SolutionColumns {
    pub(crate) fn push(&mut self, solution: &Solution) {
        let outcome = &solution.outcome;
        self.status.push(Outcomes::number_of(outcome) as u8);
        let reason = match outcome {
            Outcome::Degraded(why) => REASONS.iter().position(|reason| reason == why).map_or(0, |at| at + 1),
            _ => 0,
        };
        self.reason.push(reason as u8);
        let free = |name: &str| AXES.iter().position(|axis| *axis == name).map_or(0, |axis| 1_u8 << axis);
        self.free_directions.push(match outcome {
            Outcome::Unobservable(directions) => directions.names().map(free).fold(0, |set, bit| set | bit),
            _ => 0,
        });
        put_pose(&mut self.translation_m, &mut self.rotation_xyzw, solution.estimate.map(|estimate| estimate.pose));
        put_matrix(&mut self.covariance, solution.estimate.map(|estimate| estimate.covariance));
        self.condition.push(solution.condition().filter(|_| solution.estimate.is_some()).unwrap_or(f64::NAN));
        self.chi2.push(if solution.chi2.is_finite() { solution.chi2 } else { f64::NAN });
        self.redundancy.push(solution.redundancy as u16);
        self.iterations.push(solution.iterations as u16);
        self.cells_used.push(solution.cells_used.count() as u16);
        self.excluded_cells.push(solution.excluded.iter().fold(0, |set, cell| set | 1 << cell));
        let verified = VERIFIED.iter().position(|verified| *verified == solution.verified());
        self.verified.push(verified.unwrap_or(0) as u8);
        self.unnoticed_sigmas.push(solution.unnoticed_sigmas);
    }

    pub(crate) fn rows(&self) -> usize {
        self.status.len()
    }
}

/// The number of a board among `devices`, to which it is added if it is new.
pub(crate) fn number_in(devices: &mut Vec<DeviceId>, device: DeviceId) -> u8 {
    let number = devices.iter().position(|known| *known == device).unwrap_or_else(|| {
        devices.push(device);
        devices.len() - 1
    });
    number as u8
}

columns!(
    /// Scans, one a row.
    ScanColumns {
        device: u8,
        sequence: u64,
        time_s: f64,
        host_monotonic_ns: u64,
        host_utc_ns: u64,
        host_uncertainty_ns: u64,
        twist: f64 [6],
        twist_sigma: f64 [6],
        simulated: bool,
        truth_translation_m: f64 [3],
        truth_rotation_xyzw: f64 [4],
    }
);

columns!(
    /// What a filter found.
    FilteredColumns {
        translation_m: f64 [3],
        rotation_xyzw: f64 [4],
        covariance: f64 [6, 6],
        twist: f64 [6],
        twist_sigma: f64 [6],
        lag_s: f64,
    }
);

/// Poses of a stream, one a row.
#[derive(Default)]
pub(crate) struct RecordColumns {
    solutions: SolutionColumns,
    scans: ScanColumns,
    /// With a row for each, or none as long as there is no filter.
    filtered: FilteredColumns,
    is_filtered: bool,
}

impl RecordColumns {
    pub(crate) fn push(&mut self, record: &Record, devices: &mut Vec<DeviceId>) {
        self.solutions.push(&record.solution);
        let (scans, time) = (&mut self.scans, record.host_time);
        scans.device.push(number_in(devices, record.device));
        scans.sequence.push(record.sequence);
        scans.time_s.push(record.device_time_s);
        scans.host_monotonic_ns.push(time.map_or(0, |time| time.monotonic_ns));
        scans.host_utc_ns.push(time.map_or(0, |time| time.utc_ns));
        scans.host_uncertainty_ns.push(time.map_or(0, |time| time.uncertainty_ns));
        put_twist(&mut scans.twist, &mut scans.twist_sigma, record.twist.ok());
        scans.simulated.push(record.simulated);
        put_pose(&mut scans.truth_translation_m, &mut scans.truth_rotation_xyzw, record.truth);
        if record.filtered.is_some() && !std::mem::replace(&mut self.is_filtered, true) {
            (1..self.scans.time_s.len()).for_each(|_| self.filtered.push(None));
        }
        if self.is_filtered {
            self.filtered.push(record.filtered.as_ref());
        }
    }

    pub(crate) fn put(self, columns: &Columns<'_>) -> PyResult<()> {
        self.solutions.put(columns, "")?;
        self.scans.put(columns, "")?;
        if self.is_filtered { self.filtered.put(columns, "filtered_") } else { Ok(()) }
    }

    pub(crate) fn rows(&self) -> usize {
        self.scans.time_s.len()
    }
}

impl FilteredColumns {
    fn push(&mut self, found: Option<&Filtered>) {
        put_pose(&mut self.translation_m, &mut self.rotation_xyzw, found.map(|found| found.estimate.pose));
        put_matrix(&mut self.covariance, found.map(|found| found.estimate.covariance));
        put_twist(&mut self.twist, &mut self.twist_sigma, found.and_then(|found| found.twist.ok()));
        self.lag_s.push(found.map_or(f64::NAN, |found| found.lag_s));
    }
}

fn put_pose(translation_m: &mut Vec<f64>, rotation_xyzw: &mut Vec<f64>, pose: Option<Pose>) {
    translation_m.extend(pose.map_or([f64::NAN; 3], |pose| pose.translation_m.to_array()));
    rotation_xyzw.extend(pose.map_or([f64::NAN; 4], |pose| pose.rotation.to_array()));
}

pub(crate) fn put_matrix(values: &mut Vec<f64>, matrix: Option<[[f64; 6]; 6]>) {
    values.extend(matrix.unwrap_or([[f64::NAN; 6]; 6]).as_flattened());
}

fn put_twist(values: &mut Vec<f64>, sigmas: &mut Vec<f64>, found: Option<TwistEstimate>) {
    let Some(TwistEstimate { twist, covariance }) = found else {
        values.extend([f64::NAN; 6]);
        return sigmas.extend([f64::NAN; 6]);
    };
    values.extend(twist.linear_m_per_s.to_array());
    values.extend(twist.angular_rad_per_s.to_array());
    sigmas.extend((0..6).map(|axis| covariance[axis][axis].sqrt()));
}

/// Largest deviation of a quaternion's length from 1 that rounding explains.
const ROUNDING: f64 = 1e-6;

/// Rotation vectors (N, 3), rad, of quaternions x, y, z, w (N, 4).
#[pyfunction]
pub(crate) fn rotation_vectors<'py>(
    py: Python<'py>,
    rotation_xyzw: PyReadonlyArray2<'py, f64>,
) -> PyResult<Bound<'py, PyArray2<f64>>> {
    let rows = rows_of::<4>("rotation_xyzw", &rotation_xyzw)?;
    let vectors = rows.iter().flat_map(|row| rotation_log(DQuat::from_array(*row)).to_array()).collect();
    matrix(py, vectors, [rows.len(), 3])
}

/// Quaternions x, y, z, w (N, 4) of rotation vectors (N, 3), rad.
#[pyfunction]
pub(crate) fn quaternions<'py>(
    py: Python<'py>,
    rotation_rad: PyReadonlyArray2<'py, f64>,
) -> PyResult<Bound<'py, PyArray2<f64>>> {
    let rows = rows_of::<3>("rotation_rad", &rotation_rad)?;
    let found = rows.iter().flat_map(|row| rotation_exp(DVec3::from_array(*row)).to_array()).collect();
    matrix(py, found, [rows.len(), 4])
}

/// Poses of translations (N, 3), m, and rotations: vectors (N, 3), rad, or quaternions (N, 4).
pub(crate) fn poses(
    translation_m: &PyReadonlyArray2<'_, f64>,
    rotation: &PyReadonlyArray2<'_, f64>,
) -> PyResult<Vec<Pose>> {
    let translations = rows_of::<3>("translation_m", translation_m)?;
    let rotations: Vec<DQuat> = if rotation.as_array().ncols() == 4 {
        let rows = rows_of::<4>("rotation", rotation)?;
        rows.into_iter().enumerate().map(|(row, xyzw)| unit("rotation", row, xyzw)).collect::<PyResult<_>>()?
    } else {
        let rows = rows_of::<3>("rotation", rotation)?;
        rows.into_iter().map(|vector| rotation_exp(DVec3::from_array(vector))).collect()
    };
    if translations.len() != rotations.len() {
        let (translations, rotations) = (translations.len(), rotations.len());
        return Err(PyValueError::new_err(format!(
            "{translations} translations and {rotations} rotations; give as many"
        )));
    }
    let poses = translations.into_iter().zip(rotations);
    let poses = poses.map(|(t, rotation)| Pose { rotation, translation_m: DVec3::from_array(t) });
    let poses: Vec<Pose> = poses.collect();
    match poses.iter().position(|pose| !pose.is_finite()) {
        Some(row) => Err(PyValueError::new_err(format!("the pose of row {row} is not finite; give numbers"))),
        None => Ok(poses),
    }
}

fn unit(name: &str, row: usize, xyzw: [f64; 4]) -> PyResult<DQuat> {
    let quaternion = DQuat::from_array(xyzw);
    if (quaternion.length() - 1.0).abs() <= ROUNDING {
        return Ok(quaternion.normalize());
    }
    let length = quaternion.length();
    Err(PyValueError::new_err(format!("{name} of row {row} has the length {length}; give unit quaternions x, y, z, w")))
}

fn rows_of<const N: usize>(name: &str, array: &PyReadonlyArray2<'_, f64>) -> PyResult<Vec<[f64; N]>> {
    let array = array.as_array();
    if array.ncols() != N {
        let shape = array.shape();
        return Err(PyValueError::new_err(format!("{name} has the shape {shape:?}; give ({}, {N})", shape[0])));
    }
    Ok(array.rows().into_iter().map(|row| std::array::from_fn(|k| row[k])).collect())
}
