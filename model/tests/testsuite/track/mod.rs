//! Following a tool: a head in front of a tool in motion, at rest, in fast motion, at walls, over jumps and gaps.

use glam::DVec3;
use rand_chacha::ChaCha8Rng;
use slitpose_model::{Outcome, Pair, Photocurrents, Pose, Reading, Scene, Solver, Tier, Tracked, Tracker};

use crate::common::{generator, normal, wide};

mod faults;
mod levels;
mod motion;

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
#[derive(Clone)]
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
            let mut noise = || NOISE_A * normal(&mut self.rng);
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

/// Frames of six cells tell the light level, those of four have it from them: without, they err by hundreds of σ.
#[test]
fn few_cells_have_the_light_level_of_the_frames_before() {
    const LEVEL: f64 = 0.95;
    let mut scene = scene();
    scene.uncertainty.light_level_relative = 0.1;
    let mut rig = Rig::new();
    rig.solver = Solver::new(&scene, Tier::Paper).expect("scene").with_exposures(&OFFSETS_S);
    rig.tracker = Tracker::new(rig.solver.clone(), PERIOD_S);
    let (mut squares, mut count) = (0.0, 0);
    for frame in 0..900 {
        let is_covered = frame >= 600;
        let dim = &mut |readings: &mut Photocurrents| {
            for (cell, reading) in readings.cells.iter_mut().enumerate() {
                if let Reading::Light(pair) = reading {
                    *pair = Pair { i_x1_a: LEVEL * pair.i_x1_a, i_x2_a: LEVEL * pair.i_x2_a };
                }
                if is_covered && cell % 3 == 0 {
                    *reading = Reading::Missing;
                }
            }
        };
        let (tracked, truth) = faulty(&mut rig, swing, dim);
        if is_covered {
            assert_eq!(tracked.solution.cells_used.count(), 4);
            squares += nees(&tracked, &truth);
            count += 1;
        }
    }
    // Six, and what is left of the noise of the mean level.
    let mean = squares / f64::from(count);
    assert!((4.5..9.0).contains(&mean), "{mean}");
}

#[test]
fn a_swinging_tool_is_followed_honestly() {
    for speed in [0.0, 0.25, 0.5, 0.75, 1.0, 1.5, 2.0] {
        let swing = |t: f64| swing_at(t, speed);
        let mut rig = Rig::new();
        let (mut sum, mut count) = (0.0, 0.0);
        for frame in 0..4000 {
            let (tracked, truth) = rig.step(swing);
            assert_eq!(tracked.solution.outcome, Outcome::Converged, "frame {frame}");
            if frame >= 200 {
                sum += nees(&tracked, &truth);
                count += 1.0;
            }
        }
        println!("speed {speed}: NEES {:.3}", sum / count);
        // σ of a mean of 4000 is 0.055. What a parabola misses of the bends is told as soon as it is more than chance, at
        // twice the speed.
        assert!(if speed < 2.0 { 5.6..6.3 } else { 4.8..7.0 }.contains(&(sum / count)));
    }
}

/// In frames of a millisecond acceleration moves the tool by up to 9 µm, where noise leaves 4 µm. The covariance includes what is
/// unknown of it, and all poses are `converged`.
#[test]
fn acceleration_within_a_long_frame_is_allowed_for() {
    let offsets_s = [-400e-6, -240e-6, -80e-6, 80e-6, 240e-6, 400e-6];
    for speed in [0.0, 0.25, 0.5, 1.0, 1.5] {
        let swing = |t: f64| swing_at(t, speed);
        let mut rig = Rig::scheduled(offsets_s, 1e-3);
        let (mut sum, mut converged, mut squares) = (0.0, 0, 0.0);
        for _ in 0..2000 {
            let (tracked, truth) = rig.step(swing);
            converged += u32::from(tracked.solution.outcome == Outcome::Converged);
            sum += nees(&tracked, &truth) / 2000.0;
            let pose = tracked.solution.estimate.expect("a pose").pose;
            squares += pose.displacement_from(&truth).0.length_squared() / 2000.0;
        }
        println!("speed {speed}: NEES {sum:.2}, {converged} converged, {:.2} µm", squares.sqrt() * 1e6);
        assert_eq!(converged, 2000, "speed {speed}");
        // σ is that of any hand while the motion is unknown: too large for most, never too small. As long as a parabola predicts
        // the poses, the acceleration costs no accuracy: 3.8 µm is the error of a tool at rest.
        assert!((2.0..7.0).contains(&sum), "speed {speed}: {sum}");
        assert!(speed > 0.5 || squares.sqrt() < 4.3e-6, "speed {speed}: {squares}");
    }
}

