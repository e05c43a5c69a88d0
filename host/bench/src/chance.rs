//! Random numbers of one purpose: one seed, a stream for each purpose, so that no table depends on another's length.

use glam::DVec3;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use slitpose_model::Pose;

/// One stream of a seed.
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
