//! How the tool moves: its velocity, and its pose smoothed over frames.
//!
//! Each coordinate of the pose has several Kalman filters, with position, velocity and acceleration as their state. Each
//! assumes another noise of the jerk (white: Bar-Shalom, Li and Kirubarajan, Estimation with Applications to Tracking and
//! Navigation, 2001, section 6.2.3). The filter with the least noise has the longest memory; the one with the most takes
//! poses as they are. A filter is weighted by how well it predicts the poses (the same, section 11.6.2). The estimate is
//! the mean and the covariance of the weighted mixture, so it adapts to the motion, and σ is larger while the noise of the
//! motion is uncertain. A filter that predicts far worse than the best continues from the best one's state.
//!
//! A tool that hits something changes its velocity within a frame. A pose that no filter expects restarts all filters;
//! there is no velocity until the new one is known. A hit just before a frame cannot be seen in that frame. After hits, σ
//! of the velocity therefore includes the errors in such frames, averaged over all frames.
//!
//! Lengths and angles are in metres and radians, times in frames.

use core::ops::Range;

use arrayvec::ArrayVec;

use crate::pose::{Rigid, Twist};
use crate::scalar::{Linear3, Number};

use super::algebra::Matrix6;
use super::outcome::Estimate;
use super::tracker::{MAX_EXTRAPOLATED_FRAMES, UNKNOWN_ANGULAR_RAD_PER_S, UNKNOWN_LINEAR_M_PER_S};

/// Most filters of a coordinate.
const MAX_FILTERS: usize = 16;

/// Decades of noise from one filter to the next, unless that takes more than [`MAX_FILTERS`]: one of them is then so near to
/// the best that σ is right within a tenth.
const STEP_DECADES: f64 = 1.0;

/// Most noise of the jerk, in variances of a pose per frame⁵: a filter with it gives poses as they are.
const MAX_NOISE: f64 = 1e6;

/// Weight of a filter that predicts badly, relative to the best one's: how probable it is that the motion changes from
/// one frame to the next.
const MIN_WEIGHT: f64 = 6e-6;

/// The same after a restart, when little is known of the motion.
const MIN_WEIGHT_AT_RESTART: f64 = 0.05;

/// Squared distance from the expected pose beyond which the motion starts anew, in units of its variance: of all
/// coordinates together (χ² with six degrees of freedom exceeds it once in 10⁵ frames), and of the farthest alone.
const JUMP: f64 = 33.0;
const JUMP_OF_ONE: f64 = 20.0;

/// Squared distance of the farthest coordinate beyond which the tool has hit something. Less is also what a motion does that
/// becomes faster than the filters have learnt.
const HIT: f64 = 25.0;

/// Squared distance of the farthest coordinate from which on a pose may be the first of a new motion, so that the frame has no
/// velocity; and the same of a tool that has hit something lately.
const DOUBTFUL: f64 = 16.0;
const DOUBTFUL_AFTER_HITS: f64 = 6.25;

/// Frames after a restart before there is a velocity.
const FRAMES_TO_VELOCITY: u32 = 3;

/// How long hits are remembered, seconds.
const HITS_S: f64 = 0.5;

/// σ of an unknown velocity and acceleration: a fast hand that hits something. Metres, radians, seconds.
const UNKNOWN: [[f64; 2]; 2] = [[UNKNOWN_LINEAR_M_PER_S, 1e3], [UNKNOWN_ANGULAR_RAD_PER_S, 1e4]];

/// By how many σ of a pose a tool whose velocity has changed may be off and go unnoticed, in the first frame after the hit
/// and in those that are doubtful, together. A change of velocity by v then goes unseen for this times σ/v frames, and the
/// velocity is wrong by v for so long: squared, this times σ·v a hit.
const UNSEEN_SIGMAS: f64 = 8.0;

/// A small step has come through by half after this many times 1/α − 1 frames, α the share of the newest pose.
const LAG: f64 = 0.58;

/// Velocity of the tool with its covariance.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TwistEstimate<S = f64> {
    /// In the base frame.
    pub twist: Twist,
    /// Of (linear, angular): m²/s², m·rad/s², rad²/s².
    pub covariance: Matrix6<S>,
}

