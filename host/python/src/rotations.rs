//! Rotation vectors and quaternions, as the command computes them.

use glam::{DQuat, DVec3};
use numpy::{PyArray2, PyReadonlyArray2};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use slitpose_model::{Pose, rotation_exp, rotation_log};

use crate::arrays::matrix;

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

/// Rows of `N` numbers.
fn rows_of<const N: usize>(name: &str, array: &PyReadonlyArray2<'_, f64>) -> PyResult<Vec<[f64; N]>> {
    let array = array.as_array();
    if array.ncols() != N {
        let shape = array.shape();
        return Err(PyValueError::new_err(format!("{name} has the shape {shape:?}; give ({}, {N})", shape[0])));
    }
    Ok(array.rows().into_iter().map(|row| std::array::from_fn(|k| row[k])).collect())
}
