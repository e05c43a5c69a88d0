//! The solver: the cost of each method, and its error against the bound.

use std::hint::black_box;

use slitpose_model::{CompiledScene, Photocurrents, Pose, Scene, Solver, Tier};

use crate::report::head::{Candidate, RunTime, race};
use crate::report::head::{Errors, rms_of_covariances};
use crate::report::head::{Head, STREAM, currents};
use crate::report::method::{Compiled, Effort, Method, Precision, Start, effort_name, tier_name};
use crate::report::noise::NoiseSource;
use crate::report::section::{Getter, Section, Table, Value};
use crate::report::{ReportError, Settings};

mod picture;

pub(in crate::report) const TITLE: &str = "Solver: error against time";

/// Steps after which a solve is cut short.
const STEPS: [usize; 4] = [1, 2, 3, 4];

/// How far a warm start is off, per axis: what a frame before leaves at some 10 mm/s.
pub(in crate::report) const PRIOR_M: f64 = 3e-6;
pub(in crate::report) const PRIOR_RAD: f64 = 3e-4;

struct Entry {
    method: Method,
    noisy: Errors,
    clean: Errors,
    run_time: RunTime,
}

pub(in crate::report) fn section(head: &Head<'_>, settings: &Settings) -> Result<Section, ReportError> {
    let bound = bound(head)?;
    let entries = measure(head, settings)?;
    let floor = floor(head, settings)?;
    let mut section = Section {
        name: "solver",
        title: TITLE,
        summary: summary(&entries, bound),
        paragraphs: vec![
            format!(
                "{} poses of the workspace, one frame of photocurrents each, the tool at rest. The noise is that of the \
                 scene's front end, drawn from the covariance of each pair of currents. A cold start has no prior pose; \
                 a warm start is {} µm and {} mrad off per axis, as if from the frame before. `planes` is the initial \
                 pose from the spot positions alone; the numbers count Gauss–Newton steps on the currents after it; \
                 `full` iterates to the minimum and judges the fit. Each counted step includes a last evaluation of the \
                 model, to check that the fit has improved. A full solve from a warm start stops before that evaluation \
                 when the predicted gain is negligible, so that it takes less time than one counted step.",
                head.poses.len(),
                PRIOR_M * 1e6,
                PRIOR_RAD * 1e3
            ),
            format!(
                "Errors are root mean squares of the length of the error vector. The Cramér–Rao bound, below which no \
                 unbiased estimate from one frame comes on average, is {} µm and {} µrad. With this number of poses a \
                 root mean square scatters about its expectation by up to {} % (1 σ). The light follows the exact \
                 tier, as real light would.",
                Value::from(bound.0 * 1e6).shown(),
                Value::from(bound.1 * 1e6).shown(),
                // Of errors along one axis of each pose; more axes stray less.
                Value::from(100.0 / (2.0 * head.poses.len() as f64).sqrt()).shown()
            ),
        ],
        pictures: vec![
            picture::picture(&entries, head, bound.0, &picture::TRANSLATION),
            picture::picture(&entries, head, bound.1, &picture::ROTATION),
        ],
        tables: tables(&entries, bound).into_iter().chain([floor]).collect(),
    };
    let slowest_s = entries.iter().filter(|entry| searched(&entry.noisy)).map(|entry| entry.run_time.least_s);
    if let Some(slowest_s) = slowest_s.reduce(f64::max) {
        section.paragraphs.push(format!(
            "Where the light obeys another model than the solver's, χ² says so, and a full solve searches everywhere \
             for a pose that fits before it gives the best one, marked as a misfit: up to {} µm. Solves that stop \
             after some steps do not ask.",
            Value::from(slowest_s * 1e6).shown()
        ));
    }
    Ok(section)
}

/// The default solver on this head.
fn summary(entries: &[Entry], bound: (f64, f64)) -> Vec<String> {
    let full = |wanted: Start| {
        entries.iter().find(|Entry { method: Method { tier, precision, start, effort }, .. }| {
            (*tier, *precision, *start, *effort) == (STREAM, Precision::Double, wanted, Effort::Full)
        })
    };
    let (Some(cold), Some(warm)) = (full(Start::Cold), full(Start::Warm)) else { return Vec::new() };
    let shown = |value: f64| Value::from(value).shown();
    vec![
        format!(
            "One scan gives the position to {} µm and the orientation to {} µrad (root mean square of the error's \
             length, from nothing but that scan); the least that its noise allows (the Cramér–Rao bound) is {} µm and \
             {} µrad. {} % of the scans gave a pose.",
            shown(cold.noisy.rms_m() * 1e6),
            shown(cold.noisy.rms_rad() * 1e6),
            shown(bound.0 * 1e6),
            shown(bound.1 * 1e6),
            shown(100.0 * cold.noisy.solved()),
        ),
        format!(
            "A solve takes {} µs when the pose of the scan before is known, {} µs when nothing is.",
            shown(warm.run_time.least_s * 1e6),
            shown(cold.run_time.least_s * 1e6)
        ),
    ]
}

