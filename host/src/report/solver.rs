//! The solver: what each way to a pose costs, and how near it comes to the bound.

use std::hint::black_box;

use glam::dvec2;
use slitpose_model::{Effort, Photocurrents, Pose, Scene, Solver, Tier};

use super::accuracy::{Errors, rms_of_covariances};
use super::head::{Head, STREAM, currents};
use super::method::{Method, Precision, Start, effort_name, tier_name};
use super::noise::NoiseSource;
use super::section::{Picture, Section, Table, Value, column};
use super::sheet::{Sheet, curve};
use super::stopwatch::{Candidate, Timing, race};
use super::{ReportError, Settings};
use crate::plot::{Anchor, Axis, Chart, Curve, CurveStyle, Note, SOFT_INK, cell_colour};

pub(super) const TITLE: &str = "Solver: error against time";

/// Steps after which a solve is cut short.
const STEPS: [usize; 4] = [1, 2, 3, 4];

/// How far a warm start is off, per axis: what a frame before leaves at some 10 mm/s.
pub(super) const PRIOR_M: f64 = 3e-6;
pub(super) const PRIOR_RAD: f64 = 3e-4;

/// Which model the light obeys.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Light {
    /// The exact one: what reality does.
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
    timing: Timing,
}

/// Currents of all poses in one kind of light.
struct Data {
    noisy: Vec<Photocurrents>,
    clean: Vec<Photocurrents>,
}

pub(super) fn section(head: &Head<'_>, settings: &Settings) -> Result<Section, ReportError> {
    let bound = bound(head)?;
    let entries = measure(head, settings)?;
    let floor = floor(head, settings)?;
    let mut section = Section {
        name: "solver",
        title: TITLE,
        paragraphs: vec![
            format!(
                "{} poses of the workspace, one frame of photocurrents each, the tool at rest. Noise is that of the \
                 scene's front end, drawn from the covariance of each pair of currents. A cold start knows nothing; a \
                 warm one starts {} µm and {} mrad off per axis, as from the frame before. `planes` is the pose that \
                 the positions of the light give; so many steps follow on the currents; `full` goes to the minimum and \
                 judges the fit.",
                head.poses.len(),
                PRIOR_M * 1e6,
                PRIOR_RAD * 1e3
            ),
            format!(
                "Errors are root mean squares of the length of the error vector. The Cramér–Rao bound, below which no \
                 unbiased estimate from one frame can come, is {} µm and {} µrad. The light obeys the exact tier, as \
                 real light would; rows with the light of the paper tier show what that tier's solver would do if its \
                 model were true.",
                Value::from(bound.0 * 1e6).shown(),
                Value::from(bound.1 * 1e6).shown()
            ),
        ],
        pictures: vec![picture(&entries, head, bound.0, &TRANSLATION), picture(&entries, head, bound.1, &ROTATION)],
        tables: vec![noisy_table(&entries, bound), clean_table(&entries), floor],
    };
    let slowest_s = entries.iter().filter(|entry| searched(&entry.noisy)).map(|entry| entry.timing.least_s);
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
    let mut data = |clean: Vec<Photocurrents>| Data {
        noisy: clean.iter().map(|clean| noise.disturb(&head.scene, clean)).collect(),
        clean,
    };
    let exact = data(head.currents());
    let paper_plan = slitpose_model::Plan::<f64>::compile(&head.scene, Tier::Paper)?;
    let paper = data(head.poses.iter().map(|pose| currents(&paper_plan, pose)).collect());
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
    let timings = race(&mut candidates, settings.rounds(), timed);
    drop(candidates);
    Ok(runs
        .into_iter()
        .zip(errors)
        .zip(timings)
        .map(|((run, [noisy, clean]), timing)| Entry { run, noisy, clean, timing })
        .collect())
}

/// What tells one run from another in a table.
fn names(run: &Run) -> Vec<Value> {
    let light = if run.light == Light::Exact { "exact" } else { "paper" };
    let Method { tier, precision, start, effort } = run.method;
    vec![light.into(), tier_name(tier).into(), precision.name().into(), start.name().into(), effort_name(effort).into()]
}

const NAMES: [super::Column; 5] = [
    column("light", "light"),
    column("tier", "tier"),
    column("number", "numbers"),
    column("start", "start"),
    column("effort", "effort"),
];

