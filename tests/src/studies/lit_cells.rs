//! What a tracker costs, and whether it keeps up, whatever its head sees: few lit cells, faulty
//! cells, light of another tier than the solver's.
//!
//! Work is counted in evaluations of the whole head, which any machine counts alike; the benches of the model say how long one
//! takes.

use std::collections::BTreeMap;

use clap::Args;
use rand::RngExt;
use rand::seq::SliceRandom;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use slitpose_head::front_end::Stage;
use slitpose_head::scene_file::SceneFile;
use slitpose_head::simulator::{Trajectory, TrajectoryKind};
use slitpose_model::{CompiledScene, DegradedReason, Outcome, Pair, Pose, Solver, Tier, Tracker, Verified};

use super::trials::{Disturbance, HALF, Trials, lit_pose};
use super::{Table, Verdicts};
use crate::capture::{Decoded, STREAM, capture, decode};
use crate::consistency::{Sorted, error, worst_axis};
use crate::poses::pose;

/// Evaluations of one scan: its own 20, 56 that scans before have saved, and a dozen to end what has begun.
/// At some 2.5 µs each they leave some of the 250 µs of a scan at 4 kHz.
const MAX_EVALUATIONS: f64 = 88.0;

/// Of 99 % of all scans: without what is saved but rarely. At 2.5 µs each 90 µs.
const MAX_OF_99: f64 = 36.0;

/// A pose this many of its σ from the truth, on any axis, is wrong.
const WRONG_SIGMAS: f64 = 8.0;

#[derive(Debug, Args)]
pub struct Options {
    /// Names of shipped scenes, or scene files
    #[arg(default_value = "wide")]
    scenes: Vec<String>,
    /// Runs of each case
    #[arg(long, default_value_t = 10)]
    runs: usize,
    /// Scans of each run
    #[arg(long, default_value_t = 1000)]
    scans: usize,
    /// Scans with all cells well before each run of a second set of cases
    #[arg(long, default_value_t = 20)]
    healthy: usize,
    /// Seed of everything that is drawn
    #[arg(long, default_value_t = 20_180_718)]
    seed: u64,
}

/// What the head sees.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Sight {
    /// So many random cells; the others are blocked and measure noise.
    Lit(usize),
    /// Both electrodes of one cell scatter by 5 % of their current.
    NoisyCell,
    SwappedElectrodes,
    SwappedCells,
    /// One electrode measures the same whatever the light.
    StuckElectrode,
    /// Two cells, drawn anew each scan, are exchanged.
    RandomSwaps,
}

impl Sight {
    const FAULTS: [Self; 5] =
        [Self::NoisyCell, Self::SwappedElectrodes, Self::SwappedCells, Self::StuckElectrode, Self::RandomSwaps];

    /// What the cells then measure; `order` is the run's random order of the cells.
    fn apply(self, order: &[usize], light: &mut [Pair<f64>], rng: &mut ChaCha8Rng) {
        let faulty = order[0];
        let pair = &mut light[faulty];
        match self {
            Self::Lit(lit) => order[lit..].iter().for_each(|&cell| light[cell] = Pair::default()),
            Self::NoisyCell => {
                let mut scatter = || 1.0 + 0.05 * <StandardNormal as Distribution<f64>>::sample(&StandardNormal, rng);
                *pair = Pair { i_x1_a: pair.i_x1_a * scatter(), i_x2_a: pair.i_x2_a * scatter() };
            }
            Self::SwappedElectrodes => std::mem::swap(&mut pair.i_x1_a, &mut pair.i_x2_a),
            Self::SwappedCells => light.swap(faulty, order[1]),
            // About the middle of what an electrode of the default head measures.
            Self::StuckElectrode => pair.i_x2_a = 5e-6,
            Self::RandomSwaps => {
                let mut cells: Vec<usize> = (0..light.len()).collect();
                cells.shuffle(rng);
                light.swap(cells[0], cells[1]);
            }
        }
    }
}

/// One case: each run draws its pose or path, and its cells, anew.
#[derive(Clone, Copy, Debug)]
struct Case {
    sight: Sight,
    /// What the solver assumes.
    tier: Tier,
    light: Tier,
    /// Along a smooth path, or at rest at a random pose at which all cells are lit.
    moves: bool,
    /// Scans in which all cells are well and lit before `sight` begins: none, or a track to hold on to.
    healthy: usize,
}

