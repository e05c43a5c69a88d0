//! The page on several heads beside each other.

use slitpose_head::scene_file::SceneFile;

use super::map::{KINDS, Kind, distribution};
use super::section::{Report, Section, Table, Value, program};
use crate::map::{Map, NoiseOf, View};
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
