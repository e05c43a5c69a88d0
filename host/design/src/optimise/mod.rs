//! The best head within bounds: `slitpose scene optimise`.
//!
//! A candidate is a scene text: [`Quantity`]s are set in the scene that the search began with, and what is evaluated is
//! what is printed. [`Search::run`] looks at candidates spread over the bounds, and goes on from the best of them by
//! Nelder and Mead's simplex (1965): limits make kinks, where derivatives lead nowhere.

mod quantity;
mod score;

use std::fmt;
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};

use argmin::core::{CostFunction, Error, Executor, State};
use argmin::solver::neldermead::NelderMead;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use slitpose_head::scene_file::SceneFile;
use slitpose_head::threads::{lock, on_all_cores};

use crate::DesignError;
use quantity::{current, with_values};

pub use quantity::{Free, Quantity};
pub use score::{Demand, Goal, Judge, Score};

#[cfg(test)]
mod tests;

/// What a head has to keep.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Limits {
    /// Share of the workspace in which all spots lie on their detectors.
    pub lit: f64,
    /// Between the tool's emitters and the slits, over the workspace, metres.
    pub clearance_m: f64,
    /// Between detectors, and between emitters, from centre line to centre line: metres.
    pub detector_pitch_m: f64,
    /// See [`Self::detector_pitch_m`].
    pub emitter_pitch_m: f64,
    /// Light of other emitters of a slot, as a share of a cell's own.
    pub crosstalk: f64,
    /// Share of the workspace in which all electrodes stay below full scale.
    pub in_scale: f64,
    /// Farthest point of a detector from the z axis, metres.
    pub radius_m: f64,
}

impl Default for Limits {
    /// Of the parts of the shipped scenes: an S3932 is 13 mm long and 5 mm wide in its housing, a CQY36N 3 mm.
    fn default() -> Self {
        Self {
            lit: 0.999,
            clearance_m: 1e-3,
            detector_pitch_m: 6e-3,
            emitter_pitch_m: 4e-3,
            crosstalk: 1e-3,
            in_scale: 0.995,
            radius_m: f64::INFINITY,
        }
    }
}

/// The limits by name. Those without a field of [`Limits`] hold for every head.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[allow(missing_docs, reason = "each other is a field of Limits")]
pub enum Limit {
    /// A frame gives a pose, everywhere in the workspace.
    Pose,
    Lit,
    Clearance,
    Radius,
    DetectorPitch,
    EmitterPitch,
    /// The board can do what the front end and the lighting ask for.
    Board,
    InScale,
    Crosstalk,
}

/// A limit that is not kept.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Excess {
    /// Which one.
    pub limit: Limit,
    /// By how much, where it is worst: the share of poses without a pose; millimetres; the factor by which a current or
    /// light is too large; 1 for [`Limit::Board`].
    pub worst: f64,
    /// What it adds to the violation that a search makes least: millimetres, or logarithms of ratios, summed over parts.
    violation: f64,
}

impl fmt::Display for Excess {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let worst = self.worst;
        match self.limit {
            Limit::Pose => write!(f, "{:.1} % of the workspace without a pose", 100.0 * worst),
            Limit::Lit => write!(f, "spots {worst:.2} mm beyond their detectors"),
            Limit::Clearance => write!(f, "tool and head {worst:.2} mm too near to each other"),
            Limit::Radius => write!(f, "detectors {worst:.2} mm too far out"),
            Limit::DetectorPitch => write!(f, "detectors {worst:.2} mm too near to each other"),
            Limit::EmitterPitch => write!(f, "emitters {worst:.2} mm too near to each other"),
            Limit::Board => write!(f, "more than the board can do in a frame"),
            Limit::InScale => write!(f, "currents {:.2} % above full scale", 100.0 * (worst - 1.0)),
            Limit::Crosstalk => write!(f, "light of a slot's other emitters {worst:.2} times what it may be"),
        }
    }
}

/// Notes that `limit` is passed by `worst`, which is worth `violation`; not if that is zero.
fn note(excesses: &mut Vec<Excess>, limit: Limit, violation: f64, worst: f64) {
    if violation <= 0.0 {
        return;
    }
    match excesses.iter_mut().find(|noted| noted.limit == limit) {
        Some(noted) => {
            noted.violation += violation;
            noted.worst = noted.worst.max(worst);
        }
        None => excesses.push(Excess { limit, worst, violation }),
    }
}

/// What a search makes least: zero if all limits are kept.
fn violation(excesses: &[Excess]) -> f64 {
    excesses.iter().map(|excess| excess.violation).sum()
}

/// Candidates that are spread over the bounds, for each free quantity.
const SPREAD: usize = 150;

/// The best of them from which simplexes start, and how far apart they have to be, as a share of the bounds.
const STARTS: usize = 12;
const APART: f64 = 0.15;