#[derive(Clone, Copy, Debug)]
struct Scan {
    evaluations: usize,
    outcome: Outcome,
    verified: Verified,
    /// The largest error of an axis in σ; `None` without pose.
    worst_sigmas: Option<f64>,
}

impl Scan {
    /// Whether its pose is wrong and not called a misfit.
    fn is_wrong(&self) -> bool {
        let is_doubted = matches!(self.outcome, Outcome::Degraded(DegradedReason::Misfit | DegradedReason::Unfinished));
        !is_doubted && self.worst_sigmas.is_some_and(|sigmas| sigmas > WRONG_SIGMAS)
    }
}

pub fn study(options: &Options) -> Verdicts {
    let trials = Trials { count: options.runs, seed: options.seed };
    println!("{options:?}");
    let mut table = Table::new(&[
        "head",
        "cells",
        "tier on light",
        "tool",
        "start",
        "evaluations",
        "99 %",
        "most",
        "verified/wrong",
        "outcomes",
    ]);
    let mut verdicts = Verdicts::default();
    for scene in &options.scenes {
        let file = SceneFile::open(scene).unwrap_or_else(|error| panic!("{error}"));
        let sights = (0..=file.scene.cells.len()).rev().map(Sight::Lit).chain(Sight::FAULTS);
        for sight in sights {
            for (tier, light) in [(STREAM, STREAM), (Tier::Paper, Tier::Paper), (Tier::Paper, STREAM)] {
                for (moves, healthy) in [(false, 0), (false, options.healthy), (true, 0), (true, options.healthy)] {
                    let case = Case { sight, tier, light, moves, healthy };
                    let runs = (0..trials.count)
                        .map(|run| Rig::new(&file, case).run(options.scans, &mut trials.generator(run)));
                    let report = Report { case, runs: runs.collect() };
                    table.row(report.row(&file.name));
                    report.check(options, &mut verdicts);
                }
            }
        }
    }
    print!("{table}");
    verdicts
}

/// A head in front of a tool, and the tracker that follows it.
struct Rig<'a> {
    file: &'a SceneFile,
    case: Case,
    light: CompiledScene<f64>,
    disturbance: Disturbance,
    exposures_s: Vec<f64>,
    tracker: Tracker<f64>,
}

fn period_s(file: &SceneFile) -> f64 {
    file.front_end.as_ref().expect("the scene has a front end").frame_rate_hz.recip()
}

impl<'a> Rig<'a> {
    fn new(file: &'a SceneFile, case: Case) -> Self {
        let still = Trajectory::of_kind(TrajectoryKind::Still, 0, 1.0);
        let Decoded { schedule, scaling, .. } = decode(&capture(file, still, case.tier, 0, 1));
        let exposures_s = Stage::new(file, &schedule, &scaling).exposures_s();
        let scene = Stage::weighted_scene(file, &schedule, &scaling);
        let solver =
            Solver::new(&scene, case.tier).unwrap_or_else(|error| panic!("{error}")).with_exposures(&exposures_s);
        Self {
            file,
            case,
            light: CompiledScene::compile(&scene, case.light).unwrap_or_else(|error| panic!("{error}")),
            disturbance: Disturbance::of(&scene),
            exposures_s,
            tracker: Tracker::new(solver, schedule.frame_rate_hz().recip()),
        }
    }

    /// Where the tool is, as a function of time.
    fn motion(&self, rng: &mut ChaCha8Rng) -> Box<dyn Fn(f64) -> Pose> {
        if self.case.moves {
            let trajectory = Trajectory::of_kind(TrajectoryKind::Smooth, rng.random(), 10.0);
            Box::new(move |time_s| trajectory.pose(time_s))
        } else {
            let pose = pose(lit_pose(&self.file.scene, &self.light, HALF, rng).0);
            Box::new(move |_| pose)
        }
    }

    fn run(mut self, scans: usize, rng: &mut ChaCha8Rng) -> Vec<Scan> {
        let Case { sight, healthy, .. } = self.case;
        let motion = self.motion(rng);
        let mut order: Vec<usize> = (0..self.exposures_s.len()).collect();
        order.shuffle(rng);
        (0..healthy + scans)
            .map(|frame| {
                let time_s = frame as f64 * period_s(self.file);
                let mut light: Vec<Pair<f64>> = (self.exposures_s.iter().enumerate())
                    .map(|(cell, exposure_s)| self.light.photocurrents(cell, &motion(time_s + exposure_s)))
                    .collect();
                if frame >= healthy {
                    sight.apply(&order, &mut light, rng);
                }
                let readings = self.disturbance.measured(&light, rng);
                let solution = self.tracker.track(frame as u64, &readings).solution;
                let worst_sigmas = solution
                    .estimate
                    .map(|estimate| worst_axis(&error(&estimate.pose, &motion(time_s)), &estimate.covariance));
                let (evaluations, outcome, verified) = (solution.evaluations, solution.outcome, solution.verified());
                Scan { evaluations, outcome, verified, worst_sigmas }
            })
            .skip(healthy)
            .collect()
    }
}

