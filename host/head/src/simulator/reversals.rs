//! Straight flight between random points of a box with abrupt reversals, as against its walls, planned
//! on demand.

use std::cell::RefCell;
use std::collections::VecDeque;
use std::ops::Range;

use glam::DVec3;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use slitpose_model::Pose;

use super::trajectory::on_path;

/// Duration of a straight leg, seconds.
const LEG_S: Range<f64> = 5e-3..25e-3;

/// Half sides of the box.
const BOX_M: f64 = 2.5e-3;
const BOX_RAD: f64 = 0.12;

/// Legs kept: for poses more than a second back, all legs are planned again.
const KEPT: usize = 256;

/// A motion from home on.
#[derive(Clone, Debug)]
pub(super) struct Reversals {
    /// The generator at the beginning of the motion.
    random: ChaCha8Rng,
    end_s: f64,
    /// Factors of the box's sides.
    shrunk: [DVec3; 2],
    plan: RefCell<Plan>,
}

#[derive(Clone, Debug)]
struct Plan {
    random: ChaCha8Rng,
    /// The last ends of legs, in time.
    knots: VecDeque<(f64, Pose)>,
}

impl Reversals {
    /// A motion that rests from the end of the leg flown at `end_s`.
    pub(super) fn new(random: ChaCha8Rng, end_s: f64) -> Self {
        let plan = RefCell::new(Plan::new(random.clone()));
        Self { random, end_s, shrunk: [DVec3::ONE; 2], plan }
    }

    /// Flies in a smaller box.
    pub(super) fn shrink(&mut self, by_m: DVec3, by_rad: DVec3) {
        self.shrunk = [by_m, by_rad];
    }

    /// The pose of the tool at `time_s`.
    pub(super) fn pose(&self, time_s: f64) -> Pose {
        let mut plan = self.plan.borrow_mut();
        if plan.knots.front().is_some_and(|(first_s, _)| time_s < *first_s) {
            *plan = Plan::new(self.random.clone());
        }
        while let Some((last_s, _)) = plan.knots.back()
            && *last_s <= time_s
            && *last_s < self.end_s
        {
            plan.fly(self.shrunk);
        }
        on_path(plan.knots.make_contiguous(), time_s)
    }
}

impl Plan {
    fn new(random: ChaCha8Rng) -> Self {
        Self { random, knots: VecDeque::from([(0.0, Pose::HOME)]) }
    }

    fn fly(&mut self, [by_m, by_rad]: [DVec3; 2]) {
        let Self { random, knots } = self;
        if knots.len() == KEPT {
            knots.pop_front();
        }
        let time_s = knots.back().map_or(0.0, |(time_s, _)| *time_s) + random.random_range(LEG_S);
        let mut vector = |half: f64| DVec3::from([0; 3].map(|_| random.random_range(-half..half)));
        knots.push_back((time_s, Pose::from_vectors(vector(BOX_M) * by_m, vector(BOX_RAD) * by_rad)));
    }
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng;

    use super::*;

    fn reversals(end_s: f64) -> Reversals {
        Reversals::new(ChaCha8Rng::seed_from_u64(1), end_s)
    }

    #[test]
    fn the_tool_stays_in_its_box_and_comes_to_rest() {
        let motion = reversals(2.0);
        for i in 0..2000 {
            let pose = motion.pose(f64::from(i) * 1e-3);
            assert!(pose.translation_m.abs().max_element() <= BOX_M);
        }
        assert_eq!(motion.pose(0.0), Pose::HOME);
        assert_eq!(motion.pose(10.0), motion.pose(11.0));
    }

    /// No motion of 100,000 years is planned ahead, and none depends on what was asked before.
    #[test]
    fn the_path_does_not_depend_on_the_order_of_queries() {
        let (endless, once) = (reversals(f64::INFINITY), reversals(3.2e12));
        let times_s = [0.0, 0.3, 0.004, 40.0, 39.999, 12.0, 40.0, -1.0];
        for time_s in times_s {
            assert_eq!(endless.pose(time_s), reversals(3.2e12).pose(time_s), "{time_s} s");
            assert_eq!(endless.pose(time_s), once.pose(time_s), "{time_s} s");
        }
        assert!(once.plan.borrow().knots.len() <= KEPT);
        assert!(endless.pose(12.0) != endless.pose(12.01), "at rest");
    }
}