/// Edge of a simplex, as a share of the bounds. Limits flatten simplexes: new ones go on from the best of the last, each
/// turned the other way, while they gain.
const EDGE: f64 = 0.12;
const SIMPLEXES: usize = 8;
const GAIN: f64 = 0.002;

const STEPS: usize = 30;

/// What is found by few poses and is not as good at all of them is looked for anew so many times, having learnt from it.
const ROUNDS: usize = 4;

/// By so much, in ln σ, it may differ.
const AS_ESTIMATED: f64 = 0.01;

/// Cost of a candidate that is no scene.
const IMPOSSIBLE: f64 = 1e6;

/// What is free, what is wanted, and within which limits.
#[derive(Clone, Debug)]
pub struct Search {
    /// The scene it begins with: it is the first candidate, so that a search goes on from what an earlier one found.
    pub file: SceneFile,
    /// What is free.
    pub free: Vec<Free>,
    /// What is wanted.
    pub goal: Goal,
    /// What has to be kept.
    pub limits: Limits,
    /// Seed of the candidates that are spread.
    pub seed: u64,
}

/// The best that was found.
#[derive(Clone, Debug)]
pub struct Found {
    /// The scene, which is what was evaluated.
    pub file: SceneFile,
    /// Of the scene that the search began with.
    pub before: Score,
    /// Of the scene that was found.
    pub after: Score,
    /// Free quantities: before and after, in their units.
    pub values: Vec<(Quantity, [f64; 2])>,
    /// Candidates that were evaluated.
    pub evaluations: usize,
    /// Whether it was interrupted, and is the best so far.
    pub is_interrupted: bool,
}

/// A candidate: free quantities as shares of their bounds.
type Shares = Vec<f64>;

/// The search at work, shared by all threads.
struct Work<'a> {
    search: &'a Search,
    judge: Judge,
    evaluations: AtomicUsize,
    progress: Mutex<&'a mut (dyn FnMut(usize, f64) + Send)>,
    stop: &'a AtomicBool,
    best: Mutex<Best>,
}

struct Best {
    cost: f64,
    sigma_m: f64,
    shares: Shares,
}

impl Best {
    fn none(shares: Shares) -> Self {
        Self { cost: f64::INFINITY, sigma_m: f64::INFINITY, shares }
    }
}

impl Search {
    /// How many candidates are evaluated, about.
    pub fn evaluations(&self) -> usize {
        self.free.len() * (SPREAD + STARTS * 4 * STEPS * 3 / 2)
    }

    /// Runs on all cores. `progress` gets the number of candidates evaluated and the least σ so far, metres; `stop` ends
    /// it with the best so far.
    pub fn run(&self, progress: &mut (dyn FnMut(usize, f64) + Send), stop: &AtomicBool) -> Result<Found, DesignError> {
        if self.free.is_empty() {
            return Err(DesignError::NothingFree);
        }
        let own: Shares = self.free.iter().map(|free| share_of(free, current(&self.file, free.quantity))).collect();
        // What is wrong with the scene itself is told; a candidate may be impossible.
        for free in &self.free {
            let [from, to] = free.bounds;
            // What cannot be changed at all in this scene is told, too.
            let middle = free.quantity.rounded(0.5 * (from + to));
            with_values(&self.file, &[(free.quantity, middle)])?;
        }
        let judge = Judge::new(&self.file.workspace, self.goal, self.limits);
        let before = judge.score(&self.file)?;
        let mut found = (judge.score(&self.candidate(&own)?)?, own.clone());
        let mut work = Work {
            search: self,
            judge,
            evaluations: AtomicUsize::new(0),
            progress: Mutex::new(progress),
            stop,
            best: Mutex::new(Best::none(own.clone())),
        };
        let mut rng = ChaCha8Rng::seed_from_u64(self.seed);
        let mut candidates = vec![own.clone()];
        let count = SPREAD * self.free.len();
        // A lattice (Korobov 1959) spreads them more evenly than chance does; chance shifts it.
        let shift: Shares = self.free.iter().map(|_| rng.random_range(0.0..1.0)).collect();
        let generators: Vec<f64> = (1..=self.free.len()).map(|k| golden(self.free.len()).powi(-(k as i32))).collect();
        candidates.extend((0..count).map(|n| {
            shift.iter().zip(&generators).map(|(shift, by)| (shift + n as f64 * by).fract()).collect::<Shares>()
        }));
        let costs = on_all_cores(&candidates, |candidate| work.cost_of(candidate));
        let mut order: Vec<usize> = (0..candidates.len()).collect();
        order.sort_by(|&a, &b| costs[a].total_cmp(&costs[b]));
        let mut starts: Vec<Shares> = Vec::new();
        for &number in &order {
            let candidate = &candidates[number];
            let is_new = |other: &Shares| other.iter().zip(candidate).any(|(a, b)| (a - b).abs() > APART);
            if starts.len() < STARTS && starts.iter().all(is_new) {
                starts.push(candidate.clone());
            }
        }
        for round in 1.. {
            on_all_cores(&starts, |start| work.descend(start));
            let Best { cost: estimate, sigma_m, shares } =
                std::mem::replace(&mut *lock(&work.best), Best::none(own.clone()));
            let file = self.candidate(&shares)?;
            let score = work.judge.score(&file)?;
            // What no candidate keeps is not learnt either.
            let is_kept = score.excesses.is_empty() || estimate > sigma_m.ln();
            let is_as_estimated = is_kept && score.cost() <= estimate + AS_ESTIMATED;
            if score.cost() < found.0.cost() {
                found = (score, shares.clone());
            }
            if is_as_estimated || round == ROUNDS || stop.load(Ordering::Relaxed) {
                break;
            }
            work.judge.learn(&file)?;
            starts = vec![shares, found.1.clone()];
        }
        let (after, best) = found;
        let file = self.candidate(&best)?;
        let values = self.values(&best).into_iter();
        let values = values.map(|(quantity, value)| (quantity, [current(&self.file, quantity), value])).collect();
        let evaluations = work.evaluations.load(Ordering::Relaxed);
        Ok(Found { file, before, after, values, evaluations, is_interrupted: stop.load(Ordering::Relaxed) })
    }

