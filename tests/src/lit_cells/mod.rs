//! What a tracker costs, and whether it keeps up, whatever its head sees: few lit cells, faulty
//! cells, light of another tier than the solver's.
//!
//! Work is counted in evaluations of the whole head, which any machine counts alike; times are those
//! of the machine that ran. `examples/lit_cells.rs` prints one table of all [`cases`];
//! `tests/lit_cells.rs` judges the counts.

mod fault;
mod queue;
mod report;

use nix::time::{ClockId, clock_gettime};
use rand::RngExt;
use rand::seq::SliceRandom;
use rand_chacha::ChaCha8Rng;
use slitpose::pipeline::{Pipeline, PipelineError, SceneMatch};
use slitpose_head::front_end::Stage;
use slitpose_head::scene_file::SceneFile;
use slitpose_head::simulator::{Trajectory, TrajectoryKind};
use slitpose_model::{Outcome, Pair, Plan, Pose, Solver, Tier, Tracker, Verified};

use crate::capture::{Decoded, STREAM, capture, decode, packets};
use crate::consistency::{error, worst_axis};
use crate::monte_carlo::data::{Disturbance, lit_count, measured, pairs};
use crate::monte_carlo::trials::Trials;
use crate::monte_carlo::{HALF_DEG, HALF_MM};
use crate::poses::{one_in_box, pose};

pub use fault::Fault;
pub use queue::most_lag_s;
pub use report::{Report, table};

/// A pose this many of its σ from the truth, on any axis, is wrong.
pub const WRONG_SIGMAS: f64 = 8.0;

/// What the head sees.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Sight {
    /// So many random cells; the others are blocked and measure noise.
    Lit(usize),
    /// All cells, of which some are faulty.
    Faulty(Fault),
}

/// How the tool moves.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Motion {
    /// At rest at a random pose at which all cells are lit.
    Rest,
    /// Along a smooth path.
    Smooth,
}

/// One case: each run draws its pose or path, and its cells, anew.
#[derive(Clone, Debug)]
pub struct Conditions {
    /// The head, with front end and lighting.
    pub file: SceneFile,
    /// What the solver assumes.
    pub tier: Tier,
    /// What the light does.
    pub light: Tier,
    /// See [`Sight`].
    pub sight: Sight,
    /// See [`Motion`].
    pub motion: Motion,
    /// Scans in which all cells are well and lit before `sight` begins: none, or a track to hold on to.
    pub healthy_scans: usize,
    /// Scans of each run after those.
    pub scans: usize,
}

/// Every number of lit cells and every fault, each tier on its own light and the paper tier on the exact
/// one's, at rest and moving, from the start and after `healthy_scans`.
pub fn cases(file: &SceneFile, healthy_scans: usize, scans: usize) -> Vec<Conditions> {
    let cells = file.scene.cells.len();
    let sights = (0..=cells).rev().map(Sight::Lit).chain(Fault::ALL.map(Sight::Faulty));
    let mut cases = Vec::new();
    for sight in sights {
        for (tier, light) in [(STREAM, STREAM), (Tier::Paper, Tier::Paper), (Tier::Paper, STREAM)] {
            for motion in [Motion::Rest, Motion::Smooth] {
                for healthy_scans in [0, healthy_scans] {
                    let file = file.clone();
                    cases.push(Conditions { file, tier, light, sight, motion, healthy_scans, scans });
                }
            }
        }
    }
    cases
}

/// What one scan came to.
#[derive(Clone, Copy, Debug)]
pub struct Scan {
    /// Evaluations of all cells.
    pub evaluations: usize,
    /// Time that the tracker took of a processor: other programs' is not in it.
    pub cost_ns: u64,
    /// What was said.
    pub outcome: Outcome,
    /// How well the data checked the pose.
    pub verified: Verified,
    /// The largest error of an axis in σ; `None` without pose.
    pub worst_sigmas: Option<f64>,
}

/// A head in front of a tool, and the tracker that follows it.
struct Rig<'a> {
    conditions: &'a Conditions,
    light: Plan<f64>,
    disturbance: Disturbance,
    exposures_s: Vec<f64>,
    period_s: f64,
    tracker: Tracker<f64>,
}

impl<'a> Rig<'a> {
    fn new(conditions: &'a Conditions) -> Self {
        let Conditions { file, tier, light, .. } = conditions;
        let still = Trajectory::of_kind(TrajectoryKind::Still, 0, 1.0);
        let Decoded { schedule, scaling, .. } = decode(&capture(file, still, *tier, 0, 1));
        let exposures_s = Stage::new(file, &schedule, &scaling).exposures_s();
        let scene = Stage::weighted_scene(file, &schedule, &scaling);
        let solver = Solver::new(&scene, *tier).unwrap_or_else(|error| panic!("{error}")).with_exposures(&exposures_s);
        let period_s = schedule.frame_rate_hz().recip();
        Self {
            conditions,
            light: Plan::compile(&scene, *light).unwrap_or_else(|error| panic!("{error}")),
            disturbance: Disturbance::of(&scene),
            exposures_s,
            period_s,
            tracker: Tracker::new(solver, period_s),
        }
    }

