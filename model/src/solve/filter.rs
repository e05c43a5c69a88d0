//! A pose and its motion from many frames: a polynomial filter with fading memory.
//!
//! State is a pose X, its change V per frame and half the change A of that, on the manifold of
//! poses: the error between a measured and a predicted pose is a displacement (δt, δθ), and corrects
//! X by α, V by β, A by γ of it. The gains are those of a parabola fitted by least squares to all
//! poses since the start, later to poses that count less the older they are, by θ a frame (Morrison,
//! Introduction to Sequential Smoothing and Prediction, 1969, chapters 12 and 13). All axes share
//! them, so that the covariance of (X, V, A) is a 3×3 matrix of numbers times that of a single pose,
//! and follows from the gains exactly.
//!
//! A parabola through many frames has little noise and cuts corners. As long as its predictions err
//! by no more than noise explains, the memory grows up to the one asked for; when they err by more, it
//! shrinks: the pose of a resting tool has the noise of many frames, that of a swinging one has no delay.

use glam::DVec3;

use crate::pose::{Pose, Twist};

use super::algebra::Matrix6;
use super::outcome::Estimate;

/// Squared error above which more than chance is at work: the running mean of χ²₆/6 has a standard
/// deviation of 0.06 about 1.
const CHANCE: f64 = 1.2;

/// Frames from which on a parabola is fitted; before, a line.
const PARABOLA_FROM: u32 = 4;

/// Share of the newest frame in the running mean of squared errors.
const NEWEST: f64 = 0.02;

/// The same for the means that show the bends of translations and of rotations.
const NEWEST_BEND: f64 = 0.01;

/// Mean squared error of translations or rotations alone that chance explains, above 1: 2.7 of its
/// standard deviations.
const CHANCE_BEND: f64 = 0.16;

/// Squared velocity error of a swinging tool, relative to that of a tool whose acceleration changes steadily, both
/// with the same error of the predicted pose: 1.0 to 1.35 for hands.
const SWING: f64 = 1.2;

/// The same for the mean that an alarm is raised by, and where: three standard deviations of the mean
/// of χ²₆/6 above 1.
const NEWEST_ALARM: f64 = 0.2;
const ALARM: f64 = 1.6;

/// How much an alarm shortens the memory, and a frame without one prolongs it.
const SHRINK: f64 = 0.7;
const GROW: f64 = 1.03;

/// Shortest memory, frames: three and a half of them count.
const SHORTEST: f64 = 2.0;

/// Frames of lag per frame of memory: of a step too small to raise the alarm half has come through.
const LAG_PER_MEMORY: f64 = 0.2;

/// Velocity of the tool with its covariance.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TwistEstimate {
    /// In the base frame.
    pub twist: Twist,
    /// Of (linear, angular): m²/s², m·rad/s², rad²/s².
    pub covariance: Matrix6<f64>,
}

/// A filtered pose: from the frame and those before.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Filtered {
    /// At the reference instant of the newest frame. Its covariance grows with the distance of the poses
    /// from the parabola.
    pub estimate: Estimate,
    /// At the same instant.
    pub twist: TwistEstimate,
    /// Time after which half of a sudden step of the pose that is smaller than the noise has come
    /// through: a fifth of the present memory. Steady motion and steady acceleration
    /// come through without delay.
    pub lag_s: f64,
    /// Frames since the memory began.
    pub frames: u32,
}

/// Six numbers: displacements, or their rates.
#[derive(Clone, Copy, Debug, Default)]
struct Displacement {
    translation: DVec3,
    rotation: DVec3,
}

impl Displacement {
    fn plus(self, factor: f64, other: Self) -> Self {
        Self {
            translation: self.translation + other.translation * factor,
            rotation: self.rotation + other.rotation * factor,
        }
    }

    fn twist(self, period_s: f64) -> Twist {
        Twist { linear_m_per_s: self.translation / period_s, angular_rad_per_s: self.rotation / period_s }
    }
}

