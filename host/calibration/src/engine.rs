//! From data to a calibration.

use std::ops::ControlFlow;

use nalgebra::DMatrix;
use slitpose_head::scene_file::SceneFile;
use slitpose_head::table::TableError;
use slitpose_model::{Scene, SceneError};
use thiserror::Error;

use crate::adjust::{Adjustment, FIRST_ERROR};
use crate::data::{self, Constraint, Data, Group};
use crate::discrepancy::Discrepancy;
use crate::light::LightTrend;
use crate::normal::Normal;
use crate::plausibility::Implausible;
use crate::pose_error::PoseError;
use crate::prior::Parameters;
use crate::reading::share;
use crate::start::{beginning, solved};
use crate::state::{State, Weights, residuals};
use crate::{
    Calibration, CalibrationFileError, Coverage, Frames, Residual, Statistics, findings, plausibility, prior,
    uncalibrated,
};

/// Rounds of adjustment and estimate of the model errors.
const ROUNDS: usize = 12;

/// How much larger the model errors of a cell are for a solver than the root mean square of its residuals, whose tail is
/// longer than a normal one's, even where they grow towards the ends of detectors
/// ([`slitpose_model::ModelError::reach`]). Of five heads at 200 poses, 2000 means of 100 frames: none is `converged`
/// beyond 8 σ (7.4), 3 leave a sound cell out or are a misfit (none with 1.6); errors are 0.84 σ rms (0.74 σ), of single
/// frames 0.97 σ.
const TAIL: f64 = 1.2;

/// Least reach: model errors at the end of a detector are then some hundred times those of its centre, as unknown as before.
const MIN_REACH: f64 = 0.3;

/// Readings of a cell from which on it is told how far from the centre of its detector they reach.
const MIN_REACH_READINGS: usize = 20;

/// Blocks of rows that are left out in turn.
const BLOCKS: usize = 4;

/// Fewest known poses for which errors of poses left out mean something.
const MIN_HELD_OUT: usize = 20;

/// Why there is no calibration.
#[derive(Debug, Error)]
#[allow(missing_docs, reason = "the texts say what each is")]
pub enum CalibrateError {
    #[error(transparent)]
    Scene(#[from] SceneError),
    #[error(transparent)]
    Start(#[from] CalibrationFileError),
    #[error(transparent)]
    Table(#[from] TableError),
    #[error("there is no row of readings; give at least one of --known, --free, --pivot, --stage, --rest with data")]
    NoRows,
    #[error("the scene's [tolerance] says that every part is known; raise the tolerances of the parts that are not")]
    NothingOpen,
    #[error("{0}: only {1} of {2} rows lead to a pose by {3}; {4}")]
    NoPoses(String, usize, usize, &'static str, &'static str),
    #[error(
        "no head within the tolerances explains these readings: an adjustment leaves {0} (usual: a few µm and 0.1 %); look for exchanged electrodes or cells, for readings of other instants, for exchanged or reversed axes of poses, at the kind of measurement that each file is, and at these cells in the scene, or take one out of both"
    )]
    ForeignCells(String),
    #[error(
        "{0}: {1} of {2} rows contradict the rest, and were left out as outliers: they are not what they are said to be; look at units (step_mm is in millimetres), at instants, and at the kind of measurement (--known, --pivot, --stage, --rest)"
    )]
    ForeignRows(String, usize, usize),
    #[error(
        "{0}: its poses err by {1}, {2:.0} times what is stated: they are not poses of this tool; look for axes of another order, direction or handedness, for rotations of the other sense, and for another marker, or state how coarse the instrument is (--known-sigma-um, --known-sigma-urad)"
    )]
    ForeignPoses(String, String, f64),
    #[error(
        "{0}: the tool moves too little to tell anything from; turn it by 10 degrees about two axes, and move it through its workspace"
    )]
    LittleMotion(String),
    #[error(transparent)]
    Implausible(#[from] Implausible),
    #[error("the normal equations are singular; give more rows, or smaller tolerances")]
    Singular,
}

