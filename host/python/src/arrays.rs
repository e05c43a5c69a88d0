//! Columns that become numpy arrays; rotation vectors and quaternions, as the command computes them.

use glam::{DQuat, DVec3};
use numpy::{Element, IntoPyArray, PyArray, PyArray2, PyArrayMethods, PyReadonlyArray2};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use slitpose_model::{AXES, Pose, rotation_exp, rotation_log};
use slitpose_tracking::columns::{COLUMNS, Column, Get, Row};
use slitpose_tracking::link::DeviceId;

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

/// The number of a board among `devices`, to which it is added if it is new.
pub(crate) fn number_in(devices: &mut Vec<DeviceId>, device: DeviceId) -> u8 {
    let number = devices.iter().position(|known| *known == device).unwrap_or_else(|| {
        devices.push(device);
        devices.len() - 1
    });
    number as u8
}

/// Quantities of a filter: arrays only where there is one.
const FILTERED: &str = "filtered.";

/// The array of a quantity; several of them that have one name are side by side in it. `None`: others say it.
pub(crate) fn array_name(column: &Column) -> Option<String> {
    let of_key = || {
        let key = [".linear_m_per_s", ".angular_rad_per_s"].iter().find_map(|end| column.key.strip_suffix(end));
        key.unwrap_or(column.key).replace('.', "_")
    };
    match (column.get, column.name) {
        // All poses of a replay are in one frame.
        (Get::Correlation(_), _) | (_, "frame") => None,
        (_, "seq") => Some("sequence".to_owned()),
        (_, "device_time_s") => Some("time_s".to_owned()),
        _ if column.names().len() > 1 => Some(of_key()),
        (_, name) => Some(name.to_owned()),
    }
}

/// All arrays: name, unit, meaning, and the words that its numbers stand for.
pub(crate) fn listed() -> Vec<(String, &'static str, &'static str, Vec<&'static str>)> {
    let words = |column: &Column| match column.get {
        Get::Word(words, _) => words(),
        _ => Vec::new(),
    };
    let named = COLUMNS.iter().filter_map(|column| Some((array_name(column)?, column)));
    let mut listed: Vec<_> = named.map(|(name, column)| (name, column.unit, column.meaning, words(column))).collect();
    // Of those side by side in one array, the first.
    listed.dedup_by(|next, before| next.0 == before.0);
    listed
}

/// What a row lacks is NaN, or zero among whole numbers.
enum Values {
    /// With the words that the numbers stand for, if they do.
    Bytes(Vec<u8>, Vec<&'static str>),
    Counts(Vec<u16>),
    Integers(Vec<u64>),
    Numbers(Vec<f64>, Vec<usize>),
    Flags(Vec<bool>),
}

struct Array {
    name: String,
    columns: Vec<&'static Column>,
    values: Values,
}

impl Array {
    /// The arrays of solutions, or of a stream.
    fn all(is_stream: bool) -> Vec<Self> {
        let mut arrays = Vec::<Self>::new();
        for column in COLUMNS.iter().filter(|column| is_stream || !column.is_of_stream) {
            let Some(name) = array_name(column) else { continue };
            match arrays.last_mut().filter(|before| before.name == name) {
                Some(Self { columns, values: Values::Numbers(_, shape), .. }) => {
                    shape[0] += 3;
                    columns.push(column);
                }
                _ => arrays.push(Self { name, columns: vec![column], values: Values::of(column) }),
            }
        }
        arrays
    }

    fn is_filtered(&self) -> bool {
        self.columns[0].key.starts_with(FILTERED)
    }

