//! Velocities and filtered poses, and what is told of their errors.

use std::f64::consts::TAU;

use glam::DVec3;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use slitpose_model::{NoTwist, Photocurrents, Pose, Reading, Tracked, TwistEstimate};

use super::{PERIOD_S, Rig};
use crate::common::SEED;

/// Half sides of the box in which a tool moves.
const BOX: [f64; 6] = [2.5e-3, 2.5e-3, 2.5e-3, 0.12, 0.12, 0.12];

fn pose(v: [f64; 6]) -> Pose {
    Pose::from_vectors(DVec3::new(v[0], v[1], v[2]), DVec3::new(v[3], v[4], v[5]))
}

/// Sinusoids of up to 0.5 m/s and 5 rad/s, times `speed`.
fn sines(speed: f64) -> impl Fn(f64) -> Pose {
    let mut rng = ChaCha8Rng::seed_from_u64(SEED);
    let of: [_; 6] = std::array::from_fn(|i| {
        let most = if i < 3 { 0.5 } else { 5.0 } / 3.0_f64.sqrt();
        (rng.random_range(0.8..1.2) * speed * most / BOX[i], rng.random_range(0.0..TAU))
    });
    move |t| pose(std::array::from_fn(|i| BOX[i] * (of[i].0 * t + of[i].1).sin()))
}

/// A hand: 1 to 3 Hz, with pauses.
fn hand(t: f64) -> Pose {
    // Time that stands still for a third of each 2.7 s.
    let phase = t.rem_euclid(2.7);
    let own =
        (t / 2.7).floor() * 1.8 + if phase < 1.8 { phase - 0.2 * (TAU * phase / 1.8).sin() * 1.8 / TAU } else { 1.8 };
    pose(std::array::from_fn(|i| {
        let hertz = 1.0 + 0.37 * i as f64;
        BOX[i] * (0.6 * (TAU * hertz * own + i as f64).sin() + 0.3 * (TAU * (3.2 - hertz) * own).cos())
    }))
}

/// Straight flights, of 5 to 25 ms each, with abrupt turns.
fn contact() -> impl Fn(f64) -> Pose {
    let mut rng = ChaCha8Rng::seed_from_u64(SEED);
    let mut knots = vec![(0.0, [0.0; 6])];
    while knots.last().expect("one").0 < 5.0 {
        let at = knots.last().expect("one").0 + rng.random_range(5e-3..25e-3);
        knots.push((at, BOX.map(|half| rng.random_range(-half..half))));
    }
    move |t| {
        let after = knots.partition_point(|&(knot, _)| knot <= t).clamp(1, knots.len() - 1);
        let ((from_s, from), (to_s, to)) = (knots[after - 1], knots[after]);
        let share = (t - from_s) / (to_s - from_s);
        pose(std::array::from_fn(|i| from[i] + share * (to[i] - from[i])))
    }
}

/// To and fro between walls on each axis by itself, each hit half a sine of a millisecond.
fn hits(t: f64) -> Pose {
    pose(std::array::from_fn(|i| {
        let (flight, hit) = ((19.0 + 2.3 * i as f64) * 1e-3, 1e-3);
        let velocity = 1.6 * BOX[i] / flight;
        let legs = (t + 1.7e-3 * i as f64) / (flight + hit);
        let (number, own) = (legs.floor(), legs.fract() * (flight + hit));
        let way = if own < flight {
            velocity * (own - 0.5 * flight)
        } else {
            // v·cos(πt/h): from v to −v.
            0.5 * velocity * flight + velocity * hit / (0.5 * TAU) * (0.5 * TAU * (own - flight) / hit).sin()
        };
        if number.rem_euclid(2.0) == 0.0 { way } else { -way }
    }))
}

/// What errors are in units of what is told.
#[derive(Default)]
struct Account {
    frames: f64,
    /// Frames with a twist.
    twists: f64,
    /// Mean square of the six components of the twist.
    mean: f64,
    /// Frames with a component beyond 5 σ.
    beyond: f64,
    /// Mean squares: of the filtered pose in its σ, of its translation and of the frame's own, metres.
    filtered_nees: f64,
    filtered: f64,
    own: f64,
}

