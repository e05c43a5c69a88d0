//! Calibrations: found from measurements, read and checked.

use std::ops::ControlFlow;
use std::path::PathBuf;
use std::sync::atomic::Ordering;

use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use slitpose_calibration as adjustment;
use slitpose_calibration::{Frames, Request, Statistics, validity};
use slitpose_tracking::measurements::Measurements;

use crate::scene::{Scene, texts};
use crate::work::{beside, raised};

/// The parameters of one head.
#[pyclass(module = "slitpose._native", frozen)]
pub(crate) struct Calibration(pub(crate) adjustment::Calibration);

#[pymethods]
impl Calibration {
    /// The calibration of a file.
    #[staticmethod]
    fn open(path: PathBuf) -> PyResult<Self> {
        adjustment::Calibration::open(&path).map(Self).map_err(raised)
    }

    /// The calibration of this text; `origin` names it in messages.
    #[staticmethod]
    fn from_toml(text: &str, origin: &str) -> PyResult<Self> {
        adjustment::Calibration::from_bytes(origin, text.as_bytes()).map(Self).map_err(raised)
    }

    #[getter]
    fn id(&self) -> &str {
        &self.0.id
    }

    #[getter]
    fn date(&self) -> Option<&str> {
        self.0.date.as_deref()
    }

    #[getter]
    fn toml(&self) -> &str {
        self.0.source()
    }

    #[getter]
    fn weak(&self) -> Vec<String> {
        self.0.weak.clone()
    }

    /// How well the data fit.
    #[getter]
    fn statistics<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let Statistics {
            rows,
            readings,
            readings_rejected,
            poses_rejected,
            chi2,
            redundancy,
            held_out_m,
            held_out_rad,
        } = self.0.statistics;
        let dict = PyDict::new(py);
        dict.set_item("rows", rows)?;
        dict.set_item("readings", readings)?;
        dict.set_item("readings_rejected", readings_rejected)?;
        dict.set_item("poses_rejected", poses_rejected)?;
        dict.set_item("chi2", chi2)?;
        dict.set_item("redundancy", redundancy)?;
        dict.set_item("held_out_m", held_out_m)?;
        dict.set_item("held_out_rad", held_out_rad)?;
        Ok(dict)
    }

    /// Of each parameter: cell, or None if all share it; quantity; prior, its σ, value, its σ.
    #[getter]
    fn parameters(&self) -> Vec<(Option<usize>, String, f64, f64, f64, f64)> {
        let row = |entry: &adjustment::Parameter| {
            let quantity = entry.quantity.to_string();
            (entry.cell, quantity, entry.prior, entry.prior_sigma, entry.value, entry.sigma)
        };
        self.0.parameters().iter().map(row).collect()
    }

    /// Of each instrument: its file, `base_from_reference`, σ, `tool_from_marker`, σ.
    #[getter]
    #[expect(clippy::type_complexity, reason = "a row for Python")]
    fn frames(&self) -> Vec<(String, [f64; 6], [f64; 6], [f64; 6], [f64; 6])> {
        let row = |frames: &Frames| {
            let (base, tool) = (frames.base_from_reference, frames.tool_from_marker);
            (frames.file.clone(), base, frames.base_from_reference_sigma, tool, frames.tool_from_marker_sigma)
        };
        self.0.frames.iter().map(row).collect()
    }

    /// Whether it still describes the head that gave readings of free motion.
    fn check<'py>(&self, py: Python<'py>, readings: Vec<PathBuf>) -> PyResult<Bound<'py, PyDict>> {
        let mut remarks = Vec::new();
        let found = beside(py, |_| {
            let file = self.0.scene_file().map_err(raised)?;
            let scene = self.0.apply(&file).map_err(raised)?;
            let measurements = Measurements { free: texts(readings), ..Measurements::default() };
            let data = measurements.read(&file, &mut |remark| remarks.push(remark.to_owned())).map_err(raised)?;
            validity(&scene, data.noise.or(scene.noise), &data.rows).map_err(raised)
        })??;
        let dict = PyDict::new(py);
        dict.set_item("rows", found.rows)?;
        dict.set_item("chi2", found.chi2)?;
        dict.set_item("light_level", found.light_level)?;
        dict.set_item("is_valid", found.is_valid)?;
        dict.set_item("changed", found.changed)?;
        let cells = found
            .cells
            .iter()
            .map(|cell| (cell.readings, cell.relative, cell.position_m, cell.rms_position_m, cell.without));
        dict.set_item("cells", cells.collect::<Vec<_>>())?;
        dict.set_item("remarks", remarks)?;
        Ok(dict)
    }
}

/// The calibration of the head of `scene` by measurements on it, and remarks.
#[pyfunction]
#[pyo3(signature = (scene, *, known, free, pivot, stage, rest, own_frames, known_sigma_m,
    known_sigma_rad, start=None, date=None))]
#[expect(clippy::too_many_arguments, reason = "keywords of Python")]
pub(crate) fn calibrate(
    py: Python<'_>,
    scene: &Scene,
    known: Vec<PathBuf>,
    free: Vec<PathBuf>,
    pivot: Vec<PathBuf>,
    stage: Vec<PathBuf>,
    rest: Vec<PathBuf>,
    own_frames: bool,
    known_sigma_m: f64,
    known_sigma_rad: f64,
    start: Option<&Calibration>,
    date: Option<&str>,
) -> PyResult<(Calibration, Vec<String>)> {
    for (name, sigma) in [("known_sigma_m", known_sigma_m), ("known_sigma_rad", known_sigma_rad)] {
        if !(sigma > 0.0 && sigma < 1.0) {
            return Err(PyValueError::new_err(format!(
                "{name} = {sigma}; give a number between 0 and 1, such as 2e-6"
            )));
        }
    }
    let measurements = Measurements {
        known: texts(known),
        free: texts(free),
        pivot: texts(pivot),
        stage: texts(stage),
        rest: texts(rest),
        has_own_frames: own_frames,
        known_sigmas: Some([known_sigma_m, known_sigma_rad]),
    };
    let (file, start) = (scene.file(), start.map(|start| &start.0));
    let mut remarks = Vec::new();
    let found = beside(py, |stop| {
        let data = measurements.read(file, &mut |remark| remarks.push(remark.to_owned())).map_err(raised)?;
        let request = Request { file, data: &data, start, date };
        let mut go_on =
            |_| if stop.load(Ordering::Relaxed) { ControlFlow::Break(()) } else { ControlFlow::Continue(()) };
        adjustment::calibrate(&request, &mut go_on).map_err(raised)
    })??;
    remarks.extend(found.remarks);
    Ok((Calibration(found.calibration), remarks))
}
