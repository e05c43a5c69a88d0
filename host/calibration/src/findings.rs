//! What adjusted data showed and what they left open; which part of the workspace known poses cover; what is wrong with the data,
//! refused or remarked.

use nalgebra::{DMatrix, SymmetricEigen};
use schemars::JsonSchema;
use serde::Deserialize;
use slitpose_head::scene_file::Workspace;
use slitpose_head::table::POSE_COLUMNS;
use slitpose_model::{Pose, Scene, SceneError};

use crate::adjust::FIRST_ERROR;
use crate::data::{Constraint, Data, half_extents, values_of};
use crate::pose_error::{COEFFICIENTS, POSES, PoseError, spread};
use crate::prior::Parameter;
use crate::state::{State, Weights, sensitivities};
use crate::{CalibrateError, Calibration};

/// Share of what tolerances do to a cell that no adjustment leaves over: a hundredth is usual, and where cells or electrodes
/// are exchanged it is more than all.
const FOREIGN: f64 = 0.25;

/// Share of the rows of a file that may be outliers: a third are not exceptions.
const MAX_LEFT_OUT: f64 = 1.0 / 3.0;

/// Errors of an instrument's poses, metres and radians, that no calibration needs, if they also are so many times what is
/// stated: parts within their tolerances do as much.
const COARSE: [f64; 2] = [0.1e-3, 10e-3];
const COARSE_RATIO: f64 = 20.0;

/// Refuses data that an adjustment did not bring together; `by_tolerances` is the head before it.
pub(crate) fn require_agreement(
    by_tolerances: &Scene,
    state: &State<'_>,
    weights: &Weights,
) -> Result<(), CalibrateError> {
    foreign_rows(state.data, weights)?;
    foreign_poses(state)?;
    foreign_cells(by_tolerances, state)
}

/// What a user should know of the adjustment, with the next step.
pub(crate) fn remarks(state: &State<'_>, weights: &Weights) -> Vec<String> {
    let mut remarks = worse_instruments(state);
    remarks.extend(poses_left_out(state, weights));
    remarks.extend(beyond_tolerances(&state.parameters.entries));
    remarks
}

/// Refuses a file of which many rows had to be left out.
fn foreign_rows(data: &Data, weights: &Weights) -> Result<(), CalibrateError> {
    for group in &data.groups {
        let (file, rows) = (group.file.clone(), group.rows.len());
        let left_out = weights.poses[group.rows.clone()].iter().filter(|weight| **weight < 1.0).count();
        if left_out as f64 > MAX_LEFT_OUT * rows as f64 {
            return Err(CalibrateError::ForeignRows(file, left_out, rows));
        }
    }
    Ok(())
}

/// Refuses poses that the readings contradict by more than a coarse instrument errs.
fn foreign_poses(state: &State<'_>) -> Result<(), CalibrateError> {
    for (group, ratios) in state.data.groups.iter().zip(&state.scales) {
        let stated = [group.sigma_m, group.sigma_rad];
        let found = |k: usize| stated[k] * ratios[k];
        let Some(k) = (0..2).find(|&k| ratios[k] > COARSE_RATIO && found(k) > COARSE[k]) else { continue };
        let found = if k == 0 { format!("{:.2} mm", found(0) * 1e3) } else { format!("{:.0} mrad", found(1) * 1e3) };
        return Err(CalibrateError::ForeignPoses(group.file.clone(), found, ratios[k]));
    }
    Ok(())
}

/// Refuses readings that the parameters do not explain, and which the adjustment leaves to the model errors of cells.
fn foreign_cells(by_tolerances: &Scene, state: &State<'_>) -> Result<(), CalibrateError> {
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
    if left.is_empty() { Ok(()) } else { Err(CalibrateError::ForeignCells(left.join(", "))) }
}

/// Ratio of an instrument's errors to its stated σ that counts as worse.
const WORSE: f64 = 1.5;