/// Gains of one frame.
#[derive(Clone, Copy, Debug)]
struct Gains([f64; 3]);

impl Gains {
    /// Least squares over `n` + 1 frames.
    fn expanding(n: u32) -> Self {
        let m = f64::from(n);
        Self(match n {
            0 => [1.0, 0.0, 0.0],
            n if n < PARABOLA_FROM => {
                let product = (m + 1.0) * (m + 2.0);
                [2.0 * (2.0 * m + 1.0) / product, 6.0 / product, 0.0]
            }
            _ => {
                let product = (m + 1.0) * (m + 2.0) * (m + 3.0);
                [3.0 * (3.0 * m * m + 3.0 * m + 2.0) / product, 18.0 * (2.0 * m + 1.0) / product, 30.0 / product]
            }
        })
    }

    /// Least squares over all frames, each counting θ of the next.
    fn fading(theta: f64) -> Self {
        let fresh = 1.0 - theta;
        Self([1.0 - theta * theta * theta, 1.5 * fresh * fresh * (1.0 + theta), 0.5 * fresh * fresh * fresh])
    }
}

/// The filter.
#[derive(Clone, Debug)]
pub(super) struct FadingFilter {
    period_s: f64,
    /// Longest memory, frames.
    longest: f64,
    state: Option<State>,
}

#[derive(Clone, Copy, Debug)]
struct State {
    pose: Pose,
    step: Displacement,
    bend: Displacement,
    /// Covariance of (X, V, A) in units of a single pose's.
    spread: [[f64; 3]; 3],
    /// Frames taken.
    frames: u32,
    /// Frames of memory: θ = memory/(1 + memory).
    memory: f64,
    /// Running mean of the squared prediction error, 1 if noise explains it.
    strain: f64,
    /// The same of translations and of rotations alone: bends of the one are not those of the other.
    strains: [f64; 2],
    /// The same over few frames.
    alarm: f64,
}

/// What is expected of the next frame.
#[derive(Clone, Copy, Debug)]
pub(super) struct Prediction {
    pub(super) pose: Pose,
    pub(super) twist: Twist,
    /// Variance of the pose and of the change per frame, in units of a single pose's.
    pub(super) pose_variance: f64,
    pub(super) step_variance: f64,
    pub(super) frames: u32,
    /// Mean squared error of the last predictions in units of what noise explains, at least 1.
    pub(super) strain: f64,
}

impl FadingFilter {
    /// For frames `period_s` apart. With a memory of `memory_s` a frame counts m/(1 + m) of the next,
    /// m = `memory_s`/`period_s`.
    pub(super) fn new(period_s: f64, memory_s: f64) -> Self {
        Self { period_s, longest: (memory_s / period_s).max(SHORTEST), state: None }
    }

    pub(super) fn forget(&mut self) {
        self.state = None;
    }

    /// A frame without a pose: the motion goes on as it was.
    pub(super) fn coast(&mut self) {
        if let Some(state) = &mut self.state {
            *state = state.advanced();
        }
    }

    pub(super) fn predict(&self) -> Option<Prediction> {
        let next = self.state?.advanced();
        Some(Prediction {
            pose: next.pose,
            twist: next.step.twist(self.period_s),
            pose_variance: next.spread[0][0],
            step_variance: next.spread[1][1] + next.bent(),
            frames: next.frames,
            strain: next.strain.max(1.0),
        })
    }

