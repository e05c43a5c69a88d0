//! Motions of the tool.

use std::cell::RefCell;
use std::collections::VecDeque;
use std::f64::consts::PI;
use std::ops::Range;

use glam::DVec3;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use slitpose_model::{Pose, Twist};
use thiserror::Error;

use crate::scene_file::Workspace;
use crate::table::{PoseColumns, PoseSizes, TableError, TableReader};

const SMOOTH_M_PER_S: f64 = 0.5;
const SMOOTH_RAD_PER_S: f64 = 5.0;

/// Amplitude of smooth and fast motions, per axis: inside the usual workspace.
const AMPLITUDE_M: f64 = 2.5e-3;
const AMPLITUDE_RAD: f64 = 0.17;

/// Most of a smaller workspace that a motion takes, see [`Trajectory::within`].
const SHARE: f64 = 0.9;

/// A fast motion is a smooth one at this many times the speed.
const FAST: f64 = 4.0;

/// Most poses of a path, 72 bytes each: 35 minutes at 4 kHz.
const MAX_KNOTS: u64 = 1 << 23;

/// Motions that need no file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TrajectoryKind {
    /// At rest at home.
    Still,
    /// As a hand moves it: to and fro some times a second, with rests, and now and then against a wall.
    Hand,
    /// Sinusoids in all six coordinates, up to 0.5 m/s and 5 rad/s.
    Smooth,
    /// The same four times as fast.
    Fast,
    /// Straight flight with abrupt reversals, as against a wall.
    Contact,
}

impl TrajectoryKind {
    /// All kinds with their names.
    pub const NAMED: [(&'static str, Self); 5] = [
        ("still", Self::Still),
        ("hand", Self::Hand),
        ("smooth", Self::Smooth),
        ("fast", Self::Fast),
        ("contact", Self::Contact),
    ];

    /// The kind of this name.
    pub fn named(name: &str) -> Option<Self> {
        Self::NAMED.iter().find_map(|&(known, kind)| (known == name).then_some(kind))
    }
}

/// The pose of the tool as a function of time.
///
/// ```
/// use slitpose_head::simulator::{Trajectory, TrajectoryKind};
/// let hand = Trajectory::of_kind(TrajectoryKind::Hand, 1, 10.0);
/// assert_eq!(hand.pose(2.0), Trajectory::of_kind(TrajectoryKind::Hand, 1, 10.0).pose(2.0), "the same seed");
/// ```
#[derive(Clone, Debug)]
pub struct Trajectory(Motion);

#[derive(Clone, Debug)]
enum Motion {
    Still,
    /// As `Sines`.
    Hand([(f64, f64, f64); 6]),
    /// Amplitude, angular frequency and phase of each coordinate.
    Sines([(f64, f64, f64); 6]),
    /// Knots in time, constant twist between them, at rest before and after.
    Path(Vec<(f64, Pose)>, PoseSizes),
    Reversals(Box<Reversals>),
}

/// Why a table is not a path.
#[derive(Debug, Error)]
#[allow(missing_docs, reason = "the texts say what each is")]
pub enum PathError {
    #[error(transparent)]
    Table(#[from] TableError),
    #[error("{0}: time {2} s follows {1} s; sort the rows by time_s, each time once")]
    Order(String, f64, f64),
}

impl Trajectory {
    /// A random motion of a kind, from `seed`. Motions with reversals rest after `duration_s`, which may be
    /// infinite.
    pub fn of_kind(kind: TrajectoryKind, seed: u64, duration_s: f64) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        Self(match kind {
            TrajectoryKind::Still => Motion::Still,
            TrajectoryKind::Hand => Motion::Hand(sines(&mut rng, HAND)),
            TrajectoryKind::Smooth => Motion::Sines(sines(&mut rng, [1.0; 2])),
            TrajectoryKind::Fast => Motion::Sines(sines(&mut rng, [FAST; 2])),
            TrajectoryKind::Contact => Motion::Reversals(Box::new(Reversals::new(rng, duration_s))),
        })
    }

    /// The same motion in a smaller space, where the head's `workspace` is too small for it: as often to and fro on each
    /// axis. Paths stay as they are.
    #[must_use]
    pub fn within(mut self, workspace: &Workspace) -> Self {
        let by_m = (workspace.half_extent_m * (SHARE / AMPLITUDE_M)).min(DVec3::ONE);
        let by_rad = (workspace.half_extent_rad * (SHARE / AMPLITUDE_RAD)).min(DVec3::ONE);
        let by = by_m.to_array().into_iter().chain(by_rad.to_array());
        match &mut self.0 {
            Motion::Still | Motion::Path(..) => {}
            Motion::Sines(sines) | Motion::Hand(sines) => {
                sines.iter_mut().zip(by).for_each(|((amplitude, ..), by)| *amplitude *= by);
            }
            Motion::Reversals(reversals) => reversals.shrink(by_m, by_rad),
        }
        self
    }