fn worse_instruments(state: &State<'_>) -> Vec<String> {
    let mut remarks = Vec::new();
    for (group, [lengths, angles]) in state.data.groups.iter().zip(&state.scales) {
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

const NAMED: usize = 3;

/// Parts that are elsewhere than the scene says. Of textures tolerances say little.
fn beyond_tolerances(parameters: &[Parameter]) -> Option<String> {
    let is_far = |entry: &&Parameter| entry.quantity.kind().0.family.is_none() && entry.shift().abs() > FAR;
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

/// Poses of instruments that were outliers, with how far they are from where the readings have the tool.
fn poses_left_out(state: &State<'_>, weights: &Weights) -> Option<String> {
    let data = state.data;
    let mut left_out = Vec::new();
    for row in (0..data.rows.len()).filter(|&row| weights.poses[row] < 1.0) {
        let Some(report) = data.rows[row].reported() else { continue };
        let (t, r) = state.poses[row].displacement_from(&state.expected(row, &report));
        left_out.push(format!("{} by {:.0} µm and {:.1} mrad", data.rows[row].id, t.length() * 1e6, r.length() * 1e3));
    }
    let more = if left_out.len() > NAMED { ", and more" } else { "" };
    let count = left_out.len();
    left_out.truncate(NAMED);
    (count > 0).then(|| {
        format!(
            "{count} poses left out, of the rows with id: {}{more}; the readings have the tool elsewhere",
            left_out.join(", ")
        )
    })
}

/// Errors of poses below these are not worth a word, metres and radians: those of a single frame.
const WORTH_M: f64 = 4e-6;
const WORTH_RAD: f64 = 4e-4;

/// Share of the prior σ from which a parameter counts as unseen.
const UNSEEN: f64 = 0.9;

pub(crate) fn weaknesses(
    error: &PoseError,
    parameters: &[Parameter],
    workspace: &Workspace,
    data: &Data,
) -> Vec<String> {
    let mut found = Vec::new();
    let home = error.covariance(&Pose::HOME);
    let rms = |from: usize| ((from..from + 3).map(|k| home[k][k]).sum::<f64>() / 3.0).sqrt();
    let has = |constraint| data.groups.iter().any(|group| group.constraint == constraint);
    if rms(0) > WORTH_M || rms(3) > WORTH_RAD {
        let reason = if has(Constraint::Known) {
            "more known poses would fix it"
        } else {
            "only poses by an instrument in the scene's own frames (--known) would fix it, and a common offset does no \
             harm to motions"
        };
        found.push(format!(
            "where the base and the tool frame lie: {:.0} µm and {:.2} mrad per axis; {reason}",
            rms(0) * 1e6,
            rms(3) * 1e3
        ));
    }
    let scale = scale_sigma(error);
    let extent_m = workspace.half_extent_m.max_element();
    if scale * extent_m > WORTH_M {
        found.push(format!(
            "the scale of translations: {:.2e}, {:.0} µm at {:.0} mm; known steps along a line (--stage) or poses by an \
             instrument (--known) would fix it",
            scale,
            scale * extent_m * 1e6,
            extent_m * 1e3
        ));
    }
    let mut unseen: Vec<&Parameter> =
        parameters.iter().filter(|entry| entry.sigma > UNSEEN * entry.prior_sigma).collect();
    if !unseen.is_empty() {
        let count = unseen.len();
        unseen.sort_by(|a, b| (b.sigma / b.prior_sigma).total_cmp(&(a.sigma / a.prior_sigma)));
        let names: Vec<String> = unseen.iter().take(6).map(|entry| entry.name()).collect();
        let more = if count > names.len() { format!(", and {} more", count - names.len()) } else { String::new() };
        found.push(format!(
            "{count} of {} parameters stay as the tolerances have them: {}{more}; poses farther out and turned farther \
             would show them",
            parameters.len(),
            names.join(", ")
        ));
    }
    found
}

/// Standard deviation of the common factor of all translations.
fn scale_sigma(error: &PoseError) -> f64 {
    // The mean of ∂t_x/∂t_x, ∂t_y/∂t_y and ∂t_z/∂t_z: coordinate k of coefficient k + 1.
    let place = |k: usize| 6 * (k + 1) + k;
    let sum: f64 = (0..3)
        .flat_map(|i| (0..3).map(move |j| (i, j)))
        .map(|(i, j)| error.coefficients[place(i) * COEFFICIENTS + place(j)])
        .sum();
    (sum / 9.0).max(0.0).sqrt() / error.length_scale_m
}

/// A direction among the parameters.
#[derive(Clone, Debug, PartialEq)]
pub struct Direction<'a> {
    /// σ along it, in units of the prior σ: 1 is unseen.
    pub sigma: f64,
    /// The parameters with the largest shares of it, and these, in units of their prior σ.
    pub shares: Vec<(&'a Parameter, f64)>,
}

const NAMED_SHARES: usize = 6;

impl Calibration {
    /// Covariance of the parameters in units of their prior σ, each variance multiplied by `variances`.
    pub(crate) fn covariance(&self, variances: f64) -> DMatrix<f64> {
        let entries = self.parameters();
        let sigma = |k: usize| entries[k].sigma / entries[k].prior_sigma;
        DMatrix::from_fn(entries.len(), entries.len(), |i, j| {
            let correlation = if i == j { variances } else { self.correlation[i.max(j)][i.min(j)] };
            correlation * sigma(i) * sigma(j)
        })
    }

    /// All principal directions of what the data left open, the weakest first.
    pub fn directions(&self) -> Vec<Direction<'_>> {
        let entries = self.parameters();
        let eigen = SymmetricEigen::new(self.covariance(1.0));
        let mut order: Vec<usize> = (0..entries.len()).collect();
        order.sort_by(|&a, &b| eigen.eigenvalues[b].total_cmp(&eigen.eigenvalues[a]));
        let direction = |place: usize| {
            let vector = eigen.eigenvectors.column(place);
            let mut shares: Vec<_> = entries.iter().zip(vector.iter().copied()).collect();
            shares.sort_by(|a, b| b.1.abs().total_cmp(&a.1.abs()));
            shares.truncate(NAMED_SHARES);
            Direction { sigma: eigen.eigenvalues[place].max(0.0).sqrt(), shares }
        };
        order.into_iter().map(direction).collect()
    }
}

/// Share of the workspace, along one of its axes, below which poses do not speak for the whole.
const COVERED: f64 = 0.6;

/// The box that the known poses span.
#[derive(Clone, Debug, PartialEq, Deserialize, JsonSchema)]
pub struct Coverage {
    /// Least translations and rotation vectors, metres and radians.
    pub lower: [f64; 6],
    /// Greatest ones.
    pub upper: [f64; 6],
    /// Share of the workspace's volume.
    pub share: f64,
    /// Expected error of translations in the rest of the workspace by the parameters alone, root mean square of the
    /// distance, metres; `None`: there is no rest.
    pub outside_m: Option<f64>,
    /// The same of rotations, radians.
    pub outside_rad: Option<f64>,
}

impl Coverage {
    /// Of the poses that were known and no outliers; `None`: there are none. `covariance` is that of the unknowns.
    pub(crate) fn of(
        state: &State<'_>,
        weights: &Weights,
        covariance: &DMatrix<f64>,
        workspace: &Workspace,
    ) -> Result<Option<Self>, SceneError> {
        let rows = &state.data.rows;
        let is_known = |row: &usize| weights.poses[*row] == 1.0 && rows[*row].reported().is_some();
        let values = (0..rows.len()).filter(is_known).map(|row| values_of(&state.poses[row]));
        let bounds = values.map(|values| [values, values]).reduce(|[lower, upper], [value, _]| {
            [0, 1].map(|k| std::array::from_fn(|axis| [f64::min, f64::max][k]([lower, upper][k][axis], value[axis])))
        });
        let Some([lower, upper]) = bounds else { return Ok(None) };
        let mut found = Self { lower, upper, share: 1.0, outside_m: None, outside_rad: None };
        found.share = found.shares(workspace).into_iter().product();
        let outside: Vec<Pose> = workspace.poses(POSES).filter(|pose| !found.contains(pose)).collect();
        let cells = sensitivities(state.nominal, &state.parameters, &outside, true)?;
        let count = state.parameters.entries.len();
        let of_parameters = covariance.view((0, 0), (count, count)).clone_owned();
        if let [[metres, radians]] = spread(state, &cells, &outside, &[of_parameters])[..]
            && metres > 0.0
        {
            (found.outside_m, found.outside_rad) = (Some(metres), Some(radians));
        }
        Ok(Some(found))
    }

    fn contains(&self, pose: &Pose) -> bool {
        let values = values_of(pose);
        (0..6).all(|axis| (self.lower[axis]..=self.upper[axis]).contains(&values[axis]))
    }

    /// Of each axis of the workspace.
    fn shares(&self, workspace: &Workspace) -> [f64; 6] {
        let half = half_extents(workspace);
        std::array::from_fn(|axis| {
            let [lower, upper] = [self.lower[axis], self.upper[axis]].map(|end| end.clamp(-half[axis], half[axis]));
            if half[axis] > 0.0 { 0.5 * (upper - lower) / half[axis] } else { 1.0 }
        })
    }

    /// A sentence for users, if poses are missing somewhere.
    pub(crate) fn remark(&self, workspace: &Workspace) -> Option<String> {
        let few = self.shares(workspace).into_iter().enumerate().filter(|(_, share)| *share < COVERED);
        let few: Vec<String> =
            few.map(|(axis, share)| format!("{} {:.0} %", POSE_COLUMNS[axis], 100.0 * share)).collect();
        let expected = match (self.outside_m, self.outside_rad) {
            (Some(metres), Some(radians)) => {
                format!("expect {:.0} µm and {:.2} mrad rms outside it", metres * 1e6, radians * 1e3)
            }
            _ => "outside it errors are greater".to_owned(),
        };
        (!few.is_empty()).then(|| {
            format!(
                "the poses cover only a part of the workspace ({}; {:.2} % of its volume): the error of poses left out \
                 holds within that part, {expected}; add poses farther out",
                few.join(", "),
                100.0 * self.share
            )
        })
    }
}
