//! A slow change of all light over the rows of a file: emitters that warm up, or whose supply drifts.
//!
//! The light of a row is exp(Σ aₖ·(φₖ(x) − mean of φₖ)) times that of the head, with x from 0 at the first instant of the
//! file to 1 at its last; φ is x, or exp(−x/τ) for a warm-up. The head is thus that of the middle of the file. A term
//! enters the adjustment only if the data demand it, so that a head whose light is constant has the same result as without.

use nalgebra::{DMatrix, DVector};
use schemars::JsonSchema;
use serde::Deserialize;

use crate::data::{Constraint, Data, Group};
use crate::normal::Normal;
use crate::state::State;

/// Standard deviation of a change of the light where the scene takes its level for known, relative.
const USUAL_SIGMA: f64 = 0.1;

/// Decrease of χ² that a term must bring: 5 σ.
const EVIDENCE: f64 = 25.0;

/// Fewest rows that show a trend.
const MIN_ROWS: usize = 20;

/// Time constants of a warm-up that are tried, as shares of the duration of a file: a third apart, so that the one that is
/// nearest leaves some hundredths of a warm-up.
const WARM_UPS: [f64; 8] = [0.03, 0.045, 0.07, 0.1, 0.15, 0.22, 0.33, 0.5];

/// Error of a warm-up's size, as a share of it, where its time constant lies between two that are tried.
const BETWEEN: f64 = 0.06;

/// Share of the change by which a warm-up gets its name; with less it is the bend of some other trend.
const NAMED: f64 = 0.2;

/// φ at x: of a warm-up with the time constant `warm_up`, else in proportion.
fn shape(warm_up: Option<f64>, x: f64) -> f64 {
    warm_up.map_or(x, |share| libm::exp(-x / share))
}

/// One term of the trend of one file.
#[derive(Clone, Debug)]
pub(crate) struct Term {
    group: usize,
    /// τ, if it is one.
    warm_up: Option<f64>,
    /// φ of each row of the file, without its mean.
    values: Vec<f64>,
    /// a in units of its σ.
    pub(crate) amplitude: f64,
    pub(crate) sigma: f64,
}

impl Term {
    fn new(data: &Data, group: usize, warm_up: Option<f64>, sigma: f64) -> Self {
        let places = places(data, &data.groups[group]);
        let mut values: Vec<f64> = places.into_iter().map(|x| shape(warm_up, x)).collect();
        let mean = values.iter().sum::<f64>() / values.len() as f64;
        values.iter_mut().for_each(|value| *value -= mean);
        Self { group, warm_up, values, amplitude: 0.0, sigma }
    }

    /// Derivative of the logarithm of the light of a row by the amplitude; `None`: the row is of another file.
    pub(crate) fn slope(&self, data: &Data, row: usize) -> Option<f64> {
        let place = row.checked_sub(data.groups[self.group].rows.start)?;
        self.values.get(place).map(|value| value * self.sigma)
    }

    /// Change of φ·σ from the first instant to the last.
    fn change(&self) -> f64 {
        (shape(self.warm_up, 1.0) - shape(self.warm_up, 0.0)) * self.sigma
    }
}

/// x of each row: by time, if every row has one, else by its place in the file.
fn places(data: &Data, group: &Group) -> Vec<f64> {
    let rows = &data.rows[group.rows.clone()];
    let times_s: Option<Vec<f64>> =
        rows.iter().map(|row| row.time_s.map(|[first, last]| 0.5 * (first + last))).collect();
    let places = times_s.unwrap_or_else(|| (0..rows.len()).map(|place| place as f64).collect());
    let first = places.iter().copied().fold(f64::INFINITY, f64::min);
    let last = places.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    places.into_iter().map(|place| if last > first { (place - first) / (last - first) } else { 0.0 }).collect()
}