    /// A path through the poses of a CSV table: `time_s` and the columns of a pose. Between rows
    /// the twist is constant, so rows may turn corners.
    pub fn from_table(file: &str) -> Result<Self, PathError> {
        Self::through_rows(TableReader::open(file)?)
    }

    /// As [`Self::from_table`], of a table that is open.
    pub fn through_rows(table: TableReader) -> Result<Self, PathError> {
        let mut table = table.of_at_most(MAX_KNOTS);
        let time = table.column("time_s")?;
        let columns = PoseColumns::keyed(&table, "time_s")?;
        let (mut knots, mut sizes) = (Vec::<(f64, Pose)>::new(), PoseSizes::default());
        while let Some(row) = table.next_row()? {
            let time_s = row.number(time)?;
            if let Some(&(before_s, _)) = knots.last()
                && time_s <= before_s
            {
                return Err(PathError::Order(table.file().to_owned(), before_s, time_s));
            }
            knots.push((time_s, sizes.pose(&columns, &row)?));
        }
        Ok(Self(Motion::Path(knots, sizes)))
    }

    /// Instants, seconds, and poses that a path leads through, and the numbers of its table; `None` of any other motion.
    pub fn path(&self) -> Option<(&[(f64, Pose)], &PoseSizes)> {
        if let Motion::Path(knots, sizes) = &self.0 { Some((knots, sizes)) } else { None }
    }

    /// First and last instant of a path, seconds; `None` of any other motion.
    pub fn span_s(&self) -> Option<[f64; 2]> {
        let (knots, _) = self.path()?;
        Some([knots.first()?.0, knots.last()?.0])
    }

    /// A path through `knots`, in the order of time in seconds, with a constant twist between them.
    pub fn through(knots: Vec<(f64, Pose)>) -> Self {
        Self(Motion::Path(knots, PoseSizes::default()))
    }

    /// Whether `time_s` is within the path; before and after it the tool rests.
    pub fn covers(&self, time_s: f64) -> bool {
        self.span_s().is_none_or(|[first_s, last_s]| (first_s..=last_s).contains(&time_s))
    }

    /// The pose of the tool at `time_s`.
    pub fn pose(&self, time_s: f64) -> Pose {
        match &self.0 {
            Motion::Still => Pose::HOME,
            Motion::Sines(sines) => {
                pose_of(sines.map(|(amplitude, frequency, phase)| amplitude * (frequency * time_s + phase).sin()))
            }
            Motion::Hand(sines) => {
                let moved_s = moved_s(time_s);
                let mut v = sines.map(|(amplitude, frequency, phase)| {
                    let angle = frequency * moved_s + phase;
                    amplitude * angle.sin() * (0.6 + 0.4 * (SWELL * angle).cos())
                });
                v[2] = v[2].max(WALL * sines[2].0);
                pose_of(v)
            }
            Motion::Path(knots, _) => on_path(knots, time_s),
            Motion::Reversals(reversals) => reversals.pose(time_s),
        }
    }
}

fn pose_of(v: [f64; 6]) -> Pose {
    Pose::from_vectors(DVec3::new(v[0], v[1], v[2]), DVec3::new(v[3], v[4], v[5]))
}

/// A hand moves for the first part of each cycle, and rests for the remainder, seconds.
const MOVES_S: f64 = 2.9;
const CYCLE_S: f64 = 4.0;

/// The speeds of a hand's motion relative to a smooth one: 1 to 3 Hz, and rotations somewhat slower.
const HAND: [f64; 2] = [0.08, 0.3];

/// The frequency with which its amplitude swells, relative to that of the motion.
const SWELL: f64 = 0.37;

/// The wall that stops a hand along z, relative to the amplitude of its motion.
const WALL: f64 = -0.6;

/// The time along a hand's motion at `time_s`: it starts and stops without a jerk (smoothstep of fifth order).
fn moved_s(time_s: f64) -> f64 {
    let share = (time_s.rem_euclid(CYCLE_S) / MOVES_S).min(1.0);
    MOVES_S * (time_s.div_euclid(CYCLE_S) + share.powi(3) * (10.0 + share * (6.0 * share - 15.0)))
}

/// Each coordinate oscillates with its own frequency, so that all combinations occur. The greatest
/// speeds of the three axes add up, at worst, to the stated speed; `speeds` are factors of it for translation and rotation.
fn sines(rng: &mut ChaCha8Rng, speeds: [f64; 2]) -> [(f64, f64, f64); 6] {
    // Shares whose squares add up to one.
    let shares = |rng: &mut ChaCha8Rng| {
        let raw = [0; 3].map(|_| rng.random_range(0.7..1.3_f64));
        let norm = raw.iter().map(|share| share * share).sum::<f64>().sqrt();
        raw.map(|share| share / norm)
    };
    let mut out = [(0.0, 0.0, 0.0); 6];
    for (half, (amplitude, greatest)) in
        [(AMPLITUDE_M, SMOOTH_M_PER_S), (AMPLITUDE_RAD, SMOOTH_RAD_PER_S)].into_iter().enumerate()
    {
        for (axis, share) in shares(rng).into_iter().enumerate() {
            let frequency = speeds[half] * greatest * share / amplitude;
            out[3 * half + axis] = (amplitude, frequency, rng.random_range(0.0..2.0 * PI));
        }
    }
    out
}

/// The pose at `time_s` of `knots`, seconds and poses in the order of time; before the first and after the last the
/// tool is at rest.
fn on_path(knots: &[(f64, Pose)], time_s: f64) -> Pose {
    let after = knots.partition_point(|&(knot_s, _)| knot_s <= time_s);
    match (after.checked_sub(1).map(|before| knots[before]), knots.get(after)) {
        (Some((start_s, start)), Some(&(end_s, end))) => {
            let (dt, dr) = end.displacement_from(&start);
            let per_second = (end_s - start_s).recip();
            let twist = Twist { linear_m_per_s: dt * per_second, angular_rad_per_s: dr * per_second };
            twist.advance(&start, time_s - start_s)
        }
        (Some((_, pose)), None) | (None, Some(&(_, pose))) => pose,
        (None, None) => Pose::HOME,
    }
}

/// Duration of a straight leg, seconds.
const LEG_S: Range<f64> = 5e-3..25e-3;

/// Half sides of the box.
const BOX_M: f64 = 2.5e-3;
const BOX_RAD: f64 = 0.12;

/// Legs kept: for poses more than a second back, all legs are planned again.
const KEPT: usize = 256;

#[derive(Clone, Debug)]
struct Reversals {
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
    fn new(random: ChaCha8Rng, end_s: f64) -> Self {
        let plan = RefCell::new(Plan::new(random.clone()));
        Self { random, end_s, shrunk: [DVec3::ONE; 2], plan }
    }