#[test]
fn a_motion_goes_on_after_a_gap_at_the_right_instant() {
    let straight = |t: f64| Pose::from_vectors(DVec3::new(0.4 * t - 3e-3, 0.1 * t, 0.0), DVec3::ZERO);
    for gap in [1, 3, 7] {
        let mut rig = Rig::filtered(5e-3);
        let sigma = |tracked: &Tracked| tracked.solution.estimate.expect("a pose").sigma()[0];
        let before = (0..40).map(|_| sigma(&rig.step(straight).0)).last().expect("frames");
        rig.frame += gap;
        let (tracked, _) = rig.step(straight);
        // One frame off, the tool would be 100 µm from where it is expected: a hit, and its motion forgotten.
        assert!(sigma(&tracked) < 1.2 * before, "gap {gap}: {} after {before}", sigma(&tracked));
        let twist = tracked.twist.expect("the motion is known");
        assert!((twist.twist.linear_m_per_s.x - 0.4).abs() < 0.05, "gap {gap}: {twist:?}");
        assert!(tracked.filtered.expect("filter").frames > 40, "gap {gap}");
    }
}

#[test]
fn a_tool_that_hits_something_may_leave_as_fast_as_it_came() {
    let (speed, leg_frames) = (2.0, 12.0);
    // To and fro, turning within a frame's exposures.
    let motion = |t: f64| {
        let phase = (t / PERIOD_S + 0.3).rem_euclid(2.0 * leg_frames);
        let x = if phase < leg_frames { phase } else { 2.0 * leg_frames - phase };
        let way = (x - 0.5 * leg_frames) * PERIOD_S * speed;
        Pose::from_vectors(DVec3::new(way, 0.0, 0.5 * way), DVec3::ZERO)
    };
    let mut rig = Rig::new();
    let (mut sum, mut count) = (0.0, 0.0);
    for frame in 0..2400 {
        // Four cells do not tell twist and pose apart without a prior that is wide enough.
        let (tracked, truth) = faulty(&mut rig, motion, &mut |readings| readings.cells[1..3].fill(Reading::Missing));
        // The frame in which it turns has no one twist; the two after it have one that nobody knows.
        if frame > 24 && (1.0..3.0).contains(&(frame as f64 + 0.3).rem_euclid(leg_frames)) {
            sum += nees(&tracked, &truth);
            count += 1.0;
        }
    }
    println!("NEES {:.2} of {count} frames after a hit", sum / count);
    // Wider than need be the covariance may be.
    assert!(sum / count < 6.0 + 4.5 * f64::sqrt(12.0 / count));
}

#[test]
fn a_jump_of_the_tool_is_believed_at_once() {
    let mut rig = Rig::filtered(5e-3);
    let there = Pose::from_vectors(DVec3::new(1e-3, 0.0, -0.5e-3), DVec3::new(0.0, 0.17, 0.0));
    for frame in 0..120 {
        let (tracked, truth) = rig.step(|_| if frame < 100 { Pose::HOME } else { there });
        assert!(nees(&tracked, &truth) < 45.0, "frame {frame}");
        if frame > 102 {
            let state = tracked.filtered.expect("two frames");
            assert!(state.estimate.nees(&truth).expect("covariance") < 45.0, "frame {frame}");
        }
    }
}

#[test]
fn light_that_comes_back_is_a_pose_again() {
    let mut rig = Rig::new();
    for _ in 0..50 {
        rig.step(swing);
    }
    for missing in [3, 200] {
        for _ in 0..missing {
            let tracked = rig.tracker.track(rig.frame, &Photocurrents { cells: [Reading::<f64>::Missing; 6].into() });
            assert!(tracked.solution.estimate.is_none() && tracked.twist.is_err());
            rig.frame += 1;
        }
        for frame in 0..20 {
            let (tracked, truth) = rig.step(swing);
            assert_eq!(tracked.solution.outcome, Outcome::Converged, "{frame} frames after {missing}");
            assert!(nees(&tracked, &truth) < 45.0);
        }
    }
}

/// Callers move solvers by value, which a build without optimisation copies. With the cells of its plan in place a solver
/// has 128 kB, and the daemon's judge of a head took more than the 2 MiB that a thread has by default.
#[cfg(feature = "lanes")]
#[test]
fn solvers_and_trackers_pass_through_small_stacks() {
    use crate::common::seen;

    let whole_chain = || {
        for tier in [Tier::Paper, Tier::Exact { tolerance: 1e-6 }] {
            let solver = Solver::<f64>::new(&wide(), tier).expect("scene").with_exposures(&[0.0; 6]).with_max_steps(9);
            let pose = Pose::from_vectors(DVec3::ZERO, DVec3::ZERO);
            let seen = seen(solver.plan(), &pose);
            let mut tracker = Tracker::new(solver.clone(), 250e-6).with_filter(1e-3);
            for frame in 0..3 {
                assert!(matches!(tracker.track(frame, &seen).solution.outcome, Outcome::Converged));
            }
        }
    };
    let thread = std::thread::Builder::new().stack_size(384 << 10).spawn(whole_chain);
    thread.expect("a thread").join().expect("it has stack enough");
}
