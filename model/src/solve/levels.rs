//! What single emitters deviate from the common light level, followed while the tool moves.
//!
//! Emitters warm and age, each in its own way. The part that is common to all is an unknown of each frame
//! ([`super::level`]). What is left of each changes slowly: a process of mean zero that forgets with a time constant
//! (Uhlenbeck and Ornstein 1930), whose standard deviation is the tolerance of the scene. One frame says little of it,
//! because pose and levels explain nearly the same currents; frames from many places tell them apart.
//!
//! A frame's whitened residuals are r = C·x + c·g + A·p + τ·A·v + n: deviations x, common level g, pose p, the motion v within
//! the frame as far as it is not known, and noise of unit variance. A Kalman filter takes them one after another (Maybeck
//! 1979, section 7.7), with a pose of which nothing is known beforehand, and what it then knows of x is kept. Currents are
//! divided by 1 + x before their pose is found, and the variance of x counts as one of the emitter's gain.
//!
//! The errors of a calibrated model belong to a place. A frame from where the tool was before would bring the same errors as
//! if they were new: it counts only once the tool has moved on.

use heapless::Vec;

use crate::entries::Scalar;
use crate::pose::Rigid;
use crate::scalar::{Linear3, Number};
use crate::scene::{MAX_CELLS, Scene};

use super::compiled::LEVEL_CELLS;
use super::normal_equations::Workspace;
use super::outcome::{MAX_MEAN_MISFIT, MAX_MISFIT, Outcome, Solution};
use super::readings::{Photocurrents, Reading, Sorted};
use super::tracker::PoseTracker;
use super::weights::{CellNoise, Row};

/// How far the tool moves to a new place: the ripple of detectors is longer, the spot of a slit narrower.
const NEW_PLACE_M: f64 = 0.5e-3;

/// Seconds after which the same place counts again.
const AGAIN_S: f64 = 10.0;

/// Frames between two that count, so that a fast tool does not pay for it in each.
const PAUSE_FRAMES: u64 = 8;

/// Frames over which it is judged whether the head is as its scene and these levels say: by the share of those that contradict
/// it, and by the mean χ² over redundancy of the others, which has a standard deviation of 0.06 where five data are redundant.
const JUDGED_FRAMES: f64 = 64.0;

/// With more than this share, or a mean above [`MAX_MEAN_MISFIT`], it is not: nothing is learnt. Either part of the head is not
/// as the scene says, or an emitter has changed at once.
const TROUBLED: f64 = 0.05;

/// An emitter has changed if so many frames have no more than this mean χ² over redundancy with its level free, and more with
/// all levels as they are.
const SUSPECTED_FRAMES: u32 = 32;
const EXPLAINED: f64 = 1.25;

/// Standard deviation of the level of an emitter that has changed at once: next to nothing is known of it.
const CHANGED: f64 = 3.0;

/// Standard deviation of a pose of which nothing is known, in units of the head's length: wide against any pose, narrow
/// enough that its square loses no digits.
const ANYWHERE: f64 = 0.1;

/// Unknowns beside the deviations: common level, pose, motion.
const OTHERS: usize = 13;
const UNKNOWNS: usize = MAX_CELLS + OTHERS;

/// What a frame says of levels, and the standard deviations of what is known of motion within it.
#[derive(Clone, Debug)]
pub struct Observation<S> {
    /// Of each reading its cell, the exposure in units of the frame's duration, and the whitened rows.
    readings: Vec<(usize, S, [Row<S>; 2]), MAX_CELLS>,
    reach: [S; 2],
    level_sigma: S,
}

/// Deviations of emitters, relative to the head's scene and the common level.
#[derive(Clone, Debug)]
pub struct Levels<S: Number> {
    /// The emitter of each cell: cells that read one detector share it.
    emitters: Vec<usize, MAX_CELLS>,
    /// Variance of the gain of each cell's emitter by the scene alone.
    gains: Vec<S, MAX_CELLS>,
    /// Standard deviation and time constant in frames.
    sigma: S,
    frames: f64,
    deviations: [S; MAX_CELLS],
    covariance: [[S; MAX_CELLS]; MAX_CELLS],
    /// Share of the last frames that contradict the head, and mean χ² over redundancy of the others.
    contradicting: S,
    misfit: S,
    /// Sums of χ² over redundancy with the level of each emitter free, and with none free, of so many frames in trouble.
    suspicions: [S; MAX_CELLS],
    unexplained: S,
    suspected: u32,
    /// The last frame that counted, and where the tool was.
    counted: Option<(u64, Rigid<S>)>,
    /// Up to which the process has been followed.
    frame: u64,
}

