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

use crate::pose::{Rigid, Twist};
use crate::scalar::{Linear3, Number, Vector3};

use super::algebra::Matrix6;
use super::outcome::Estimate;

/// Squared error above which more than chance is at work: the running mean of χ²₆/6 has a standard
/// deviation of 0.06 about 1.
const CHANCE: f64 = 1.2;

/// Frames from which on a parabola is fitted; before, a line.
const PARABOLA_FROM: u32 = 4;

/// A pose whose variance is this many times that of the pose before, in translation or rotation, says little of the motion: of a
/// cell less, for example, that the head can hardly do without.
const WEAK: f64 = 9.0;

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
const MIN: f64 = 2.0;

/// Frames of lag per frame of memory: of a step too small to raise the alarm half has come through.
const LAG_PER_MEMORY: f64 = 0.2;

/// Velocity of the tool with its covariance.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TwistEstimate<S = f64> {
    /// In the base frame.
    pub twist: Twist,
    /// Of (linear, angular): m²/s², m·rad/s², rad²/s².
    pub covariance: Matrix6<S>,
}

/// A filtered pose: from the frame and those before.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Filtered<S = f64> {
    /// At the reference instant of the newest frame. Its covariance grows with the distance of the poses
    /// from the parabola.
    pub estimate: Estimate<S>,
    /// At the same instant.
    pub twist: TwistEstimate<S>,
    /// Time after which half of a sudden step of the pose that is smaller than the noise has come
    /// through: a fifth of the present memory. Steady motion and steady acceleration
    /// come through without delay.
    pub lag_s: S,
    /// Frames since the memory began.
    pub frames: u32,
}

/// Six numbers: displacements, or their rates.
#[derive(Clone, Copy, Debug, Default)]
struct Displacement<S: Number> {
    translation: S::Vec3,
    rotation: S::Vec3,
}

impl<S: Number> Displacement<S> {
    fn plus(self, factor: S, other: Self) -> Self {
        Self {
            translation: self.translation + other.translation * factor,
            rotation: self.rotation + other.rotation * factor,
        }
    }

    fn rates(self, period_s: S) -> [S::Vec3; 2] {
        [self.translation, self.rotation].map(|v| v * period_s.recip())
    }
}

#[derive(Clone, Copy, Debug)]
struct Gains<S>([S; 3]);

impl<S: Number> Gains<S> {
    /// Least squares over `n` + 1 frames.
    fn expanding(n: u32) -> Self {
        let m = count::<S>(n);
        let (one, two, three, six) = (S::one(), S::two(), S::of(3.0), S::of(6.0));
        Self(match n {
            0 => [one, S::zero(), S::zero()],
            n if n < PARABOLA_FROM => {
                let per_product = ((m + one) * (m + two)).recip();
                [two * (two * m + one) * per_product, six * per_product, S::zero()]
            }
            _ => {
                let per_product = ((m + one) * (m + two) * (m + three)).recip();
                let square = three * (three * m * m + three * m + two);
                [square * per_product, three * six * (two * m + one) * per_product, S::of(30.0) * per_product]
            }
        })
    }

    /// Least squares over all frames, each counting θ of the next.
    fn fading(theta: S) -> Self {
        let fresh = S::one() - theta;
        let square = fresh * fresh;
        Self([S::one() - theta * theta * theta, S::of(1.5) * square * (S::one() + theta), S::half() * square * fresh])
    }
}

#[inline(always)]
fn count<S: Number>(frames: u32) -> S {
    S::from(frames).unwrap_or_else(S::infinity)
}

#[derive(Clone, Debug)]
pub struct FadingFilter<S: Number> {
    period_s: S,
    longest: S,
    state: Option<State<S>>,
}

