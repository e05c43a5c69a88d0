//! A tool that moves while its cells are exposed one after another, followed frame by frame: are
//! the poses as good as their covariance says?

use std::fmt;

use slitpose_head::front_end::Stage;
use slitpose_head::scene_file::SceneFile;
use slitpose_head::simulator::{Trajectory, TrajectoryKind};
use slitpose_model::{AXES, MotionPrior, Outcome, Pose, Solution, Solver, Start, Tracker, Twist};

use super::layout::Table;
use super::trials::Trials;
use crate::capture::{Decoded, STREAM, capture, decode};
use crate::consistency::{error, nees, sigma, worst_axis};

/// Frames after which a tracker knows how the tool moves: five, and some margin. The covariance of
/// those before counts a twist of which nothing is known.
const SETTLED_FRAMES: usize = 10;

/// What is followed.
#[derive(Clone, Debug)]
pub struct Conditions {
    /// The scene, with front end and lighting.
    pub file: SceneFile,
    /// How the tool moves; each run has a motion of its own.
    pub motion: TrajectoryKind,
    /// Frames of each run, the first ones not counted.
    pub frames: usize,
}

/// Errors judged by one covariance.
#[derive(Clone, Debug, Default)]
pub struct Judged {
    /// Mean of eᵀC⁻¹e of each run.
    batches: Vec<f64>,
    /// Root mean square of error/σ, per axis.
    pub in_sigmas: [f64; 6],
    /// Root mean square of error/bound for a tool at rest there, per axis.
    pub in_bounds: [f64; 6],
    /// The largest error of an axis in σ.
    pub worst_sigmas: f64,
}

impl Judged {
    /// Mean of eᵀC⁻¹e.
    pub fn nees(&self) -> f64 {
        self.batches.iter().sum::<f64>() / self.batches.len() as f64
    }

    /// Standard error of that mean. Frames that share a twist are correlated, runs are not: the
    /// scatter of the runs' means tells it.
    pub fn standard_error(&self) -> f64 {
        let (n, mean) = (self.batches.len() as f64, self.nees());
        (self.batches.iter().map(|batch| (batch - mean).powi(2)).sum::<f64>() / (n * (n - 1.0))).sqrt()
    }
}

/// What came out.
#[derive(Clone, Debug)]
pub struct Report {
    conditions: Conditions,
    trials: Trials,
    /// Poses of the tracker.
    pub tracked: Judged,
    /// Poses of single frames whose twist is known exactly: noise and optics alone.
    pub known_twist: Judged,
    /// Frames that are not `converged`.
    pub unconverged: usize,
}

/// One frame's pose against the truth.
#[derive(Clone, Copy, Debug)]
struct Frame {
    nees: f64,
    worst_sigmas: f64,
    /// (error/σ)² per axis.
    in_sigmas: [f64; 6],
    in_bounds: [f64; 6],
}

impl Frame {
    fn of(solution: &Solution, truth: &Pose, bound: &[f64; 6]) -> Option<Self> {
        let estimate = solution.estimate?;
        let error = error(&estimate.pose, truth);
        let squares = |sigma: &[f64; 6]| std::array::from_fn(|axis| (error[axis] / sigma[axis]).powi(2));
        Some(Self {
            nees: nees(&error, &estimate.covariance),
            worst_sigmas: worst_axis(&error, &estimate.covariance),
            in_sigmas: squares(&sigma(&estimate.covariance)),
            in_bounds: squares(bound),
        })
    }
}

/// One motion followed: with the tracker, with the twist known, and how many did not converge.
type Run = (Vec<Frame>, Vec<Frame>, usize);

/// Follows `trials.count` motions.
///
/// # Panics
/// If no board can run the scene.
pub fn study(conditions: Conditions, trials: Trials) -> Report {
    let runs = trials.run(|run, _| follow(&conditions, trials.seed.wrapping_add(run as u64)));
    Report {
        tracked: judge(&runs, |run| &run.0),
        known_twist: judge(&runs, |run| &run.1),
        unconverged: runs.iter().map(|run| run.2).sum(),
        conditions,
        trials,
    }
}

