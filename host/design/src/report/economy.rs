//! Effects that a scene lacks are not computed: the cost of each effect where it is present.

use std::hint::black_box;

use glam::DVec3;
use slitpose_model::{
    CompiledScene, MotionPrior, Noise, Photocurrents, Pose, Profile, Scene, Solution, Solver, Start, Twist, Uncertainty,
};

use super::Settings;
use super::head::{Candidate, Head, NoiseSource, PRIOR, RunTime, STREAM, exponent, is_lit, race};
use super::section::{Section, Table, Value};
use crate::DesignError;

pub(super) const TITLE: &str = "What is left out costs nothing";

/// Effects at sizes that a real head would have.
const THICKNESS_M: f64 = 0.15e-3;
const TILT_RAD: f64 = 0.035;
const KNOT_STEP_DEG: usize = 5;
const UNSETTLED: Uncertainty = Uncertainty {
    emitter_gain_relative: 1e-3,
    electrode_gain_relative: 1e-3,
    position_m: 1e-6,
    light_level_relative: 0.0,
    emitter_drift_relative: 0.0,
    emitter_drift_s: 0.0,
};

/// A tool that moves while its cells are exposed one after another.
const SPEED_M_PER_S: f64 = 0.1;
const SPEED_RAD_PER_S: f64 = 1.0;

const LEAST_CELLS: usize = 3;

struct Variant {
    group: &'static str,
    name: String,
    scene: Scene,
    /// When cells are exposed and how the tool moves meanwhile; `None`: all at one instant.
    moving: Option<(Vec<f64>, MotionPrior)>,
}

/// A variant, times of the forward model and of solves, and mean steps of these.
type Entry = (Variant, [RunTime; 2], f64);

pub(super) fn section(head: &Head<'_>, settings: &Settings) -> Result<Section, DesignError> {
    let entries = measure(head, settings)?;
    Ok(Section {
        name: "economy",
        title: TITLE,
        paragraphs: vec![
            "The same head with one thing added at a time. A scene is compiled to a plan that holds only what the scene \
             has, so that the first row of each group pays for nothing it does not use. Warm solves are of noisy \
             currents, in full; without noise the weights are those of the arithmetic, and a solve goes on for longer. Of \
             three cells nothing is left over to check a pose with, and images are searched for."
                .to_owned(),
        ],
        tables: vec![table(&entries)],
        ..Section::default()
    })
}

fn variants(head: &Head<'_>) -> Vec<Variant> {
    let lean = |change: &dyn Fn(&mut Scene)| {
        let mut scene = Scene { uncertainty: Uncertainty::default(), ..head.scene.clone() };
        for cell in &mut scene.cells {
            cell.slit.thickness_m = 0.0;
            cell.slit.tilt_rad = DVec3::ZERO;
            cell.emitter.profile = Profile::Cosine { exponent: exponent(&cell.emitter.profile) };
        }
        change(&mut scene);
        scene
    };
    let mut variants = Vec::new();
    let mut add = |group, name: &str, scene| {
        variants.push(Variant { group, name: name.to_owned(), scene, moving: None });
    };
    let cells = |scene: &mut Scene, change: &dyn Fn(&mut slitpose_model::Cell)| scene.cells.iter_mut().for_each(change);
    if head.is_of_slits() {
        add("mask", "thin mask", lean(&|_| {}));
        add("mask", "mask 0.15 mm thick", lean(&|scene| cells(scene, &|cell| cell.slit.thickness_m = THICKNESS_M)));
        add("slit", "slit parallel to the detector", lean(&|_| {}));
        add("slit", "slit turned by 2°", lean(&|scene| cells(scene, &|cell| cell.slit.tilt_rad = DVec3::Z * TILT_RAD)));
    }
    add("profile", "profile: cosine power", lean(&|_| {}));
    add(
        "profile",
        "profile: table of 19 knots",
        lean(&|scene| cells(scene, &|cell| tabulate(&mut cell.emitter.profile))),
    );
    add("uncertainty", "calibration settled", lean(&|_| {}));
    add("uncertainty", "gains 0.1 %, positions 1 µm", lean(&|scene| scene.uncertainty = UNSETTLED));
    let noise = head.scene.noise;
    let without = |parts: &dyn Fn(&mut Noise)| {
        lean(&|scene| {
            scene.noise = noise;
            scene.noise.iter_mut().for_each(parts);
        })
    };
    add("noise", "no noise", lean(&|scene| scene.noise = None));
    if noise.is_some() {
        let shot = |noise: &mut Noise| (noise.johnson_bandwidth_hz, noise.adc_a) = (0.0, 0.0);
        add("noise", "shot noise", without(&shot));
        add("noise", "shot and Johnson noise", without(&|noise| noise.adc_a = 0.0));
        add("noise", "shot, Johnson, converter", without(&|_| {}));
    }
    add("exposure", "all cells at one instant", lean(&|_| {}));
    if let Some(frame) = &head.frame {
        let twist = Twist {
            linear_m_per_s: DVec3::new(0.6, -0.64, 0.48) * SPEED_M_PER_S,
            angular_rad_per_s: DVec3::new(-0.48, 0.6, 0.64) * SPEED_RAD_PER_S,
        };
        let known = MotionPrior { twist, ..MotionPrior::AT_REST };
        let vague = MotionPrior { linear_sigma_m_per_s: 5e-3, angular_sigma_rad_per_s: 0.5, ..known };
        for (name, motion) in [("in turn, twist known", known), ("in turn, twist uncertain", vague)] {
            let moving = Some((frame.exposures_s.clone(), motion));
            variants.push(Variant { group: "exposure", name: name.to_owned(), scene: lean(&|_| {}), moving });
        }
    }
    let most = head.scene.cells.len();
    for count in (LEAST_CELLS.min(most)..=most).rev() {
        let scene = lean(&|scene| scene.cells.truncate(count));
        variants.push(Variant { group: "cells", name: format!("{count} cells"), scene, moving: None });
    }
    variants
}