#[derive(Clone, Copy, Debug)]
struct State<S: Number> {
    pose: Rigid<S>,
    step: Displacement<S>,
    bend: Displacement<S>,
    /// Covariance of (X, V, A) in units of a single pose's.
    spread: [[S; 3]; 3],
    frames: u32,
    /// Frames of memory: θ = memory/(1 + memory).
    memory: S,
    /// Variances of the last pose's translation and rotation, mean of the axes.
    variances: [S; 2],
    /// Running mean of the squared prediction error, 1 if noise explains it.
    strain: S,
    /// The same of translations and of rotations alone: bends of the one are not those of the other.
    strains: [S; 2],
    /// The same over few frames.
    alarm: S,
}

#[derive(Clone, Copy, Debug)]
pub struct Prediction<S: Number> {
    pub pose: Rigid<S>,
    /// Linear and angular, per second.
    pub twist: [S::Vec3; 2],
    /// Variance of the pose and of the change per frame, in units of a single pose's.
    pub pose_variance: S,
    pub step_variance: S,
    pub frames: u32,
    /// Mean squared error of the last predictions in units of what noise explains, at least 1.
    pub strain: S,
}

impl<S: Number> FadingFilter<S> {
    /// For frames `period_s` apart. With a memory of `memory_s` a frame counts m/(1 + m) of the next,
    /// m = `memory_s`/`period_s`.
    pub fn new(period_s: f64, memory_s: f64) -> Self {
        Self { period_s: S::of(period_s), longest: S::of((memory_s / period_s).max(MIN)), state: None }
    }

    pub fn forget(&mut self) {
        self.state = None;
    }

    /// Whether a pose of this covariance says little of the motion, beside the poses before: see [`WEAK`].
    #[inline(always)]
    pub fn is_weak(&self, covariance: &Matrix6<S>) -> bool {
        let Some(State { frames, variances, .. }) = &self.state else { return false };
        let found = mean_variances(covariance);
        *frames > PARABOLA_FROM && (found[0] > S::of(WEAK) * variances[0] || found[1] > S::of(WEAK) * variances[1])
    }

    /// σ of the last pose taken, mean of the axes: metres and radians.
    pub fn sigmas(&self) -> [S; 2] {
        self.state.as_ref().map_or([S::zero(); 2], |state| state.variances.map(S::root))
    }

    /// A frame without a pose: the motion goes on as it was.
    pub fn extrapolate(&mut self) {
        if let Some(state) = &mut self.state {
            *state = state.advanced();
        }
    }

    pub fn predict(&self) -> Option<Prediction<S>> {
        let next = self.state.as_ref()?.advanced();
        Some(Prediction {
            pose: next.pose,
            twist: next.step.rates(self.period_s),
            pose_variance: next.spread[0][0],
            step_variance: next.spread[1][1] + next.bent(),
            frames: next.frames,
            strain: next.strain.max(S::one()),
        })
    }

    /// Half the acceleration, linear and angular: m/s² and rad/s².
    pub fn predicted_bend(&self) -> Option<[S::Vec3; 2]> {
        self.state.as_ref().map(|state| state.bend.rates(self.period_s * self.period_s))
    }

