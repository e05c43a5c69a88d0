//! Pages on several heads beside each other: given ones, and the best within several radii.

use slitpose_head::scene_file::SceneFile;

use super::map::{KINDS, Kind, distribution};
use super::section::{Report, Section, Sheet, Table, Value, column, program, scene};
use crate::map::{Map, NoiseOf, View};
use crate::optimise::{Demand, Found, Search};
use crate::plot::{Axis, Chart, CurveStyle, curve};
use crate::survey::WorkspaceFacts;

/// Compares the heads of `maps`, each over its own workspace and with its own noise.
pub fn comparison(maps: &[(SceneFile, Map)]) -> Report {
    let noise = |map: &Map| match map.noise {
        NoiseOf::FrontEnd => "front end",
        NoiseOf::Channel => "channel",
        NoiseOf::Nothing => "none",
    };
    let [position, rotation] = KINDS;
    let of = |map: &Map, kind: &Kind, share: f64| Value::from(map.quantile(share, kind.of) * kind.scale);
    let by_rate = |map: &Map, kind: &Kind| {
        Value::optional(map.per_root_hz().map(|by| map.quantile(0.5, kind.of) * kind.scale * by))
    };
    let share = |map: &Map, holds: &dyn Fn(&View) -> bool| Value::from(100.0 * map.share(holds));
    let table = Table::of(
        "heads",
        "Single frames over the workspace",
        maps,
        &[
            ("scene", "scene", &|(file, _)| file.origin.as_str().into()),
            ("cells", "cells", &|(_, map)| map.cells().into()),
            ("noise", "noise", &|(_, map)| noise(map).into()),
            ("frame_rate_hz", "frames/s", &|(_, map)| Value::optional(map.frame_rate_hz)),
            ("position_median_um", "σ / µm", &|(_, map)| of(map, &position, 0.5)),
            ("position_99_percent_um", "99 %", &|(_, map)| of(map, &position, 0.99)),
            ("position_worst_um", "worst", &|(_, map)| of(map, &position, 1.0)),
            ("position_um_per_root_hz", "µm/√Hz", &|(_, map)| by_rate(map, &position)),
            ("rotation_median_mrad", "σ / mrad", &|(_, map)| of(map, &rotation, 0.5)),
            ("rotation_99_percent_mrad", "99 %", &|(_, map)| of(map, &rotation, 0.99)),
            ("rotation_worst_mrad", "worst", &|(_, map)| of(map, &rotation, 1.0)),
            ("rotation_mrad_per_root_hz", "mrad/√Hz", &|(_, map)| by_rate(map, &rotation)),
            ("all_lit_percent", "all lit / %", &|(_, map)| share(map, &|view| view.lit == map.cells())),
            ("with_pose_percent", "with pose / %", &|(_, map)| share(map, &|view| view.sigma.is_some())),
            ("condition_median", "condition", &|(_, map)| map.quantile(0.5, |view| view.condition).into()),
            ("unnoticed_median_sigmas", "unnoticed / σ", &|(_, map)| {
                map.quantile(0.5, |view| Some(view.unnoticed_sigmas)).into()
            }),
            ("one_dark_um", "one dark / µm", &|(_, map)| {
                Value::optional(map.worst_dark(View::sigma_m).map(|(_, worst)| worst * 1e6))
            }),
        ],
    );
    let names: Vec<(&str, &Map)> = maps.iter().map(|(file, map)| (file.origin.as_str(), map)).collect();
    let workspace = |file: &SceneFile| format!("{}: {}", file.origin, WorkspaceFacts::from(file.workspace));
    let best = |kind: &Kind, is_by_rate: bool| {
        let Kind { name, unit, scale, of, .. } = kind;
        let medians = maps.iter().filter_map(|(file, map)| {
            Some((file, map.quantile(0.5, of) * if is_by_rate { map.per_root_hz()? } else { 1.0 }))
        });
        let (file, median) = medians.filter(|(_, median)| median.is_finite()).min_by(|a, b| a.1.total_cmp(&b.1))?;
        let per = if is_by_rate { "/√Hz" } else { "" };
        Some(format!("Best in {name} by the median: {}, {:.3} {unit}{per}.", file.origin, median * scale))
    };
    // Of a head with more frames a second, each counts for less.
    let is_of_one_rate = maps.windows(2).all(|pair| pair[0].1.frame_rate_hz == pair[1].1.frame_rate_hz);
    let ways = if is_of_one_rate { &[false][..] } else { &[false, true] };
    let bests = ways.iter().flat_map(|by_rate| KINDS.iter().filter_map(|kind| best(kind, *by_rate)));
    Report {
        title: "Heads compared",
        scene: maps.iter().map(|(file, _)| file.origin.as_str()).collect::<Vec<_>>().join(", "),
        conditions: vec![
            program(),
            ("workspaces", maps.iter().map(|(file, _)| workspace(file)).collect::<Vec<_>>().join("; ")),
            ("noise", if maps.iter().all(|(_, map)| map.noise == NoiseOf::FrontEnd) {
                "of a single frame by the front end".to_owned()
            } else {
                "of the measuring channel of `[noise]`".to_owned()
            }),
            ("data", "computed: the Cramér–Rao bound; nothing was measured".to_owned()),
        ],
        sections: vec![Section {
            name: "heads",
            title: "Accuracy",
            summary: bests.collect(),
            paragraphs: vec![
                "Each head over its own workspace. σ is that of a single frame, three axes together; unnoticed is what a fault of \
                 one cell can do to the pose, see `slitpose scene map`."
                    .to_owned(),
            ],
            pictures: vec![distribution(&names)],
            tables: vec![table],
        }],
        ..Report::default()
    }
}

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
    let mut curves = vec![curve("all limits kept", 0, CurveStyle::Joined, points(&kept))];
    if found.iter().any(|(_, found)| !kept(found)) {
        curves.push(curve("not all limits kept", 1, CurveStyle::Rings, points(&|found| !kept(found))));
    }
    let x = |x| Axis::around("largest radius of the head / mm", x);
    let chart = Chart::over(curves, x, |y| Axis::around("σ / µm", y).starting_at_zero());
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
        ..Report::default()
    }
}

/// The file of the scene that was found within `radius_m`.
pub fn scene_name(radius_m: f64) -> String {
    format!("radius_{}.toml", format!("{:.1}", radius_m * 1e3).replace('.', "_"))
}
