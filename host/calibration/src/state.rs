//! Everything that an adjustment changes; currents and their derivatives there, and what is left between readings and model.

use slitpose_head::threads::on_all_cores;
use slitpose_model::{CompiledScene, ModelError, Pose, Scene, SceneError, Status};

use crate::data::{self, Constraint, Data, Group, compose, inverse, pose_of};
use crate::light::Term;
use crate::prior::Parameters;
use crate::reading::{Covariance, ReadingNoise, TIER, deviation, whiten, whitener};

/// Parameters, poses and unknowns of the groups.
#[derive(Clone, Debug)]
pub(crate) struct State<'a> {
    pub(crate) nominal: &'a Scene,
    /// What it explains.
    pub(crate) data: &'a Data,
    pub(crate) parameters: Parameters,
    /// Of each group.
    pub(crate) unknowns: Vec<Vec<f64>>,
    pub(crate) poses: Vec<Pose>,
    pub(crate) noise: Vec<ReadingNoise>,
    pub(crate) model_errors: Vec<ModelError>,
    /// The same by the residuals alone, without what is known of usual heads: of intensity, relative, and position, metres.
    pub(crate) residual_errors: Vec<[f64; 2]>,
    /// Of each group: errors of lengths and angles by what is stated.
    pub(crate) scales: Vec<[f64; 2]>,
    /// How the light of groups changes.
    pub(crate) light: Vec<Term>,
    pub(crate) length_scale_m: f64,
    /// Of each row.
    groups: Vec<usize>,
}

/// Weights between 0 and 1: of outliers.
#[derive(Clone, Debug)]
pub(crate) struct Weights {
    /// Of each row's cells.
    pub(crate) readings: Vec<Vec<f64>>,
    /// Of what is known of each row's pose.
    pub(crate) poses: Vec<f64>,
}

impl Weights {
    pub(crate) fn equal(data: &Data) -> Self {
        Self {
            readings: data.rows.iter().map(|row| vec![1.0; row.readings.len()]).collect(),
            poses: vec![1.0; data.rows.len()],
        }
    }
}

impl<'a> State<'a> {
    pub(crate) fn new(
        nominal: &'a Scene,
        parameters: Parameters,
        data: &'a Data,
        poses: Vec<Pose>,
        model_errors: Vec<ModelError>,
    ) -> Self {
        let mut groups = vec![0; data.rows.len()];
        for (number, group) in data.groups.iter().enumerate() {
            groups[group.rows.clone()].fill(number);
        }
        Self {
            nominal,
            data,
            parameters,
            unknowns: data.groups.iter().map(|group| vec![0.0; data::unknowns(group.constraint)]).collect(),
            poses,
            noise: nominal.cells.iter().map(|cell| ReadingNoise::new(nominal.noise.as_ref(), cell)).collect(),
            residual_errors: vec![[0.0; 2]; model_errors.len()],
            model_errors,
            scales: vec![[1.0; 2]; data.groups.len()],
            light: Vec::new(),
            length_scale_m: nominal.length_scale_m(),
            groups,
        }
    }

    pub(crate) fn scene(&self) -> Scene {
        let mut scene = self.parameters.scene(self.nominal);
        for (cell, error) in scene.cells.iter_mut().zip(&self.model_errors) {
            cell.effects.model_error = *error;
        }
        scene
    }

    pub(crate) fn covariance(&self, cell: usize, reading: [f64; 2], frames: f64) -> Covariance {
        self.noise[cell].covariance(reading, frames, &self.model_errors[cell])
    }

    /// The group of a row, with its number.
    pub(crate) fn group_of(&self, row: usize) -> (usize, &'a Group) {
        let number = self.groups[row];
        (number, &self.data.groups[number])
    }

    /// Standard deviations of lengths and angles of a group, as the data have them.
    pub(crate) fn sigmas(&self, group: usize) -> [f64; 2] {
        let Group { sigma_m, sigma_rad, .. } = self.data.groups[group];
        [sigma_m * self.scales[group][0], sigma_rad * self.scales[group][1]]
    }

    /// The pose of the tool in the base that an instrument's report means.
    pub(crate) fn expected(&self, row: usize, report: &Pose) -> Pose {
        let (number, group) = self.group_of(row);
        if group.constraint != Constraint::KnownInOwnFrames {
            return *report;
        }
        let [x, y] = [0, 6].map(|k| pose_of(&self.unknowns[number][k..k + 6]));
        compose(&compose(&x, report), &inverse(&y))
    }