/// What to calibrate with what.
#[derive(Clone, Copy, Debug)]
pub struct Request<'a> {
    /// The scene.
    pub file: &'a SceneFile,
    /// The measurements.
    pub data: &'a Data,
    /// An earlier result of the same scene, which stands in place of the tolerances.
    pub start: Option<&'a Calibration>,
    /// The day of the measurements.
    pub date: Option<&'a str>,
}

/// How far an adjustment is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Progress {
    /// Poses are estimated by the uncalibrated head.
    Starting,
    /// Round of so many; χ² per redundancy so far.
    Adjusting(usize, usize, f64),
    /// Block of so many that is left out.
    LeavingOut(usize, usize),
}

/// A calibration, and what it rests on.
#[derive(Debug)]
pub struct Calibrated {
    /// The result.
    pub calibration: Calibration,
    /// What is left between readings and model.
    pub residuals: Vec<Residual>,
    /// What was noticed on the way, with the next step.
    pub remarks: Vec<String>,
    /// Whether it was interrupted, and is the best so far.
    pub is_interrupted: bool,
}

/// The most probable parameters of the head of `request`, given its data.
///
/// `progress` is told how far the work is; a break ends it with the best so far.
///
/// ```
/// use slitpose_calibration::{Constraint, Data, Knowledge, Request, Row, calibrate, draw};
/// use slitpose_model::{CompiledScene, Tier};
/// // A head whose parts deviate within their tolerances, at 40 poses that an instrument knows to 2 um.
/// let (file, mut k) = (slitpose_head::scene_file::WIDE.read()?, 0.0_f64);
/// let (head, _) = draw(&file, || { k += 1.0; k.sin() })?;
/// let plan = CompiledScene::<f64>::compile(&head, Tier::Exact { tolerance: 1e-6 })?;
/// let row = |pose| {
///     let pair = |cell| { let pair = plan.photocurrents(cell, &pose); Some([pair.i_x1_a, pair.i_x2_a]) };
///     let readings = (0..plan.cell_count()).map(pair).collect();
///     Row { readings, knowledge: Knowledge::Reported(pose), ..Row::default() }
/// };
/// let mut data = Data::default();
/// data.add("poses.csv", Constraint::Known, [2e-6, 2e-4], file.workspace.poses(40).map(row).collect());
/// let request = Request { file: &file, data: &data, start: None, date: None };
/// let calibration = calibrate(&request, &mut |_| std::ops::ControlFlow::Continue(()))?.calibration;
/// assert_eq!((calibration.statistics.rows, calibration.statistics.poses_rejected), (40, 0));
/// assert!(calibration.statistics.held_out_m.expect("enough rows") < 20e-6, "{:?}", calibration.statistics);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub fn calibrate(
    request: &Request<'_>,
    progress: &mut dyn FnMut(Progress) -> ControlFlow<()>,
) -> Result<Calibrated, CalibrateError> {
    let Request { file, data, start, .. } = *request;
    if data.rows.is_empty() {
        return Err(CalibrateError::NoRows);
    }
    let (parameters, information) = before(file, start)?;
    if parameters.entries.is_empty() {
        return Err(CalibrateError::NothingOpen);
    }
    let _ = progress(Progress::Starting);
    let by_tolerances = uncalibrated(file)?;
    let (outliers, mut remarks) = plausibility::check(&by_tolerances, data)?;
    let kept = (!outliers.is_empty()).then(|| data.without(&outliers));
    let data = kept.as_ref().unwrap_or(data);
    let nominal = Scene { noise: data.noise.or(file.scene.noise), ..file.scene.clone() };
    // Cells are not trusted far at first.
    let errors = vec![FIRST_ERROR; file.scene.cells.len()];
    let started = start.map(|start| start.apply(file)).transpose()?;
    let (poses, unknowns) = beginning(started.as_ref().unwrap_or(&by_tolerances), start, data)?;
    let mut state = State::new(&nominal, parameters, data, poses, errors);
    state.unknowns = unknowns;
    let mut is_interrupted = false;
    let mut adjustment = Adjustment { prior: information, learns_sizes: start.is_none() };
    let mut normal = adjustment.minimise(&mut state, 4)?;
    let mut round = 1;
    loop {
        let Statistics { chi2, redundancy, .. } = adjustment.statistics(&state, &normal);
        if progress(Progress::Adjusting(round.min(ROUNDS), ROUNDS, chi2 / redundancy)).is_break() {
            is_interrupted = true;
            break;
        }
        let change = adjustment.round(&mut state, &mut normal)?;
        if change < 0.1 || round % ROUNDS == 0 {
            if !adjustment.adds_light(&mut state, &mut normal)? {
                break;
            }
            round = round.next_multiple_of(ROUNDS);
        }
        round += 1;
    }
    if !is_interrupted && let Err(error) = findings::require_agreement(&by_tolerances, &state, &normal.weights) {
        let likely = plausibility::likely_reading(&state.scene(), data)?.map(CalibrateError::Implausible);
        return Err(likely.unwrap_or(error));
    }
    remarks.extend(findings::remarks(&state, &normal.weights));
    let mut calibration = conclude(request, &adjustment, state.clone(), &normal)?;
    remarks.extend(calibration.light.iter().map(LightTrend::remark));
    remarks.extend(calibration.covered.as_ref().and_then(|covered| covered.remark(&file.workspace)));
    if !is_interrupted {
        is_interrupted =
            hold_out(&adjustment, &state, &normal.weights, &mut calibration.statistics, &mut remarks, progress)?;
    }
    calibration.write();
    let residuals = residuals(&state)?;
    Ok(Calibrated { calibration, residuals, remarks, is_interrupted })
}