fn noisy_table(entries: &[Entry], bound: (f64, f64)) -> Table {
    let row = |entry: &Entry| {
        let (rms_m, rms_rad) = (entry.noisy.rms_m(), entry.noisy.rms_rad());
        let mut row = names(&entry.run);
        row.extend([
            Value::from(100.0 * entry.noisy.solved()),
            Value::from(rms_m * 1e6),
            Value::from(rms_rad * 1e6),
            Value::from(rms_m / bound.0),
            Value::from(rms_rad / bound.1),
            Value::from(entry.noisy.mean_iterations()),
            Value::from(entry.timing.least_s * 1e6),
            Value::from(entry.timing.median_s * 1e6),
        ]);
        row
    };
    Table {
        name: "solver_noisy",
        caption: "Noisy currents: error, its ratio to the Cramér–Rao bound, and time per solve".to_owned(),
        columns: NAMES
            .into_iter()
            .chain([
                column("solved_percent", "solved / %"),
                column("rms_um", "rms / µm"),
                column("rms_urad", "rms / µrad"),
                column("ratio_to_bound_translation", "translation to bound"),
                column("ratio_to_bound_rotation", "rotation to bound"),
                column("steps", "steps, mean"),
                column("least_us", "least / µs"),
                column("median_us", "median / µs"),
            ])
            .collect(),
        rows: entries.iter().map(row).collect(),
    }
}

fn clean_table(entries: &[Entry]) -> Table {
    let row = |entry: &Entry| {
        let mut row = names(&entry.run);
        row.extend([
            Value::from(100.0 * entry.clean.solved()),
            Value::from(entry.clean.rms_m() * 1e6),
            Value::from(entry.clean.rms_rad() * 1e6),
            Value::from(entry.clean.median_m() * 1e6),
            Value::from(entry.clean.median_rad() * 1e6),
            Value::from(entry.clean.mean_iterations()),
        ]);
        row
    };
    Table {
        name: "solver_clean",
        caption: "The same with currents free of noise: what is left is the method's own error".to_owned(),
        columns: NAMES
            .into_iter()
            .chain([
                column("solved_percent", "solved / %"),
                column("rms_um", "rms / µm"),
                column("rms_urad", "rms / µrad"),
                column("median_um", "median / µm"),
                column("median_urad", "median / µrad"),
                column("steps", "steps, mean"),
            ])
            .collect(),
        rows: entries.iter().map(row).collect(),
    }
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
        let plan = slitpose_model::Plan::<f64>::compile(&silent, own)?;
        let readings: Vec<Photocurrents> = head.poses.iter().map(|pose| currents(&plan, pose)).collect();
        // What `f32` cannot keep it is not asked for.
        let kept = Precision::BOTH.into_iter().filter(|p| *p == Precision::Double || tier != head.truth_tier);
        for precision in kept {
            for start in Start::BOTH {
                let method = Method { tier, precision, start, effort: Effort::Full };
                let solve = method.compile(&silent)?;
                let solved = readings.iter().zip(&priors).map(|(readings, prior)| solve(readings, prior));
                let errors = Errors::of(solved.zip(&head.poses));
                rows.push(vec![
                    tier_name(tier).into(),
                    precision.name().into(),
                    start.name().into(),
                    Value::from(100.0 * errors.solved()),
                    Value::from(errors.rms_m() * 1e6),
                    Value::from(errors.rms_rad() * 1e6),
                    Value::from(errors.median_m() * 1e6),
                    Value::from(errors.median_rad() * 1e6),
                    Value::from(errors.mean_iterations()),
                ]);
            }
        }
    }
    Ok(Table {
        name: "solver_floor",
        caption: "Numerical floor: no noise in currents and weights, each tier in its own light".to_owned(),
        columns: vec![
            column("tier", "tier"),
            column("number", "numbers"),
            column("start", "start"),
            column("solved_percent", "solved / %"),
            column("rms_um", "rms / µm"),
            column("rms_urad", "rms / µrad"),
            column("median_um", "median / µm"),
            column("median_urad", "median / µrad"),
            column("steps", "steps, mean"),
        ],
        rows,
    })
}

/// Which half of a pose a picture shows.
struct Half {
    name: &'static str,
    /// What of the pose, in the picture's title.
    what: &'static str,
    caption: &'static str,
    axis: &'static str,
    rms: fn(&Errors) -> f64,
}

const TRANSLATION: Half = Half {
    name: "work-precision",
    what: "translation",
    caption: "Error of the translation against time per solve. Each curve goes from the first guess to the full solve; \
              lower and further left is better, and nothing comes below the bound.",
    axis: "rms error of the translation / µm",
    rms: Errors::rms_m,
};