/// Mean steps of a full solve that found no fit and searched everywhere for one. Such a point
/// lies far to the right of all others; a word tells of it.
const SEARCHED: f64 = 40.0;

/// Whether solves found no fit and searched everywhere for one.
fn searched(errors: &Errors) -> bool {
    errors.mean_iterations() > SEARCHED
}

/// The Cramér–Rao bound over all poses: metres and radians.
fn bound(head: &Head<'_>) -> Result<(f64, f64), ReportError> {
    let solver = Solver::<f64>::new(&head.scene, STREAM)?;
    Ok(rms_of_covariances(head.poses.iter().filter_map(|pose| solver.bound(pose))))
}

fn methods(head: &Head<'_>) -> Vec<Method> {
    let mut methods = Vec::new();
    for tier in [STREAM, Tier::Paper] {
        for precision in Precision::BOTH {
            for start in Start::BOTH {
                // From a pose nearby the planes are skipped.
                let planes = (start == Start::Cold).then_some(Effort::Planes);
                let efforts = planes.into_iter().chain(STEPS.map(Effort::Steps)).chain([Effort::Full]);
                methods.extend(efforts.map(|effort| Method { tier, precision, start, effort }));
            }
        }
    }
    // What the tolerance costs and gives: once more at a tight one.
    for start in Start::BOTH {
        let efforts = STEPS.map(Effort::Steps).into_iter().chain([Effort::Full]);
        let method = |effort| Method { tier: head.truth_tier, precision: Precision::Double, start, effort };
        methods.extend(efforts.map(method));
    }
    methods
}

fn measure(head: &Head<'_>, settings: &Settings) -> Result<Vec<Entry>, ReportError> {
    let mut noise = NoiseSource::seeded(settings.seed);
    let clean: Vec<Photocurrents> = head.poses.iter().map(|pose| currents(&head.truth, pose)).collect();
    let disturbed =
        clean.iter().zip(&head.poses).map(|(clean, pose)| noise.disturb(&head.scene, &head.truth, pose, clean));
    let noisy: Vec<Photocurrents> = disturbed.collect();
    let priors: Vec<Pose> = head.poses.iter().map(|pose| noise.near(pose, PRIOR_M, PRIOR_RAD)).collect();

    let methods = methods(head);
    let solves = methods.iter().map(|method| method.compile(&head.scene)).collect::<Result<Vec<_>, _>>()?;
    let errors_of = |solve: &Compiled, readings: &[Photocurrents]| {
        let solved = readings.iter().zip(&priors).map(|(readings, prior)| solve(readings, prior));
        Errors::of(solved.zip(&head.poses))
    };
    let errors: Vec<[Errors; 2]> =
        solves.iter().map(|solve| [&noisy, &clean].map(|readings| errors_of(solve, readings))).collect();
    let timed = settings.timed_poses();
    let mut candidates: Vec<Candidate<'_>> = Vec::new();
    for solve in &solves {
        candidates.push(Box::new(|| {
            for (readings, prior) in noisy[..timed].iter().zip(&priors) {
                black_box(solve(black_box(readings), prior));
            }
        }));
    }
    let run_times = race(&mut candidates, settings.rounds(), timed);
    let entries = methods.into_iter().zip(errors).zip(run_times);
    Ok(entries.map(|((method, [noisy, clean]), run_time)| Entry { method, noisy, clean, run_time }).collect())
}

