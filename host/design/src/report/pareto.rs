//! A page on what size buys: the best heads within several radii.

use super::conditions::{program, scene};
use super::section::{Report, Section, Table, Value, column};
use super::sheet::{Sheet, curve};
use crate::optimise::{Demand, Found, Search};
use crate::plot::{Axis, Chart, CurveStyle};

/// The best heads that `search` found within radii, metres, in ascending order.
pub fn pareto(search: &Search, found: &[(f64, Found)]) -> Report {
    let which = match search.goal.demand {
        Demand::Median => "in the median of the workspace",
        Demand::Worst => "at worst in the workspace",
    };
    let point = format!("{} mm from the tool's centre", search.goal.lever_m * 1e3);
    let kept = |found: &Found| found.after.excesses.is_empty();
    let points = |of: &dyn Fn(&Found) -> bool| -> Vec<[f64; 2]> {
        let wanted = found.iter().filter(|(_, found)| of(found));
        wanted.map(|(radius_m, found)| [radius_m * 1e3, found.after.sigma_m * 1e6]).collect()
    };
    let all = || points(&|_| true).into_iter();
    let mut curves = vec![curve("all limits kept", 0, CurveStyle::Joined, points(&kept))];
    if found.iter().any(|(_, found)| !kept(found)) {
        curves.push(curve("not all limits kept", 1, CurveStyle::Rings, points(&|found| !kept(found))));
    }
    let chart = Chart {
        x: Axis::around("largest radius of the head / mm", all().map(|point| point[0])),
        y: Axis::around("σ / µm", all().map(|point| point[1])).starting_at_zero(),
        curves,
        notes: Vec::new(),
    };
    let mut columns = vec![column("radius_mm", "radius / mm"), column("sigma_um", "σ / µm"), column("kept", "limits")];
    let names: Vec<_> = found.first().map(|(_, found)| found.values.clone()).unwrap_or_default();
    columns.extend(names.iter().map(|(quantity, _)| column(quantity.name(), quantity.name())));
    columns.push(column("scene", "scene"));
    let row = |(radius_m, found): &(f64, Found)| {
        let excesses = found.after.excesses.iter().map(ToString::to_string).collect::<Vec<_>>().join("; ");
        let limits = if kept(found) { Value::from("kept") } else { Value::Alert(excesses) };
        let mut row = vec![(radius_m * 1e3).into(), (found.after.sigma_m * 1e6).into(), limits];
        row.extend(found.values.iter().map(|(_, [_, value])| Value::from(*value)));
        row.push(scene_name(*radius_m).into());
        row
    };
    let mut best = found.iter().filter(|(_, found)| kept(found));
    let summary = match (best.clone().next(), best.next_back()) {
        (Some((least_m, first)), Some((most_m, last))) => vec![format!(
            "Within {:.1} mm the best head has a σ of {:.2} µm, within {:.1} mm one of {:.2} µm.",
            least_m * 1e3,
            first.after.sigma_m * 1e6,
            most_m * 1e3,
            last.after.sigma_m * 1e6
        )],
        _ => vec!["No head keeps all limits within these radii.".to_owned()],
    };
    Report {
        title: "Accuracy against size",
        scene: search.file.name.clone(),
        conditions: vec![
            program(),
            scene(&search.file),
            (
                "free",
                (search.free.iter())
                    .map(|free| {
                        format!("{} {} to {} {}", free.quantity, free.bounds[0], free.bounds[1], free.quantity.unit())
                    })
                    .collect::<Vec<_>>()
                    .join(", "),
            ),
            ("wanted", format!("least σ of a point {point}, single frames, {which}")),
            ("seed", search.seed.to_string()),
            ("data", "computed: the Cramér–Rao bound; nothing was measured".to_owned()),
        ],
        warnings: Vec::new(),
        sections: vec![Section {
            name: "size",
            title: "What size buys",
            summary,
            paragraphs: vec![
                "Each point is the best head that a search found whose detectors end within that radius. Its scene is in a file \
                 of this folder."
                    .to_owned(),
            ],
            pictures: vec![
                Sheet {
                    title: "Accuracy against size".to_owned(),
                    note: format!("σ of a point {point}, single frames, {which}."),
                    panels: vec![(String::new(), chart)],
                }
                .draw("pareto", "The best head within each radius."),
            ],
            tables: vec![Table {
                name: "pareto",
                caption: "The best head within each radius".to_owned(),
                columns,
                rows: found.iter().map(row).collect(),
            }],
        }],
        leading: 0,
        data: Vec::new(),
    }
}

/// The file of the scene that was found within `radius_m`.
pub fn scene_name(radius_m: f64) -> String {
    format!("radius_{}.toml", format!("{:.1}", radius_m * 1e3).replace('.', "_"))
}