    fn shrink(&mut self, by_m: DVec3, by_rad: DVec3) {
        self.shrunk = [by_m, by_rad];
    }

    /// The pose of the tool at `time_s`.
    fn pose(&self, time_s: f64) -> Pose {
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
    use crate::scene_file::{SPACEMOUSE, WIDE};

    #[test]
    fn motions_stay_within_the_workspace_and_only_shrink() {
        let [wide, small] = [WIDE, SPACEMOUSE].map(|shipped| shipped.read().unwrap().workspace);
        for kind in [TrajectoryKind::Hand, TrajectoryKind::Smooth, TrajectoryKind::Fast, TrajectoryKind::Contact] {
            let motion = || Trajectory::of_kind(kind, 3, f64::INFINITY);
            let (own, inside) = (motion().within(&wide), motion().within(&small));
            let mut most = [0.0_f64; 2];
            for i in 0..4000 {
                let time_s = f64::from(i) * 2.5e-3;
                assert_eq!(own.pose(time_s), motion().pose(time_s));
                let pose = inside.pose(time_s);
                most[0] = most[0].max((pose.translation_m.abs() / small.half_extent_m).max_element());
                most[1] = most[1].max((pose.rotation_rad().abs() / small.half_extent_rad).max_element());
            }
            // Nearly as far as they may; the box of reversals is less deep in rotation.
            assert!((0.8..0.95).contains(&most[0]) && (0.55..0.95).contains(&most[1]), "{kind:?}: {most:?}");
        }
    }

    fn greatest_speeds(trajectory: &Trajectory) -> (f64, f64) {
        let step = 1e-5;
        (0..200_000).fold((0.0, 0.0), |(linear, angular), i| {
            let time_s = f64::from(i) * 5e-5;
            let (dt, dr) = trajectory.pose(time_s + step).displacement_from(&trajectory.pose(time_s));
            (f64::max(linear, dt.length() / step), f64::max(angular, dr.length() / step))
        })
    }

    #[test]
    fn smooth_motion_comes_near_its_greatest_speed_and_not_above() {
        for seed in 0..5 {
            let (linear, angular) = greatest_speeds(&Trajectory::of_kind(TrajectoryKind::Smooth, seed, 10.0));
            assert!((0.45..=0.5001).contains(&linear), "seed {seed}: {linear} m/s");
            assert!((4.0..=5.001).contains(&angular), "seed {seed}: {angular} rad/s");
        }
    }

    #[test]
    fn a_hand_moves_rests_and_meets_its_wall() {
        let hand = Trajectory::of_kind(TrajectoryKind::Hand, 1, f64::INFINITY);
        let (linear, angular) = greatest_speeds(&hand);
        assert!((0.01..0.08).contains(&linear) && (0.5..5.0).contains(&angular), "{linear} m/s, {angular} rad/s");
        let (mut rests, mut presses) = (0, 0);
        for i in 0..10_000 {
            let time_s = f64::from(i) * 1e-2;
            let [here, there] = [time_s, time_s + 1e-3].map(|time_s| hand.pose(time_s).translation_m);
            rests += i32::from(here.distance(there) < 2e-6);
            presses += i32::from(here.z < WALL * AMPLITUDE_M + 1e-9);
        }
        assert!((2000..5000).contains(&rests) && (100..2500).contains(&presses), "{rests} {presses} of 10,000");
    }

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
