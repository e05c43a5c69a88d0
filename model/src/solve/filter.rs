//! Where the tool will be in the next frame: a polynomial filter with fading memory.
//!
//! State is a pose X, its change V per frame and half the change A of that, on the manifold of
//! poses: the error between a measured and a predicted pose is a displacement (δt, δθ), and corrects
//! X by α, V by β, A by γ of it. The gains are those of a parabola fitted by least squares to all
//! poses since the start, later to poses that count less the older they are, by θ a frame (Morrison,
//! Introduction to Sequential Smoothing and Prediction, 1969, chapters 12 and 13). All axes share
//! them, so that the covariance of (X, V, A) is a 3×3 matrix of numbers times that of a single pose,
//! and follows from the gains exactly.
//!
//! Its memory is short, so that it follows a swinging tool and costs a board little. Velocities that are given out come
//! from [`super::motion`].

use crate::pose::Rigid;
use crate::scalar::Number;

use super::algebra::Matrix6;

/// Squared error above which more than chance is at work: the running mean of χ²₆/6 has a standard
/// deviation of 0.06 about 1.
const CHANCE: f64 = 1.2;

/// Share θ that a frame counts of the next: long enough that the noise of the twist adds next to nothing to that of a
/// pose, short enough for the accelerations of a fast hand.
const THETA: f64 = 2.0 / 3.0;

/// Frames from which on a parabola is fitted; before, a line.
const PARABOLA_FROM: u32 = 4;

/// A pose whose variance is this many times that of the pose before, in translation or rotation, says little of the motion: of a
/// cell less, for example, that the head can hardly do without.
const WEAK: f64 = 9.0;

/// Share of the newest frame in the running mean of squared errors.
const NEWEST: f64 = 0.02;

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
    fn fading() -> Self {
        let theta = S::of(THETA);
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
    /// Variances of the last pose's translation and rotation, mean of the axes.
    variances: [S; 2],
    /// Running mean of the squared prediction error, 1 if noise explains it.
    strain: S,
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
    /// For frames `period_s` apart.
    pub fn new(period_s: f64) -> Self {
        Self { period_s: S::of(period_s), state: None }
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
                variances,
                strain: one,
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
            next.strain += S::of(NEWEST) * (squared - next.strain);
        }
        let expanding = Gains::<S>::expanding(next.frames);
        let fading = Gains::fading();
        let Gains(gains) = if expanding.0[0] > fading.0[0] { expanding } else { fading };
        next.pose = next.pose.perturbed(translation * gains[0], rotation * gains[0]);
        next.step = next.step.plus(gains[1], error);
        next.bend = next.bend.plus(gains[2], error);
        next.spread = corrected(&next.spread, &gains);
        next.frames = next.frames.saturating_add(1);
        *state = next;
    }
}

/// Of translation and rotation, mean of the axes.
fn mean_variances<S: Number>(covariance: &Matrix6<S>) -> [S; 2] {
    [0, 3].map(|i| (covariance[i][i] + covariance[i + 1][i + 1] + covariance[i + 2][i + 2]) * S::of(1.0 / 3.0))
}

impl<S: Number> State<S> {
    /// Mean square of what noise does not explain in the predicted step: motion that bends more than a
    /// parabola.
    fn bent(&self) -> S {
        let excess = if self.strain > S::of(CHANCE) { self.strain - S::one() } else { S::zero() };
        let astray = astray::<S>();
        astray * astray * excess * (S::one() + self.spread[0][0])
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
fn astray<S: Number>() -> S {
    let fresh = S::one() - S::of(THETA);
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
    fn run(frames: u32, pose: impl Fn(f64) -> Pose) -> FadingFilter<f64> {
        let mut filter = FadingFilter::new(PERIOD);
        for frame in 0..frames {
            filter.update(&Rigid::of(&pose(f64::from(frame) * PERIOD)), &UNIT, |_| 6.0);
        }
        filter
    }

    #[test]
    fn steady_acceleration_is_predicted() {
        let (velocity, acceleration) = (DVec3::new(0.3, -0.2, 0.1), DVec3::new(20.0, 0.0, -40.0));
        let at = |t: f64| Pose::from_vectors(velocity * t + acceleration * (0.5 * t * t), DVec3::ZERO);
        let predicted = run(400, at).predict().expect("many frames");
        let next_s = 400.0 * PERIOD;
        assert!((predicted.pose.to_pose().translation_m - at(next_s).translation_m).length() < 1e-12);
        assert!((predicted.twist[0] - (velocity + acceleration * next_s)).length() < 1e-9);
    }

    #[test]
    fn a_steady_jerk_leads_pose_and_step_astray_as_told() {
        // The filter forgets its start; t³/6 in units of frames stays small enough for its digits.
        let at = |frame: f64| Pose::from_vectors(DVec3::X * (frame * frame * frame / 6.0), DVec3::ZERO);
        let predicted = run(600, |t| at(t / PERIOD - 400.0)).predict().expect("started");
        let pose = at(200.0).translation_m.x - predicted.pose.to_pose().translation_m.x;
        let step = 0.5 * 200.0 * 200.0 - predicted.twist[0].x * PERIOD;
        assert!((pose * (1.0 - THETA).powi(3) - 1.0).abs() < 1e-6, "{pose}");
        assert!((step / pose - astray::<f64>()).abs() < 1e-6, "{step} {pose}");
    }

    #[test]
    fn variances_are_those_of_the_response_to_one_pose_that_is_off() {
        let mut filter = run(300, |_| Pose::HOME);
        let (mut pose, mut step) = (0.0, 0.0);
        for frame in 0..200 {
            let measured = Pose::from_vectors(DVec3::X * f64::from(u8::from(frame == 0)), DVec3::ZERO);
            filter.update(&Rigid::of(&measured), &UNIT, |_| 6.0);
            let predicted = filter.predict().expect("started");
            pose += predicted.pose.to_pose().translation_m.x.powi(2);
            step += (predicted.twist[0].x * PERIOD).powi(2);
        }
        let predicted = filter.predict().expect("started");
        assert!((predicted.pose_variance / pose - 1.0).abs() < 1e-9, "{predicted:?} {pose}");
        assert!((predicted.step_variance / step - 1.0).abs() < 1e-9, "{predicted:?} {step}");
    }

    #[test]
    fn gains_start_as_least_squares_and_end_fading() {
        // A parabola through five points of which the last is one off: the textbook's weights.
        let gains = Gains::<f64>::expanding(PARABOLA_FROM).0;
        assert!((gains[0] - 31.0 / 35.0).abs() < 1e-12, "{gains:?}");
        let predicted = run(3000, |_| Pose::HOME).predict().expect("started");
        // Morrison 1969, table of the fading-memory parabola: variance of the position one frame ahead.
        let expected = (1.0 - THETA)
            * (19.0 + 24.0 * THETA + 16.0 * THETA.powi(2) + 6.0 * THETA.powi(3) + THETA.powi(4))
            / (1.0 + THETA).powi(5);
        assert!((predicted.pose_variance / expected - 1.0).abs() < 1e-9, "{} {expected}", predicted.pose_variance);
    }
}