fn tabulate(profile: &mut Profile) {
    let exponent = exponent(profile);
    let knots = (0..=90).step_by(KNOT_STEP_DEG).map(|degrees| {
        let gamma = (degrees as f64).to_radians();
        // cos 90° is no exact zero.
        (gamma, if degrees == 90 { 0.0 } else { gamma.cos().powf(exponent) })
    });
    *profile = Profile::Table(knots.collect());
}

struct Bench {
    plan: CompiledScene<f64>,
    solver: Solver<f64>,
    motion: MotionPrior,
    readings: Vec<Photocurrents>,
    priors: Vec<Pose>,
}

impl Bench {
    fn solve(&self, index: usize) -> Solution {
        self.solver.solve(black_box(&self.readings[index]), Start::Near(&self.priors[index]), &self.motion)
    }
}

fn measure(head: &Head<'_>, settings: &Settings) -> Result<Vec<Entry>, DesignError> {
    let tier = STREAM;
    let variants = variants(head);
    let plans =
        variants.iter().map(|variant| CompiledScene::compile(&variant.scene, tier)).collect::<Result<Vec<_>, _>>()?;
    let lit = head.poses.iter().filter(|pose| plans.iter().all(|plan: &CompiledScene<f64>| is_lit(plan, pose)));
    let poses: Vec<Pose> = lit.take(settings.timed_poses()).copied().collect();
    let mut benches = Vec::new();
    for (variant, plan) in variants.iter().zip(plans) {
        // The same draws for every variant.
        let mut noise = NoiseSource::seeded(settings.seed);
        let mut solver = Solver::new(&variant.scene, tier)?;
        let rest = (vec![0.0; variant.scene.cells.len()], MotionPrior::AT_REST);
        let (offsets_s, motion) = variant.moving.as_ref().unwrap_or(&rest);
        if variant.moving.is_some() {
            solver = solver.with_exposures(offsets_s);
        }
        let reading = |pose: &Pose| {
            let exposed = |cell: usize| motion.twist.advance(pose, offsets_s[cell]);
            Photocurrents::of_pairs((0..plan.cell_count()).map(|cell| plan.photocurrents(cell, &exposed(cell))))
        };
        let readings = poses.iter().map(|pose| noise.disturb(&variant.scene, &plan, pose, &reading(pose))).collect();
        let priors = poses.iter().map(|pose| noise.near(pose, PRIOR)).collect();
        benches.push(Bench { solver, motion: *motion, readings, priors, plan });
    }
    let steps: Vec<f64> = benches
        .iter()
        .map(|bench| {
            let taken: usize = (0..poses.len()).map(|index| bench.solve(index).iterations).sum();
            taken as f64 / poses.len() as f64
        })
        .collect();
    let poses = &poses;
    let mut candidates: Vec<Candidate<'_>> = benches
        .iter()
        .flat_map(|bench| {
            let forward = move || {
                for pose in poses {
                    for cell in 0..bench.plan.cell_count() {
                        black_box(bench.plan.photocurrents(cell, black_box(pose)));
                    }
                }
            };
            let solve = move || {
                for index in 0..poses.len() {
                    black_box(bench.solve(index));
                }
            };
            [Box::new(forward) as Candidate<'_>, Box::new(solve)]
        })
        .collect();
    let run_times = race(&mut candidates, settings.rounds(), poses.len());
    drop(candidates);
    let entries = variants.into_iter().zip(run_times.chunks_exact(2)).zip(steps);
    Ok(entries.map(|((variant, times), steps)| (variant, [times[0], times[1]], steps)).collect())
}

fn table(entries: &[Entry]) -> Table {
    let us = |seconds: f64| Value::from(seconds * 1e6);
    let ratio = |entry: &Entry, k: usize| {
        // Every group has a first.
        let first = entries.iter().find(|other| other.0.group == entry.0.group).unwrap_or(entry);
        Value::from(entry.1[k].least_s / first.1[k].least_s)
    };
    Table::of(
        "economy",
        "Exact tier at 1e-6, f64",
        entries,
        &[
            ("group", "group", &|(variant, ..)| variant.group.into()),
            ("variant", "variant", &|(variant, ..)| variant.name.as_str().into()),
            ("forward_least_us", "forward, least / µs", &|(_, [forward, _], _)| us(forward.least_s)),
            ("forward_median_us", "median / µs", &|(_, [forward, _], _)| us(forward.median_s)),
            ("forward_ratio", "ratio", &|entry| ratio(entry, 0)),
            ("solve_least_us", "warm solve, least / µs", &|(_, [_, solve], _)| us(solve.least_s)),
            ("solve_median_us", "median / µs", &|(_, [_, solve], _)| us(solve.median_s)),
            ("solve_ratio", "ratio", &|entry| ratio(entry, 1)),
            ("steps", "steps, mean", &|(.., steps)| (*steps).into()),
        ],
    )
}