/// Parameters, and the information of their prior in units of its σ.
fn before(file: &SceneFile, start: Option<&Calibration>) -> Result<(Parameters, DMatrix<f64>), CalibrateError> {
    let Some(start) = start else {
        let parameters = prior::parameters(file)?;
        let count = parameters.entries.len();
        return Ok((parameters, DMatrix::identity(count, count)));
    };
    start.require_scene(file)?;
    let mut parameters = start.parameters.clone();
    // The digits of the file are worth that much.
    let covariance = start.covariance(1.0 + 1e-3);
    let information = covariance.cholesky().ok_or(CalibrateError::Singular)?.inverse();
    for entry in &mut parameters.entries {
        entry.prior = entry.value;
    }
    Ok((parameters, information))
}

fn conclude(
    request: &Request<'_>,
    adjustment: &Adjustment,
    mut state: State<'_>,
    normal: &Normal,
) -> Result<Calibration, CalibrateError> {
    let (Request { file, date, .. }, data) = (*request, state.data);
    let by_noise = normal.covariance().ok_or(CalibrateError::Singular)?;
    let discrepancy = Discrepancy::of(adjustment, &state, normal, &file.workspace).ok_or(CalibrateError::Singular)?;
    let (pose_error, rest) = PoseError::of(&state, &by_noise, Some(&discrepancy), &file.workspace)?;
    let covariance = by_noise + discrepancy.covariance();
    let covered = Coverage::of(&state, &normal.weights, &covariance, &file.workspace)?;
    let statistics = adjustment.statistics(&state, normal);
    for (cell, (error, rest)) in state.model_errors.iter_mut().zip(rest).enumerate() {
        error.reach = reach(data, &normal.weights, cell);
        error.relative = libm::hypot(TAIL * error.relative, rest.relative);
        error.position_m = libm::hypot(TAIL * error.position_m, rest.position_m);
    }
    let count = state.parameters.entries.len();
    for (k, entry) in state.parameters.entries.iter_mut().enumerate() {
        entry.sigma = covariance[(k, k)].sqrt() * entry.prior_sigma;
    }
    let correlation = (0..count)
        .map(|i| (0..i).map(|j| covariance[(i, j)] / (covariance[(i, i)] * covariance[(j, j)]).sqrt()).collect())
        .collect();
    let has_own_frames = |(_, group): &(usize, &Group)| group.constraint == Constraint::KnownInOwnFrames;
    let frames_of = |(number, group): (usize, &Group)| {
        let part = |from: usize| std::array::from_fn(|k| state.unknowns[number][from + k]);
        let sigma = |from: usize| {
            std::array::from_fn(|k| {
                let place = state.first_unknown(number) + from + k;
                covariance[(place, place)].sqrt() * data::scale(group.constraint, from + k)
            })
        };
        Frames {
            file: group.file.clone(),
            base_from_reference: part(0),
            base_from_reference_sigma: sigma(0),
            tool_from_marker: part(6),
            tool_from_marker_sigma: sigma(6),
        }
    };
    let frames = data.groups.iter().enumerate().filter(has_own_frames).map(frames_of).collect();
    let weak = findings::weaknesses(&pose_error, &state.parameters.entries, &file.workspace, data);
    let mut calibration = Calibration {
        id: String::new(),
        date: date.map(str::to_owned),
        origin: "calibration".to_owned(),
        source: String::new(),
        hash: 0,
        scene_name: file.name.clone(),
        scene_source: file.source.clone(),
        scene_hash: file.hash,
        statistics,
        weak,
        frames,
        light: LightTrend::all(&state, &covariance),
        covered,
        parameters: state.parameters,
        correlation,
        model_errors: state.model_errors,
        pose_error,
    };
    calibration.name_by_parameters();
    Ok(calibration)
}

