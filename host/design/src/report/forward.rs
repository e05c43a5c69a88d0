//! The forward model: cost and accuracy of an evaluation.

use std::hint::black_box;

use glam::dvec2;
use slitpose_model::{CompiledScene, Pair, Pose, Scalar, Scene, SceneError, Tier};

use super::head::{Candidate, Head, RunTime, race};
use super::method::{Precision, tier_name};
use super::section::{Picture, Section, Table, Value};
use super::sheet::Sheet;
use super::{ReportError, Settings};
use crate::plot::curve;
use crate::plot::{Anchor, Axis, Chart, CurveStyle, Note, cell_colour};

pub(super) const TITLE: &str = "Forward model: error against time";

/// Tolerances of the exact tier.
const TOLERANCES: [f64; 7] = [1e-2, 1e-3, 1e-4, 1e-6, 1e-8, 1e-10, 1e-12];

/// The tier that stands for the truth.
const REFERENCE: Tier = Tier::Exact { tolerance: 1e-13 };

/// Errors of electrode currents relative to the total current of their cell.
struct Spread {
    median: f64,
    worst: f64,
}

/// One way to evaluate, with its results.
struct Entry {
    tier: Tier,
    precision: Precision,
    /// Against the exact tier at its tightest, in `f64`.
    error: Spread,
    /// Against the same tier in `f64`: the error of the number type.
    rounding: Option<Spread>,
    currents: RunTime,
    derivatives: RunTime,
}

type Currents = Box<dyn Fn(usize, &Pose) -> Pair<f64>>;

/// Evaluates all cells at all poses, for the stopwatch.
type Work = Box<dyn FnMut(&[Pose])>;

/// The plan of one entry, its number type forgotten.
struct Compiled {
    currents: Currents,
    time_currents: Work,
    time_derivatives: Work,
}

fn compile<S: Scalar>(scene: &Scene, tier: Tier) -> Result<Compiled, SceneError> {
    let plan = CompiledScene::<S>::compile(scene, tier)?;
    let (first, second) = (plan.clone(), plan.clone());
    Ok(Compiled {
        currents: Box::new(move |cell, pose| {
            let pair = plan.photocurrents(cell, pose);
            Pair { i_x1_a: pair.i_x1_a.as_f64(), i_x2_a: pair.i_x2_a.as_f64() }
        }),
        time_currents: Box::new(move |poses| {
            for pose in poses {
                for cell in 0..first.cell_count() {
                    black_box(first.photocurrents(cell, black_box(pose)));
                }
            }
        }),
        time_derivatives: Box::new(move |poses| {
            for pose in poses {
                for cell in 0..second.cell_count() {
                    black_box(second.linearise(cell, black_box(pose)));
                }
            }
        }),
    })
}

fn compile_in(precision: Precision, scene: &Scene, tier: Tier) -> Result<Compiled, SceneError> {
    match precision {
        Precision::Double => compile::<f64>(scene, tier),
        Precision::Single => compile::<f32>(scene, tier),
    }
}

pub(super) fn section(head: &Head<'_>, settings: &Settings) -> Result<Section, ReportError> {
    let entries = measure(head, settings)?;
    let paper = entries.iter().find(|entry| entry.tier == Tier::Paper);
    let difference = paper.map_or(f64::NAN, |entry| entry.error.worst);
    Ok(Section {
        name: "forward",
        title: TITLE,
        summary: vec![format!(
            "The equations of the source paper (paper tier) differ from the integrals over the spot (exact tier) by \
             up to {} % of a cell's current.",
            Value::from(100.0 * difference).shown()
        )],
        paragraphs: vec![
            format!(
                "All {} cells at {} poses of the workspace. The error is that of an electrode's current relative to \
                 the total current of its cell, against the exact tier at a tolerance of 1e-13 in f64; the time is \
                 that of all cells together, with the pose's conversion, with and without the analytic derivatives \
                 by the pose.",
                head.scene.cells.len(),
                head.poses.len()
            ),
            format!(
                "The paper tier computes what equations (1) to (6) say; its error here is the difference between \
                 the two models, up to {} of a cell's current, and no arithmetic removes it. What f32 adds is in a \
                 column of its own.",
                Value::from(difference).shown()
            ),
        ],
        pictures: vec![picture(&entries, head)],
        tables: vec![table(&entries)],
    })
}

