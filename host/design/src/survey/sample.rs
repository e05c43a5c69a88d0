//! Poses of a workspace, and along its axes.

use std::convert::Infallible;

use glam::DVec3;
use slitpose_head::threads::{cores, in_order};
use slitpose_model::{Plan, Pose};

/// Poses that a core takes at a time.
const POSES: usize = 256;

/// What is known of the poses that were looked at.
pub(super) trait Tally: Clone + Send + Sync {
    /// Adds a pose, looked at with the optics of `plan`.
    fn add(&mut self, plan: &Plan<f64>, pose: &Pose);

    /// Adds the poses of `later`, which come after those of `self`.
    fn merge(&mut self, later: Self);
}

impl<T: Tally> Tally for Vec<T> {
    fn add(&mut self, plan: &Plan<f64>, pose: &Pose) {
        self.iter_mut().for_each(|tally| tally.add(plan, pose));
    }

    fn merge(&mut self, later: Self) {
        self.iter_mut().zip(later).for_each(|(tally, later)| tally.merge(later));
    }
}

/// What `none` becomes with all of `poses`, on all cores, the same however many they are. `progress` gets the number of
/// poses of each piece that is done.
pub(super) fn over<T: Tally>(
    plan: &Plan<f64>,
    none: &T,
    mut poses: impl Iterator<Item = Pose>,
    mut progress: impl FnMut(usize),
) -> T {
    let mut all = none.clone();
    let next = || {
        Ok::<_, Infallible>(Some(poses.by_ref().take(POSES).collect()).filter(|piece: &Vec<Pose>| !piece.is_empty()))
    };
    let work = |piece: Vec<Pose>| {
        let mut tally = none.clone();
        piece.iter().for_each(|pose| tally.add(plan, pose));
        (tally, piece.len())
    };
    let Ok(()) = in_order(cores(), next, work, |(tally, count)| {
        all.merge(tally);
        progress(count);
        Ok(())
    });
    all
}

/// The six axes of motion from home, in the order (t, θ).
pub(crate) const AXES: [&str; 6] = ["tx", "ty", "tz", "rx", "ry", "rz"];

/// The pose after a pure motion from home along one of [`AXES`], in metres or radians.
///
/// # Panics
/// If `axis` is not below 6.
pub(crate) fn axis_motion(axis: usize, amount: f64) -> Pose {
    let mut motion = [0.0; 6];
    motion[axis] = amount;
    let [tx, ty, tz, rx, ry, rz] = motion;
    Pose::from_vectors(DVec3::new(tx, ty, tz), DVec3::new(rx, ry, rz))
}
