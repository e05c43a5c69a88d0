//! What is wrong with data that were adjusted: refused, or remarked.

use slitpose_model::Scene;

use crate::CalibrateError;
use crate::adjust::FIRST_ERROR;
use crate::data::Data;
use crate::parameters::Parameter;
use crate::state::{State, Weights};

/// Share of what tolerances do to a cell that no adjustment leaves over: a hundredth is usual, and where cells or electrodes
/// are exchanged it is more than all.
const FOREIGN: f64 = 0.25;

/// Share of the rows of a file that may be outliers: a third are not exceptions.
const MOST_LEFT_OUT: f64 = 1.0 / 3.0;

/// Errors of an instrument's poses, metres and radians, that no calibration needs, if they also are so many times what is
/// stated: parts within their tolerances do as much.
const COARSE: [f64; 2] = [0.1e-3, 10e-3];
const COARSE_RATIO: f64 = 20.0;

/// Refuses data that an adjustment did not bring together; `by_tolerances` is the head before it.
///
/// # Errors
/// What they contradict.
pub(crate) fn require_agreement(
    by_tolerances: &Scene,
    data: &Data,
    state: &State,
    weights: &Weights,
) -> Result<(), CalibrateError> {
    foreign_rows(data, weights)?;
    foreign_poses(data, state)?;
    foreign_cells(by_tolerances, state)
}

/// What a user should know of the adjustment, with the next step.
pub(crate) fn remarks(data: &Data, state: &State) -> Vec<String> {
    let mut remarks = worse_instruments(data, state);
    remarks.extend(beyond_tolerances(&state.parameters.entries));
    remarks
}

/// Refuses a file of which many rows had to be left out.
fn foreign_rows(data: &Data, weights: &Weights) -> Result<(), CalibrateError> {
    for group in &data.groups {
        let (file, rows) = (group.file.clone(), group.rows.len());
        let left_out = weights.poses[group.rows.clone()].iter().filter(|weight| **weight < 1.0).count();
        if left_out as f64 > MOST_LEFT_OUT * rows as f64 {
            return Err(CalibrateError::ForeignRows { file, left_out, rows });
        }
    }
    Ok(())
}

/// Refuses poses that the readings contradict by more than a coarse instrument errs.
fn foreign_poses(data: &Data, state: &State) -> Result<(), CalibrateError> {
    for (group, ratios) in data.groups.iter().zip(&state.scales) {
        let stated = [group.sigma_m, group.sigma_rad];
        let found = |k: usize| stated[k] * ratios[k];
        let Some(k) = (0..2).find(|&k| ratios[k] > COARSE_RATIO && found(k) > COARSE[k]) else { continue };
        let found = if k == 0 { format!("{:.2} mm", found(0) * 1e3) } else { format!("{:.0} mrad", found(1) * 1e3) };
        return Err(CalibrateError::ForeignPoses { file: group.file.clone(), found, ratio: ratios[k] });
    }
    Ok(())
}

/// Refuses readings that the parameters do not explain, and which the adjustment leaves to the model errors of cells.
fn foreign_cells(by_tolerances: &Scene, state: &State) -> Result<(), CalibrateError> {
    let cells = by_tolerances.cells.iter().zip(&state.model_errors).enumerate();
    let foreign = cells.filter_map(|(number, (cell, left))| {
        let before = &cell.effects.model_error;
        // With too few readings of a cell to tell, an adjustment ends as it began.
        let is_foreign = left.position_m > (FOREIGN * before.position_m).max(FIRST_ERROR.position_m)
            || left.relative > (FOREIGN * before.relative).max(FIRST_ERROR.relative);
        is_foreign
            .then(|| format!("{:.0} µm and {:.1} % of cell {number}", left.position_m * 1e6, 100.0 * left.relative))
    });
    let left: Vec<String> = foreign.collect();
    if left.is_empty() { Ok(()) } else { Err(CalibrateError::ForeignCells { left: left.join(", ") }) }
}

/// Ratio of an instrument's errors to its stated σ that counts as worse.
const WORSE: f64 = 1.5;

fn worse_instruments(data: &Data, state: &State) -> Vec<String> {
    let mut remarks = Vec::new();
    for (group, [lengths, angles]) in data.groups.iter().zip(&state.scales) {
        for (sigma, scale, unit) in [(group.sigma_m, lengths, "µm"), (group.sigma_rad, angles, "µrad")] {
            if *scale > WORSE {
                let [stated, found] = [sigma * 1e6, sigma * scale * 1e6];
                remarks.push(format!(
                    "{}: poses err by {found:.1} {unit}, not by {stated:.1} {unit} as stated; counted as found",
                    group.file
                ));
            }
        }
    }
    remarks
}

/// Shift of a part, in units of its tolerance, that two in a thousand million have by chance.
const FAR: f64 = 6.0;

/// Most parts that are named.
const NAMED: usize = 3;

/// Parts that are elsewhere than the scene says. Of textures tolerances say little.
fn beyond_tolerances(parameters: &[Parameter]) -> Option<String> {
    let is_far = |entry: &&Parameter| entry.quantity.family().is_none() && entry.shift().abs() > FAR;
    let mut far: Vec<&Parameter> = parameters.iter().filter(is_far).collect();
    far.sort_by(|a, b| b.shift().abs().total_cmp(&a.shift().abs()));
    let name = |entry: &&Parameter| format!("{} {:.0} times its tolerance", entry.name(), entry.shift().abs());
    let named: Vec<String> = far.iter().take(NAMED).map(name).collect();
    (!far.is_empty()).then(|| {
        format!(
            "{} parameters are farther from the scene than its [tolerance] says: {}; check the scene's numbers and the frames \
             of the poses (--frames own), or state greater tolerances",
            far.len(),
            named.join(", ")
        )
    })
}
