//! Scenes: currents of poses, poses of currents, bounds and pictures.

use std::path::PathBuf;

use glam::DVec3;
use numpy::{PyReadonlyArray1, PyReadonlyArray2, PyReadonlyArray3};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use slitpose_calibration::Head;
use slitpose_design::map::Outlook;
use slitpose_design::plot::{cell_picture, scene_picture};
use slitpose_head::scene_file::SceneFile;
use slitpose_model::{Cell, CompiledScene, Pair, Pose, Status, Tier};
use slitpose_tracking::frame::View;
use slitpose_tracking::solving::{MODEL_TOLERANCE, RowSolver, STREAM_TOLERANCE};

use crate::arrays::{Columns, PoseArrays, poses, put_matrix};
use crate::calibration::Calibration;
use crate::work::{beside, each_piece, each_row, raised, tier_choice};

/// The numbers of a cell's status.
pub(crate) const CELL_STATUSES: [Status; 4] = [Status::Lit, Status::Clipped, Status::Dark, Status::Behind];

/// More than a picture can show.
const PICTURE_TOLERANCE: f64 = 1e-6;

/// A head as its scene says, or as a calibration found it.
#[pyclass(module = "slitpose._native")]
pub(crate) struct Scene {
    file: SceneFile,
    /// The calibrated head, or as the scene says.
    head: Head,
}

#[pymethods]
impl Scene {
    /// The scene of a file, or the shipped one of this name.
    #[staticmethod]
    fn open(name: &str) -> PyResult<Self> {
        Ok(Self::of(SceneFile::open(name).map_err(raised)?))
    }

    /// The scene of this text; `origin` names it in messages.
    #[staticmethod]
    fn from_toml(text: &str, origin: &str) -> PyResult<Self> {
        Ok(Self::of(SceneFile::parse(origin, text).map_err(raised)?))
    }

    /// The head of this scene by a calibration.
    fn with_calibration(&self, calibration: &Calibration) -> PyResult<Self> {
        let head = Head::calibrated(self.file.clone(), calibration.0.clone()).map_err(raised)?;
        Ok(Self { file: self.file.clone(), head })
    }

    #[getter]
    fn name(&self) -> &str {
        &self.file.name
    }

    #[getter]
    fn origin(&self) -> &str {
        &self.file.origin
    }

    #[getter]
    fn toml(&self) -> &str {
        &self.file.source
    }

    #[getter]
    fn hash(&self) -> u64 {
        self.file.hash
    }

    #[getter]
    fn cells(&self) -> usize {
        self.file.scene.cells.len()
    }

    #[getter]
    fn is_calibrated(&self) -> bool {
        self.head.calibration().is_some()
    }

    /// The text of the calibration, if there is one.
    #[getter]
    fn calibration(&self) -> Option<&str> {
        self.head.calibration().map(|calibration| calibration.source())
    }

    /// Half extents of the workspace: metres, and radians of the rotation vector.
    #[getter]
    fn workspace(&self) -> ([f64; 3], [f64; 3]) {
        let workspace = self.file.workspace;
        (workspace.half_extent_m.to_array(), workspace.half_extent_rad.to_array())
    }

