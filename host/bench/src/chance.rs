//! Random numbers of one purpose: one seed, a stream for each purpose, so that no table depends on another's length; and motions drawn from them.

use std::f64::consts::TAU;

use glam::{DQuat, DVec3};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use slitpose_calibration::{half_extents, pose_of};
use slitpose_head::scene_file::Workspace;
use slitpose_model::Pose;

pub(crate) struct Chance(ChaCha8Rng);

impl Chance {
    pub(crate) fn of(seed: u64, stream: u64) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        rng.set_stream(stream);
        Self(rng)
    }

    pub(crate) fn normal(&mut self) -> f64 {
        StandardNormal.sample(&mut self.0)
    }

    /// Normal, but within three standard deviations: parts beyond do not leave the factory.
    pub(crate) fn within_three_sigma(&mut self) -> f64 {
        loop {
            let value = self.normal();
            if value.abs() <= 3.0 {
                return value;
            }
        }
    }

    pub(crate) fn between(&mut self, [least, most]: [f64; 2]) -> f64 {
        least + (most - least) * self.0.random::<f64>()
    }

    /// Uniform in the box of half extents `extent`.
    pub(crate) fn in_box(&mut self, extent: DVec3) -> DVec3 {
        extent * DVec3::from_array([0; 3].map(|_| self.between([-1.0, 1.0])))
    }

    pub(crate) fn normals(&mut self, sigma: f64) -> DVec3 {
        sigma * DVec3::from_array([0; 3].map(|_| self.normal()))
    }

    /// A pose off `pose` by normal errors of every axis.
    pub(crate) fn near(&mut self, pose: &Pose, [sigma_m, sigma_rad]: [f64; 2]) -> Pose {
        let (dt, dr) = (self.normals(sigma_m), self.normals(sigma_rad));
        pose.perturbed(dt, dr)
    }
}

/// Frequencies of a free motion by hand, hertz.
const FREE_HZ: [f64; 2] = [0.15, 1.2];

/// Share of the workspace that a free motion fills.
const FREE_SHARE: f64 = 0.95;

/// Shares of the two sinusoids of each coordinate.
const SINUSOIDS: [f64; 2] = [0.65, 0.35];

/// Distance of a tip from the tool's origin, in extents of the workspace: turning about it uses this share of the
/// translations.
const TIP_SHARE: f64 = 0.7;

/// Length of a tip of a head that does not turn, metres.
const TIP_M: f64 = 10e-3;

/// A pose of the workspace, every coordinate uniform.
pub(crate) fn anywhere(workspace: &Workspace, chance: &mut Chance) -> Pose {
    let translation_m = chance.in_box(workspace.half_extent_m);
    Pose::from_vectors(translation_m, chance.in_box(workspace.half_extent_rad))
}

/// Free motion: two sinusoids in each coordinate.
pub(crate) struct FreeMotion {
    /// Amplitude, angular frequency, phase.
    sines: [[[f64; 3]; 2]; 6],
}

impl FreeMotion {
    pub(crate) fn draw(workspace: &Workspace, chance: &mut Chance) -> Self {
        let sines = half_extents(workspace).map(|extent| {
            SINUSOIDS
                .map(|share| [share * FREE_SHARE * extent, TAU * chance.between(FREE_HZ), chance.between([0.0, TAU])])
        });
        Self { sines }
    }

    pub(crate) fn pose(&self, time_s: f64) -> Pose {
        let of = |[amplitude, frequency, phase]: &[f64; 3]| amplitude * (frequency * time_s + phase).sin();
        pose_of(&self.sines.each_ref().map(|pair| pair.iter().map(of).sum::<f64>()))
    }
}

#[derive(Clone, Copy, Debug)]
pub(crate) struct Pivot {
    /// The tip in the tool frame, metres.
    pub(crate) in_tool_m: DVec3,
    /// The cone in the base frame, metres.
    pub(crate) in_base_m: DVec3,
}

impl Pivot {
    pub(crate) fn draw(workspace: &Workspace, chance: &mut Chance) -> Self {
        let least_m = workspace.half_extent_m.min_element();
        let most_rad = workspace.half_extent_rad.max_element();
        let length_m = if most_rad > 0.0 { TIP_SHARE * least_m / most_rad } else { TIP_M };
        let in_tool_m = DVec3::new(0.0, 0.0, -length_m);
        Self { in_tool_m, in_base_m: in_tool_m + 0.2 * chance.in_box(workspace.half_extent_m) }
    }

    pub(crate) fn pose(&self, workspace: &Workspace, chance: &mut Chance) -> Pose {
        self.turned(Pose::from_vectors(DVec3::ZERO, chance.in_box(workspace.half_extent_rad)).rotation)
    }

    /// The pose with this rotation, the tip in the cone.
    pub(crate) fn turned(&self, rotation: DQuat) -> Pose {
        Pose { rotation, translation_m: self.in_base_m - rotation * self.in_tool_m }
    }
}
