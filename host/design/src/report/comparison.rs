//! A page on several heads beside each other.

use slitpose_head::scene_file::SceneFile;

use super::conditions::program;
use super::map::{KINDS, Kind, distribution};
use super::section::{Report, Section, Table, Value, column};
use crate::map::{Map, NoiseOf, View};
use crate::survey::WorkspaceFacts;

/// Compares the heads of `maps`, each over its own workspace and with its own noise.
pub fn comparison(maps: &[(SceneFile, Map)]) -> Report {
    let row = |(file, map): &(SceneFile, Map)| {
        let noise = match map.noise {
            NoiseOf::FrontEnd => "front end",
            NoiseOf::Channel => "channel",
            NoiseOf::Nothing => "none",
        };
        let finite = |value: f64| Value::optional(Some(value));
        let mut row =
            vec![file.origin.as_str().into(), map.cells().into(), noise.into(), Value::optional(map.frame_rate_hz)];
        for Kind { scale, of, .. } in KINDS {
            let found = map.quantiles([0.5, 0.99, 1.0], of).map(|value| value * scale);
            row.extend(found.map(Value::from));
            row.push(Value::optional(map.per_root_hz().map(|by| found[0] * by)));
        }
        row.extend([
            (100.0 * map.share(|view| view.lit == map.cells())).into(),
            (100.0 * map.share(|view| view.sigma.is_some())).into(),
            finite(map.quantile(0.5, |view| view.condition)),
            finite(map.quantile(0.5, |view| Some(view.unnoticed_sigmas))),
            finite(map.worst_dark(View::sigma_m).map_or(f64::INFINITY, |(_, worst)| worst * 1e6)),
        ]);
        row
    };
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
        warnings: Vec::new(),
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
            tables: vec![Table {
                name: "heads",
                caption: "Single frames over the workspace".to_owned(),
                columns: vec![
                    column("scene", "scene"),
                    column("cells", "cells"),
                    column("noise", "noise"),
                    column("frame_rate_hz", "frames/s"),
                    column("position_median_um", "σ / µm"),
                    column("position_99_percent_um", "99 %"),
                    column("position_worst_um", "worst"),
                    column("position_um_per_root_hz", "µm/√Hz"),
                    column("rotation_median_mrad", "σ / mrad"),
                    column("rotation_99_percent_mrad", "99 %"),
                    column("rotation_worst_mrad", "worst"),
                    column("rotation_mrad_per_root_hz", "mrad/√Hz"),
                    column("all_lit_percent", "all lit / %"),
                    column("with_pose_percent", "with pose / %"),
                    column("condition_median", "condition"),
                    column("unnoticed_median_sigmas", "unnoticed / σ"),
                    column("one_dark_um", "one dark / µm"),
                ],
                rows: maps.iter().map(row).collect(),
            }],
        }],
        leading: 0,
        data: Vec::new(),
    }
}