    /// Takes the pose of the next frame and its covariance. `squared_sigmas` gives the squared length of a
    /// displacement (metres, radians) in σ of that pose.
    pub(super) fn update(
        &mut self,
        measured: &Pose,
        covariance: &Matrix6<f64>,
        squared_sigmas: impl Fn(DVec3, DVec3) -> f64,
    ) {
        let Some(state) = &mut self.state else {
            self.state = Some(State {
                pose: *measured,
                step: Displacement::default(),
                bend: Displacement::default(),
                spread: [[1.0, 0.0, 0.0], [0.0; 3], [0.0; 3]],
                frames: 1,
                memory: self.longest,
                strain: 1.0,
                strains: [1.0; 2],
                alarm: 1.0,
            });
            return;
        };
        let mut next = state.advanced();
        let (translation, rotation) = measured.displacement_from(&next.pose);
        let error = Displacement { translation, rotation };
        if next.frames > PARABOLA_FROM {
            let squared = squared_sigmas(translation, rotation) / (6.0 * (1.0 + next.spread[0][0]));
            next.strain += NEWEST * (squared - next.strain);
            next.alarm += NEWEST_ALARM * (squared - next.alarm);
            for (group, error) in [translation, rotation].into_iter().enumerate() {
                let of_axis = |i: usize| error[i] * error[i] / covariance[3 * group + i][3 * group + i];
                let squared = (0..3).map(of_axis).sum::<f64>() / (3.0 * (1.0 + next.spread[0][0]));
                next.strains[group] += NEWEST_BEND * (squared - next.strains[group]);
            }
            let factor = if next.alarm > ALARM { SHRINK } else { GROW };
            next.memory = (next.memory * factor).clamp(SHORTEST, self.longest);
        }
        let expanding = Gains::expanding(next.frames);
        let fading = Gains::fading(next.theta());
        let Gains(gains) = if expanding.0[0] > fading.0[0] { expanding } else { fading };
        next.pose = next.pose.perturbed(translation * gains[0], rotation * gains[0]);
        next.step = next.step.plus(gains[1], error);
        next.bend = next.bend.plus(gains[2], error);
        next.spread = corrected(&next.spread, &gains);
        next.frames = next.frames.saturating_add(1);
        *state = next;
    }

    /// The state, where the covariance of a single pose is `covariance`.
    pub(super) fn state(&self, covariance: &Matrix6<f64>) -> Option<Filtered> {
        let state = self.state?;
        // What bends add is no noise: it is not correlated as that is.
        let scaled = |noise: f64, bends: [f64; 2]| {
            let mut scaled = covariance.map(|row| row.map(|value| value * noise));
            for (i, row) in scaled.iter_mut().enumerate() {
                row[i] += covariance[i][i] * bends[i / 3];
            }
            scaled
        };
        let bends = state.bends();
        let per_second2 = (self.period_s * self.period_s).recip();
        // Of one frame's velocity nothing is known.
        (state.frames >= 2).then(|| Filtered {
            estimate: Estimate {
                pose: state.pose,
                covariance: scaled(state.spread[0][0], bends.map(|[pose, _]| pose)),
            },
            twist: TwistEstimate {
                twist: state.step.twist(self.period_s),
                covariance: scaled(state.spread[1][1] * per_second2, bends.map(|[_, step]| step * per_second2)),
            },
            lag_s: LAG_PER_MEMORY * state.memory * self.period_s,
            frames: state.frames,
        })
    }
}

impl State {
    fn theta(&self) -> f64 {
        self.memory / (1.0 + self.memory)
    }

    /// Mean square of what noise does not explain in the predicted step: motion that bends more than a
    /// parabola.
    fn bent(&self) -> f64 {
        let excess = if self.strain > CHANCE { self.strain - 1.0 } else { 0.0 };
        let astray = astray(self.theta());
        astray * astray * excess * (1.0 + self.spread[0][0])
    }

    /// The same of translations and of rotations, in the pose and in the step, both corrected by the
    /// newest frame, which has seen its bend.
    fn bends(&self) -> [[f64; 2]; 2] {
        let theta = self.theta();
        let Gains([of_pose, of_step, _]) = Gains::fading(theta);
        let (left, astray) = (1.0 - of_pose, astray(theta) - of_step);
        // With a short memory chance adds a tenth to what noise does; with a long one it would be most.
        let chance = CHANCE_BEND * (1.0 - SHORTEST / self.memory);
        self.strains.map(|strain| {
            let square = (strain - 1.0 - chance).max(0.0) * (1.0 + self.spread[0][0]);
            [left * left * square, SWING * astray * astray * square]
        })
    }

