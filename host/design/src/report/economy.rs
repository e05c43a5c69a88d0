//! What digits and effects cost: the forward model and warm solves in each tier, and with each effect where it is present.

use std::hint::black_box;

use glam::DVec3;
use slitpose_model::{
    CompiledScene, MotionPrior, Noise, Pair, Photocurrents, Pose, Profile, Scene, SceneError, Solver, Start, Tier,
    Twist, Uncertainty,
};

use super::Settings;
use super::head::{Candidate, Head, NoiseSource, PRIOR, RunTime, STREAM, exponent, is_lit, race, tier_name};
use super::section::{Picture, Section, Sheet, Table, Value};
use crate::DesignError;
use crate::plot::{Axis, Chart, CurveStyle, curve};

pub(super) const TITLE: &str = "What digits and effects cost";

/// Tiers of the forward model, the printed equations first.
const TOLERANCES: [f64; 7] = [1e-2, 1e-3, 1e-4, 1e-6, 1e-8, 1e-10, 1e-12];

/// The tier that stands for the truth.
const REFERENCE: Tier = Tier::Exact { tolerance: 1e-13 };

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
    tier: Tier,
    /// When cells are exposed; `None`: all at one instant.
    exposures_s: Option<Vec<f64>>,
    motion: MotionPrior,
}

impl Variant {
    fn of(group: &'static str, name: String, scene: Scene) -> Self {
        Self { group, name, scene, tier: STREAM, exposures_s: None, motion: MotionPrior::AT_REST }
    }
}

struct Entry {
    variant: Variant,
    /// Median and worst error of electrode currents, relative to the total current of their cell; `None` where another
    /// effect than the tier is studied.
    error: Option<[f64; 2]>,
    /// Of currents, of currents with derivatives, and of solves.
    times: [RunTime; 3],
    /// Mean steps of the solves.
    steps: f64,
}

pub(super) fn section(head: &Head, settings: &Settings) -> Result<Section, DesignError> {
    let entries = measure(head, settings)?;
    let paper = entries.iter().find(|entry| entry.variant.tier == Tier::Paper);
    let difference = paper.and_then(|entry| entry.error).map_or(f64::NAN, |[_, worst]| worst);
    Ok(Section {
        name: "economy",
        title: TITLE,
        summary: vec![format!(
            "The equations of the source paper (paper tier) differ from the integrals over the spot (exact tier) by \
             up to {} % of a cell's current.",
            Value::from(100.0 * difference).shown()
        )],
        paragraphs: vec![
            format!(
                "The first group is the scene as it is, in each tier. The error is that of an electrode's current relative to \
                 the total current of its cell, against the exact tier at a tolerance of 1e-13; times are those of all {} cells \
                 together. The paper tier computes what equations (1) to (6) say: its error is the difference between the two \
                 models, and no arithmetic removes it.",
                head.scene.cells.len()
            ),
            "The other groups are the same head in the exact tier at 1e-6, with one thing added at a time. A scene is compiled \
             to a plan that holds only what the scene has, so that the first row of each group pays for nothing it does not \
             use. Warm solves are of noisy currents, in full; without noise the weights are those of the arithmetic, and a \
             solve goes on for longer. Of three cells nothing is left over to check a pose with, and images are searched for."
                .to_owned(),
        ],
        pictures: vec![picture(&entries, head)],
        tables: vec![table(&entries)],
    })
}