    fn candidate(&self, shares: &[f64]) -> Result<SceneFile, DesignError> {
        Ok(SceneFile::parse(&self.file.origin, &with_values(&self.file, &self.values(shares))?)?)
    }

    /// The values of a candidate, in the order in which they act, as a drawing states them.
    fn values(&self, shares: &[f64]) -> Vec<(Quantity, f64)> {
        let of = |quantity: Quantity| {
            let (free, share) = self.free.iter().zip(shares).find(|(free, _)| free.quantity == quantity)?;
            let [from, to] = free.bounds;
            Some((quantity, quantity.rounded(from + share.clamp(0.0, 1.0) * (to - from))))
        };
        Quantity::all().filter_map(of).collect()
    }
}

fn share_of(free: &Free, value: f64) -> f64 {
    let [from, to] = free.bounds;
    ((value - from) / (to - from)).clamp(0.0, 1.0)
}

/// The root of x^(d+1) = x + 1, whose powers make an even lattice in d dimensions (Roberts 2018).
fn golden(dimensions: usize) -> f64 {
    (0..60).fold(2.0, |x: f64, _| (1.0 + x).powf(1.0 / (dimensions as f64 + 1.0)))
}

impl Work<'_> {
    /// What is made least; beyond the bounds it grows.
    fn cost_of(&self, shares: &Shares) -> f64 {
        if self.stop.load(Ordering::Relaxed) {
            return IMPOSSIBLE;
        }
        let beyond: f64 = shares.iter().map(|share| (share - share.clamp(0.0, 1.0)).abs()).sum();
        let candidate = self.search.candidate(shares).ok();
        let score = candidate.and_then(|candidate| self.judge.estimate(&candidate).ok());
        let (cost, sigma_m) = score.map_or((IMPOSSIBLE, f64::INFINITY), |score| (score.cost(), score.sigma_m));
        let done = self.evaluations.fetch_add(1, Ordering::Relaxed) + 1;
        let mut best = lock(&self.best);
        // Equal costs: the first in the order of the quantities, whichever thread came first.
        if cost < best.cost || (cost == best.cost && shares < &best.shares) {
            *best = Best { cost, sigma_m, shares: shares.clone() };
        }
        lock(&self.progress)(done, best.sigma_m);
        cost + 10.0 * beyond
    }

    fn descend(&self, start: &Shares) {
        let steps = (STEPS * start.len()) as u64;
        let mut best = (f64::INFINITY, start.clone());
        for number in 0..SIMPLEXES {
            let edge = EDGE / (1.0 + number as f64 / 2.0);
            let mut simplex = vec![best.1.clone()];
            for k in 0..start.len() {
                let mut corner = best.1.clone();
                let is_up = (corner[k] > 0.5) == (number % 2 == 1);
                let moved = corner[k] + if is_up { edge } else { -edge };
                // Within the bounds, on whichever side.
                corner[k] = if (0.0..=1.0).contains(&moved) { moved } else { 2.0 * corner[k] - moved };
                simplex.push(corner);
            }
            let run = NelderMead::new(simplex).with_sd_tolerance(1e-5).and_then(|solver| {
                Executor::new(self, solver).configure(|state| state.max_iters(steps)).timer(false).run()
            });
            // Costs are no errors, and each is kept where it was found.
            let Ok(found) = run else { return };
            let gain = best.0 - found.state.get_best_cost();
            let Some(lowest) = found.state.get_best_param() else { return };
            best = (found.state.get_best_cost(), lowest.clone());
            if gain < GAIN && number > 0 {
                return;
            }
        }
    }
}

impl CostFunction for &Work<'_> {
    type Param = Shares;
    type Output = f64;

    fn cost(&self, shares: &Shares) -> Result<f64, Error> {
        Ok(self.cost_of(shares))
    }
}
