//! What tolerances cost, by kind of part, and of drawn heads.

use glam::dvec2;
use slitpose_calibration::{PartCosts, PoseRms};

use super::micro;
use crate::map::{KNOWN, Tolerances};
use crate::plot::{Anchor, Axis, Canvas, Chart, CurveStyle, Scale, Stroke, TextStyle, cell_colour};
use crate::report::accuracy::median;
use crate::report::section::{Picture, Section, Table, Value, column};
use crate::report::sheet::curve;

pub(super) fn section(studied: &Tolerances, are_stated: bool) -> Section {
    let Tolerances { costs, heads, .. } = studied;
    let row = |what: &str, key: &str, [before, after]: [PoseRms; 2]| {
        vec![
            what.into(),
            key.into(),
            micro(before[0]),
            Value::from(before[1] * 1e3),
            micro(after[0]),
            Value::from(after[1] * 1e3),
        ]
    };
    let mut rows: Vec<_> = costs.parts.iter().map(|part| row(part.part, part.key, [part.before, part.after])).collect();
    rows.push(row("all together", "", [costs.before, costs.after]));
    let of_head = |(number, errors): (usize, &[PoseRms; 2])| {
        let mut row = row("", "", *errors).split_off(2);
        row.insert(0, number.into());
        row
    };
    let mut summary = Vec::new();
    if !heads.is_empty() {
        let [before, after] = [0, 1].map(|k| median(heads.iter().map(|head| head[k][0]).collect()));
        summary.push(format!(
            "Heads of parts within their tolerances err by {:.0} µm uncalibrated, by {:.2} µm calibrated at {} known poses \
             (rms, median of {}).",
            before * 1e6,
            after * 1e6,
            KNOWN.count,
            if heads.len() == 1 { "one head".to_owned() } else { format!("{} heads", heads.len()) }
        ));
    }
    if let [first, ..] = costs.parts.as_slice() {
        let dearest = costs.parts.iter().max_by(|a, b| a.after[0].total_cmp(&b.after[0])).unwrap_or(first);
        summary.push(format!("The dearest tolerance: {} before calibration, {} after it.", first.part, dearest.part));
    }
    let whose = if are_stated { "of `[tolerance]`" } else { "of usual parts: the scene has no `[tolerance]`" };
    Section {
        name: "tolerances",
        title: "What tolerances cost",
        summary,
        paragraphs: vec![format!(
            "Tolerances are those {whose}. What each kind of part costs is calculated to first order: before calibration, its \
             share of the errors; after it, by how much the head would err less if that part were known. Calibrated at {} \
             poses by an instrument of {:.0} µm and {:.0} µrad, {:.0} frames at each. Heads are drawn (seed {}), calibrated, and \
             solved without noise. Errors are root mean squares over the workspace, three axes together.",
            KNOWN.count,
            KNOWN.instrument[0] * 1e6,
            KNOWN.instrument[1] * 1e6,
            KNOWN.frames,
            studied.seed
        )],
        pictures: vec![Picture {
            name: "tolerances",
            caption: "What each kind of part costs, before calibration and after it.".to_owned(),
            svg: cost_picture(costs),
        }],
        tables: vec![
            Table {
                name: "tolerances",
                caption: "By kind of part, the dearest first".to_owned(),
                columns: vec![
                    column("part", "part"),
                    column("key", "key in [tolerance]"),
                    column("before_um", "before / µm"),
                    column("before_mrad", "mrad"),
                    column("after_um", "after / µm"),
                    column("after_mrad", "mrad"),
                ],
                rows,
            },
            Table {
                name: "heads",
                caption: "Drawn heads".to_owned(),
                columns: vec![
                    column("head", "head"),
                    column("before_um", "before / µm"),
                    column("before_mrad", "mrad"),
                    column("after_um", "after / µm"),
                    column("after_mrad", "mrad"),
                ],
                rows: heads.iter().enumerate().map(of_head).collect(),
            },
        ],
    }
}

/// Errors by kind of part, as discs on a logarithmic axis.
fn cost_picture(costs: &PartCosts) -> String {
    const LABELS: f64 = 230.0;
    const WIDTH: f64 = 560.0;
    const ROW: f64 = 24.0;
    const TOP: f64 = 112.0;
    let rows: Vec<(&str, [PoseRms; 2])> = (costs.parts.iter().map(|part| (part.part, [part.before, part.after])))
        .chain([("all together", [costs.before, costs.after])])
        .collect();
    let bottom = TOP + ROW * rows.len() as f64;
    let title = "What tolerances cost in position";
    let mut canvas = Canvas::new(LABELS + WIDTH + 30.0, bottom + 56.0, title);
    canvas.text(dvec2(20.0, 30.0), title, TextStyle::new(16.0).bold());
    canvas.text(dvec2(20.0, 50.0), "Errors of poses, root mean square over the workspace.", TextStyle::new(12.0));
    let all =
        rows.iter().flat_map(|(_, errors)| errors.iter().map(|error| error[0] * 1e6)).filter(|value| *value > 0.0);
    let x = Axis::logarithmic("error of the position / µm", all);
    let curves = ["before calibration", "after it"].into_iter().enumerate();
    let y = Axis { label: String::new(), range: [0.0, 1.0], scale: Scale::Bare };
    let curves = curves.map(|(index, label)| curve(label, index, CurveStyle::Markers, Vec::new())).collect();
    let chart = Chart { x, y, curves, notes: Vec::new() };
    chart.draw(&mut canvas, dvec2(LABELS, TOP), dvec2(LABELS + WIDTH, bottom));
    for (index, (part, errors)) in rows.into_iter().enumerate() {
        let y = TOP + ROW * (index as f64 + 0.5);
        canvas.text(dvec2(LABELS - 10.0, y + 4.5), part, TextStyle::new(13.0).anchored(Anchor::End));
        for (kind, error) in errors.into_iter().enumerate().filter(|(_, error)| error[0] > 0.0) {
            let colour = cell_colour(kind);
            let at = dvec2(LABELS + WIDTH * chart.x.share(error[0] * 1e6), y);
            canvas.disc(at, 4.5, colour, Stroke::new(colour, 0.5));
        }
    }
    canvas.into_svg()
}
