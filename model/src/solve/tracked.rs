//! Pose and velocity frame after frame, and a smoothed pose beside them: what a host makes of a stream of frames.

use heapless::Vec;

use crate::entries::Scalar;
use crate::scalar::Number;
use crate::scene::{MAX_CELLS, Scene};

use super::levels::Levels;
use super::motion::{Filtered, MotionEstimator, NoTwist, TwistEstimate};
use super::outcome::Solution;
use super::readings::Photocurrents;
use super::solver::Solver;
use super::tracker::PoseTracker;

/// Memory of the velocity, frames.
const MEMORY_FRAMES: f64 = 8.0;

/// The result of one frame.
#[derive(Clone, Copy, Debug)]
pub struct Tracked<S: Number = f64> {
    /// From this frame alone, but for the motion within it.
    pub solution: Solution<S>,
    /// Velocity at the reference instant, from this frame and those before.
    pub twist: Result<TwistEstimate<S>, NoTwist>,
    /// From many frames, if asked for.
    pub filtered: Option<Filtered<S>>,
    /// How bright all light is, relative to the scene: the mean of some 64 frames with a pose; `None` where it is taken for
    /// known.
    pub light_level: Option<S>,
}

/// Solves consecutive frames.
///
/// ```
/// # let scene: slitpose_model::Scene = include!(concat!(env!("CARGO_MANIFEST_DIR"), "/doc/ring.rs"));
/// // `scene` has six cells in a ring, as in the example of this crate.
/// use slitpose_model::*;
/// let tier = Tier::Exact { tolerance: 1e-6 };
/// let plan = CompiledScene::<f64>::compile(&scene, tier)?;
/// let mut tracker = Tracker::<f64>::new(Solver::new(&scene, tier)?, 250e-6);
/// let mut last = None;
/// for frame in 0..200_u32 {
///     // 10 mm/s along x.
///     let pose = Pose { translation_m: glam::DVec3::X * 2.5e-6 * f64::from(frame), ..Pose::HOME };
///     let currents = Photocurrents::of_pairs((0..6).map(|cell| plan.photocurrents(cell, &pose)));
///     last = Some(tracker.track(frame.into(), &currents));
/// }
/// let twist = last.expect("frames").twist.expect("a velocity").twist;
/// assert!((twist.linear_m_per_s.x - 10e-3).abs() < 1e-4);
/// # Ok::<(), SceneError>(())
/// ```
#[derive(Clone, Debug)]
pub struct Tracker<S: Scalar> {
    poses: PoseTracker<S>,
    period_s: f64,
    motion: MotionEstimator<S>,
    filter: Option<MotionEstimator<S>>,
    levels: Option<Levels<S>>,
}

impl<S: Scalar> PoseTracker<S> {
    /// The pose of frame `frame`. Frames are numbered without gaps by the device; across a longer
    /// gap in the numbers the tracker forgets how the tool moved.
    pub fn track(&mut self, frame: u64, readings: &Photocurrents<S>) -> Solution<S> {
        S::track(self, frame, readings)
    }
}

impl<S: Scalar> Tracker<S> {
    /// For frames `period_s` seconds apart.
    pub fn new(solver: Solver<S>, period_s: f64) -> Self {
        Self {
            poses: PoseTracker::new(solver, period_s),
            period_s,
            motion: MotionEstimator::new(period_s, MEMORY_FRAMES * period_s),
            filter: None,
            levels: None,
        }
    }

    /// See [`PoseTracker::neglecting_motion`].
    #[must_use]
    pub fn neglecting_motion(mut self, share: f64) -> Self {
        self.poses = self.poses.neglecting_motion(share);
        self
    }

    /// Follows what single emitters deviate from the common light level, if `scene` says that they may: see
    /// [`crate::Uncertainty::emitter_drift_relative`].
    #[must_use]
    pub fn following_levels(mut self, scene: &Scene) -> Self {
        self.levels = Levels::of(scene, &self.poses.solver().compiled.noise, self.period_s);
        if let Some(levels) = &self.levels {
            self.poses.allow_for(levels);
        }
        self
    }

    /// The tracker of poses alone.
    pub fn poses(&self) -> &PoseTracker<S> {
        &self.poses
    }

    /// What the emitter of each cell deviates from the common light level, relative, and its standard deviation, as far as the
    /// tool's motion has told; `None`: single emitters are taken for known.
    pub fn emitter_drifts(&self) -> Option<Vec<[S; 2], MAX_CELLS>> {
        self.levels.as_ref().map(Levels::deviations)
    }

    /// The tracker of poses of a board, which takes all light levels for known.
    pub fn poses_as_on_board(&self) -> PoseTracker<S> {
        let mut poses = self.poses.clone();
        poses.solver_mut().compiled.take_light_level_for_known();
        match &self.levels {
            Some(levels) => poses.without(levels),
            None => poses,
        }
    }

    /// Also gives a filtered pose, from no longer than some `memory_s` seconds, in which a frame counts m/(1 + m) of the next,
    /// m = `memory_s`/`period_s`; from fewer where the motion is not steady for so long.
    #[must_use]
    pub fn with_filter(mut self, memory_s: f64) -> Self {
        self.filter = Some(MotionEstimator::new(self.period_s, memory_s));
        self
    }

    /// [`PoseTracker::track`], with velocity and filtered pose.
    pub fn track(&mut self, frame: u64, readings: &Photocurrents<S>) -> Tracked<S> {
        let solution = match &mut self.levels {
            Some(levels) => {
                let corrected = levels.corrected(readings);
                let solution = self.poses.track(frame, &corrected);
                self.poses.observe_levels(levels, frame, &corrected, &solution);
                solution
            }
            None => self.poses.track(frame, readings),
        };
        let light_level = self.poses.light_level();
        let Some(estimate) = &solution.estimate else {
            return Tracked { solution, twist: Err(NoTwist::NoPose), filtered: None, light_level };
        };
        let (pose, covariance) = (solution.rigid, estimate.covariance);
        self.motion.update(frame, &pose, &covariance);
        let filtered = self.filter.as_mut().map(|filter| {
            filter.update(frame, &pose, &covariance);
            filter.filtered(&covariance)
        });
        Tracked { twist: self.motion.twist(&covariance), filtered, solution, light_level }
    }
}