/// The errors with noise, and those without.
fn tables(entries: &[Entry], bound: (f64, f64)) -> [Table; 2] {
    let micro = |value: f64| Value::from(value * 1e6);
    let run: [Getter<'_, Entry>; 4] = [
        ("tier", "tier", &|entry| tier_name(entry.method.tier).into()),
        ("number", "numbers", &|entry| entry.method.precision.name().into()),
        ("start", "start", &|entry| entry.method.start.name().into()),
        ("effort", "effort", &|entry| effort_name(entry.method.effort).into()),
    ];
    let noisy: [Getter<'_, Entry>; 8] = [
        ("solved_percent", "solved / %", &|entry| (100.0 * entry.noisy.solved()).into()),
        ("rms_um", "rms / µm", &|entry| micro(entry.noisy.rms_m())),
        ("rms_urad", "rms / µrad", &|entry| micro(entry.noisy.rms_rad())),
        ("ratio_to_bound_translation", "translation to bound", &|entry| (entry.noisy.rms_m() / bound.0).into()),
        ("ratio_to_bound_rotation", "rotation to bound", &|entry| (entry.noisy.rms_rad() / bound.1).into()),
        ("steps", "steps, mean", &|entry| entry.noisy.mean_iterations().into()),
        ("least_us", "least / µs", &|entry| micro(entry.run_time.least_s)),
        ("median_us", "median / µs", &|entry| micro(entry.run_time.median_s)),
    ];
    let clean: [Getter<'_, Entry>; 6] = [
        ("solved_percent", "solved / %", &|entry| (100.0 * entry.clean.solved()).into()),
        ("rms_um", "rms / µm", &|entry| micro(entry.clean.rms_m())),
        ("rms_urad", "rms / µrad", &|entry| micro(entry.clean.rms_rad())),
        ("median_um", "median / µm", &|entry| micro(entry.clean.median_m())),
        ("median_urad", "median / µrad", &|entry| micro(entry.clean.median_rad())),
        ("steps", "steps, mean", &|entry| entry.clean.mean_iterations().into()),
    ];
    let table = |name, caption, columns: &[Getter<'_, Entry>]| Table::of(name, caption, entries, columns);
    [
        table(
            "solver_noisy",
            "Noisy currents: error, its ratio to the Cramér–Rao bound, and time per solve",
            &[&run[..], &noisy].concat(),
        ),
        table("solver_clean", "Currents free of noise: the error of the method itself", &[&run[..], &clean].concat()),
    ]
}

/// The numerical floor: no noise in the currents and none in the weights, so that a solve goes on
/// until arithmetic ends it.
fn floor(head: &Head<'_>, settings: &Settings) -> Result<Table, ReportError> {
    let silent: Scene = head.silent();
    let mut noise = NoiseSource::seeded(settings.seed);
    let priors: Vec<Pose> = head.poses.iter().map(|pose| noise.near(pose, PRIOR_M, PRIOR_RAD)).collect();
    let mut rows = Vec::new();
    for tier in [Tier::Paper, STREAM, head.truth_tier] {
        // Each tier on its own light: the model is no part of this error.
        let own = if tier == Tier::Paper { tier } else { head.truth_tier };
        let plan = CompiledScene::<f64>::compile(&silent, own)?;
        let readings: Vec<Photocurrents> = head.poses.iter().map(|pose| currents(&plan, pose)).collect();
        // What `f32` cannot keep it is not asked for.
        let kept = Precision::BOTH.into_iter().filter(|p| *p == Precision::Double || tier != head.truth_tier);
        for precision in kept {
            for start in Start::BOTH {
                let method = Method { tier, precision, start, effort: Effort::Full };
                let solve = method.compile(&silent)?;
                let solved = readings.iter().zip(&priors).map(|(readings, prior)| solve(readings, prior));
                let errors = Errors::of(solved.zip(&head.poses));
                rows.push((method, errors));
            }
        }
    }
    let micro = |value: f64| Value::from(value * 1e6);
    Ok(Table::of(
        "solver_floor",
        "Numerical floor: no noise in currents and weights, each tier in its own light",
        &rows,
        &[
            ("tier", "tier", &|(method, _)| tier_name(method.tier).into()),
            ("number", "numbers", &|(method, _)| method.precision.name().into()),
            ("start", "start", &|(method, _)| method.start.name().into()),
            ("solved_percent", "solved / %", &|(_, errors)| (100.0 * errors.solved()).into()),
            ("rms_um", "rms / µm", &|(_, errors)| micro(errors.rms_m())),
            ("rms_urad", "rms / µrad", &|(_, errors)| micro(errors.rms_rad())),
            ("median_um", "median / µm", &|(_, errors)| micro(errors.median_m())),
            ("median_urad", "median / µrad", &|(_, errors)| micro(errors.median_rad())),
            ("steps", "steps, mean", &|(_, errors)| errors.mean_iterations().into()),
        ],
    ))
}