/// The term that the data demand most beside those that `state` has, if they demand any. `normal` is of `state`; its cells
/// are given back.
pub(crate) fn missing(state: &State<'_>, normal: &mut Normal, prior: &DMatrix<f64>) -> Option<Term> {
    let State { nominal, data, .. } = *state;
    let level = nominal.uncertainty.light_level_relative;
    let sigma = if level > 0.0 { level } else { USUAL_SIGMA };
    let mut tried = state.clone();
    let known = state.light.len();
    for (number, group) in data.groups.iter().enumerate() {
        let has =
            |is_warm_up| state.light.iter().any(|term| term.group == number && term.warm_up.is_some() == is_warm_up);
        // The light along a stage changes with the step.
        if group.constraint == Constraint::Stage || group.rows.len() < MIN_ROWS {
            continue;
        }
        if !has(false) {
            tried.light.push(Term::new(data, number, None, sigma));
        }
        if !has(true) {
            tried.light.extend(WARM_UPS.map(|share| Term::new(data, number, Some(share), sigma)));
        }
    }
    if tried.light.len() == known {
        return None;
    }
    let cells = std::mem::take(&mut normal.cells);
    let of_tried = Normal::assemble(&tried, cells, normal.weights.clone(), prior);
    let found = of_tried.step(0.0).zip(of_tried.covariance()).and_then(|(step, covariance)| {
        let (first, count) = (tried.first_light(), tried.light.len());
        let information = covariance.view((first, first), (count, count)).clone_owned().cholesky()?.inverse();
        Some((&information * step.rows(first, count), information))
    });
    normal.cells = of_tried.cells;
    let (gradient, information) = found?;
    // Of a term alone beside the known ones: χ² decreases by g²/I, with what the known ones explain left out of both.
    let inverse = information.view((0, 0), (known, known)).clone_owned().cholesky().map(|known| known.inverse())?;
    let decrease = |term: usize| {
        let with: DVector<f64> = information.view((0, term), (known, 1)).column(0).clone_owned();
        let shared: DVector<f64> = &inverse * &with;
        let gradient = gradient[term] - shared.dot(&gradient.rows(0, known));
        // The others are absent: their prior, which the step has, does not matter.
        gradient * gradient / (information[(term, term)] - shared.dot(&with))
    };
    let best = (known..tried.light.len()).max_by(|&a, &b| decrease(a).total_cmp(&decrease(b)))?;
    (decrease(best) > EVIDENCE).then(|| tried.light.swap_remove(best))
}

/// How the light of a file changed while it was taken.
#[derive(Clone, Debug, PartialEq, Deserialize, JsonSchema)]
pub struct LightTrend {
    /// The file.
    pub file: String,
    /// Relative change from its first row to its last.
    pub change: f64,
    /// Its standard deviation.
    pub change_sigma: f64,
    /// Time constant of the warm-up, as a share of the duration of the file, if there was one.
    pub warm_up: Option<f64>,
}

impl LightTrend {
    /// Of all files that have one; `covariance` is that of all unknowns.
    pub(crate) fn all(state: &State<'_>, covariance: &DMatrix<f64>) -> Vec<Self> {
        let of_group = |(number, group): (usize, &Group)| {
            let terms: Vec<(usize, &Term)> =
                state.light.iter().enumerate().filter(|(_, term)| term.group == number).collect();
            let first = state.first_light();
            let variance = |(i, a): &(usize, &Term), (j, b): &(usize, &Term)| {
                a.change() * b.change() * covariance[(first + i, first + j)]
            };
            let change: f64 = terms.iter().map(|(_, term)| term.amplitude * term.change()).sum();
            let variance: f64 = terms.iter().flat_map(|a| terms.iter().map(move |b| variance(a, b))).sum();
            let warm_ups = || terms.iter().filter(|(_, term)| term.warm_up.is_some());
            let between = warm_ups().map(|(_, term)| (BETWEEN * term.amplitude * term.change()).powi(2));
            let variance = variance + between.sum::<f64>();
            let is_named = |(_, term): &&(usize, &Term)| (term.amplitude * term.change()).abs() > NAMED * change.abs();
            let warm_up = warm_ups().find(is_named).and_then(|(_, term)| term.warm_up);
            (!terms.is_empty()).then(|| Self {
                file: group.file.clone(),
                change: libm::expm1(change),
                change_sigma: variance.sqrt() * libm::exp(change),
                warm_up,
            })
        };
        state.data.groups.iter().enumerate().filter_map(of_group).collect()
    }

    pub(crate) fn remark(&self) -> String {
        let Self { file, change, change_sigma, warm_up } = self;
        let verb = if *change < 0.0 { "faded" } else { "grew" };
        let (size, sigma) = (100.0 * change.abs(), 100.0 * change_sigma);
        // One digit of σ.
        let digits = (-libm::log10(sigma).floor()).clamp(1.0, 6.0) as usize;
        let how = warm_up.map_or(String::new(), |share| {
            format!(", as in a warm-up with a time constant of {:.0} % of that time", 100.0 * share)
        });
        format!(
            "{file}: the light {verb} by {size:.digits$} ± {sigma:.digits$} % from the first row to the last{how}; the result allows for \
             it and holds for the middle of the file; let emitters warm up and hold their current"
        )
    }
}