/// Why a frame has no twist.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum NoTwist {
    /// It has no pose, or one of a board, which sends no twist.
    NoPose,
    /// There were too few poses yet.
    Start,
    /// The tool is not where its motion led: it has hit something, or the pose is wrong.
    Jump,
}

/// A filtered pose: from the frame and those before.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Filtered<S = f64> {
    /// At the reference instant of the newest frame.
    pub estimate: Estimate<S>,
    /// At the same instant.
    pub twist: Result<TwistEstimate<S>, NoTwist>,
    /// Time after which half of a sudden step of the pose that is smaller than the noise has come through. Steady motion and
    /// steady acceleration come through without delay.
    pub lag_s: S,
    /// Frames since the motion last started anew.
    pub frames: u32,
}

/// The filters of one coordinate: number k of each array is that of filter k.
#[derive(Clone, Debug)]
struct Coordinate<S> {
    /// Those that count: the ones of more than the least weight, and one more on each side. The others would continue from
    /// the best one's state in each frame; they do so once they are next to one that counts.
    active: Range<usize>,
    position: [S; MAX_FILTERS],
    velocity: [S; MAX_FILTERS],
    acceleration: [S; MAX_FILTERS],
    /// Rows 0, 1, 2 of the upper half: 00, 01, 02, 11, 12, 22.
    covariance: [[S; MAX_FILTERS]; 6],
    /// Sum to one over those that count.
    weights: [S; MAX_FILTERS],
    /// How far the newest pose is from where each filter expects it, and the variance of that.
    distance: [S; MAX_FILTERS],
    variance: [S; MAX_FILTERS],
    /// Variance of the velocity by hits that are not seen yet.
    hits: S,
    /// Velocity before the last restart, until the new one is known.
    before: Option<S>,
}

#[derive(Clone, Debug)]
pub struct MotionEstimator<S: Number> {
    period_s: f64,
    /// Noise of each filter, in variances of a pose per frame⁵.
    noises: ArrayVec<S, MAX_FILTERS>,
    /// Positions are relative to this.
    reference: Rigid<S>,
    coordinates: [Coordinate<S>; 6],
    /// Of the last pose.
    variances: [S; 6],
    next_frame: u64,
    /// Since the restart; 0: none at all.
    frames: u32,
    /// Since the last hit.
    since_hit: Option<u32>,
    is_doubtful: bool,
    /// Whether the motion last started anew because a pose was not where it led.
    has_jumped: bool,
}

impl<S: Number> MotionEstimator<S> {
    /// For frames `period_s` apart. A filter whose α is 3 frames per memory remembers as a fading memory of `memory_s` does,
    /// in which a frame counts m/(1 + m) of the next, m = `memory_s`/`period_s`; none remembers longer.
    pub fn new(period_s: f64, memory_s: f64) -> Self {
        let frames = (memory_s / period_s).max(1.0);
        let least = 6.0 * libm::log10(1.5 / frames);
        let decades = libm::log10(MAX_NOISE) - least;
        let steps = libm::ceil(decades / STEP_DECADES).clamp(1.0, MAX_FILTERS as f64 - 1.0);
        let noise = |k: usize| S::of(libm::pow(10.0, least + decades * k as f64 / steps));
        let none = [S::zero(); MAX_FILTERS];
        let coordinate = Coordinate {
            active: 0..0,
            position: none,
            velocity: none,
            acceleration: none,
            covariance: [none; 6],
            weights: none,
            distance: none,
            variance: none,
            hits: S::zero(),
            before: None,
        };
        Self {
            period_s,
            noises: (0..=steps as usize).map(noise).collect(),
            reference: Rigid::home(),
            coordinates: core::array::from_fn(|_| coordinate.clone()),
            variances: [S::zero(); 6],
            next_frame: 0,
            frames: 0,
            since_hit: None,
            is_doubtful: false,
            has_jumped: false,
        }
    }

