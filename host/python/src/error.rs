//! Errors as exceptions.

use std::error::Error;

use pyo3::exceptions::{PyException, PyValueError};
use pyo3::{PyErr, create_exception};
use slitpose_head::causes::with_causes;
use slitpose_tracking::solving::{TierChoice, is_tolerance};

create_exception!(slitpose, SlitposeError, PyException, "What cannot be done, why, and the next step.");

/// The exception of an error, with the errors behind it.
pub(crate) fn raised(error: impl Error) -> PyErr {
    SlitposeError::new_err(with_causes(&error))
}

/// The tier by its name and tolerance.
pub(crate) fn tier_choice(tier: Option<&str>, tolerance: Option<f64>) -> Result<TierChoice, PyErr> {
    if let Some(other) = tolerance.filter(|tolerance| !is_tolerance(*tolerance)) {
        let text = format!("tolerance = {other}; give a number between 0 and 1, such as 1e-10");
        return Err(PyValueError::new_err(text));
    }
    match tier {
        None if tolerance.is_none() => Ok(TierChoice::Usual),
        None | Some("exact") => Ok(TierChoice::Exact(tolerance)),
        Some("paper") => Ok(TierChoice::Paper),
        Some(other) => Err(PyValueError::new_err(format!("tier = {other:?}; give \"paper\" or \"exact\""))),
    }
}

/// A number of seconds that is not below zero.
pub(crate) fn seconds(name: &str, value: Option<f64>) -> Result<(), PyErr> {
    match value.filter(|value| !(*value >= 0.0 && value.is_finite())) {
        Some(other) => Err(PyValueError::new_err(format!("{name} = {other}; give seconds, 0 or more"))),
        None => Ok(()),
    }
}