struct Report {
    case: Case,
    runs: Vec<Vec<Scan>>,
}

impl Report {
    fn scans(&self) -> impl Iterator<Item = &Scan> {
        self.runs.iter().flatten()
    }

    /// All scans but the first of each run, whose search may take as long as a cold solve.
    fn later(&self) -> impl Iterator<Item = &Scan> {
        self.runs.iter().flat_map(|run| &run[1..])
    }

    fn evaluations(&self) -> Sorted {
        Sorted::of(self.later().map(|scan| scan.evaluations as f64))
    }

    fn wrong(&self) -> usize {
        self.scans().filter(|scan| scan.is_wrong()).count()
    }

    fn check(&self, options: &Options, verdicts: &mut Verdicts) {
        let Case { sight, tier, light, moves, healthy } = self.case;
        let what = format!("{:?}", self.case);
        let evaluations = self.evaluations();
        let (most, of_99) = (evaluations.most(), evaluations.at(0.99));
        verdicts.check(
            most <= MAX_EVALUATIONS && of_99 <= MAX_OF_99,
            format!("{what}: at most {most} evaluations, of 99 % {of_99}"),
        );
        let Sight::Lit(lit) = sight else { return };
        if tier != light {
            return;
        }
        verdicts.check(self.wrong() == 0, format!("{what}: {} wrong poses", self.wrong()));
        let is_tracked = healthy > 0;
        // Two cells tell of no pose; a track of three ends where its pose has a twin, after 25 scans at the least.
        let least = match lit {
            0..=2 => 0.0,
            3 => 25.0 / options.scans as f64,
            _ => 0.99,
        };
        let with_pose = self.scans().filter(|scan| scan.worst_sigmas.is_some()).count() as f64;
        let share = with_pose / self.scans().count() as f64;
        verdicts.check(!is_tracked || share >= least, format!("{what}: {share:.3} of scans with a pose"));
        if lit == 6 || lit > 3 && is_tracked || !moves && lit < 3 {
            // What one solve of a tool that was expected takes.
            let mean = self.later().map(|scan| scan.evaluations as f64).sum::<f64>() / self.later().count() as f64;
            verdicts.check(mean < 2.5, format!("{what}: {mean:.2} evaluations in the mean"));
        }
    }

    /// The two most frequent outcomes and their shares.
    fn outcomes(&self) -> String {
        let mut counts: BTreeMap<&str, usize> = BTreeMap::new();
        for scan in self.scans() {
            let word = match &scan.outcome {
                Outcome::Degraded(weakness) => weakness.as_str(),
                other => other.as_str(),
            };
            *counts.entry(word).or_default() += 1;
        }
        let mut counts: Vec<_> = counts.into_iter().collect();
        counts.sort_by_key(|(_, count)| std::cmp::Reverse(*count));
        let total = self.scans().count() as f64;
        let part = |(word, count): &(&str, usize)| format!("{word} {:.1} %", 100.0 * *count as f64 / total);
        counts.iter().take(2).map(part).collect::<Vec<_>>().join(", ")
    }

    fn row(&self, head: &str) -> [String; 10] {
        let Case { sight, tier, light, moves, healthy } = self.case;
        let name = |tier| if tier == Tier::Paper { "paper" } else { "exact" };
        let evaluations = self.evaluations();
        let verified = self.scans().filter(|scan| scan.is_wrong() && scan.verified != Verified::Not).count();
        [
            head.to_owned(),
            match sight {
                Sight::Lit(lit) => format!("{lit} lit"),
                fault => format!("{fault:?}"),
            },
            format!("{} on {}", name(tier), name(light)),
            if moves { "smooth" } else { "rest" }.to_owned(),
            if healthy > 0 { "tracked" } else { "cold" }.to_owned(),
            evaluations.at(0.5).to_string(),
            evaluations.at(0.99).to_string(),
            evaluations.most().to_string(),
            format!("{verified}/{}", self.wrong()),
            self.outcomes(),
        ]
    }
}