    /// Takes the pose of frame `frame` and its covariance. Frames are numbered without gaps; some may have no pose.
    pub fn update(&mut self, frame: u64, measured: &Rigid<S>, covariance: &Matrix6<S>) {
        let passed = frame
            .checked_sub(self.next_frame)
            .filter(|passed| *passed <= u64::from(MAX_EXTRAPOLATED_FRAMES) && self.frames > 0);
        self.next_frame = frame.wrapping_add(1);
        let Some(passed) = passed else {
            self.variances = core::array::from_fn(|i| covariance[i][i]);
            return self.restart(measured);
        };
        (0..=passed).for_each(|_| self.predict());
        self.variances = core::array::from_fn(|i| covariance[i][i]);
        let [t, r] = measured.displacement_from(&self.reference);
        let (mut sum, mut most) = (S::zero(), S::zero());
        for (i, found) in [t.x(), t.y(), t.z(), r.x(), r.y(), r.z()].into_iter().enumerate() {
            let squared = self.coordinates[i].innovate(found, self.variances[i]);
            (sum, most) = (sum + squared, most.max(squared));
        }
        // Written so that NaN is a jump.
        let is_expected = sum <= S::of(JUMP) && most <= S::of(JUMP_OF_ONE);
        if !is_expected {
            let is_hit = most > S::of(HIT);
            for coordinate in self.coordinates.iter_mut().filter(|_| is_hit) {
                let velocity = coordinate.mean(&coordinate.velocity);
                coordinate.before.get_or_insert(velocity);
            }
            if is_hit {
                self.since_hit = Some(0);
            }
            self.restart(measured);
            self.has_jumped = true;
            return;
        }
        self.since_hit = self.since_hit.map(|frames| frames.saturating_add(1));
        let has_hit = self.since_hit.is_some_and(|frames| f64::from(frames) * self.period_s < HITS_S);
        self.is_doubtful = most > S::of(if has_hit { DOUBTFUL_AFTER_HITS } else { DOUBTFUL });
        self.frames = self.frames.saturating_add(1);
        let share = (self.period_s / HITS_S).min(1.0);
        let count = self.noises.len();
        for (i, coordinate) in self.coordinates.iter_mut().enumerate() {
            coordinate.correct(count, self.variances[i]);
            coordinate.hits *= S::of(1.0 - share);
            if self.frames > FRAMES_TO_VELOCITY
                && let Some(before) = coordinate.before.take()
            {
                let change = (coordinate.mean(&coordinate.velocity) - before).abs();
                coordinate.hits += S::of(share * UNSEEN_SIGMAS) * self.variances[i].root() * change;
            }
        }
    }

    /// Begins with the pose `measured`, of which nothing but its variances is known.
    fn restart(&mut self, measured: &Rigid<S>) {
        let count = self.noises.len();
        self.reference = *measured;
        for (i, coordinate) in self.coordinates.iter_mut().enumerate() {
            let [velocity, acceleration] = UNKNOWN[i / 3];
            let square = |sigma: f64| S::of(sigma * sigma);
            coordinate.position = [S::zero(); MAX_FILTERS];
            coordinate.velocity = [S::zero(); MAX_FILTERS];
            coordinate.acceleration = [S::zero(); MAX_FILTERS];
            let of = [
                self.variances[i],
                S::zero(),
                S::zero(),
                square(velocity * self.period_s),
                S::zero(),
                square(acceleration * self.period_s * self.period_s),
            ];
            coordinate.covariance = of.map(|value| [value; MAX_FILTERS]);
            // At the very first, all alike.
            let least = if self.frames == 0 { S::one() } else { S::of(MIN_WEIGHT_AT_RESTART) };
            // Those that did not count weigh nothing.
            (0..count).filter(|k| !coordinate.active.contains(k)).for_each(|k| coordinate.weights[k] = S::zero());
            coordinate.active = 0..count;
            coordinate.raise_weights(least);
        }
        (self.frames, self.is_doubtful, self.has_jumped) = (1, false, false);
    }