    /// Whether an instrument knows the row's pose, in whatever frames.
    pub(crate) fn is_known(&self, row: usize) -> bool {
        matches!(self.group_of(row).1.constraint, Constraint::Known | Constraint::KnownInOwnFrames)
    }

    /// Place of the first unknown of a group.
    pub(crate) fn first_unknown(&self, group: usize) -> usize {
        self.parameters.entries.len() + self.unknowns[..group].iter().map(Vec::len).sum::<usize>()
    }

    /// Place of the first term of the light, after all groups.
    pub(crate) fn first_light(&self) -> usize {
        self.first_unknown(self.unknowns.len())
    }

    pub(crate) fn unknown_count(&self) -> usize {
        self.first_light() + self.light.len()
    }

    /// The light of row `row` by that of the head.
    pub(crate) fn light_of(&self, row: usize) -> f64 {
        let parts = self.light.iter().filter_map(|term| Some(term.amplitude * term.slope(self.data, row)?));
        libm::exp(parts.sum::<f64>())
    }

    /// Moves parameters and groups by `step`, in prior σ and scales.
    pub(crate) fn advance(&mut self, step: &[f64]) {
        let count = self.parameters.entries.len();
        for (entry, step) in self.parameters.entries.iter_mut().zip(step) {
            entry.value += step * entry.prior_sigma;
        }
        let mut rest = step[count..].iter();
        for (unknowns, group) in self.unknowns.iter_mut().zip(&self.data.groups) {
            for ((k, unknown), step) in unknowns.iter_mut().enumerate().zip(&mut rest) {
                *unknown += step * data::scale(group.constraint, k);
            }
        }
        for (term, step) in self.light.iter_mut().zip(rest) {
            term.amplitude += step;
        }
    }
}

/// Step of a one-sided difference by a parameter, in standard deviations of its prior: parts deviate by a hundredth of
/// their size, so that curvature is below 1e-4 of the slope.
const STEP: f64 = 0.01;

pub(crate) struct CellSensitivity {
    pub(crate) acting: Vec<usize>,
    /// Currents above dark; `None`: no direct light reaches the detector.
    pub(crate) pairs: Vec<Option<[f64; 2]>>,
    pub(crate) by_pose: Vec<[[f64; 6]; 2]>,
    /// Derivatives by the acting parameters in units of their prior σ: row after row, then parameter after parameter.
    /// Empty if not asked for.
    pub(crate) by_parameter: Vec<[f64; 2]>,
}

impl CellSensitivity {
    /// Multiplies the light of row `row` by `factor`.
    fn brighten(&mut self, row: usize, factor: f64) {
        let Some(pair) = &mut self.pairs[row] else { return };
        let width = if self.by_parameter.is_empty() { 0 } else { self.acting.len() };
        let by_parameter = self.by_parameter[row * width..][..width].as_flattened_mut();
        for value in pair.iter_mut().chain(self.by_pose[row].as_flattened_mut()).chain(by_parameter) {
            *value *= factor;
        }
    }
}

/// The part of the scene that cell `number` needs: all cells if light of other emitters reaches it.
fn scene_of(nominal: &Scene, parameters: &Parameters, number: usize, changed: Option<(usize, f64)>) -> (Scene, usize) {
    let cell = parameters.cell(&nominal.cells[number], number, changed);
    if cell.effects.lit_together == 0 {
        return (Scene { cells: [cell].into_iter().collect(), ..Scene::default() }, 0);
    }
    let mut scene = parameters.scene(nominal);
    scene.cells[number] = cell;
    if let Some(owner) = changed.and_then(|(place, _)| parameters.entries[place].cell) {
        scene.cells[owner] = parameters.cell(&nominal.cells[owner], owner, changed);
    }
    (scene, number)
}

