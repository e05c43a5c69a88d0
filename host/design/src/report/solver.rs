//! The solver: the cost of each method, and its error against the bound.

use std::hint::black_box;

use glam::dvec2;
use slitpose_model::{MotionPrior, Photocurrents, Pose, SceneError, Solution, Solver, Start, Tier};

use super::Settings;
use super::head::{
    Candidate, Errors, Head, NoiseSource, PRIOR, RunTime, STREAM, currents, race, rms_of_covariances, tier_name,
};
use super::section::{Picture, Section, Sheet, Table, Value};
use crate::DesignError;
use crate::plot::{Axis, Chart, Curve, CurveStyle, Note, SOFT_INK, curve};

pub(super) const TITLE: &str = "Solver: error against time";

/// How far a solve goes: to the pose on the planes, at most so many steps, or to the end.
const EFFORTS: [&str; 6] = ["planes", "1 step", "2 steps", "3 steps", "4 steps", "full"];
const PLANES: usize = 0;
const FULL: usize = 5;

struct Method {
    tier: Tier,
    solver: Solver<f64>,
    /// From a pose near the truth, as from the frame before; else from nothing.
    is_warm: bool,
    /// Place in [`EFFORTS`].
    effort: usize,
}

impl Method {
    fn solve(&self, readings: &Photocurrents, prior: &Pose) -> Solution {
        let start = match (self.effort, self.is_warm) {
            (PLANES, _) => Start::PlanesOnly,
            (_, false) => Start::Cold,
            (_, true) => Start::Near(prior),
        };
        self.solver.solve(readings, start, &MotionPrior::AT_REST)
    }
}

struct Entry {
    method: Method,
    /// Of currents with noise, and of currents without.
    noisy: Errors,
    clean: Errors,
    run_time: RunTime,
}

pub(super) fn section(head: &Head, settings: &Settings) -> Result<Section, DesignError> {
    let solver = Solver::<f64>::new(&head.scene, STREAM)?;
    let bound = rms_of_covariances(head.poses.iter().filter_map(|pose| solver.bound(pose)));
    let entries = measure(head, settings)?;
    Ok(Section {
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
                PRIOR[0] * 1e6,
                PRIOR[1] * 1e3
            ),
            format!(
                "Errors are root mean squares of the length of the error vector. The Cramér–Rao bound, below which no \
                 unbiased estimate from one frame comes on average, is {} µm and {} µrad. With this number of poses a \
                 root mean square scatters about its expectation by up to {} % (1 σ). The light follows the exact \
                 tier, as real light would.",
                Value::from(bound[0] * 1e6).shown(),
                Value::from(bound[1] * 1e6).shown(),
                // Of errors along one axis of each pose; more axes stray less.
                Value::from(100.0 / (2.0 * head.poses.len() as f64).sqrt()).shown()
            ),
            "Where the light obeys another model than the solver's, χ² says so, and a full solve searches everywhere for a \
             pose that fits before it gives the best one, marked as a misfit: such points lie far to the right. Solves that \
             stop after some steps do not ask."
                .to_owned(),
        ],
        pictures: vec![
            picture(
                &entries,
                head,
                bound,
                0,
                "work-precision",
                "Error of the translation against time per solve. Each curve goes from the first guess step by step, a lone \
                 point is the full solve; lower and further left is better; below the bound nothing comes but by chance.",
            ),
            picture(&entries, head, bound, 1, "work-precision-rotation", "The same for the rotation."),
        ],
        tables: vec![table(&entries, bound)],
    })
}

fn summary(entries: &[Entry], bound: [f64; 2]) -> Vec<String> {
    let full = |is_warm| chosen(entries, STREAM, is_warm).find(|entry| entry.method.effort == FULL);
    let (Some(cold), Some(warm)) = (full(false), full(true)) else { return Vec::new() };
    let micro = |value: f64| Value::micro(value).shown();
    vec![
        format!(
            "One scan gives the position to {} µm and the orientation to {} µrad (root mean square of the error's \
             length, from nothing but that scan); the least that its noise allows (the Cramér–Rao bound) is {} µm and \
             {} µrad. {} % of the scans gave a pose.",
            micro(cold.noisy.rms[0]),
            micro(cold.noisy.rms[1]),
            micro(bound[0]),
            micro(bound[1]),
            Value::from(100.0 * cold.noisy.solved).shown(),
        ),
        format!(
            "A solve takes {} µs when the pose of the scan before is known, {} µs when nothing is.",
            micro(warm.run_time.least_s),
            micro(cold.run_time.least_s)
        ),
    ]
}

fn chosen(entries: &[Entry], tier: Tier, is_warm: bool) -> impl Iterator<Item = &Entry> {
    entries.iter().filter(move |Entry { method, .. }| (method.tier, method.is_warm) == (tier, is_warm))
}

fn methods(head: &Head) -> Result<Vec<Method>, SceneError> {
    let mut methods = Vec::new();
    // What the tolerance costs and gives: once more at a tight one.
    for tier in [STREAM, Tier::Paper, head.truth_tier] {
        for (is_warm, effort) in
            [false, true].into_iter().flat_map(|is_warm| (PLANES..=FULL).map(move |k| (is_warm, k)))
        {
            // From a pose nearby the planes are skipped.
            if effort == PLANES && (is_warm || tier == head.truth_tier) {
                continue;
            }
            let solver = Solver::new(&head.scene, tier)?;
            let solver = if effort == PLANES || effort == FULL { solver } else { solver.with_max_steps(effort) };
            methods.push(Method { tier, solver, is_warm, effort });
        }
    }
    Ok(methods)
}