    /// Where detector, slit and emitter of each cell are with the tool at home: metres and radians, a row per cell;
    /// detectors and slits in the base frame and the cell's own, emitters in the tool frame.
    fn geometry<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let cells = &self.head.file.scene.cells;
        let columns = Columns::new(py, cells.len());
        let vectors = |of: fn(&Cell) -> DVec3| cells.iter().flat_map(|cell| of(cell).to_array()).collect();
        columns.put_shaped("detector_m", vectors(|cell| cell.detector.centre_base_m), &[3])?;
        columns.put_shaped("x_axis", vectors(|cell| cell.detector.x_axis_base), &[3])?;
        columns.put_shaped("normal", vectors(|cell| cell.detector.normal_base), &[3])?;
        columns.put_shaped(
            "active_area_m",
            pairs(cells, |cell| [cell.detector.length_m, cell.detector.width_m]),
            &[2],
        )?;
        columns.put("slit_distance_m", cells.iter().map(|cell| cell.slit.distance_m).collect())?;
        columns.put_shaped("slit_m", pairs(cells, |cell| [cell.slit.width_m, cell.slit.length_m]), &[2])?;
        columns.put_shaped("slit_offset_m", pairs(cells, |cell| cell.slit.offset_m.to_array()), &[2])?;
        columns.put_shaped("slit_tilt_rad", vectors(|cell| cell.slit.tilt_rad), &[3])?;
        columns.put("mask_thickness_m", cells.iter().map(|cell| cell.slit.thickness_m).collect())?;
        columns.put_shaped("emitter_m", vectors(|cell| cell.emitter.position_tool_m), &[3])?;
        columns.put_shaped("emitter_axis", vectors(|cell| cell.emitter.axis_tool), &[3])?;
        let openings: Vec<String> = cells.iter().map(|cell| cell.opening().to_string()).collect();
        columns.dict.set_item("opening", openings)?;
        Ok(columns.dict)
    }

    /// Poses spread evenly over the workspace.
    fn workspace_poses<'py>(&self, py: Python<'py>, count: usize) -> PyResult<Bound<'py, PyDict>> {
        let poses: Vec<Pose> = self.file.workspace.poses(count).collect();
        let columns = Columns::new(py, poses.len());
        let flat = |part: fn(&Pose) -> DVec3| poses.iter().flat_map(|pose| part(pose).to_array()).collect();
        columns.put_shaped("translation_m", flat(|pose| pose.translation_m), &[3])?;
        columns.put_shaped("rotation_rad", flat(Pose::rotation_rad), &[3])?;
        Ok(columns.dict)
    }

    /// Currents and spots of every cell at poses.
    #[pyo3(signature = (translation_m, rotation, tier=None, tolerance=None))]
    fn model<'py>(
        &self,
        py: Python<'py>,
        translation_m: PyReadonlyArray2<'py, f64>,
        rotation: PyReadonlyArray2<'py, f64>,
        tier: Option<&str>,
        tolerance: Option<f64>,
    ) -> PyResult<Bound<'py, PyDict>> {
        let poses = poses(&translation_m, &rotation)?;
        let tier = tier_choice(tier, tolerance)?.tier(MODEL_TOLERANCE);
        let (cells, rows) = self.of_each_cell(py, &poses, tier, CompiledScene::respond)?;
        let all = || rows.iter().flatten();
        let columns = Columns::new(py, rows.len());
        let per_cell = [cells];
        let pairs = all().flat_map(|response| [response.currents.i_x1_a, response.currents.i_x2_a]).collect();
        columns.put_shaped("currents_a", pairs, &[cells, 2])?;
        columns.put_shaped("i_o_a", all().map(|response| response.i_o_a).collect(), &per_cell)?;
        columns.put_shaped("x_a_m", all().map(|response| response.x_a_m.unwrap_or(f64::NAN)).collect(), &per_cell)?;
        columns.put_shaped("solid_angle_sr", all().map(|response| response.solid_angle_sr).collect(), &per_cell)?;
        columns.put_shaped("status", all().map(|response| number_of(response.status)).collect(), &per_cell)?;
        let flags = |response: &slitpose_model::Response<f64>| {
            let flags = response.flags;
            u8::from(flags.saturated) | u8::from(flags.faint) << 1 | u8::from(flags.facing_away) << 2
        };
        columns.put_shaped("flags", all().map(flags).collect(), &per_cell)?;
        let error = |response: &slitpose_model::Response<f64>| match response.integration {
            Some(integration) => integration.relative_error,
            None => f64::NAN,
        };
        columns.put_shaped("relative_error", all().map(error).collect(), &per_cell)?;
        columns.dict.set_item(
            "tolerance",
            match tier {
                Tier::Exact { tolerance } => Some(tolerance),
                Tier::Paper => None,
            },
        )?;
        Ok(columns.dict)
    }

    /// Currents above dark and their derivatives with respect to the pose.
    #[pyo3(signature = (translation_m, rotation, tier=None, tolerance=None))]
    fn derivatives<'py>(
        &self,
        py: Python<'py>,
        translation_m: PyReadonlyArray2<'py, f64>,
        rotation: PyReadonlyArray2<'py, f64>,
        tier: Option<&str>,
        tolerance: Option<f64>,
    ) -> PyResult<Bound<'py, PyDict>> {
        let poses = poses(&translation_m, &rotation)?;
        let tier = tier_choice(tier, tolerance)?.tier(MODEL_TOLERANCE);
        let (cells, rows) = self.of_each_cell(py, &poses, tier, CompiledScene::linearise)?;
        let all = || rows.iter().flatten();
        let columns = Columns::new(py, rows.len());
        columns.put_shaped("status", all().map(|(status, ..)| number_of(*status)).collect(), &[cells])?;
        let pairs = all().flat_map(|(_, pair, _)| [pair.i_x1_a, pair.i_x2_a]).collect();
        columns.put_shaped("photocurrents_a", pairs, &[cells, 2])?;
        let jacobians = all().flat_map(|(.., jacobian)| jacobian.as_flattened()).copied().collect();
        columns.put_shaped("derivatives", jacobians, &[cells, 2, 6])?;
        Ok(columns.dict)
    }

    /// The pose behind each row of currents, each from a cold start.
    #[pyo3(signature = (currents_a, frames=None, tier=None, tolerance=None, without_clipped=false, frame=None, tip=None))]
    #[expect(clippy::too_many_arguments, reason = "keywords of Python")]
    fn solve<'py>(
        &self,
        py: Python<'py>,
        currents_a: PyReadonlyArray3<'py, f64>,
        frames: Option<PyReadonlyArray1<'py, f64>>,
        tier: Option<&str>,
        tolerance: Option<f64>,
        without_clipped: bool,
        frame: Option<&str>,
        tip: Option<&str>,
    ) -> PyResult<Bound<'py, PyDict>> {
        let view = View::open(frame, tip).map_err(raised)?;
        let (currents, cells) = (currents_a.as_array(), self.cells());
        let &[rows, found_cells, electrodes] = currents.shape() else { unreachable!("three dimensions") };
        if (found_cells, electrodes) != (cells, 2) {
            let text = format!(
                "currents_a has the shape {:?}; the scene has {cells} cells: give ({rows}, {cells}, 2)",
                currents.shape()
            );
            return Err(PyValueError::new_err(text));
        }
        let frames: Vec<f64> = match frames {
            Some(frames) => frames.as_array().iter().copied().collect(),
            None => vec![1.0; rows],
        };
        if frames.len() != rows {
            return Err(PyValueError::new_err(format!(
                "{} numbers of frames for {rows} rows; give one for each",
                frames.len()
            )));
        }
        if let Some((row, value)) =
            frames.iter().enumerate().find(|(_, frames)| !(**frames >= 1.0 && frames.is_finite()))
        {
            return Err(PyValueError::new_err(format!("frames[{row}] = {value}; give a number of frames, 1 or more")));
        }
        let pair = |row: usize, cell: usize| {
            let [i_x1_a, i_x2_a] = [0, 1].map(|electrode| currents[[row, cell, electrode]]);
            Some(Pair { i_x1_a, i_x2_a }).filter(|pair| pair.i_x1_a.is_finite() && pair.i_x2_a.is_finite())
        };
        let tier = tier_choice(tier, tolerance)?.tier(STREAM_TOLERANCE);
        let head = beside(py, |_| self.solving_head())??;
        let solver = beside(py, |_| RowSolver::new(head, tier, without_clipped))?.map_err(raised)?;
        let mut distinct = frames.clone();
        distinct.sort_by(f64::total_cmp);
        distinct.dedup();
        let mut solutions = vec![None; rows];
        for of in distinct {
            let wanted: Vec<usize> = (0..rows).filter(|row| frames[*row].to_bits() == of.to_bits()).collect();
            let ready = solver.with_frames(of).map_err(raised)?;
            let found = each_piece(py, wanted.len(), |piece| {
                piece.map(|at| ready.solve(&ready.readings((0..cells).map(|cell| pair(wanted[at], cell))))).collect()
            })?;
            wanted.into_iter().zip(found).for_each(|(row, solution)| solutions[row] = Some(solution));
        }
        let mut found = PoseArrays::new(false);
        solutions.iter_mut().flatten().for_each(|solution| view.iter().for_each(|view| view.apply(solution)));
        solutions.iter().flatten().for_each(|solution| found.push(&solution.into(), &mut Vec::new()));
        let columns = Columns::new(py, found.rows);
        found.put(&columns)?;
        Ok(columns.dict)
    }

    /// What a single frame is worth at poses.
    fn crlb<'py>(
        &self,
        py: Python<'py>,
        translation_m: PyReadonlyArray2<'py, f64>,
        rotation: PyReadonlyArray2<'py, f64>,
    ) -> PyResult<Bound<'py, PyDict>> {
        let poses = poses(&translation_m, &rotation)?;
        let outlook = beside(py, |_| Outlook::of(self.head.clone()))?.map_err(raised)?;
        let views = each_row(py, poses.len(), |row| outlook.at(&poses[row]))?;
        let columns = Columns::new(py, views.len());
        let sigma = views.iter().flat_map(|view| view.sigma.unwrap_or([f64::NAN; 6])).collect();
        columns.put_shaped("sigma", sigma, &[6])?;
        let mut covariance = Vec::with_capacity(36 * views.len());
        views.iter().for_each(|view| put_matrix(&mut covariance, view.covariance));
        columns.put_shaped("covariance", covariance, &[6, 6])?;
        columns.put("lit", views.iter().map(|view| view.lit as u16).collect())?;
        columns.put("condition", views.iter().map(|view| view.condition.unwrap_or(f64::NAN)).collect())?;
        columns.put("unnoticed_sigmas", views.iter().map(|view| view.unnoticed_sigmas).collect())?;
        columns.put("full_scale", views.iter().map(|view| view.full_scale).collect())?;
        columns.put("saturation", views.iter().map(|view| view.saturation).collect())?;
        columns.put("faint", views.iter().map(|view| view.faint).collect())?;
        Ok(columns.dict)
    }

    /// A picture of the head, or of one cell, as SVG.
    #[pyo3(signature = (translation_m, rotation, cell=None))]
    fn plot(
        &self,
        py: Python<'_>,
        translation_m: PyReadonlyArray2<'_, f64>,
        rotation: PyReadonlyArray2<'_, f64>,
        cell: Option<usize>,
    ) -> PyResult<String> {
        let poses = poses(&translation_m, &rotation)?;
        let [pose] = poses.as_slice() else {
            return Err(PyValueError::new_err(format!("{} poses; a picture shows one", poses.len())));
        };
        let file = &self.head.file;
        let tier = Tier::Exact { tolerance: PICTURE_TOLERANCE };
        let plan = beside(py, |_| CompiledScene::<f64>::compile(&file.scene, tier))?.map_err(raised)?;
        match cell {
            None => Ok(scene_picture(&file.name, &file.scene, &plan, pose)),
            Some(number) => match file.scene.cells.get(number) {
                Some(cell) => Ok(cell_picture(&file.name, number, cell, &plan, pose)),
                None => {
                    let last = self.cells() - 1;
                    Err(PyValueError::new_err(format!("cell = {number}; the scene has the cells 0 to {last}")))
                }
            },
        }
    }
}