    /// One frame later.
    fn predict(&mut self) {
        let mut by = [S::zero(); 6];
        for (i, coordinate) in self.coordinates.iter_mut().enumerate() {
            coordinate.predict(&self.noises, self.variances[i]);
            by[i] = coordinate.mean(&coordinate.position);
            for k in coordinate.active.clone() {
                coordinate.position[k] -= by[i];
            }
        }
        self.reference = self.moved(by);
    }

    fn moved(&self, by: [S; 6]) -> Rigid<S> {
        self.reference.perturbed(S::Vec3::new(by[0], by[1], by[2]), S::Vec3::new(by[3], by[4], by[5]))
    }

    /// The twist, after a pose of this covariance.
    pub fn twist(&self, covariance: &Matrix6<S>) -> Result<TwistEstimate<S>, NoTwist> {
        if self.frames <= FRAMES_TO_VELOCITY {
            return Err(if self.has_jumped { NoTwist::Jump } else { NoTwist::Start });
        }
        if self.is_doubtful {
            return Err(NoTwist::Jump);
        }
        let per_second = S::of(self.period_s.recip());
        let mixed = self.coordinates.each_ref().map(|one| {
            let (mean, variance) = one.mixture(&one.velocity, &one.covariance[3]);
            (mean * per_second, (variance + one.hits) * per_second * per_second)
        });
        let v = mixed.map(|(mean, _)| mean.as_f64());
        let twist = Twist {
            linear_m_per_s: glam::DVec3::new(v[0], v[1], v[2]),
            angular_rad_per_s: glam::DVec3::new(v[3], v[4], v[5]),
        };
        Ok(TwistEstimate { twist, covariance: self.covariance(covariance, &mixed.map(|(_, variance)| variance)) })
    }

    /// The smoothed pose, after a pose of this covariance.
    pub fn filtered(&self, covariance: &Matrix6<S>) -> Filtered<S> {
        let mixed = self.coordinates.each_ref().map(|one| one.mixture(&one.position, &one.covariance[0]));
        let least = self.newest_shares().into_iter().fold(S::one(), S::min);
        Filtered {
            estimate: Estimate {
                pose: self.moved(mixed.map(|(mean, _)| mean)).to_pose(),
                covariance: self.covariance(covariance, &mixed.map(|(_, variance)| variance)),
            },
            twist: self.twist(covariance),
            lag_s: S::of(LAG * self.period_s) * (least.recip() - S::one()),
            frames: self.frames,
        }
    }

    /// α of each coordinate: the share of the newest pose in the smoothed one.
    fn newest_shares(&self) -> [S; 6] {
        core::array::from_fn(|i| {
            let one = &self.coordinates[i];
            one.mean(&one.covariance[0]) / self.variances[i]
        })
    }

    /// Of errors with these `variances`, by poses with errors of this covariance. Two coordinates whose filters remember so
    /// differently share less of their noise: as filters of first order, 2·√(αβ)/(α + β) of the correlation is left.
    fn covariance(&self, of_pose: &Matrix6<S>, variances: &[S; 6]) -> Matrix6<S> {
        let shares = self.newest_shares();
        let by: [S; 6] = core::array::from_fn(|i| (variances[i] * shares[i] / of_pose[i][i]).root());
        core::array::from_fn(|i| {
            core::array::from_fn(|j| of_pose[i][j] * by[i] * by[j] * S::two() / (shares[i] + shares[j]))
        })
    }
}

impl<S: Number> Coordinate<S> {
    /// One frame later: x + v + a/2, v + a, a, with white noise in the jerk, in units of `variance`.
    fn predict(&mut self, noises: &[S], variance: S) {
        let half = S::half();
        let [p00, p01, p02, p11, p12, p22] = &mut self.covariance;
        for k in self.active.clone() {
            let q = noises[k] * variance;
            self.position[k] += self.velocity[k] + half * self.acceleration[k];
            self.velocity[k] += self.acceleration[k];
            p00[k] += S::two() * p01[k] + p02[k] + p11[k] + p12[k] + half * half * p22[k] + q * S::of(1.0 / 20.0);
            p01[k] += p02[k] + p11[k] + S::of(1.5) * p12[k] + half * p22[k] + q * S::of(1.0 / 8.0);
            p02[k] += p12[k] + half * p22[k] + q * S::of(1.0 / 6.0);
            p11[k] += S::two() * p12[k] + p22[k] + q * S::of(1.0 / 3.0);
            p12[k] += p22[k] + half * q;
            p22[k] += q;
        }
    }