fn variants(head: &Head) -> Vec<Variant> {
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
    for tier in [Tier::Paper].into_iter().chain(TOLERANCES.map(|tolerance| Tier::Exact { tolerance })) {
        variants.push(Variant { tier, ..Variant::of("tier", tier_name(tier), head.scene.clone()) });
    }
    let mut add = |group, name: &str, scene| variants.push(Variant::of(group, name.to_owned(), scene));
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
            let still = Variant::of("exposure", name.to_owned(), lean(&|_| {}));
            variants.push(Variant { exposures_s: Some(frame.exposures_s.clone()), motion, ..still });
        }
    }
    let most = head.scene.cells.len();
    for count in (LEAST_CELLS.min(most)..=most).rev() {
        let scene = lean(&|scene| scene.cells.truncate(count));
        variants.push(Variant::of("cells", format!("{count} cells"), scene));
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

fn measure(head: &Head, settings: &Settings) -> Result<Vec<Entry>, DesignError> {
    let variants = variants(head);
    let compile = |variant: &Variant| {
        let solver = Solver::<f64>::new(&variant.scene, variant.tier)?;
        Ok(variant.exposures_s.iter().fold(solver, |solver, exposures_s| solver.with_exposures(exposures_s)))
    };
    let solvers = variants.iter().map(compile).collect::<Result<Vec<_>, SceneError>>()?;
    let lit = head.poses.iter().filter(|pose| solvers.iter().all(|solver| is_lit(solver.plan(), pose)));
    let poses: &Vec<Pose> = &lit.take(settings.timed_poses()).copied().collect();
    let frames = |(variant, solver): (&Variant, &Solver<f64>)| -> (Vec<Photocurrents>, Vec<Pose>) {
        // The same draws for every variant.
        let plan = solver.plan();
        let mut noise = NoiseSource::of(&variant.scene, plan, settings.seed);
        let exposed = |cell: usize, pose: &Pose| {
            let after_s = variant.exposures_s.as_ref().map_or(0.0, |exposures_s| exposures_s[cell]);
            plan.photocurrents(cell, &variant.motion.twist.advance(pose, after_s))
        };
        let reading = |pose: &Pose| Photocurrents::of_pairs((0..plan.cell_count()).map(|cell| exposed(cell, pose)));
        let readings = poses.iter().map(|pose| noise.disturb(pose, &reading(pose))).collect();
        (readings, poses.iter().map(|pose| noise.near(pose, PRIOR)).collect())
    };
    let frames: Vec<_> = variants.iter().zip(&solvers).map(frames).collect();
    let reference = all_currents(&CompiledScene::compile(&head.scene, REFERENCE)?, &head.poses);
    let (mut candidates, mut found): (Vec<Candidate<'_>>, Vec<_>) = (Vec::new(), Vec::new());
    for ((variant, solver), (readings, priors)) in variants.iter().zip(&solvers).zip(&frames) {
        let plan = solver.plan();
        let solves = move || {
            let both = readings.iter().zip(priors);
            both.map(|(readings, prior)| solver.solve(black_box(readings), Start::Near(prior), &variant.motion))
        };
        let steps = solves().map(|solution| solution.iterations as f64).sum::<f64>() / poses.len() as f64;
        let error = (variant.group == "tier").then(|| spread(&all_currents(plan, &head.poses), &reference));
        found.push((error, steps));
        let each = move || poses.iter().flat_map(|pose| (0..plan.cell_count()).map(move |cell| (cell, pose)));
        candidates.push(Box::new(move || {
            for (cell, pose) in each() {
                black_box(plan.photocurrents(cell, black_box(pose)));
            }
        }));
        candidates.push(Box::new(move || {
            for (cell, pose) in each() {
                black_box(plan.linearise(cell, black_box(pose)));
            }
        }));
        candidates.push(Box::new(move || {
            for solution in solves() {
                black_box(solution);
            }
        }));
    }
    let run_times = race(&mut candidates, settings.rounds(), poses.len());
    drop(candidates);
    let (times, _) = run_times.as_chunks();
    let entries = variants.into_iter().zip(found).zip(times);
    Ok(entries.map(|((variant, (error, steps)), times)| Entry { variant, error, times: *times, steps }).collect())
}

fn all_currents(plan: &CompiledScene<f64>, poses: &[Pose]) -> Vec<Pair<f64>> {
    let all = poses.iter().flat_map(|pose| (0..plan.cell_count()).map(move |cell| (cell, pose)));
    all.map(|(cell, pose)| plan.photocurrents(cell, pose)).collect()
}

/// Median and greatest difference of electrode currents, relative to the total current of their cell.
fn spread(found: &[Pair<f64>], truth: &[Pair<f64>]) -> [f64; 2] {
    let of_pair = |(found, truth): (&Pair<f64>, &Pair<f64>)| {
        [found.i_x1_a - truth.i_x1_a, found.i_x2_a - truth.i_x2_a].map(|error| (error / truth.total_a()).abs())
    };
    let mut errors: Vec<f64> = found.iter().zip(truth).flat_map(of_pair).collect();
    errors.sort_by(f64::total_cmp);
    [errors[errors.len() / 2], errors[errors.len() - 1]]
}

fn table(entries: &[Entry]) -> Table {
    let error = |entry: &Entry, k: usize| Value::optional(entry.error.map(|error| error[k]));
    let ratio = |entry: &Entry, k: usize| {
        // Every group has a first.
        let first = entries.iter().find(|other| other.variant.group == entry.variant.group).unwrap_or(entry);
        Value::from(entry.times[k].least_s / first.times[k].least_s)
    };
    Table::of(
        "economy",
        "What digits and effects cost, f64: all cells at a pose, and a warm solve",
        entries,
        &[
            ("group", "group", &|entry| entry.variant.group.into()),
            ("variant", "variant", &|entry| entry.variant.name.as_str().into()),
            ("error_median", "error, median", &|entry| error(entry, 0)),
            ("error_worst", "worst", &|entry| error(entry, 1)),
            ("forward_least_us", "currents, least / µs", &|entry| Value::micro(entry.times[0].least_s)),
            ("forward_median_us", "median / µs", &|entry| Value::micro(entry.times[0].median_s)),
            ("forward_ratio", "ratio", &|entry| ratio(entry, 0)),
            ("derivatives_least_us", "with derivatives, least / µs", &|entry| Value::micro(entry.times[1].least_s)),
            ("derivatives_median_us", "median / µs", &|entry| Value::micro(entry.times[1].median_s)),
            ("solve_least_us", "warm solve, least / µs", &|entry| Value::micro(entry.times[2].least_s)),
            ("solve_median_us", "median / µs", &|entry| Value::micro(entry.times[2].median_s)),
            ("solve_ratio", "ratio", &|entry| ratio(entry, 2)),
            ("steps", "steps, mean", &|entry| entry.steps.into()),
        ],
    )
}

/// Error of the forward model against its time.
fn picture(entries: &[Entry], head: &Head) -> Picture {
    let panel = |heading: &str, k: usize| {
        let of = |is_paper| {
            let chosen = entries.iter().filter(move |entry| (entry.variant.tier == Tier::Paper) == is_paper);
            chosen.filter_map(|entry| Some([1e6 * entry.times[k].least_s, entry.error?[0]])).collect()
        };
        let exact = "exact tier at tolerances from 1e-2 to 1e-12";
        let paper = "paper tier: the difference between the models";
        let curves =
            vec![curve(exact, 0, CurveStyle::Joined, of(false)), curve(paper, 1, CurveStyle::Markers, of(true))];
        let x = |x| Axis::logarithmic("time for all cells / µs", x);
        (heading.to_owned(), Chart::over(curves, x, |y| Axis::logarithmic("median error of a current", y)))
    };
    Sheet {
        title: "Forward model: error against time".to_owned(),
        note: format!("{} cells; {} poses of the workspace", head.scene.cells.len(), head.poses.len()),
        panels: vec![panel("currents", 0), panel("currents and derivatives", 1)],
    }
    .draw("forward", "Error of the forward model against its time; lower and further left is better.")
}