impl Scene {
    /// What `compute` says of each cell at each pose, a row a pose; and the number of cells.
    fn of_each_cell<T: Send>(
        &self,
        py: Python<'_>,
        poses: &[Pose],
        tier: Tier,
        compute: fn(&CompiledScene<f64>, usize, &Pose) -> T,
    ) -> PyResult<(usize, Vec<Vec<T>>)> {
        let plan = beside(py, |_| CompiledScene::<f64>::compile(&self.head.file.scene, tier))?.map_err(raised)?;
        let cells = self.cells();
        let of_row = |row: usize| (0..cells).map(|cell| compute(&plan, cell, &poses[row])).collect();
        Ok((cells, each_row(py, poses.len(), of_row)?))
    }

    fn of(file: SceneFile) -> Self {
        Self { head: file.clone().into(), file }
    }

    pub(crate) fn file(&self) -> &SceneFile {
        &self.file
    }

    /// For readings of a real head: by the calibration, else by the tolerances of the scene, if it has any.
    fn solving_head(&self) -> PyResult<Head> {
        match self.head.calibration() {
            Some(_) => Ok(self.head.clone()),
            None => Head::as_scene_says(self.file.clone()).map_err(raised),
        }
    }
}

fn pairs(cells: &[Cell], of: impl Fn(&Cell) -> [f64; 2]) -> Vec<f64> {
    cells.iter().flat_map(of).collect()
}

fn number_of(status: Status) -> u8 {
    CELL_STATUSES.iter().position(|known| *known == status).map_or(0, |at| at as u8)
}

/// Paths as text, as tables and captures are named.
pub(crate) fn texts(paths: Vec<PathBuf>) -> Vec<String> {
    paths.into_iter().map(|path| path.display().to_string()).collect()
}