fn measure(head: &Head, settings: &Settings) -> Result<Vec<Entry>, DesignError> {
    let mut noise = NoiseSource::of(&head.scene, &head.truth, settings.seed);
    let silent: Vec<Photocurrents> = head.poses.iter().map(|pose| currents(&head.truth, pose)).collect();
    let noisy = silent.iter().zip(&head.poses);
    let noisy: Vec<_> = noisy.map(|(clean, pose)| noise.disturb(pose, clean)).collect();
    let priors: Vec<Pose> = head.poses.iter().map(|pose| noise.near(pose, PRIOR)).collect();
    let methods = methods(head)?;
    let timed = settings.timed_poses();
    let candidate = |method| -> Candidate<'_> {
        let (readings, priors) = (&noisy[..timed], &priors);
        Box::new(move || {
            for (readings, prior) in readings.iter().zip(priors) {
                black_box(Method::solve(method, black_box(readings), prior));
            }
        })
    };
    let run_times = race(&mut methods.iter().map(candidate).collect::<Vec<_>>(), settings.rounds(), timed);
    let entry = |(method, run_time): (Method, RunTime)| {
        let [noisy, clean] = [&noisy, &silent].map(|readings| {
            let solved = readings.iter().zip(&priors).map(|(readings, prior)| method.solve(readings, prior));
            Errors::of(solved.zip(&head.poses))
        });
        Entry { method, noisy, clean, run_time }
    };
    Ok(methods.into_iter().zip(run_times).map(entry).collect())
}

fn table(entries: &[Entry], bound: [f64; 2]) -> Table {
    Table::of(
        "solver",
        "Error, its ratio to the Cramér–Rao bound, and time per solve; and the error of the method itself, from currents free \
         of noise",
        entries,
        &[
            ("tier", "tier", &|entry| tier_name(entry.method.tier).into()),
            ("start", "start", &|entry| if entry.method.is_warm { "warm" } else { "cold" }.into()),
            ("effort", "effort", &|entry| EFFORTS[entry.method.effort].into()),
            ("solved_percent", "solved / %", &|entry| (100.0 * entry.noisy.solved).into()),
            ("rms_um", "rms / µm", &|entry| Value::micro(entry.noisy.rms[0])),
            ("rms_urad", "rms / µrad", &|entry| Value::micro(entry.noisy.rms[1])),
            ("ratio_to_bound_translation", "translation to bound", &|entry| (entry.noisy.rms[0] / bound[0]).into()),
            ("ratio_to_bound_rotation", "rotation to bound", &|entry| (entry.noisy.rms[1] / bound[1]).into()),
            ("steps", "steps, mean", &|entry| entry.noisy.steps.into()),
            ("least_us", "least / µs", &|entry| Value::micro(entry.run_time.least_s)),
            ("median_us", "median / µs", &|entry| Value::micro(entry.run_time.median_s)),
            ("clean_solved_percent", "free of noise: solved / %", &|entry| (100.0 * entry.clean.solved).into()),
            ("clean_rms_um", "rms / µm", &|entry| Value::micro(entry.clean.rms[0])),
            ("clean_rms_urad", "rms / µrad", &|entry| Value::micro(entry.clean.rms[1])),
            ("clean_steps", "steps, mean", &|entry| entry.clean.steps.into()),
        ],
    )
}

/// Error of translations (`half` 0) or rotations (1) against time.
fn picture(entries: &[Entry], head: &Head, bound: [f64; 2], half: usize, name: &'static str, caption: &str) -> Picture {
    let (what, unit) = [("translation", "µm"), ("rotation", "µrad")][half];
    let tight = format!("{}, cold start", tier_name(head.truth_tier).replace("exact", "exact tier at"));
    let panel = |heading: &str, errors: fn(&Entry) -> &Errors, floor: Option<f64>| {
        let point = |entry: &Entry| [entry.run_time.least_s * 1e6, errors(entry).rms[half] * 1e6];
        let mut curves = Vec::new();
        for (colour, (name, tier, is_warm)) in [
            ("exact tier, cold start", STREAM, false),
            ("exact tier, warm start", STREAM, true),
            ("paper tier, cold start", Tier::Paper, false),
            ("paper tier, warm start", Tier::Paper, true),
            (tight.as_str(), head.truth_tier, false),
        ]
        .into_iter()
        .enumerate()
        {
            // A full solve goes its own way: it is no further step.
            for (label, style, is_full) in [(name, CurveStyle::Joined, false), ("", CurveStyle::Markers, true)] {
                let shown = chosen(entries, tier, is_warm).filter(|it| (it.method.effort == FULL) == is_full);
                curves.push(curve(label, colour, style, shown.map(point).collect()));
            }
        }
        let y =
            |y: Vec<f64>| Axis::logarithmic(&format!("rms error of the {what} / {unit}"), y.into_iter().chain(floor));
        let mut chart = Chart::over(curves, |x| Axis::logarithmic("time per solve / µs", x), y);
        let times = chart.x.range;
        if let Some(floor) = floor {
            let (at, text) = ([times[0], floor], "Cramér–Rao bound of one frame".to_owned());
            chart.notes.push(Note { at, offset: dvec2(8.0, 16.0), text });
            let points = times.map(|x| [x, floor]).to_vec();
            chart.curves.push(Curve { label: String::new(), colour: SOFT_INK, style: CurveStyle::Dashed, points });
        }
        (heading.to_owned(), chart)
    };
    Sheet {
        title: format!("Pose from {} cells: error of the {what} against time", head.scene.cells.len()),
        note: format!(
            "{} poses, one frame each. Curves: planes (cold start), 1, 2, 3, 4 steps; lone points: full.",
            head.poses.len()
        ),
        panels: vec![
            panel("noisy currents", |entry| &entry.noisy, Some(bound[half] * 1e6)),
            panel("currents free of noise", |entry| &entry.clean, None),
        ],
    }
    .draw(name, caption)
}