impl Account {
    fn of(motion: impl Fn(f64) -> Pose, period_s: f64, memory_s: f64) -> Self {
        let mut rig = Rig::scheduled([0.0; 6], period_s);
        rig.tracker = rig.tracker.with_filter(memory_s);
        let mut account = Self::default();
        let frames = (2.0 / period_s).min(6000.0) as u32;
        for frame in 0..frames {
            let time_s = (rig.frame as f64 + 0.37) * period_s;
            let (tracked, truth) = rig.step(|t| motion(t + 0.37 * period_s));
            if frame >= 100 {
                account.add(&tracked, &truth, &motion, time_s);
            }
        }
        for sum in [&mut account.filtered_nees, &mut account.filtered, &mut account.own] {
            *sum /= account.frames;
        }
        account.mean /= account.twists;
        account
    }

    fn add(&mut self, tracked: &Tracked, truth: &Pose, motion: &impl Fn(f64) -> Pose, time_s: f64) {
        self.frames += 1.0;
        let filtered = tracked.filtered.expect("a filter");
        let own = tracked.solution.estimate.expect("a pose").pose;
        self.filtered_nees += filtered.estimate.nees(truth).expect("covariance") / 6.0;
        self.filtered += filtered.estimate.pose.displacement_from(truth).0.length_squared();
        self.own += own.displacement_from(truth).0.length_squared();
        let Ok(told) = tracked.twist else { return };
        self.twists += 1.0;
        let squares = squared_sigmas(&told, motion, time_s);
        self.mean += squares.iter().sum::<f64>() / 6.0;
        self.beyond += f64::from(u8::from(squares.iter().any(|square| *square > 25.0)));
    }
}

fn squared_sigmas(told: &TwistEstimate, motion: &impl Fn(f64) -> Pose, time_s: f64) -> [f64; 6] {
    let h = 1e-7;
    let (dt, dr) = motion(time_s + h).displacement_from(&motion(time_s - h));
    let off = [told.twist.linear_m_per_s - dt / (2.0 * h), told.twist.angular_rad_per_s - dr / (2.0 * h)];
    std::array::from_fn(|i| off[i / 3][i % 3].powi(2) / told.covariance[i][i])
}

/// Mean squares are of thousands of frames whose errors are correlated over some ten: a tenth is chance. Below 1 they are where
/// the motion is slower than the steadiest filter reckons with; a tool that hits something has a few frames with all of its
/// error, and σ is so wide for them.
#[test]
fn velocities_err_as_told_in_every_motion_and_filtered_poses_err_no_more_than_frames() {
    type Motion = Box<dyn Fn(f64) -> Pose>;
    let motions: [(&str, Motion, f64); 6] = [
        ("slow", Box::new(sines(0.25)), 0.0),
        ("smooth", Box::new(sines(1.0)), 0.0),
        ("fast", Box::new(sines(4.0)), 0.0),
        ("hand", Box::new(hand), 0.0),
        ("contact", Box::new(contact()), 3e-3),
        ("hits", Box::new(hits), 12e-3),
    ];
    let mut failed = Vec::new();
    for (name, motion, most_beyond) in &motions {
        for rate in [1e3, 2e3, 4e3] {
            let account = Account::of(motion, 1.0 / rate, 5e-3);
            let Account { frames, twists, mean, beyond, filtered_nees, filtered, own } = account;
            println!(
                "{name} {rate}: twist {mean:.2} σ², {:.2} ‰ beyond 5 σ, withheld {:.1} %; filtered {filtered_nees:.2} σ², \
                 {:.2} of {:.2} µm",
                1e3 * beyond / twists,
                100.0 * (1.0 - twists / frames),
                1e6 * filtered.sqrt(),
                1e6 * own.sqrt(),
            );
            // Hits of a millisecond fall between two frames of a millisecond.
            let most_beyond = if *name == "hits" && rate == 1e3 { 50e-3 } else { *most_beyond };
            let is_honest = (0.2..1.3).contains(&mean) && beyond <= most_beyond * twists + 1.0;
            let is_filtered_well = (0.75..1.4).contains(&filtered_nees) && filtered <= 1.05 * own;
            // While a tool has hit something lately, more frames are doubtful.
            let is_told = twists > if most_beyond > 0.0 { 0.5 } else { 0.94 } * frames;
            if !(is_honest && is_filtered_well && is_told) {
                failed.push(format!("{name} {rate}"));
            }
        }
    }
    assert!(failed.is_empty(), "{failed:?}");
}