/// The emitters, each once, of cells that have these.
fn own(emitters: &[usize]) -> impl Iterator<Item = usize> + '_ {
    emitters.iter().enumerate().filter(|(cell, emitter)| cell == *emitter).map(|(cell, _)| cell)
}

impl<S: Number> Levels<S> {
    /// Of a head of `scene` with frames `period_s` apart; `None`: its emitters do not drift, or it does not tell levels.
    pub fn of(scene: &Scene, noise: &[CellNoise<S>], period_s: f64) -> Option<Self> {
        let sigma = S::of(scene.uncertainty.emitter_drift_relative);
        let is_told = scene.uncertainty.light_level_relative > 0.0 && scene.cells.len() >= LEVEL_CELLS;
        let emitters: Vec<usize, MAX_CELLS> =
            scene.cells.iter().enumerate().map(|(number, cell)| cell.emitter(number)).collect();
        if sigma <= S::zero() || !is_told || own(&emitters).count() < 2 {
            return None;
        }
        let mut covariance = [[S::zero(); MAX_CELLS]; MAX_CELLS];
        (0..MAX_CELLS).for_each(|i| covariance[i][i] = sigma * sigma);
        Some(Self {
            emitters,
            gains: noise.iter().map(|noise| noise.emitter_gain).collect(),
            sigma,
            frames: scene.uncertainty.emitter_drift_s / period_s,
            deviations: [S::zero(); MAX_CELLS],
            covariance,
            contradicting: S::zero(),
            misfit: S::one(),
            suspicions: [S::zero(); MAX_CELLS],
            unexplained: S::zero(),
            suspected: 0,
            counted: None,
            frame: 0,
        })
    }

    /// Relative variance of the light of each cell's emitter, without what is common to all: that each frame finds.
    pub fn variances(&self) -> Vec<S, MAX_CELLS> {
        let per_emitter = S::of((own(&self.emitters).count() as f64).recip());
        let mean = |of: &dyn Fn(usize) -> S| {
            own(&self.emitters).fold(S::zero(), |sum, emitter| sum + of(emitter)) * per_emitter
        };
        let with_all = |row: usize| mean(&|column| self.covariance[row][column]);
        let common = mean(&with_all);
        // Of n deviations from their mean the variance is by 1/n too small.
        let of = |&emitter: &usize| {
            let from_mean = self.covariance[emitter][emitter] - S::two() * with_all(emitter) + common;
            from_mean.at_least(S::zero()) / (S::one() - per_emitter)
        };
        self.emitters.iter().map(of).collect()
    }

    /// Relative deviation of each cell's emitter from the common level, and its standard deviation.
    pub fn deviations(&self) -> Vec<[S; 2], MAX_CELLS> {
        let of = |(variance, &emitter): (S, &usize)| [self.deviations[emitter], variance.root()];
        self.variances().into_iter().zip(&self.emitters).map(of).collect()
    }

    /// The currents that emitters as in the scene would give.
    pub fn corrected(&self, readings: &Photocurrents<S>) -> Photocurrents<S> {
        let mut corrected = readings.clone();
        for (reading, &emitter) in corrected.cells.iter_mut().zip(&self.emitters) {
            if let Reading::Light(pair) = reading {
                let factor = (S::one() + self.deviations[emitter]).recip();
                (pair.i_x1_a, pair.i_x2_a) = (pair.i_x1_a * factor, pair.i_x2_a * factor);
            }
        }
        corrected
    }

    /// Whether frame `frame`, with the tool at `pose`, counts.
    fn is_new(&self, frame: u64, pose: &Rigid<S>, length_m: S, period_s: f64) -> bool {
        let Some((last, place)) = &self.counted else { return true };
        let frames = frame.wrapping_sub(*last);
        let [shift, turn] = pose.displacement_from(place);
        let moved = shift.length() + length_m * turn.length();
        frames >= PAUSE_FRAMES && (moved >= S::of(NEW_PLACE_M) || frames as f64 * period_s >= AGAIN_S)
    }