    /// Where the tool is, as a function of time.
    fn motion(&self, rng: &mut ChaCha8Rng) -> Box<dyn Fn(f64) -> Pose> {
        match self.conditions.motion {
            Motion::Smooth => {
                let trajectory = Trajectory::of_kind(TrajectoryKind::Smooth, rng.random(), 10.0);
                Box::new(move |time_s| trajectory.pose(time_s))
            }
            Motion::Rest => loop {
                let pose = pose(one_in_box(rng, HALF_MM, HALF_DEG));
                let scene = &self.conditions.file.scene;
                if lit_count(scene, &pairs(&self.light, &pose)) == scene.cells.len() {
                    return Box::new(move |_| pose);
                }
            },
        }
    }

    fn run(mut self, rng: &mut ChaCha8Rng) -> Vec<Scan> {
        let &Conditions { sight, healthy_scans, scans, .. } = self.conditions;
        let motion = self.motion(rng);
        let mut order: Vec<usize> = (0..self.exposures_s.len()).collect();
        order.shuffle(rng);
        (0..healthy_scans + scans)
            .map(|frame| {
                let time_s = frame as f64 * self.period_s;
                let mut light: Vec<Pair<f64>> = (self.exposures_s.iter().enumerate())
                    .map(|(cell, exposure_s)| self.light.photocurrents(cell, &motion(time_s + exposure_s)))
                    .collect();
                if frame >= healthy_scans {
                    match sight {
                        Sight::Lit(lit) => order[lit..].iter().for_each(|&cell| light[cell] = Pair::default()),
                        Sight::Faulty(fault) => fault.apply(&order, &mut light, rng),
                    }
                }
                let readings = measured(&self.disturbance, &light, rng);
                let start_ns = processor_ns();
                let solution = self.tracker.track(frame as u64, &readings).solution;
                let cost_ns = processor_ns() - start_ns;
                let worst_sigmas = solution
                    .estimate
                    .map(|estimate| worst_axis(&error(&estimate.pose, &motion(time_s)), &estimate.covariance));
                Scan {
                    evaluations: solution.evaluations,
                    cost_ns,
                    outcome: solution.outcome,
                    verified: solution.verified(),
                    worst_sigmas,
                }
            })
            .skip(healthy_scans)
            .collect()
    }
}

/// What a scan costs besides its tracker, µs: decoding, scaling, the health of the cells, and a record. The
/// median and what 99 % do not exceed, by packets of some scans each.
///
/// # Panics
/// If no board can run the scene.
pub fn intake_us(file: &SceneFile, seed: u64) -> [f64; 2] {
    const SCANS: usize = 4000;
    let bytes = capture(file, Trajectory::of_kind(TrajectoryKind::Smooth, seed, 1.0), Tier::Paper, seed, SCANS);
    // A tracker for which all of this light is too faint returns at once.
    let mut blind = file.clone();
    blind.scene.cells.iter_mut().for_each(|cell| cell.detector.faint_a = f64::MAX);
    let mut pipeline = Pipeline::new(blind, STREAM, SceneMatch::Waived).watched();
    let mut costs_ns: Vec<f64> = Vec::new();
    for packet in packets(&bytes) {
        let start_ns = processor_ns();
        pipeline.push(&bytes[packet.bytes], |_| Ok::<_, PipelineError>(())).unwrap_or_else(|error| panic!("{error}"));
        let cost_ns = processor_ns() - start_ns;
        if !packet.scans.is_empty() {
            costs_ns.push(cost_ns as f64 / packet.scans.count() as f64);
        }
    }
    assert_eq!(pipeline.counts().scans, SCANS as u64);
    costs_ns.sort_unstable_by(f64::total_cmp);
    [0.5, 0.99].map(|share| costs_ns[((costs_ns.len() - 1) as f64 * share) as usize] * 1e-3)
}

/// Time that this thread has had of a processor.
fn processor_ns() -> u64 {
    let time = clock_gettime(ClockId::CLOCK_THREAD_CPUTIME_ID).expect("a clock of threads");
    (time.tv_sec() * 1_000_000_000 + time.tv_nsec()) as u64
}

/// Runs a case as often as `trials` says, one run after another: times are those of a core of its own. Each run is made
/// `passes` times with the same draws, and a scan counts with its least time: what other users of the processor's caches and
/// units add differs from pass to pass.
///
/// # Panics
/// If no board can run the scene, or the same draws cost other evaluations.
pub fn study(conditions: &Conditions, trials: Trials, passes: usize) -> Report {
    let period_s = Rig::new(conditions).period_s;
    let pass = |run| Rig::new(conditions).run(&mut trials.generator(run));
    let runs = (0..trials.count).map(|run| (1..passes).fold(pass(run), |least, _| with_least_times(least, &pass(run))));
    Report::of(conditions, period_s, runs.collect())
}

fn with_least_times(mut scans: Vec<Scan>, again: &[Scan]) -> Vec<Scan> {
    assert_eq!(scans.len(), again.len());
    for (scan, again) in scans.iter_mut().zip(again) {
        assert_eq!(scan.evaluations, again.evaluations);
        scan.cost_ns = scan.cost_ns.min(again.cost_ns);
    }
    scans
}
