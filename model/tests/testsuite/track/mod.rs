//! Following a tool: a head in front of a tool in motion.

mod faults;
mod motion;

use crate::common::{generator, wide};
use glam::DVec3;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use slitpose_model::{Pair, Photocurrents, Pose, Reading, Scene, Solver, Tier, Tracked, Tracker};

const PERIOD_S: f64 = 250e-6;
const OFFSETS_S: [f64; 6] = [-34e-6, 0.0, 34e-6, -34e-6, 0.0, 34e-6];

/// Of the converter, amperes: about what a real frame has.
const NOISE_A: f64 = 1.8e-9;

fn scene() -> Scene {
    let mut scene = wide();
    scene.noise.as_mut().expect("noise").adc_a = NOISE_A;
    scene
}

/// A head in front of a moving tool.
struct Rig {
    tracker: Tracker<f64>,
    solver: Solver<f64>,
    offsets_s: [f64; 6],
    period_s: f64,
    rng: ChaCha8Rng,
    frame: u64,
}

impl Rig {
    fn new() -> Self {
        Self::exposed(OFFSETS_S)
    }

    fn exposed(offsets_s: [f64; 6]) -> Self {
        Self::scheduled(offsets_s, PERIOD_S)
    }

    fn scheduled(offsets_s: [f64; 6], period_s: f64) -> Self {
        let solver = Solver::<f64>::new(&scene(), Tier::Paper).expect("scene").with_exposures(&offsets_s);
        Self {
            tracker: Tracker::new(solver.clone(), period_s),
            solver,
            offsets_s,
            period_s,
            rng: generator(),
            frame: 0,
        }
    }

    fn filtered(memory_s: f64) -> Self {
        let rig = Self::new();
        Self { tracker: rig.tracker.with_filter(memory_s), ..rig }
    }

    fn readings(&mut self, pose: impl Fn(f64) -> Pose) -> Photocurrents {
        let time_s = self.frame as f64 * self.period_s;
        Photocurrents::of_pairs((0..6).map(|cell| {
            let pair = self.solver.plan().photocurrents(cell, &pose(time_s + self.offsets_s[cell]));
            let mut noise = || NOISE_A * <StandardNormal as Distribution<f64>>::sample(&StandardNormal, &mut self.rng);
            Pair { i_x1_a: pair.i_x1_a + noise(), i_x2_a: pair.i_x2_a + noise() }
        }))
    }

    /// One frame of a motion: what is told, and where the tool was.
    fn step(&mut self, pose: impl Fn(f64) -> Pose) -> (Tracked, Pose) {
        let readings = self.readings(&pose);
        let tracked = self.tracker.track(self.frame, &readings);
        let truth = pose(self.frame as f64 * self.period_s);
        self.frame += 1;
        (tracked, truth)
    }
}

fn nees(tracked: &Tracked, truth: &Pose) -> f64 {
    tracked.solution.estimate.and_then(|estimate| estimate.nees(truth)).expect("pose and covariance")
}

/// Up to 0.45 m/s and 5 rad/s.
fn swing(time_s: f64) -> Pose {
    swing_at(time_s, 1.0)
}

fn swing_at(time_s: f64, speed: f64) -> Pose {
    let (a, b) = (120.0 * speed * time_s, 90.0 * speed * time_s);
    Pose::from_vectors(
        DVec3::new(2.5 * a.sin(), 2.5 * b.cos(), 2.0 * a.cos()) * 1e-3,
        DVec3::new(0.03 * b.sin(), 0.025 * a.cos(), 0.03 * a.sin()),
    )
}

/// The next frame with `fault` done to its readings, frames counted from `start`.
fn faulty(rig: &mut Rig, motion: impl Fn(f64) -> Pose, fault: &mut dyn FnMut(&mut Photocurrents)) -> (Tracked, Pose) {
    let mut readings = rig.readings(&motion);
    fault(&mut readings);
    let tracked = rig.tracker.track(rig.frame, &readings);
    let truth = motion(rig.frame as f64 * rig.period_s);
    rig.frame += 1;
    (tracked, truth)
}

fn blocked(pair: &mut Reading) {
    // As a converter near zero: a nanoampere or two of noise.
    *pair = Reading::Light(Pair { i_x1_a: 1e-9, i_x2_a: -2e-9 });
}