    /// Counts a frame with this solution; whether levels can be told by it at all.
    fn judge(&mut self, solution: &Solution<S>) -> bool {
        let is_converged = solution.outcome == Outcome::Converged;
        if !is_converged && !solution.outcome.is_contradiction() {
            return false;
        }
        let contradicts = if is_converged { S::zero() } else { S::one() };
        let part = S::of(JUDGED_FRAMES.recip());
        self.contradicting += (contradicts - self.contradicting) * part;
        if is_converged && solution.redundancy > 0 {
            let misfit = solution.chi2 / S::of(solution.redundancy as f64);
            self.misfit += (misfit.min(S::of(MAX_MISFIT)) - self.misfit) * part;
        }
        is_converged || self.is_in_trouble()
    }

    fn is_in_trouble(&self) -> bool {
        self.contradicting > S::of(TROUBLED) || self.misfit > S::of(MAX_MEAN_MISFIT)
    }

    /// Tries with each emitter whether a change of it explains a frame in trouble; after many, takes the best for changed.
    fn suspect(&mut self, observation: &Observation<S>) {
        // Of a frame's data, six are the pose's and one the common level's.
        let redundancy = (2 * observation.readings.len()).saturating_sub(OTHERS - 6).max(2);
        let misfit = |mut levels: Self, freed: usize| {
            let misfit = levels.update(observation) / S::of((redundancy - freed) as f64);
            misfit.min(S::of(MAX_MISFIT))
        };
        self.unexplained += misfit(self.clone(), 0);
        for emitter in own(&self.emitters) {
            let mut changed = self.clone();
            changed.set_free(emitter);
            self.suspicions[emitter] += misfit(changed, 1);
        }
        self.suspected += 1;
        if self.suspected < SUSPECTED_FRAMES {
            return;
        }
        let best = own(&self.emitters).reduce(|a, b| if self.suspicions[b] < self.suspicions[a] { b } else { a });
        let enough = S::of(EXPLAINED * f64::from(SUSPECTED_FRAMES));
        if let Some(emitter) = best
            && self.suspicions[emitter] <= enough
            && self.unexplained > enough
        {
            self.set_free(emitter);
            self.update(observation);
            (self.contradicting, self.misfit) = (S::zero(), S::one());
        }
        self.acquit();
    }

    fn acquit(&mut self) {
        (self.suspicions, self.unexplained, self.suspected) = ([S::zero(); MAX_CELLS], S::zero(), 0);
    }

    /// Forgets what is known of an emitter that has changed at once.
    fn set_free(&mut self, emitter: usize) {
        self.covariance[emitter] = [S::zero(); MAX_CELLS];
        self.covariance.iter_mut().for_each(|row| row[emitter] = S::zero());
        self.covariance[emitter][emitter] = S::of(CHANGED * CHANGED);
    }

    /// What the process does up to frame `frame`.
    fn advance(&mut self, frame: u64) {
        let frames = frame.saturating_sub(self.frame);
        self.frame = frame;
        let kept = S::of(libm::exp(-(frames as f64) / self.frames));
        let added = self.sigma * self.sigma * (S::one() - kept * kept);
        for i in 0..MAX_CELLS {
            self.deviations[i] *= kept;
            self.covariance[i].iter_mut().for_each(|element| *element = *element * kept * kept);
            self.covariance[i][i] += added;
        }
    }

