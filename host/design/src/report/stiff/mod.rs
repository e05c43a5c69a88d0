//! Stiff and extreme cases, which are numerically difficult, and their results.
//!
//! `cell` drives one cell's optics to extremes and compares with `reference`, an integration of its
//! own; `pose` drives solves there and compares with what rounding allows; `time` has
//! front ends and jumps. A `case` is judged by the ratio of its error to what is attainable.

mod case;
mod cell;
mod pose;
mod reference;
mod time;

use std::collections::BTreeMap;

use super::head::Head;
use super::method::Precision;
use super::section::{Picture, Section, Value};
use super::sheet::Sheet;
use super::{ReportError, Settings};
use crate::plot::curve;
use crate::plot::{Axis, Chart, CurveStyle};
use case::Case;

pub(super) const TITLE: &str = "Stiff and extreme cases";

pub(super) fn section(head: &Head<'_>, settings: &Settings) -> Result<Section, ReportError> {
    let mut cases = cell::cases(&head.scene)?;
    cases.extend(pose::layouts(head, settings)?);
    cases.extend(pose::masks(head, settings)?);
    cases.extend(pose::rotations(head, settings)?);
    cases.extend(pose::scales(head, settings)?);
    cases.extend(time::front_ends(head));
    cases.extend(time::jumps(head, settings)?);
    let summary = summary(&cases);
    let of_slits = if head.is_of_slits() {
        ""
    } else {
        " Those of one cell are of a slit on the base with the dimensions of the first cell."
    };
    Ok(Section {
        name: "stiff",
        title: TITLE,
        summary: vec![format!("Extreme cases: {}{}", summary[..1].to_lowercase(), &summary[1..])],
        paragraphs: vec![
            format!(
                "Each case is driven towards the point where it must fail, in f64 and in f32. The condition number of \
                 a case says by how much it magnifies a relative error of what goes in; what is attainable is what \
                 remains when every number that goes in is rounded once: the condition number times the number type's \
                 rounding. Currents of one cell are compared with an integration that shares nothing with the \
                 model; poses, {} near home in each case, with the truth.{of_slits}",
                pose::POSES
            ),
            summary,
        ],
        pictures: vec![layouts_picture(&cases), cells_picture(&cases)],
        tables: vec![case::table(&cases)],
    })
}

/// How many cases fall short, by study and number type.
fn summary(cases: &[Case]) -> String {
    let mut short: BTreeMap<(&str, &str), usize> = BTreeMap::new();
    for case in cases {
        for precision in case.short() {
            *short.entry((case.study, precision)).or_default() += 1;
        }
    }
    let slow = match cases.iter().filter_map(Case::slow_s).reduce(f64::max) {
        Some(slow_s) => {
            let count = cases.iter().filter(|case| case.slow_s().is_some()).count();
            let cases = if count == 1 { "case is" } else { "cases are" };
            format!(" {count} {cases} slow: up to {} ms a solve.", Value::from(slow_s * 1e3).shown())
        }
        None => String::new(),
    };
    if short.is_empty() {
        return format!("All {} cases came out as they must.{slow}", cases.len());
    }
    let of = |study: &str| cases.iter().filter(|case| case.study == study).count();
    let names: Vec<String> = short
        .into_iter()
        .map(|((study, precision), count)| format!("{study} in {precision} ({count} of {})", of(study)))
        .collect();
    format!("Of {} cases these fall short, and are marked in the table: {}.{slow}", cases.len(), names.join(", "))
}

/// Error and what is attainable against the condition number, of the chosen cases.
fn against_condition(cases: &[&Case], x: &str, y: &str) -> Chart {
    let points = |precision: Precision, value: fn(&case::Reached) -> Option<f64>| -> Vec<[f64; 2]> {
        let point = |case: &Case| Some([case.condition?, value(case.reached_in(precision)?)?]);
        let mut points: Vec<_> = cases.iter().copied().filter_map(point).collect();
        points.sort_by(|a, b| a[0].total_cmp(&b[0]));
        points
    };
    let curves = vec![
        curve("attainable in f64", 0, CurveStyle::Dashed, points(Precision::Double, |reached| reached.attainable)),
        curve("f64", 0, CurveStyle::Markers, points(Precision::Double, |reached| reached.error)),
        curve("attainable in f32", 1, CurveStyle::Dashed, points(Precision::Single, |reached| reached.attainable)),
        curve("f32", 1, CurveStyle::Rings, points(Precision::Single, |reached| reached.error)),
    ];
    let all: Vec<[f64; 2]> = curves.iter().flat_map(|curve| curve.points.clone()).collect();
    let axis = |label: &str, index: usize| Axis::logarithmic(label, all.iter().map(|point| point[index]));
    Chart { x: axis(x, 0), y: axis(y, 1), curves, notes: Vec::new() }
}

fn layouts_picture(cases: &[Case]) -> Picture {
    let panel = |start: &'static str| {
        let chosen = cases.iter().filter(|case| case.study == pose::LAYOUTS && case.case.ends_with(start));
        let chart = against_condition(
            &chosen.collect::<Vec<_>>(),
            "condition number",
            "error of the pose at the emitters / µm",
        );
        (format!("{start} start"), chart)
    };
    Sheet {
        title: "Poses from layouts that hardly tell them".to_owned(),
        note: "Rolls of the detectors from ±45° down to ±1e−8°, no noise. No point: no pose was given.".to_owned(),
        panels: vec![panel("cold"), panel("warm")],
    }
    .draw("stiff-layouts", "Error of the pose against the condition number, with what each number type can attain.")
}

fn cells_picture(cases: &[Case]) -> Picture {
    let panel = |study: &'static str| {
        let chosen: Vec<_> = cases.iter().filter(|case| case.study == study).collect();
        let chart = against_condition(&chosen, "condition number of the current", "relative error of a current");
        (study.to_owned(), chart)
    };
    Sheet {
        title: "Currents of one cell in extreme places".to_owned(),
        note: "Near field: emitter a millimetre to a nanometre above the slit's plane. Horizon: γ = 90° crosses the spot, ever \
               nearer to its end.".to_owned(),
        panels: vec![panel("near field"), panel("horizon")],
    }
    .draw("stiff-cells", "Error of a cell's current against the condition of the problem.")
}