fn measure(head: &Head<'_>, settings: &Settings) -> Result<Vec<Entry>, ReportError> {
    let tiers = || std::iter::once(Tier::Paper).chain(TOLERANCES.map(|tolerance| Tier::Exact { tolerance }));
    let variants: Vec<(Tier, Precision)> =
        Precision::BOTH.into_iter().flat_map(|precision| tiers().map(move |tier| (tier, precision))).collect();
    let reference = compile::<f64>(&head.scene, REFERENCE)?;
    let mut compiled = Vec::new();
    let mut errors = Vec::new();
    for &(tier, precision) in &variants {
        let this = compile_in(precision, &head.scene, tier)?;
        let rounding = match precision {
            Precision::Double => None,
            Precision::Single => Some(spread(head, &this.currents, &compile::<f64>(&head.scene, tier)?.currents)),
        };
        errors.push((spread(head, &this.currents, &reference.currents), rounding));
        compiled.push(this);
    }
    let timed = &head.poses[..settings.timed_poses()];
    let mut candidates: Vec<Candidate<'_>> = compiled
        .iter_mut()
        .flat_map(|Compiled { time_currents, time_derivatives, .. }| {
            [Box::new(move || time_currents(timed)) as Candidate<'_>, Box::new(move || time_derivatives(timed))]
        })
        .collect();
    let run_times = race(&mut candidates, settings.rounds(), timed.len());
    let entries = variants.into_iter().zip(errors).zip(run_times.chunks_exact(2));
    Ok(entries
        .map(|(((tier, precision), (error, rounding)), run_times)| Entry {
            tier,
            precision,
            error,
            rounding,
            currents: run_times[0],
            derivatives: run_times[1],
        })
        .collect())
}

fn spread(head: &Head<'_>, currents: &Currents, reference: &Currents) -> Spread {
    let mut errors = Vec::new();
    for pose in &head.poses {
        for cell in 0..head.scene.cells.len() {
            let (found, truth) = (currents(cell, pose), reference(cell, pose));
            let total = truth.total_a().abs();
            errors.extend([(found.i_x1_a - truth.i_x1_a).abs() / total, (found.i_x2_a - truth.i_x2_a).abs() / total]);
        }
    }
    errors.sort_by(f64::total_cmp);
    Spread { median: errors[errors.len() / 2], worst: errors[errors.len() - 1] }
}

fn table(entries: &[Entry]) -> Table {
    let base_s = entries.first().map_or(f64::NAN, |entry| entry.derivatives.least_s);
    let us = |seconds: f64| Value::from(seconds * 1e6);
    Table::of(
        "forward",
        "Errors of currents and times per evaluation of all cells",
        entries,
        &[
            ("tier", "tier", &|entry| tier_name(entry.tier).into()),
            ("number", "numbers", &|entry| entry.precision.name().into()),
            ("error_median", "error, median", &|entry| entry.error.median.into()),
            ("error_worst", "error, worst", &|entry| entry.error.worst.into()),
            ("rounding_worst", "of which f32, worst", &|entry| {
                Value::optional(entry.rounding.as_ref().map(|rounding| rounding.worst))
            }),
            ("currents_least_us", "currents, least / µs", &|entry| us(entry.currents.least_s)),
            ("currents_median_us", "median / µs", &|entry| us(entry.currents.median_s)),
            ("derivatives_least_us", "with derivatives, least / µs", &|entry| us(entry.derivatives.least_s)),
            ("derivatives_median_us", "median / µs", &|entry| us(entry.derivatives.median_s)),
            ("ratio", "ratio to the first", &|entry| (entry.derivatives.least_s / base_s).into()),
        ],
    )
}

fn picture(entries: &[Entry], head: &Head<'_>) -> Picture {
    let panel = |heading: &str, time: fn(&Entry) -> f64| {
        let of = |precision, is_paper| {
            let chosen =
                entries.iter().filter(move |e| e.precision == precision && (e.tier == Tier::Paper) == is_paper);
            chosen.map(|entry| [1e6 * time(entry), entry.error.median]).collect::<Vec<_>>()
        };
        let curves = vec![
            curve(
                "exact tier, f64, at the tolerance written beside it",
                0,
                CurveStyle::Joined,
                of(Precision::Double, false),
            ),
            curve("exact tier, f32", 1, CurveStyle::DashedRings, of(Precision::Single, false)),
            curve(
                "paper tier, f64: the difference between the models",
                2,
                CurveStyle::Markers,
                of(Precision::Double, true),
            ),
            curve("paper tier, f32", 3, CurveStyle::Rings, of(Precision::Single, true)),
        ];
        let note = |entry: &Entry| match entry.tier {
            Tier::Exact { tolerance } if entry.precision == Precision::Double => Some(Note {
                at: [1e6 * time(entry), entry.error.median],
                offset: dvec2(8.0, -6.0),
                anchor: Anchor::Start,
                text: format!("{tolerance:e}").replace('-', "−"),
                colour: cell_colour(0),
            }),
            _ => None,
        };
        let points = || curves.iter().flat_map(|curve| &curve.points);
        let mut x = Axis::logarithmic("time for all cells / µs", points().map(|point| point[0]));
        // Room for the last note.
        x.range[1] *= 1.1;
        let y = Axis::logarithmic("median error of a current", points().map(|point| point[1]));
        let notes = entries.iter().filter_map(note).collect();
        (heading.to_owned(), Chart { x, y, curves, notes })
    };
    let note =
        format!("{} cells; {}; {} poses of the workspace", head.scene.cells.len(), head.file.name, head.poses.len());
    Sheet {
        title: TITLE.to_owned(),
        note,
        panels: vec![
            panel("currents", |entry| entry.currents.least_s),
            panel("currents and derivatives", |entry| entry.derivatives.least_s),
        ],
    }
    .draw("forward", "Error of the forward model against its time; lower and further left is better.")
}