    /// Takes what a frame says, and returns χ² of what it says that was not expected.
    fn update(&mut self, observation: &Observation<S>) -> S {
        let count = self.emitters.len();
        let size = count + OTHERS;
        let mut state = [S::zero(); UNKNOWNS];
        let mut covariance = [[S::zero(); UNKNOWNS]; UNKNOWNS];
        for i in 0..count {
            covariance[i][..count].copy_from_slice(&self.covariance[i][..count]);
        }
        let mut sigmas = [S::of(ANYWHERE); OTHERS];
        sigmas[0] = observation.level_sigma;
        (0..6).for_each(|axis| sigmas[7 + axis] = observation.reach[axis / 3]);
        for (i, &sigma) in (count..size).zip(&sigmas) {
            covariance[i][i] = sigma * sigma;
        }
        let mut chi2 = S::zero();
        let rows = observation
            .readings
            .iter()
            .flat_map(|(cell, share, rows)| rows.iter().map(move |row| (*cell, *share, row)));
        for (cell, share, row) in rows {
            let mut of = [S::zero(); UNKNOWNS];
            of[self.emitters[cell]] = row.by_level;
            of[count] = row.by_level;
            for (axis, &by) in row.by_pose.iter().enumerate() {
                (of[count + 1 + axis], of[count + 7 + axis]) = (by, share * by);
            }
            let product = |a: &[S; UNKNOWNS], b: &[S; UNKNOWNS]| (0..size).fold(S::zero(), |sum, i| sum + a[i] * b[i]);
            let mut gain = [S::zero(); UNKNOWNS];
            (0..size).for_each(|i| gain[i] = product(&covariance[i], &of));
            let per_variance = (S::one() + product(&of, &gain)).recip();
            let unexpected = row.residual - product(&of, &state);
            let innovation = unexpected * per_variance;
            chi2 += unexpected * innovation;
            for i in 0..size {
                state[i] += gain[i] * innovation;
                let share = gain[i] * per_variance;
                (0..size).for_each(|j| covariance[i][j] -= share * gain[j]);
            }
        }
        for i in 0..count {
            self.deviations[i] += state[i];
            self.covariance[i][..count].copy_from_slice(&covariance[i][..count]);
        }
        chi2
    }
}

impl<S: Scalar> PoseTracker<S> {
    /// Takes what frame `frame` with these `readings`, already corrected, says of `levels`, if it says anything new.
    pub(crate) fn observe_levels(
        &mut self,
        levels: &mut Levels<S>,
        frame: u64,
        readings: &Photocurrents<S>,
        solution: &Solution<S>,
    ) {
        let length_m = self.solver().compiled.length_scale_m;
        let can_tell = levels.judge(solution);
        if !can_tell || !levels.is_new(frame, &solution.rigid, length_m, self.period_s()) {
            return;
        }
        levels.advance(frame);
        self.set_emitter_gains(&levels.gains);
        if let Some(observation) = S::observe(self, readings, solution)
            && observation.readings.len() >= LEVEL_CELLS
        {
            if levels.is_in_trouble() {
                levels.suspect(&observation);
            } else {
                levels.update(&observation);
                levels.acquit();
            }
            levels.counted = Some((frame, solution.rigid));
        }
        self.allow_for(levels);
    }

    /// Adds the variances of `levels` to those of the emitters' gains.
    pub(crate) fn allow_for(&mut self, levels: &Levels<S>) {
        let of = |((&gain, variance), number): ((&S, S), usize)| {
            // As shot noise: see [`CellNoise::compile`].
            let readers = levels.emitters.iter().filter(|&&emitter| emitter == levels.emitters[number]).count();
            gain + variance * S::of(readers as f64)
        };
        let gains: Vec<S, MAX_CELLS> = levels.gains.iter().zip(levels.variances()).zip(0..).map(of).collect();
        self.set_emitter_gains(&gains);
    }

    /// Takes single emitters for as well known as the scene says, as if no levels were followed.
    pub(crate) fn without(mut self, levels: &Levels<S>) -> Self {
        self.set_emitter_gains(&levels.gains);
        self
    }

    fn set_emitter_gains(&mut self, gains: &[S]) {
        let noise = &mut self.solver_mut().compiled.noise;
        noise.iter_mut().zip(gains).for_each(|(noise, &gain)| noise.emitter_gain = gain);
    }

    #[inline(always)]
    pub(crate) fn observe_here(&self, readings: &Photocurrents<S>, solution: &Solution<S>) -> Option<Observation<S>> {
        let compiled = &self.solver().compiled;
        let mut sorted = Sorted::of(readings, &compiled.limits);
        let level_sigma = compiled.level_information(sorted.usable.len())?.inverse_root();
        sorted.divide_by(self.light_level()?);
        let motion = self.expected_motion()?;
        let workspace = &mut Workspace::new();
        let problem = compiled.problem(&sorted, &motion);
        problem.linearise(&solution.rigid.to_transform(), workspace);
        let duration = compiled.duration_s();
        let reach = [motion.sigmas[0] * duration / compiled.length_scale_m, motion.sigmas[1] * duration];
        let of_readings = sorted.usable.iter().zip(&workspace.rows);
        let readings = of_readings.map(|(reading, rows)| (reading.cell, problem.share(reading), *rows)).collect();
        Some(Observation { readings, reach, level_sigma })
    }
}