    /// One frame later.
    fn advanced(&self) -> Self {
        let step = self.step.plus(1.0, self.bend);
        // F·P·Fᵀ with F = [1 1 1; 0 1 2; 0 0 1].
        let apply = |v: [f64; 3]| [v[0] + v[1] + v[2], v[1] + 2.0 * v[2], v[2]];
        let rows = self.spread.map(apply);
        let columns = [0, 1, 2].map(|j| apply([rows[0][j], rows[1][j], rows[2][j]]));
        let spread = core::array::from_fn(|i| core::array::from_fn(|j| columns[j][i]));
        Self {
            pose: self.pose.perturbed(step.translation, step.rotation),
            step: step.plus(1.0, self.bend),
            spread,
            ..*self
        }
    }
}

/// (1 − K·H)·P·(1 − K·H)ᵀ + K·Kᵀ for a measurement of X with unit variance.
fn corrected(p: &[[f64; 3]; 3], gains: &[f64; 3]) -> [[f64; 3]; 3] {
    core::array::from_fn(|i| {
        core::array::from_fn(|j| {
            p[i][j] - gains[i] * p[0][j] - gains[j] * p[i][0] + gains[i] * gains[j] * (p[0][0] + 1.0)
        })
    })
}

/// What a steady change of acceleration, x = t³/6, does to the predicted step, per what it does to
/// the predicted pose, which lags by 1/(1 − θ)³.
fn astray(theta: f64) -> f64 {
    let fresh = 1.0 - theta;
    fresh * (3.0 + fresh * (-1.5 + fresh / 3.0))
}

#[cfg(test)]
mod tests {
    use super::*;

    const PERIOD: f64 = 250e-6;

    /// A covariance.
    const UNIT: Matrix6<f64> = {
        let mut unit = [[0.0; 6]; 6];
        let mut i = 0;
        while i < 6 {
            unit[i][i] = 1.0;
            i += 1;
        }
        unit
    };

    /// Frames of a polynomial motion, through a filter.
    /// None of them is off by more than noise explains.
    fn run(memory_s: f64, frames: u32, pose: impl Fn(f64) -> Pose) -> FadingFilter {
        let mut filter = FadingFilter::new(PERIOD, memory_s);
        for frame in 0..frames {
            filter.update(&pose(f64::from(frame) * PERIOD), &UNIT, |_, _| 6.0);
        }
        filter
    }

    #[test]
    fn steady_acceleration_comes_through_without_delay() {
        let (velocity, acceleration) = (DVec3::new(0.3, -0.2, 0.1), DVec3::new(20.0, 0.0, -40.0));
        let at = |t: f64| Pose::from_vectors(velocity * t + acceleration * (0.5 * t * t), DVec3::ZERO);
        let state = run(2e-3, 400, at).state(&[[0.0; 6]; 6]).expect("many frames");
        let end = 399.0 * PERIOD;
        assert!((state.estimate.pose.translation_m - at(end).translation_m).length() < 1e-12);
        let expected = velocity + acceleration * end;
        assert!((state.twist.twist.linear_m_per_s - expected).length() < 1e-9);
    }

