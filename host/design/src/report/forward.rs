//! The forward model: cost and accuracy of an evaluation.

use std::hint::black_box;

use glam::dvec2;
use slitpose_model::{CompiledScene, Pair, Pose, SceneError, Tier};

use super::Settings;
use super::head::{Candidate, Head, RunTime, race};
use super::section::{Picture, Section, Sheet, Table, Value};
use super::solver::tier_name;
use crate::DesignError;
use crate::plot::{Anchor, Axis, Chart, CurveStyle, Note, cell_colour, curve};

pub(super) const TITLE: &str = "Forward model: error against time";

const TOLERANCES: [f64; 7] = [1e-2, 1e-3, 1e-4, 1e-6, 1e-8, 1e-10, 1e-12];

/// The tier that stands for the truth.
const REFERENCE: Tier = Tier::Exact { tolerance: 1e-13 };

/// One way to evaluate, with its results. Errors are of electrode currents, relative to the total current of their cell.
struct Entry {
    tier: Tier,
    /// Median and worst, against the exact tier at its tightest.
    error: [f64; 2],
    currents: RunTime,
    derivatives: RunTime,
}

/// Currents of all cells at all poses, one pose after the other; and evaluations at the `timed` ones without and with
/// derivatives.
type Evaluated<'a> = (Vec<Pair<f64>>, [Candidate<'a>; 2]);

fn evaluate<'a>(head: &Head<'_>, tier: Tier, timed: &'a [Pose]) -> Result<Evaluated<'a>, SceneError> {
    let plan = CompiledScene::<f64>::compile(&head.scene, tier)?;
    let cells = plan.cell_count();
    let currents = head.poses.iter().flat_map(|pose| (0..cells).map(move |cell| (cell, pose)));
    let currents = currents.map(|(cell, pose)| plan.photocurrents(cell, pose)).collect();
    let other = plan.clone();
    let without = move || {
        for (pose, cell) in timed.iter().flat_map(|pose| (0..cells).map(move |cell| (pose, cell))) {
            black_box(other.photocurrents(cell, black_box(pose)));
        }
    };
    let with = move || {
        for (pose, cell) in timed.iter().flat_map(|pose| (0..cells).map(move |cell| (pose, cell))) {
            black_box(plan.linearise(cell, black_box(pose)));
        }
    };
    Ok((currents, [Box::new(without), Box::new(with)]))
}

pub(super) fn section(head: &Head<'_>, settings: &Settings) -> Result<Section, DesignError> {
    let entries = measure(head, settings)?;
    let paper = entries.iter().find(|entry| entry.tier == Tier::Paper);
    let difference = paper.map_or(f64::NAN, |entry| entry.error[1]);
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
                 the total current of its cell, against the exact tier at a tolerance of 1e-13; the time is \
                 that of all cells together, with the pose's conversion, with and without the analytic derivatives \
                 by the pose.",
                head.scene.cells.len(),
                head.poses.len()
            ),
            format!(
                "The paper tier computes what equations (1) to (6) say; its error here is the difference between \
                 the two models, up to {} of a cell's current, and no arithmetic removes it.",
                Value::from(difference).shown()
            ),
        ],
        pictures: vec![picture(&entries, head)],
        tables: vec![table(&entries)],
    })
}

fn measure(head: &Head<'_>, settings: &Settings) -> Result<Vec<Entry>, DesignError> {
    let timed = &head.poses[..settings.timed_poses()];
    let (reference, _) = evaluate(head, REFERENCE, timed)?;
    let (mut errors, mut candidates) = (Vec::new(), Vec::new());
    for tier in [Tier::Paper].into_iter().chain(TOLERANCES.map(|tolerance| Tier::Exact { tolerance })) {
        let (currents, works) = evaluate(head, tier, timed)?;
        candidates.extend(works);
        errors.push((tier, spread(&currents, &reference)));
    }
    let run_times = race(&mut candidates, settings.rounds(), timed.len());
    let entry = |((tier, error), run_times): (_, &[RunTime])| Entry {
        tier,
        error,
        currents: run_times[0],
        derivatives: run_times[1],
    };
    Ok(errors.into_iter().zip(run_times.chunks_exact(2)).map(entry).collect())
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
    let base_s = entries.first().map_or(f64::NAN, |entry| entry.derivatives.least_s);
    let us = |seconds: f64| Value::from(seconds * 1e6);
    Table::of(
        "forward",
        "Errors of currents and times per evaluation of all cells",
        entries,
        &[
            ("tier", "tier", &|entry| tier_name(entry.tier).into()),
            ("error_median", "error, median", &|entry| entry.error[0].into()),
            ("error_worst", "error, worst", &|entry| entry.error[1].into()),
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
        let of = |is_paper| {
            let chosen = entries.iter().filter(move |entry| (entry.tier == Tier::Paper) == is_paper);
            chosen.map(|entry| [1e6 * time(entry), entry.error[0]]).collect::<Vec<_>>()
        };
        let exact = "exact tier, at the tolerance written beside it";
        let paper = "paper tier: the difference between the models";
        let curves =
            vec![curve(exact, 0, CurveStyle::Joined, of(false)), curve(paper, 1, CurveStyle::Markers, of(true))];
        let note = |entry: &Entry| match entry.tier {
            Tier::Exact { tolerance } => Some(Note {
                at: [1e6 * time(entry), entry.error[0]],
                offset: dvec2(8.0, -6.0),
                anchor: Anchor::Start,
                text: format!("{tolerance:e}").replace('-', "−"),
                colour: cell_colour(0),
            }),
            Tier::Paper => None,
        };
        let x = |x| Axis::logarithmic("time for all cells / µs", x);
        let mut chart = Chart::over(curves, x, |y| Axis::logarithmic("median error of a current", y));
        // Room for the last note.
        chart.x.range[1] *= 1.1;
        chart.notes = entries.iter().filter_map(note).collect();
        (heading.to_owned(), chart)
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
