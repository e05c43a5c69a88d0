//! A tool that moves while its cells are exposed one after another, followed frame by frame: are
//! the poses as good as their covariance says?

use slitpose_head::front_end::Stage;
use slitpose_head::scene_file::{SceneFile, WIDE};
use slitpose_head::simulator::{Trajectory, TrajectoryKind};
use slitpose_model::{AXES, MotionPrior, Outcome, Pose, Solution, Solver, Start, Tracker, Twist};

use super::{Conditions, NEES_BAND, by_chance, read};
use crate::capture::{Decoded, STREAM, capture, decode};
use crate::consistency::{error, nees, sigma, worst_axis};
use crate::studies::trials::Trials;
use crate::studies::{Table, Verdicts};

/// Frames after which a tracker knows how the tool moves: five, and some margin. The covariance of
/// those before counts a twist of which nothing is known.
const SETTLED_FRAMES: usize = 10;

/// One frame's pose against the truth.
#[derive(Clone, Copy, Debug)]
struct Frame {
    nees: f64,
    worst_sigmas: f64,
    /// (error/σ)² per axis.
    in_sigmas: [f64; 6],
    /// The same by the bound for a tool at rest there.
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

/// One motion followed: with the tracker, with the twist known exactly, which leaves noise and optics alone, and how many
/// did not converge.
type Run = (Vec<Frame>, Vec<Frame>, usize);

type Part = fn(&Run) -> &Vec<Frame>;

fn follow(file: &SceneFile, motion: TrajectoryKind, frames: usize, seed: u64) -> Run {
    let trajectory = Trajectory::of_kind(motion, seed, 10.0);
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

/// Root mean square per axis.
fn rms(frames: &[Frame], of: fn(&Frame) -> &[f64; 6]) -> [f64; 6] {
    std::array::from_fn(|axis| (frames.iter().map(|frame| of(frame)[axis]).sum::<f64>() / frames.len() as f64).sqrt())
}

pub fn study(conditions: &Conditions, verdicts: &mut Verdicts) {
    let file = read(&WIDE);
    let (trials, frames) = (Trials { count: conditions.runs, seed: conditions.seed }, conditions.count.unwrap_or(2000));
    for motion in [TrajectoryKind::Still, TrajectoryKind::Smooth] {
        let runs = trials.run(|run, _| follow(&file, motion, frames, trials.seed.wrapping_add(run as u64)));
        let unconverged: usize = runs.iter().map(|run| run.2).sum();
        println!("moving tool, wide, {motion:?} motion, the scene's front end and schedule, {STREAM:?}");
        println!(
            "  {frames} frames after the first {SETTLED_FRAMES} of each run, {trials:?}; {unconverged} not converged"
        );
        verdicts.check(unconverged == 0, "all frames converged");
        // Frames that share a twist are not quite independent: 40 runs of 2000 frames scatter by a tenth
        // more than independent ones would.
        let all = trials.count * frames;
        let band = by_chance(NEES_BAND, all, 1.1 * (12.0 / all as f64).sqrt());
        // Of 9000 normal numbers one in 3000 draws has one beyond 5.5 σ, and far fewer none beyond 3.2; of half a million
        // one in 1000 has one beyond 6.
        let worst_range = 3.2..if all > 1500 { 6.0 } else { 5.5 };
        let mut table = Table::new(&[&["", "NEES mean", "its σ", "worst"], &AXES[..]].concat());
        let parts: [(&str, Part); 2] = [("tracked", |run| &run.0), ("twist known", |run| &run.1)];
        let in_bounds = parts.map(|(name, part)| {
            let mean = |frames: &[Frame]| frames.iter().map(|frame| frame.nees).sum::<f64>() / frames.len() as f64;
            let means: Vec<f64> = runs.iter().map(|run| mean(part(run))).collect();
            let n = means.len() as f64;
            let nees = means.iter().sum::<f64>() / n;
            // Frames that share a twist are correlated, runs are not: the scatter of the runs' means tells the error.
            let standard_error = (means.iter().map(|mean| (mean - nees).powi(2)).sum::<f64>() / (n * (n - 1.0))).sqrt();
            let frames: Vec<Frame> = runs.iter().flat_map(part).copied().collect();
            let worst = frames.iter().map(|frame| frame.worst_sigmas).fold(0.0, f64::max);
            let numbers = [format!("{nees:.3}"), format!("{standard_error:.3}"), format!("{worst:.1} σ")];
            let in_sigmas = rms(&frames, |frame| &frame.in_sigmas).map(|value| format!("{value:.3}"));
            table.row([format!("{name}, RMSE/σ")].into_iter().chain(numbers).chain(in_sigmas));
            let in_bounds = rms(&frames, |frame| &frame.in_bounds);
            let empty = [const { String::new() }; 3];
            let values = in_bounds.map(|value| format!("{value:.3}"));
            table.row([format!("{name}, RMSE/bound at rest")].into_iter().chain(empty).chain(values));
            verdicts.check((nees - 6.0).abs() <= band, format!("{name}: NEES mean {nees:.3} within 6 ± {band:.3}"));
            verdicts.check(worst_range.contains(&worst), format!("{name}: worst {worst:.2} σ within {worst_range:?}"));
            in_bounds
        });
        print!("{table}");
        // A twist that has to be estimated costs some percent; it cannot gain anything.
        let costs: [f64; 6] = std::array::from_fn(|axis| in_bounds[0][axis] / in_bounds[1][axis]);
        verdicts.check(
            costs.iter().all(|cost| (0.98..1.1).contains(cost)),
            format!("the cost of an unknown twist: {costs:.3?}"),
        );
    }
}