    /// Takes the pose of the next frame and its covariance. `squared_sigmas` gives the squared length of a
    /// displacement (metres, radians) in σ of that pose.
    pub fn update(&mut self, measured: &Rigid<S>, covariance: &Matrix6<S>, squared_sigmas: impl Fn([S::Vec3; 2]) -> S) {
        let (zero, one) = (S::zero(), S::one());
        let variances = mean_variances(covariance);
        let Some(state) = &mut self.state else {
            self.state = Some(State {
                pose: *measured,
                step: Displacement::default(),
                bend: Displacement::default(),
                spread: [[one, zero, zero], [zero; 3], [zero; 3]],
                frames: 1,
                memory: self.longest,
                variances,
                strain: one,
                strains: [one; 2],
                alarm: one,
            });
            return;
        };
        let mut next = state.advanced();
        next.variances = variances;
        let [translation, rotation] = measured.displacement_from(&next.pose);
        let error = Displacement { translation, rotation };
        if next.frames > PARABOLA_FROM {
            let per_axis = (one + next.spread[0][0]).recip();
            let squared = squared_sigmas([translation, rotation]) * (S::of(1.0 / 6.0) * per_axis);
            let toward = |mean: S, share: f64, squared: S| mean + S::of(share) * (squared - mean);
            next.strain = toward(next.strain, NEWEST, squared);
            next.alarm = toward(next.alarm, NEWEST_ALARM, squared);
            for (group, error) in [translation, rotation].into_iter().enumerate() {
                let error = [error.x(), error.y(), error.z()];
                let of_axis = |i: usize| error[i] * error[i] / covariance[3 * group + i][3 * group + i];
                let squared = (of_axis(0) + of_axis(1) + of_axis(2)) * (S::of(1.0 / 3.0) * per_axis);
                next.strains[group] = toward(next.strains[group], NEWEST_BEND, squared);
            }
            let factor = if next.alarm > S::of(ALARM) { SHRINK } else { GROW };
            next.memory = (next.memory * S::of(factor)).max(S::of(MIN)).min(self.longest);
        }
        let expanding = Gains::<S>::expanding(next.frames);
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
    pub fn state(&self, covariance: &Matrix6<S>) -> Option<Filtered<S>> {
        let state = self.state.as_ref()?;
        // What bends add is no noise: it is not correlated as that is.
        let scaled = |noise: S, bends: [S; 2]| {
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
                pose: state.pose.to_pose(),
                covariance: scaled(state.spread[0][0], bends.map(|[pose, _]| pose)),
            },
            twist: TwistEstimate {
                twist: twist::<S>(state.step.rates(self.period_s)),
                covariance: scaled(state.spread[1][1] * per_second2, bends.map(|[_, step]| step * per_second2)),
            },
            lag_s: S::of(LAG_PER_MEMORY) * state.memory * self.period_s,
            frames: state.frames,
        })
    }
}

/// Of translation and rotation, mean of the axes.
fn mean_variances<S: Number>(covariance: &Matrix6<S>) -> [S; 2] {
    [0, 3].map(|i| (covariance[i][i] + covariance[i + 1][i + 1] + covariance[i + 2][i + 2]) * S::of(1.0 / 3.0))
}

fn twist<S: Number>([linear, angular]: [S::Vec3; 2]) -> Twist {
    Twist { linear_m_per_s: linear.as_dvec3(), angular_rad_per_s: angular.as_dvec3() }
}

impl<S: Number> State<S> {
    fn theta(&self) -> S {
        self.memory / (S::one() + self.memory)
    }

    /// Mean square of what noise does not explain in the predicted step: motion that bends more than a
    /// parabola.
    fn bent(&self) -> S {
        let excess = if self.strain > S::of(CHANCE) { self.strain - S::one() } else { S::zero() };
        let astray = astray(self.theta());
        astray * astray * excess * (S::one() + self.spread[0][0])
    }

    /// The same of translations and of rotations, in the pose and in the step, both corrected by the
    /// newest frame, which has seen its bend.
    fn bends(&self) -> [[S; 2]; 2] {
        let theta = self.theta();
        let Gains([of_pose, of_step, _]) = Gains::<S>::fading(theta);
        let (left, astray) = (S::one() - of_pose, astray(theta) - of_step);
        // With a short memory chance adds a tenth to what noise does; with a long one it would be most.
        let chance = S::of(CHANCE_BEND) * (S::one() - S::of(MIN) / self.memory);
        self.strains.map(|strain| {
            let square = (strain - S::one() - chance).max(S::zero()) * (S::one() + self.spread[0][0]);
            [left * left * square, S::of(SWING) * astray * astray * square]
        })
    }

    /// One frame later.
    fn advanced(&self) -> Self {
        let step = self.step.plus(S::one(), self.bend);
        // F·P·Fᵀ with F = [1 1 1; 0 1 2; 0 0 1].
        let apply = |v: [S; 3]| [v[0] + v[1] + v[2], v[1] + S::two() * v[2], v[2]];
        let rows = self.spread.map(apply);
        let columns = [0, 1, 2].map(|j| apply([rows[0][j], rows[1][j], rows[2][j]]));
        let spread = core::array::from_fn(|i| core::array::from_fn(|j| columns[j][i]));
        Self {
            pose: self.pose.perturbed(step.translation, step.rotation),
            step: step.plus(S::one(), self.bend),
            spread,
            ..*self
        }
    }
}