fn follow(conditions: &Conditions, seed: u64) -> Run {
    let Conditions { file, motion, frames } = conditions;
    let trajectory = Trajectory::of_kind(*motion, seed, 10.0);
    let Decoded { schedule, scaling, scans, truths } =
        decode(&capture(file, trajectory.clone(), STREAM, seed, SETTLED_FRAMES + frames));
    let stage = Stage::new(file, &schedule, &scaling);
    let scene = Stage::weighted_scene(file, &schedule, &scaling);
    let solver = Solver::<f64>::new(&scene, STREAM)
        .unwrap_or_else(|error| panic!("{error}"))
        .with_exposures(&stage.exposures_s());
    let mut tracker = Tracker::new(solver.clone(), schedule.frame_rate_hz().recip());
    let (mut tracked, mut known, mut unconverged) = (Vec::new(), Vec::new(), 0);
    for (frame, (scan, truth)) in scans.iter().zip(&truths).enumerate() {
        let readings = stage.photocurrents(scan);
        let solution = tracker.track(scan.sequence, &readings);
        let Some(bound) = solver.bound(truth).filter(|_| frame >= SETTLED_FRAMES) else {
            continue;
        };
        let bound = sigma(&bound);
        unconverged += usize::from(solution.solution.outcome != Outcome::Converged);
        tracked.extend(Frame::of(&solution.solution, truth, &bound));

        let time_s = (scan.tick as f64 + schedule.reference_ticks()) / f64::from(schedule.tick_hz);
        let motion = MotionPrior { twist: twist(&trajectory, time_s), ..MotionPrior::AT_REST };
        known.extend(Frame::of(&solver.solve(&readings, Start::Near(truth), &motion), truth, &bound));
    }
    (tracked, known, unconverged)
}

/// The twist of the tool at `time_s`, by a central difference as long as a frame's exposures are.
fn twist(trajectory: &Trajectory, time_s: f64) -> Twist {
    const HALF_S: f64 = 50e-6;
    let change = error(&trajectory.pose(time_s + HALF_S), &trajectory.pose(time_s - HALF_S));
    let [vx, vy, vz, wx, wy, wz] = change.map(|value| value / (2.0 * HALF_S));
    Twist { linear_m_per_s: [vx, vy, vz].into(), angular_rad_per_s: [wx, wy, wz].into() }
}

fn judge(runs: &[Run], part: fn(&Run) -> &Vec<Frame>) -> Judged {
    let mean = |frames: &[Frame]| frames.iter().map(|frame| frame.nees).sum::<f64>() / frames.len() as f64;
    let frames = || runs.iter().flat_map(part);
    let count = frames().count() as f64;
    let root = |of: fn(&Frame) -> &[f64; 6]| {
        std::array::from_fn(|axis| (frames().map(|frame| of(frame)[axis]).sum::<f64>() / count).sqrt())
    };
    Judged {
        batches: runs.iter().map(|run| mean(part(run))).collect(),
        in_sigmas: root(|frame| &frame.in_sigmas),
        in_bounds: root(|frame| &frame.in_bounds),
        worst_sigmas: frames().map(|frame| frame.worst_sigmas).fold(0.0, f64::max),
    }
}

impl fmt::Display for Report {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Conditions { file, motion, frames } = &self.conditions;
        let Trials { count, seed } = self.trials;
        writeln!(f, "moving tool, {}, {motion:?} motion, the scene's front end and schedule, {STREAM:?}", file.name)?;
        writeln!(
            f,
            "  {count} runs of {frames} frames after the first {SETTLED_FRAMES}, seeds from {seed}; {} frames not converged",
            self.unconverged
        )?;
        let mut table = Table::new(&["", "NEES mean", "its σ", "worst", "RMSE/σ", "", "", "", "", ""]);
        let named = [("tracked", &self.tracked), ("twist known", &self.known_twist)];
        let row = |table: &mut Table, name: &str, judged: Option<&Judged>, values: [String; 6]| {
            let numbers = judged.map_or([const { String::new() }; 3], |judged| {
                [
                    format!("{:.3}", judged.nees()),
                    format!("{:.3}", judged.standard_error()),
                    format!("{:.1} σ", judged.worst_sigmas),
                ]
            });
            table.row([name.to_owned()].into_iter().chain(numbers).chain(values));
        };
        row(&mut table, "", None, AXES.map(str::to_owned));
        for (name, judged) in named {
            row(&mut table, name, Some(judged), judged.in_sigmas.map(|value| format!("{value:.3}")));
        }
        row(&mut table, "RMSE/bound at rest", None, [const { String::new() }; 6]);
        for (name, judged) in named {
            row(&mut table, name, None, judged.in_bounds.map(|value| format!("{value:.3}")));
        }
        write!(f, "{table}")
    }
}