#[test]
fn a_filter_trades_noise_for_the_lag_it_tells() {
    let mut sigmas = Vec::new();
    for memory_s in [2e-3, 20e-3] {
        let mut rig = Rig::filtered(memory_s);
        let (mut sum, mut raw, mut filtered, mut count) = (0.0, 0.0, 0.0, 0.0);
        for frame in 0..6000 {
            let (tracked, truth) = rig.step(|_| Pose::HOME);
            if frame < 1000 {
                continue;
            }
            let state = tracked.filtered.expect("filter");
            sum += state.estimate.nees(&truth).expect("covariance");
            raw += tracked.solution.estimate.expect("pose").sigma()[0];
            filtered += state.estimate.sigma()[0];
            count += 1.0;
        }
        println!("memory {memory_s} s: NEES {:.2}, σ {:.3} of a frame's", sum / count, filtered / raw);
        // Neighbouring poses share most of their noise: some 5000 frames hold few independent ones. A filter that allows for
        // motion is too cautious of a tool at rest.
        assert!((4.0..7.0).contains(&(sum / count)));
        sigmas.push(filtered / raw);
        // A step of a tenth of σ comes through by half in the time told before.
        let step_m = 0.1 * filtered / count;
        let told_s = rig.step(|_| Pose::HOME).0.filtered.expect("filter").lag_s;
        let mut reference = rig.clone();
        let mut frames = 0.0;
        loop {
            let moved = rig.step(|_| Pose::from_vectors(DVec3::X * step_m, DVec3::ZERO)).0;
            let still = reference.step(|_| Pose::HOME).0;
            let [moved, still] = [moved, still].map(|tracked| tracked.filtered.expect("filter").estimate.pose);
            if moved.translation_m.x - still.translation_m.x > 0.5 * step_m {
                break;
            }
            frames += 1.0;
        }
        assert!((frames * PERIOD_S - told_s).abs() < 1.5 * PERIOD_S + 0.2 * told_s, "{frames} frames, {told_s} s");
    }
    // √α of 8 and 80 frames: √0.313 and √0.0368.
    assert!((0.53..0.62).contains(&sigmas[0]) && (0.17..0.25).contains(&sigmas[1]), "{sigmas:?}");
}

#[test]
fn the_lag_told_is_that_of_the_steadiest_coordinate() {
    let told_s = |swing_m: f64| {
        let mut rig = Rig::filtered(20e-3);
        let pose = |t: f64| Pose::from_vectors(DVec3::X * swing_m * (150.0 * t).sin(), DVec3::ZERO);
        (0..1000).map(|_| rig.step(pose).0.filtered.expect("filter").lag_s).last().expect("frames")
    };
    let (at_rest, swinging) = (told_s(0.0), told_s(3e-3));
    assert!((swinging / at_rest - 1.0).abs() < 0.2, "{swinging} s, {at_rest} s at rest");
}

/// Half a metre a second into a wall, and back with half of it.
#[test]
fn of_a_hit_there_is_no_velocity_until_the_new_one_is_known() {
    let hit_frame = 200.3;
    let motion = |t: f64| {
        let since_s = t - hit_frame * PERIOD_S;
        let way = if since_s < 0.0 { 0.5 * since_s } else { -0.25 * since_s };
        Pose::from_vectors(DVec3::new(2e-3 + way * 0.1, way * 0.05, 0.0), DVec3::new(way * 0.5, 0.0, 0.0))
    };
    let mut rig = Rig::new();
    let twists: Vec<_> = (0..240).map(|_| rig.step(motion).0.twist).collect();
    assert_eq!(twists[2], Err(NoTwist::Start));
    // It shows a frame or two after the hit.
    let withheld: Vec<usize> = (150..240).filter(|&frame| twists[frame] == Err(NoTwist::Jump)).collect();
    let first = *withheld.first().expect("the hit is seen");
    assert!((201..204).contains(&first) && withheld.len() <= 5, "{withheld:?}");
    let told = twists[first + 5].expect("known again");
    let error = told.twist.linear_m_per_s.x + 0.025;
    assert!(error.abs() < 4.0 * told.covariance[0][0].sqrt(), "{error}");
    let nothing = Photocurrents { cells: [Reading::<f64>::Missing; 6].into() };
    assert_eq!(rig.tracker.track(rig.frame, &nothing).twist, Err(NoTwist::NoPose));
}