/// (1 − K·H)·P·(1 − K·H)ᵀ + K·Kᵀ for a measurement of X with unit variance.
fn corrected<S: Number>(p: &[[S; 3]; 3], gains: &[S; 3]) -> [[S; 3]; 3] {
    core::array::from_fn(|i| {
        core::array::from_fn(|j| {
            p[i][j] - gains[i] * p[0][j] - gains[j] * p[i][0] + gains[i] * gains[j] * (p[0][0] + S::one())
        })
    })
}

/// What a steady change of acceleration, x = t³/6, does to the predicted step, per what it does to
/// the predicted pose, which lags by 1/(1 − θ)³.
fn astray<S: Number>(theta: S) -> S {
    let fresh = S::one() - theta;
    fresh * (S::of(3.0) + fresh * (S::of(-1.5) + fresh * S::of(1.0 / 3.0)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pose::Pose;
    use glam::DVec3;

    const PERIOD: f64 = 250e-6;

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
    fn run(memory_s: f64, frames: u32, pose: impl Fn(f64) -> Pose) -> FadingFilter<f64> {
        let mut filter = FadingFilter::new(PERIOD, memory_s);
        for frame in 0..frames {
            filter.update(&Rigid::of(&pose(f64::from(frame) * PERIOD)), &UNIT, |_| 6.0);
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
            let pose = at(200.0).translation_m.x - predicted.pose.to_pose().translation_m.x;
            let step = 0.5 * 200.0 * 200.0 - predicted.twist[0].x * PERIOD;
            let theta = filter.state.expect("started").theta();
            assert!((pose * (1.0 - theta).powi(3) - 1.0).abs() < 1e-6, "{pose}");
            assert!((step / pose - astray(theta)).abs() < 1e-6, "{step} {pose}");
        }
    }

    #[test]
    fn gains_start_as_least_squares_and_end_fading() {
        // A parabola through five points of which the last is one off: the textbook's weights.
        let mut filter = FadingFilter::<f64>::new(PERIOD, 1.0);
        for frame in 0..=PARABOLA_FROM {
            let x = if frame == PARABOLA_FROM { 35.0 } else { 0.0 };
            filter.update(&Rigid::of(&Pose::from_vectors(DVec3::new(x, 0.0, 0.0), DVec3::ZERO)), &UNIT, |_| 6.0);
        }
        let x = filter.state.expect("started").pose.to_pose().translation_m.x;
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
        let lag_s = |filter: &FadingFilter<f64>| filter.state(&UNIT).expect("many frames").lag_s;
        assert!((lag_s(&filter) / (0.2 * 0.1) - 1.0).abs() < 1e-9);
        // Predictions err by twice what noise explains. The mean over 50 frames would need 12 to notice.
        (0..12).for_each(|_| filter.update(&Rigid::of(&Pose::HOME), &UNIT, |_| 4.0 * 12.0));
        let memory = filter.state.expect("started").memory * PERIOD;
        assert!(memory < 0.1 * 0.05, "{memory}");
        // The step of which half has come through, as long as the memory is what it is now.
        let (told, there) = (lag_s(&filter), Pose::from_vectors(DVec3::X * 1e-6, DVec3::ZERO));
        let mut frames = 0.0;
        while filter.state.expect("started").pose.to_pose().translation_m.x < 0.5e-6 {
            filter.update(&Rigid::of(&there), &UNIT, |_| 6.0);
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
            while filter.state.expect("started").pose.to_pose().translation_m.x < 0.5e-6 {
                filter.update(&Rigid::of(&there), &UNIT, |_| 6.0);
                frames += 1.0;
            }
            let told = filter.state(&[[0.0; 6]; 6]).expect("many frames").lag_s;
            // Counted in whole frames, from the step's first one on.
            assert!((frames * PERIOD - told).abs() < 1.5 * PERIOD + 0.1 * told, "{memory_s}: {frames} frames, {told}");
        }
    }
}