fn of_cell(
    nominal: &Scene,
    parameters: &Parameters,
    number: usize,
    poses: &[Pose],
    derivatives: bool,
) -> Result<CellSensitivity, SceneError> {
    let cell = &nominal.cells[number];
    let acting = parameters.acting_on(cell, number, cell.effects.lit_together);
    let plan_of = |changed| {
        let (scene, index) = scene_of(nominal, parameters, number, changed);
        Ok((CompiledScene::<f64>::compile(&scene, TIER)?, index))
    };
    let (plan, index) = plan_of(None)?;
    let mut pairs = Vec::with_capacity(poses.len());
    let mut by_pose = Vec::with_capacity(poses.len());
    for pose in poses {
        let (status, pair, jacobian) = plan.linearise(index, pose);
        pairs.push(matches!(status, Status::Lit | Status::Clipped).then_some([pair.i_x1_a, pair.i_x2_a]));
        by_pose.push(jacobian);
    }
    let mut by_parameter = Vec::new();
    if derivatives {
        by_parameter = vec![[0.0; 2]; poses.len() * acting.len()];
        for (place, &k) in acting.iter().enumerate() {
            let entry = &parameters.entries[k];
            let step = STEP * entry.prior_sigma;
            let (after, _) = plan_of(Some((k, entry.value + step)))?;
            for (row, pose) in poses.iter().enumerate() {
                let Some(before) = pairs[row] else { continue };
                let changed = after.photocurrents(index, pose);
                by_parameter[row * acting.len() + place] =
                    [(changed.i_x1_a - before[0]) / STEP, (changed.i_x2_a - before[1]) / STEP];
            }
        }
    }
    Ok(CellSensitivity { acting, pairs, by_pose, by_parameter })
}

/// All cells, each computed by one of the processor's cores.
pub(crate) fn sensitivities(
    nominal: &Scene,
    parameters: &Parameters,
    poses: &[Pose],
    derivatives: bool,
) -> Result<Vec<CellSensitivity>, SceneError> {
    let numbers: Vec<usize> = (0..nominal.cells.len()).collect();
    let of_cell = |&number: &usize| of_cell(nominal, parameters, number, poses, derivatives);
    on_all_cores(&numbers, of_cell).into_iter().collect()
}

/// Those of all rows, in the light that they have by `state`.
pub(crate) fn sensitivities_of_rows(state: &State<'_>, derivatives: bool) -> Result<Vec<CellSensitivity>, SceneError> {
    let mut cells = sensitivities(state.nominal, &state.parameters, &state.poses, derivatives)?;
    if !state.light.is_empty() {
        for row in 0..state.data.rows.len() {
            let factor = state.light_of(row);
            cells.iter_mut().for_each(|cell| cell.brighten(row, factor));
        }
    }
    Ok(cells)
}

/// One reading, against the head before and after calibration.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Residual {
    /// The cell.
    pub cell: usize,
    /// Position of the light on the detector, metres.
    pub position_m: f64,
    /// Angle γ of the beam to the emitter's axis, radians.
    pub angle_rad: f64,
    /// Deviation of the photocurrent, relative, and of the position, metres, from the most probable head of the tolerances.
    pub before: [f64; 2],
    /// The same from the calibrated head.
    pub after: [f64; 2],
    /// Both in units of their σ, uncorrelated.
    pub normalised: [f64; 2],
}

/// Of all readings that have light in both models.
pub(crate) fn residuals(state: &State<'_>) -> Result<Vec<Residual>, SceneError> {
    let State { nominal, data, .. } = *state;
    let mut at_prior = state.parameters.clone();
    at_prior.entries.iter_mut().for_each(|entry| entry.value = entry.prior);
    let [before, after] =
        [&at_prior, &state.parameters].map(|of| CompiledScene::<f64>::compile(&of.scene(nominal), TIER));
    let (before, after) = (before?, after?);
    let mut found = Vec::new();
    for (number, (row, pose)) in data.rows.iter().zip(&state.poses).enumerate() {
        let level = state.light_of(number);
        for (cell, reading) in row.readings.iter().enumerate() {
            let (Some(reading), response) = (*reading, after.respond(cell, pose)) else { continue };
            let reading = reading.map(|current_a| current_a / level);
            let (Some(position_m), Some(angle_rad)) = (response.x_a_m, response.gamma_rad) else { continue };
            let half_length_m = 0.5 * nominal.cells[cell].detector.length_m;
            let [(before, _), (after, change)] =
                [&before, &after].map(|plan| deviation(plan, cell, pose, reading, half_length_m));
            let normalised = whiten(whitener(state.covariance(cell, reading, row.frames)), change);
            if before.iter().chain(&after).all(|value| value.is_finite()) {
                found.push(Residual { cell, position_m, angle_rad, before, after, normalised });
            }
        }
    }
    Ok(found)
}
