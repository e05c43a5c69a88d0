//! Everything that an adjustment changes.

use slitpose_model::{ModelError, Pose, Scene};

use crate::constraint;
use crate::data::{Constraint, Data, Group, compose, inverse, pose_of};
use crate::parameters::Parameters;
use crate::reading_noise::{Covariance, ReadingNoise};

/// Parameters, poses and unknowns of the groups.
#[derive(Clone, Debug)]
pub(crate) struct State {
    pub(crate) parameters: Parameters,
    /// Of each group.
    pub(crate) unknowns: Vec<Vec<f64>>,
    pub(crate) poses: Vec<Pose>,
    pub(crate) noise: Vec<ReadingNoise>,
    pub(crate) model_errors: Vec<ModelError>,
    /// Of each group: errors of lengths and angles by what is stated.
    pub(crate) scales: Vec<[f64; 2]>,
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

impl State {
    pub(crate) fn new(
        nominal: &Scene,
        parameters: Parameters,
        data: &Data,
        poses: Vec<Pose>,
        model_errors: Vec<ModelError>,
    ) -> Self {
        let mut groups = vec![0; data.rows.len()];
        for (number, group) in data.groups.iter().enumerate() {
            groups[group.rows.clone()].fill(number);
        }
        Self {
            parameters,
            unknowns: data.groups.iter().map(|group| vec![0.0; constraint::unknowns(group)]).collect(),
            poses,
            noise: nominal.cells.iter().map(|cell| ReadingNoise::new(nominal.noise.as_ref(), cell)).collect(),
            model_errors,
            scales: vec![[1.0; 2]; data.groups.len()],
            length_scale_m: nominal.length_scale_m(),
            groups,
        }
    }

    /// The head, with its model errors.
    pub(crate) fn scene(&self, nominal: &Scene) -> Scene {
        let mut scene = self.parameters.scene(nominal);
        for (cell, error) in scene.cells.iter_mut().zip(&self.model_errors) {
            cell.effects.model_error = *error;
        }
        scene
    }

    pub(crate) fn covariance(&self, cell: usize, reading: [f64; 2], frames: f64) -> Covariance {
        self.noise[cell].covariance(reading, frames, &self.model_errors[cell])
    }

    /// The group of a row, with its number.
    pub(crate) fn group_of<'a>(&self, data: &'a Data, row: usize) -> (usize, &'a Group) {
        let number = self.groups[row];
        (number, &data.groups[number])
    }

    /// Standard deviations of lengths and angles of a group, as the data have them.
    pub(crate) fn sigmas(&self, data: &Data, group: usize) -> [f64; 2] {
        let Group { sigma_m, sigma_rad, .. } = data.groups[group];
        [sigma_m * self.scales[group][0], sigma_rad * self.scales[group][1]]
    }

    /// What has been found of the clock of a group beyond what was known of it: seconds ahead, and the share by which it is
    /// faster.
    pub(crate) fn clock(&self, data: &Data, group: usize) -> Option<[f64; 2]> {
        let place = constraint::clock_place(data.groups[group].constraint);
        self.unknowns[group].get(place..)?.try_into().ok()
    }

    /// Takes what has been found of the clocks of all groups, for the data to be put forward by.
    pub(crate) fn take_clocks(&mut self, data: &Data) -> Vec<Option<[f64; 2]>> {
        let found = (0..data.groups.len()).map(|group| self.clock(data, group)).collect();
        for (unknowns, group) in self.unknowns.iter_mut().zip(&data.groups) {
            unknowns[constraint::clock_place(group.constraint)..].fill(0.0);
        }
        found
    }

    /// The pose of an instrument's marker that row `row` reports, by the clock as it is known now.
    pub(crate) fn reported(&self, data: &Data, row: usize) -> Option<Pose> {
        let (number, _) = self.group_of(data, row);
        data.rows[row].reported_at(self.clock(data, number).unwrap_or_default())
    }

    /// The pose of the tool in the base that an instrument's report means.
    pub(crate) fn expected(&self, data: &Data, row: usize, report: &Pose) -> Pose {
        let (number, group) = self.group_of(data, row);
        if group.constraint != Constraint::KnownInOwnFrames {
            return *report;
        }
        let [x, y] = [0, 6].map(|k| pose_of(&self.unknowns[number][k..k + 6]));
        compose(&compose(&x, report), &inverse(&y))
    }

    /// Whether an instrument knows the row's pose, in whatever frames.
    pub(crate) fn is_known(&self, data: &Data, row: usize) -> bool {
        matches!(self.group_of(data, row).1.constraint, Constraint::Known | Constraint::KnownInOwnFrames)
    }

    /// Place of the first unknown of a group.
    pub(crate) fn first_unknown(&self, group: usize) -> usize {
        self.parameters.entries.len() + self.unknowns[..group].iter().map(Vec::len).sum::<usize>()
    }

    /// Parameters, and unknowns of all groups.
    pub(crate) fn unknown_count(&self) -> usize {
        self.first_unknown(self.unknowns.len())
    }

    /// Moves parameters and groups by `step`, in prior σ and scales.
    pub(crate) fn advance(&mut self, data: &Data, step: &[f64]) {
        let count = self.parameters.entries.len();
        for (entry, step) in self.parameters.entries.iter_mut().zip(step) {
            entry.value += step * entry.prior_sigma;
        }
        let mut rest = step[count..].iter();
        for (unknowns, group) in self.unknowns.iter_mut().zip(&data.groups) {
            for ((k, unknown), step) in unknowns.iter_mut().enumerate().zip(&mut rest) {
                *unknown += step * constraint::scale(group.constraint, k);
            }
        }
    }
}
