//! The solver: the cost of each method, and its error against the bound.

mod picture;
mod tables;

use std::hint::black_box;

use slitpose_model::{Photocurrents, Plan, Pose, Solver, Tier};

use crate::report::accuracy::{Errors, rms_of_covariances};
use crate::report::head::{Head, STREAM, currents};
use crate::report::method::{Effort, Method, Precision, Start};
use crate::report::noise::NoiseSource;
use crate::report::section::{Section, Value};
use crate::report::stopwatch::{Candidate, RunTime, race};
use crate::report::{ReportError, Settings};

pub(in crate::report) const TITLE: &str = "Solver: error against time";

/// Steps after which a solve is cut short.
const STEPS: [usize; 4] = [1, 2, 3, 4];

/// How far a warm start is off, per axis: what a frame before leaves at some 10 mm/s.
pub(in crate::report) const PRIOR_M: f64 = 3e-6;
pub(in crate::report) const PRIOR_RAD: f64 = 3e-4;

/// Which model the light obeys.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Light {
    /// The exact one, as in reality.
    Exact,
    /// That of the paper: an answer book for its own solver.
    Paper,
}

/// One way to solve, on one kind of data.
#[derive(Clone, Copy, Debug)]
struct Run {
    method: Method,
    light: Light,
}

struct Entry {
    run: Run,
    noisy: Errors,
    clean: Errors,
    run_time: RunTime,
}

/// Currents of all poses in one kind of light.
struct Data {
    noisy: Vec<Photocurrents>,
    clean: Vec<Photocurrents>,
}

pub(in crate::report) fn section(head: &Head<'_>, settings: &Settings) -> Result<Section, ReportError> {
    let bound = bound(head)?;
    let entries = measure(head, settings)?;
    let floor = tables::floor(head, settings)?;
    let mut section = Section {
        name: "solver",
        title: TITLE,
        summary: summary(&entries, bound),
        paragraphs: vec![
            format!(
                "{} poses of the workspace, one frame of photocurrents each, the tool at rest. Noise is that of the \
                 scene's front end, drawn from the covariance of each pair of currents. A cold start knows nothing; a \
                 warm one starts {} µm and {} mrad off per axis, as from the frame before. `planes` is the pose that \
                 the positions of the light give; so many steps follow on the currents; `full` goes to the minimum and \
                 judges the fit. A counted step ends with an evaluation of the model at the pose that it has reached, \
                 to see that the fit is better there; a full solve from nearby knows before its last step that nothing \
                 more can be won and leaves that evaluation out, so that it takes less time than one counted step.",
                head.poses.len(),
                PRIOR_M * 1e6,
                PRIOR_RAD * 1e3
            ),
            format!(
                "Errors are root mean squares of the length of the error vector. The Cramér–Rao bound, below which no \
                 unbiased estimate from one frame comes on average, is {} µm and {} µrad; of so many poses a root mean \
                 square strays from its expectation by up to {} % (1 σ). The light obeys the exact tier, as \
                 real light would; rows with the light of the paper tier show what that tier's solver would do if its \
                 model were true.",
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
        tables: vec![tables::noisy(&entries, bound), tables::clean(&entries), floor],
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
        entries.iter().find(|Entry { run: Run { method, light }, .. }| {
            let Method { tier, precision, start, effort } = *method;
            (tier, precision, start, effort, *light) == (STREAM, Precision::Double, wanted, Effort::Full, Light::Exact)
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

fn runs(head: &Head<'_>) -> Vec<Run> {
    let mut runs = Vec::new();
    for (tier, light) in [(STREAM, Light::Exact), (Tier::Paper, Light::Exact), (Tier::Paper, Light::Paper)] {
        for precision in Precision::BOTH {
            for start in Start::BOTH {
                // From a pose nearby the planes are skipped.
                let planes = (start == Start::Cold).then_some(Effort::Planes);
                let efforts = planes.into_iter().chain(STEPS.map(Effort::Steps)).chain([Effort::Full]);
                runs.extend(efforts.map(|effort| Run { method: Method { tier, precision, start, effort }, light }));
            }
        }
    }
    // What the tolerance costs and gives: once more at a tight one.
    for start in Start::BOTH {
        let efforts = STEPS.map(Effort::Steps).into_iter().chain([Effort::Full]);
        let method = |effort| Method { tier: head.truth_tier, precision: Precision::Double, start, effort };
        runs.extend(efforts.map(|effort| Run { method: method(effort), light: Light::Exact }));
    }
    runs
}

fn measure(head: &Head<'_>, settings: &Settings) -> Result<Vec<Entry>, ReportError> {
    let mut noise = NoiseSource::seeded(settings.seed);
    let mut data = |plan: &Plan<f64>| {
        let clean: Vec<Photocurrents> = head.poses.iter().map(|pose| currents(plan, pose)).collect();
        let disturbed =
            clean.iter().zip(&head.poses).map(|(clean, pose)| noise.disturb(&head.scene, plan, pose, clean));
        Data { noisy: disturbed.collect(), clean }
    };
    let exact = data(&head.truth);
    let paper_plan = Plan::<f64>::compile(&head.scene, Tier::Paper)?;
    let paper = data(&paper_plan);
    let priors: Vec<Pose> = head.poses.iter().map(|pose| noise.near(pose, PRIOR_M, PRIOR_RAD)).collect();
    let of = |light| if light == Light::Exact { &exact } else { &paper };

    let runs = runs(head);
    let solves = runs.iter().map(|run| run.method.compile(&head.scene)).collect::<Result<Vec<_>, _>>()?;
    let errors: Vec<[Errors; 2]> = runs
        .iter()
        .zip(&solves)
        .map(|(run, solve)| {
            let data = of(run.light);
            [&data.noisy, &data.clean].map(|readings| {
                let solved = readings.iter().zip(&priors).map(|(readings, prior)| solve(readings, prior));
                Errors::of(solved.zip(&head.poses))
            })
        })
        .collect();
    let timed = settings.timed_poses();
    let mut candidates: Vec<Candidate<'_>> = runs
        .iter()
        .zip(&solves)
        .map(|(run, solve)| {
            let readings = &of(run.light).noisy[..timed];
            let priors = &priors;
            Candidate::new(move || {
                for (readings, prior) in readings.iter().zip(priors) {
                    black_box(solve(black_box(readings), prior));
                }
            })
        })
        .collect();
    let run_times = race(&mut candidates, settings.rounds(), timed);
    drop(candidates);
    Ok(runs
        .into_iter()
        .zip(errors)
        .zip(run_times)
        .map(|((run, [noisy, clean]), run_time)| Entry { run, noisy, clean, run_time })
        .collect())
}
