//! Errors as exceptions.

use std::error::Error;

use pyo3::exceptions::{PyException, PyValueError};
use pyo3::{PyErr, create_exception};
use slitpose::solving::{TierName, TierOptions, is_tolerance};
use slitpose_head::causes::with_causes;

create_exception!(slitpose, SlitposeError, PyException, "What cannot be done, why, and the next step.");

/// The exception of an error, with the errors behind it.
pub(crate) fn raised(error: impl Error) -> PyErr {
    SlitposeError::new_err(with_causes(&error))
}

/// The tier by its name and tolerance.
pub(crate) fn tier_options(tier: Option<&str>, tolerance: Option<f64>) -> Result<TierOptions, PyErr> {
    let tier = match tier {
        None => None,
        Some("paper") => Some(TierName::Paper),
        Some("exact") => Some(TierName::Exact),
        Some(other) => return Err(PyValueError::new_err(format!("tier = {other:?}; give \"paper\" or \"exact\""))),
    };
    match tolerance.filter(|tolerance| !is_tolerance(*tolerance)) {
        Some(other) => {
            Err(PyValueError::new_err(format!("tolerance = {other}; give a number between 0 and 1, such as 1e-10")))
        }
        None => Ok(TierOptions { tier, tolerance }),
    }
}

/// A number of seconds that is not below zero.
pub(crate) fn seconds(name: &str, value: Option<f64>) -> Result<(), PyErr> {
    match value.filter(|value| !(*value >= 0.0 && value.is_finite())) {
        Some(other) => Err(PyValueError::new_err(format!("{name} = {other}; give seconds, 0 or more"))),
        None => Ok(()),
    }
}