    #[test]
    fn a_steady_jerk_leads_pose_and_step_astray_as_told() {
        for memory_s in [0.75e-3, 5e-3] {
            // The filter forgets its start; t³/6 in units of frames stays small enough for its digits.
            let at = |frame: f64| Pose::from_vectors(DVec3::X * (frame * frame * frame / 6.0), DVec3::ZERO);
            let filter = run(memory_s, 600, |t| at(t / PERIOD - 400.0));
            let predicted = filter.predict().expect("started");
            let pose = at(200.0).translation_m.x - predicted.pose.translation_m.x;
            let step = 0.5 * 200.0 * 200.0 - predicted.twist.linear_m_per_s.x * PERIOD;
            let theta = filter.state.expect("started").theta();
            assert!((pose * (1.0 - theta).powi(3) - 1.0).abs() < 1e-6, "{pose}");
            assert!((step / pose - astray(theta)).abs() < 1e-6, "{step} {pose}");
        }
    }

    #[test]
    fn gains_start_as_least_squares_and_end_fading() {
        // A parabola through five points of which the last is one off: the textbook's weights.
        let mut filter = FadingFilter::new(PERIOD, 1.0);
        for frame in 0..=PARABOLA_FROM {
            let x = if frame == PARABOLA_FROM { 35.0 } else { 0.0 };
            filter.update(&Pose::from_vectors(DVec3::new(x, 0.0, 0.0), DVec3::ZERO), &UNIT, |_, _| 6.0);
        }
        let x = filter.state.expect("started").pose.translation_m.x;
        assert!((x - 31.0).abs() < 1e-12, "{x}");
        let predicted = run(2e-3, 3000, |_| Pose::HOME).state.expect("started").advanced();
        let theta = predicted.theta();
        // Morrison 1969, table of the fading-memory parabola: variance of the position one frame ahead.
        let expected = (1.0 - theta)
            * (19.0 + 24.0 * theta + 16.0 * theta.powi(2) + 6.0 * theta.powi(3) + theta.powi(4))
            / (1.0 + theta).powi(5);
        assert!((predicted.spread[0][0] / expected - 1.0).abs() < 1e-9, "{} {expected}", predicted.spread[0][0]);
    }

    #[test]
    fn a_sudden_bend_shortens_the_memory_within_a_few_frames_and_the_lag_told_with_it() {
        let mut filter = run(0.1, 5_000, |_| Pose::HOME);
        let lag_s = |filter: &FadingFilter| filter.state(&UNIT).expect("many frames").lag_s;
        assert!((lag_s(&filter) / (0.2 * 0.1) - 1.0).abs() < 1e-9);
        // Predictions err by twice what noise explains. The mean over 50 frames would need 12 to notice.
        (0..12).for_each(|_| filter.update(&Pose::HOME, &UNIT, |_, _| 4.0 * 12.0));
        let memory = filter.state.expect("started").memory * PERIOD;
        assert!(memory < 0.1 * 0.05, "{memory}");
        // The step of which half has come through, as long as the memory is what it is now.
        let (told, there) = (lag_s(&filter), Pose::from_vectors(DVec3::X * 1e-6, DVec3::ZERO));
        let mut frames = 0.0;
        while filter.state.expect("started").pose.translation_m.x < 0.5e-6 {
            filter.update(&there, &UNIT, |_, _| 6.0);
            frames += 1.0;
        }
        assert!((frames * PERIOD - told).abs() < 1.5 * PERIOD + 0.2 * told, "{frames} frames, {told}");
    }

    #[test]
    fn lag_is_what_a_small_step_shows() {
        for memory_s in [5e-3, 50e-3, 500e-3] {
            let mut filter = run(memory_s, 30_000, |_| Pose::HOME);
            let mut frames = 0.0;
            let there = Pose::from_vectors(DVec3::X * 1e-6, DVec3::ZERO);
            while filter.state.expect("started").pose.translation_m.x < 0.5e-6 {
                filter.update(&there, &UNIT, |_, _| 6.0);
                frames += 1.0;
            }
            let told = filter.state(&[[0.0; 6]; 6]).expect("many frames").lag_s;
            // Counted in whole frames, from the step's first one on.
            assert!((frames * PERIOD - told).abs() < 1.5 * PERIOD + 0.1 * told, "{memory_s}: {frames} frames, {told}");
        }
    }
}