    fn push(&mut self, row: &Row<'_>, devices: &mut Vec<DeviceId>) {
        for column in &self.columns {
            match (&mut self.values, column.get) {
                (Values::Bytes(values, words), Get::Word(_, get)) => {
                    let word = get(row);
                    values.push(words.iter().position(|known| *known == word).unwrap_or(0) as u8);
                }
                (Values::Bytes(values, _), Get::Device(get)) => values.push(number_in(devices, get(row))),
                (Values::Bytes(values, _), Get::Directions(get)) => {
                    let bit = |name| AXES.iter().position(|axis| *axis == name).map_or(0, |axis| 1 << axis);
                    values.push(get(row).names().map(bit).fold(0, |set, bit| set | bit));
                }
                (Values::Counts(values), Get::Count(get)) => values.push(get(row) as u16),
                (Values::Counts(values), Get::Cells(get)) => values.push(get(row).bits()),
                (Values::Integers(values), Get::Integer(get)) => values.push(get(row).unwrap_or(0)),
                (Values::Flags(values), Get::Flag(get)) => values.push(get(row)),
                (Values::Numbers(values, _), Get::Number(get)) => values.push(get(row).unwrap_or(f64::NAN)),
                (
                    Values::Numbers(values, _),
                    Get::Translation(get) | Get::Velocity(get) | Get::AngularVelocity(get),
                ) => {
                    values.extend(get(row).map_or([f64::NAN; 3], |v| v.to_array()));
                }
                (Values::Numbers(values, _), Get::Rotation(get)) => {
                    values.extend(get(row).map_or([f64::NAN; 4], |r| r.to_array()));
                }
                (Values::Numbers(values, _), Get::TwistSigma(get)) => {
                    values.extend(get(row).unwrap_or([f64::NAN; 6]));
                }
                (Values::Numbers(values, _), Get::Covariance(get)) => put_matrix(values, get(row).copied()),
                _ => unreachable!("values are those of their columns"),
            }
        }
    }

    fn put(self, columns: &Columns<'_>) -> PyResult<()> {
        match self.values {
            Values::Bytes(values, _) => columns.put(&self.name, values),
            Values::Counts(values) => columns.put(&self.name, values),
            Values::Integers(values) => columns.put(&self.name, values),
            Values::Flags(values) => columns.put(&self.name, values),
            Values::Numbers(values, shape) => columns.put_shaped(&self.name, values, &shape),
        }
    }
}

impl Values {
    fn of(column: &Column) -> Self {
        let numbers = |shape: &[usize]| Self::Numbers(Vec::new(), shape.to_vec());
        match column.get {
            Get::Word(words, _) => Self::Bytes(Vec::new(), words()),
            Get::Device(_) | Get::Directions(_) => Self::Bytes(Vec::new(), Vec::new()),
            Get::Count(_) | Get::Cells(_) => Self::Counts(Vec::new()),
            Get::Integer(_) => Self::Integers(Vec::new()),
            Get::Flag(_) => Self::Flags(Vec::new()),
            Get::Number(_) => numbers(&[]),
            Get::Translation(_) | Get::Velocity(_) | Get::AngularVelocity(_) => numbers(&[3]),
            Get::Rotation(_) => numbers(&[4]),
            Get::TwistSigma(_) => numbers(&[6]),
            Get::Covariance(_) | Get::Correlation(_) => numbers(&[6, 6]),
        }
    }
}

/// Poses, one a row.
pub(crate) struct PoseArrays {
    arrays: Vec<Array>,
    pub(crate) rows: usize,
    is_filtered: bool,
}

impl PoseArrays {
    pub(crate) fn new(is_stream: bool) -> Self {
        Self { arrays: Array::all(is_stream), rows: 0, is_filtered: false }
    }

    pub(crate) fn push(&mut self, row: &Row<'_>, devices: &mut Vec<DeviceId>) {
        let Self { arrays, rows, is_filtered } = self;
        if !*is_filtered && row.record.is_some_and(|record| record.filtered.is_some()) {
            *is_filtered = true;
            let unfiltered = Row { record: None, ..*row };
            let filtered = arrays.iter_mut().filter(|array| array.is_filtered());
            filtered.for_each(|array| (0..*rows).for_each(|_| array.push(&unfiltered, devices)));
        }
        let arrays = arrays.iter_mut().filter(|array| *is_filtered || !array.is_filtered());
        arrays.for_each(|array| array.push(row, devices));
        *rows += 1;
    }

    pub(crate) fn put(self, columns: &Columns<'_>) -> PyResult<()> {
        let is_filtered = self.is_filtered;
        let mut arrays = self.arrays.into_iter().filter(|array| is_filtered || !array.is_filtered());
        arrays.try_for_each(|array| array.put(columns))
    }
}

pub(crate) fn put_matrix(values: &mut Vec<f64>, matrix: Option<[[f64; 6]; 6]>) {
    values.extend(matrix.unwrap_or([[f64::NAN; 6]; 6]).as_flattened());
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
