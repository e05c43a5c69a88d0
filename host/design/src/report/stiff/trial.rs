//! Solves of extreme problems, in both number types.

use std::time::Instant;

use slitpose_model::{Photocurrents, Plan, Pose, Scene, SceneError};

use super::case::Reached;
use crate::report::attainable::Attainable;
use crate::report::head::currents;
use crate::report::method::{Effort, Method, Precision, Start};
use crate::report::noise::NoiseSource;

/// Poses of one case.
pub(super) const POSES: usize = 20;

/// How far from home they are, per axis: so near that cases differ and not poses.
const NEAR_HOME_M: f64 = 0.3e-3;
const NEAR_HOME_RAD: f64 = 0.02;

/// Repetitions of a timed solve; the least time counts, the others were disturbed.
const TIMES: usize = 3;

/// How far a warm start is off, per axis.
const PRIOR_M: f64 = 3e-6;
const PRIOR_RAD: f64 = 3e-4;

/// The measure of a pose error.
pub(super) const AT_EMITTERS: &str = "pose at the emitters / µm";

/// Poses and their measurements.
pub(super) struct Trial {
    pub(super) scene: Scene,
    pub(super) plan: Plan<f64>,
    pub(super) poses: Vec<Pose>,
    pub(super) readings: Vec<Photocurrents>,
    pub(super) priors: Vec<Pose>,
}

impl Trial {
    /// Noise-free currents of `scene` at poses around `centre`.
    pub(super) fn around(scene: Scene, centre: &Pose, seed: u64) -> Result<Self, SceneError> {
        Self::within(scene, centre, 1.0, seed)
    }

    /// The same with poses `spread` times as far from `centre`.
    pub(super) fn within(scene: Scene, centre: &Pose, spread: f64, seed: u64) -> Result<Self, SceneError> {
        let plan = Plan::compile(&scene, Precision::Double.tightest_tier())?;
        let mut noise = NoiseSource::seeded(seed);
        let poses: Vec<Pose> =
            (0..POSES).map(|_| noise.near(centre, spread * NEAR_HOME_M, spread * NEAR_HOME_RAD)).collect();
        let readings = poses.iter().map(|pose| currents(&plan, pose)).collect();
        let priors = poses.iter().map(|pose| noise.near(pose, PRIOR_M, PRIOR_RAD)).collect();
        Ok(Self { scene, plan, poses, readings, priors })
    }

    /// Solves all of it with a full effort. `attainable_m` says how exact each pose can be.
    pub(super) fn solve(
        &self,
        start: Start,
        attainable_m: impl Fn(usize, Precision) -> f64,
    ) -> Result<Vec<(Precision, Reached)>, SceneError> {
        let arm_m = self.scene.length_scale_m();
        let of = |precision: Precision| {
            let tier = precision.tightest_tier();
            let solve = Method { tier, precision, start, effort: Effort::Full }.compile(&self.scene)?;
            let mut reached = Reached::default();
            let (mut squares, mut best, mut found, mut slowest_s) = (0.0, 0.0, 0.0, 0.0_f64);
            for (index, pose) in self.poses.iter().enumerate() {
                let timed = || {
                    let clock = Instant::now();
                    let solved = solve(&self.readings[index], &self.priors[index]);
                    (clock.elapsed().as_secs_f64(), solved)
                };
                let (mut least_s, solved) = timed();
                for _ in 1..TIMES {
                    least_s = least_s.min(timed().0);
                }
                slowest_s = slowest_s.max(least_s);
                *reached.outcomes.entry(solved.outcome.as_str().to_owned()).or_default() += 1;
                reached.without_value += usize::from(solved.pose.is_none());
                best += attainable_m(index, precision).powi(2);
                if let Some(found_pose) = solved.pose {
                    let (dt, dr) = found_pose.displacement_from(pose);
                    squares += dt.length_squared() + arm_m * arm_m * dr.length_squared();
                    found += 1.0;
                }
            }
            let rms_um = |sum: f64, count: f64| (sum / count).sqrt() * 1e6;
            reached.error = Some(rms_um(squares, found)).filter(|error| error.is_finite());
            reached.slowest_s = Some(slowest_s);
            reached.attainable = Some(rms_um(best, self.poses.len() as f64));
            Ok((precision, reached))
        };
        Precision::BOTH.into_iter().map(of).collect()
    }

    /// What rounding allows at each pose, from the cells that `used` lets pass.
    pub(super) fn attainable(&self, used: impl Fn(usize) -> bool) -> Vec<Attainable> {
        self.poses.iter().map(|pose| Attainable::at(&self.scene, &self.plan, pose, &used)).collect()
    }

    /// [`Self::solve`] against what rounding allows.
    pub(super) fn solve_to_rounding(
        &self,
        start: Start,
        attainable: &[Attainable],
    ) -> Result<Vec<(Precision, Reached)>, SceneError> {
        let arm_m = self.scene.length_scale_m();
        self.solve(start, |index, precision| attainable[index].at_emitters_m(precision, arm_m))
    }
}

/// The middle condition number.
pub(super) fn condition(attainable: &[Attainable]) -> f64 {
    crate::report::accuracy::median(attainable.iter().map(|attainable| attainable.condition).collect())
}