const ROTATION: Half = Half {
    name: "work-precision-rotation",
    what: "rotation",
    caption: "The same for the rotation.",
    axis: "rms error of the rotation / µrad",
    rms: Errors::rms_rad,
};

/// Mean steps of a full solve that found no fit and searched everywhere for one. Such a point
/// lies far to the right of all others; a word tells of it.
const SEARCHED: f64 = 40.0;

fn picture(entries: &[Entry], head: &Head<'_>, bound: f64, half: &Half) -> Picture {
    let tight = format!("{}, cold start", tier_name(head.truth_tier).replace("exact", "exact tier at"));
    let panel = |heading: &str, errors: fn(&Entry) -> &Errors, floor: Option<f64>| {
        let point = |entry: &Entry| [entry.timing.least_s * 1e6, (half.rms)(errors(entry)) * 1e6];
        let chosen = |tier: Tier, start, precision| {
            entries.iter().filter(move |entry| {
                let Method { tier: t, precision: p, start: s, .. } = entry.run.method;
                (t, p, s, entry.run.light) == (tier, precision, start, Light::Exact)
            })
        };
        let is_shown = |entry: &&Entry| !searched(errors(entry));
        let mut curves = Vec::new();
        for (colour, (name, tier, start)) in [
            ("exact tier, cold start", STREAM, Start::Cold),
            ("exact tier, warm start", STREAM, Start::Warm),
            ("paper tier, cold start", Tier::Paper, Start::Cold),
            ("paper tier, warm start", Tier::Paper, Start::Warm),
            (tight.as_str(), head.truth_tier, Start::Cold),
        ]
        .into_iter()
        .enumerate()
        {
            let points = |precision| chosen(tier, start, precision).filter(is_shown).map(point).collect::<Vec<_>>();
            curves.push(curve(name, colour, CurveStyle::Joined, points(Precision::Double)));
            curves.push(curve("", colour, CurveStyle::DashedRings, points(Precision::Single)));
        }
        let all = || curves.iter().flat_map(|curve: &Curve| curve.points.clone());
        let x = Axis::logarithmic("time per solve / µs", all().map(|point| point[0]));
        let y = Axis::logarithmic(half.axis, all().map(|point| point[1]).chain(floor.map(|floor| floor * 1e6)));
        let mut notes = Vec::new();
        let mut note = |at, offset, anchor, text: &str, colour| {
            notes.push(Note { at, offset, anchor, text: text.to_owned(), colour });
        };
        // The clearest curve says what its points are, as far as they do not lie on the bound.
        let is_apart = |entry: &&Entry| floor.is_none_or(|floor| (half.rms)(errors(entry)) > 2.0 * floor);
        for entry in chosen(STREAM, Start::Cold, Precision::Double).take(2).filter(is_apart) {
            let text = effort_name(entry.run.method.effort);
            note(point(entry), dvec2(9.0, -5.0), Anchor::Start, &text, cell_colour(0));
        }
        let beyond = chosen(Tier::Paper, Start::Cold, Precision::Double).find(|entry| !is_shown(entry));
        if let Some(entry) = beyond {
            let [time, error] = point(entry);
            let text = format!("paper tier in full: {} µs →", Value::from(time).shown());
            note([x.range[1], error], dvec2(-8.0, 16.0), Anchor::End, &text, cell_colour(2));
        }
        if let Some(floor) = floor {
            let points = x.range.map(|x| [x, floor * 1e6]).to_vec();
            let text = "Cramér–Rao bound of one frame";
            note([x.range[0], floor * 1e6], dvec2(8.0, 16.0), Anchor::Start, text, SOFT_INK);
            curves.push(Curve { label: String::new(), colour: SOFT_INK, style: CurveStyle::Dashed, points });
        }
        (heading.to_owned(), Chart { x, y, curves, notes })
    };
    Sheet {
        title: format!("Pose from {} cells: error of the {} against time", head.scene.cells.len(), half.what),
        note: format!(
            "{}; {} poses, one frame each; one thread. Discs f64, rings f32; each curve: planes (from a cold start), 1, 2, 3, 4 \
             steps, full.",
            head.file.name,
            head.poses.len()
        ),
        panels: vec![
            panel("noisy currents", |entry| &entry.noisy, Some(bound)),
            panel("currents free of noise", |entry| &entry.clean, None),
        ],
    }
    .draw(half.name, half.caption)
}