    /// Takes the newest pose, of variance `noise`; its squared distance from the expected one, in units of its variance.
    fn innovate(&mut self, measured: S, noise: S) -> S {
        for k in self.active.clone() {
            self.distance[k] = measured - self.position[k];
            self.variance[k] = self.covariance[0][k] + noise;
        }
        let (mean, variance) = self.mixture(&self.distance, &self.variance);
        mean * mean / variance
    }

    /// Corrects the filters, of which there are `count`, by the newest pose.
    fn correct(&mut self, count: usize, noise: S) {
        let [p00, p01, p02, p11, p12, p22] = &mut self.covariance;
        for k in self.active.clone() {
            let (distance, inverse) = (self.distance[k], self.variance[k].recip());
            let gains = [p00[k], p01[k], p02[k]].map(|value| value * inverse);
            self.position[k] += gains[0] * distance;
            self.velocity[k] += gains[1] * distance;
            self.acceleration[k] += gains[2] * distance;
            p11[k] -= gains[1] * p01[k];
            p12[k] -= gains[1] * p02[k];
            p22[k] -= gains[2] * p02[k];
            // 1 − α = noise/variance, without cancellation.
            let left = noise * inverse;
            (p00[k], p01[k], p02[k]) = (p00[k] * left, p01[k] * left, p02[k] * left);
            // The normal density of the distance, but for a factor that all filters share.
            self.weights[k] *= (-S::half() * distance * distance * inverse).exponential() * left.root();
        }
        let best = self.best();
        let floor = self.weights[best] * S::of(MIN_WEIGHT);
        let counts = |k: &usize| self.weights[*k] > floor;
        let first = self.active.clone().find(counts).unwrap_or(best);
        let last = self.active.clone().rfind(counts).unwrap_or(best);
        let were_active = core::mem::replace(&mut self.active, first.saturating_sub(1)..(last + 2).min(count));
        for k in self.active.clone() {
            if !were_active.contains(&k) || self.weights[k] <= floor {
                self.position[k] = self.position[best];
                self.velocity[k] = self.velocity[best];
                self.acceleration[k] = self.acceleration[best];
                self.covariance.iter_mut().for_each(|of| of[k] = of[best]);
                self.weights[k] = floor;
            }
        }
        self.raise_weights(S::of(MIN_WEIGHT));
    }

    /// The filter of the greatest weight.
    fn best(&self) -> usize {
        self.active
            .clone()
            .fold(self.active.start, |best, k| if self.weights[k] > self.weights[best] { k } else { best })
    }

    /// No weight less than `least` times the greatest; all sum to one.
    fn raise_weights(&mut self, least: S) {
        let greatest = self.weights[self.best()];
        let least = if greatest > S::zero() { greatest * least } else { S::one() };
        let weights = &mut self.weights[self.active.clone()];
        weights.iter_mut().for_each(|weight| *weight = weight.max(least));
        let inverse = weights.iter().fold(S::zero(), |sum, &weight| sum + weight).recip();
        weights.iter_mut().for_each(|weight| *weight *= inverse);
    }

    /// Of numbers of all filters, by weight.
    fn mean(&self, of: &[S; MAX_FILTERS]) -> S {
        self.active.clone().fold(S::zero(), |sum, k| sum + self.weights[k] * of[k])
    }

    /// Mean and variance of a mixture of distributions with these means and variances.
    fn mixture(&self, means: &[S; MAX_FILTERS], variances: &[S; MAX_FILTERS]) -> (S, S) {
        let mean = self.mean(means);
        let variance = self.active.clone().fold(S::zero(), |sum, k| {
            let off = means[k] - mean;
            sum + self.weights[k] * (variances[k] + off * off)
        });
        (mean, variance)
    }
}