/// See [`slitpose_model::ModelError::reach`]; readings that were left out do not count.
fn reach(data: &Data, weights: &Weights, cell: usize) -> Option<f64> {
    let used = data.rows.iter().zip(&weights.readings).filter(|(_, weights)| weights[cell] > 0.0);
    let mut from_centre: Vec<f64> =
        used.filter_map(|(row, _)| row.readings[cell]).map(|reading| share(reading).abs()).collect();
    let place = 9 * from_centre.len() / 10;
    (from_centre.len() >= MIN_REACH_READINGS)
        .then(|| from_centre.select_nth_unstable_by(place, f64::total_cmp).1.max(MIN_REACH))
}

/// Errors of poses of rows that are left out in turn, against the instrument, its outliers excepted; whether it was interrupted.
fn hold_out(
    adjustment: &Adjustment,
    state: &State<'_>,
    weights: &Weights,
    statistics: &mut Statistics,
    remarks: &mut Vec<String>,
    progress: &mut dyn FnMut(Progress) -> ControlFlow<()>,
) -> Result<bool, CalibrateError> {
    let data = state.data;
    let known: Vec<usize> =
        (0..data.rows.len()).filter(|&row| weights.poses[row] == 1.0 && data.rows[row].reported().is_some()).collect();
    if known.len() < MIN_HELD_OUT {
        return Ok(false);
    }
    let (mut squares, mut count) = ([0.0; 2], 0.0);
    for block in 0..BLOCKS {
        if progress(Progress::LeavingOut(block + 1, BLOCKS)).is_break() {
            return Ok(true);
        }
        let left_out = &known[block * known.len() / BLOCKS..(block + 1) * known.len() / BLOCKS];
        let mut rest = data.clone();
        for &row in left_out {
            rest.rows[row].readings.fill(None);
        }
        let without = Adjustment { prior: adjustment.prior.clone(), learns_sizes: false };
        let mut found = state.clone();
        found.data = &rest;
        without.minimise(&mut found, 2)?;
        let scene: Scene = found.parameters.scene(state.nominal);
        let rows: Vec<_> = left_out.iter().map(|&row| data.rows[row].clone()).collect();
        for (&row, pose) in left_out.iter().zip(solved(&scene, &rows)?) {
            let (Some(pose), Some(report)) = (pose, data.rows[row].reported()) else { continue };
            let (t, r) = pose.displacement_from(&found.expected(row, &report));
            squares[0] += t.length_squared();
            squares[1] += r.length_squared();
            count += 1.0;
        }
    }
    if count > 0.0 {
        statistics.held_out_m = Some((squares[0] / count).sqrt());
        statistics.held_out_rad = Some((squares[1] / count).sqrt());
    } else {
        remarks.push(
            "of poses left out in turn none was found again: `slitpose scene map` tells where this head has none"
                .to_owned(),
        );
    }
    Ok(false)
}
