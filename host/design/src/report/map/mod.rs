//! Pages on the accuracy of heads over their workspaces: `slitpose scene map` of one, `slitpose compare` of several beside each other.

use slitpose_calibration::{Head, PartCosts};
use slitpose_head::causes::with_causes;
use slitpose_head::front_end::configuration;
use slitpose_head::scene_file::SceneFile;

use crate::map::{Map, NoiseOf, Plane, PlanePoint, Schedules, View};
use crate::plot::{Axis, Chart, CurveStyle, Heat, curve, heat_picture};
use crate::report::section::{Getter, Picture, Report, Section, Sheet, Table, Value, program, scene};
use crate::survey::{AXES, pose_text, workspace_text};

mod checks;

type Of = fn(&View) -> Option<f64>;

/// What of a pose is shown, its three axes together.
struct Kind {
    name: &'static str,
    unit: &'static str,
    /// From SI to `unit`.
    scale: f64,
    of: Of,
    /// The worst behind a point of a plane.
    worst: fn(&PlanePoint) -> f64,
}

const POSITION: Kind =
    Kind { name: "position", unit: "µm", scale: 1e6, of: View::sigma_m, worst: |point| point.worst_m };
const ROTATION: Kind =
    Kind { name: "rotation", unit: "mrad", scale: 1e3, of: View::sigma_rad, worst: |point| point.worst_rad };
const KINDS: [Kind; 2] = [POSITION, ROTATION];

/// The report on `map` of `head`, with what its tolerances cost and schedules do, if that was asked for.
pub fn map_report(head: &Head, map: &Map, costs: Option<&PartCosts>, proposed: Option<&Schedules>) -> Report {
    let file = &head.file;
    let noise = match map.noise {
        NoiseOf::FrontEnd => "that of a single frame by `[front_end]` and `[lighting]`",
        NoiseOf::Channel => "that of the measuring channel of `[noise]`",
        NoiseOf::Nothing => "none: what is left is the arithmetic of the model",
    };
    let mut conditions = vec![
        program(),
        scene(file),
        ("workspace", workspace_text(&file.workspace)),
        ("noise", noise.to_owned()),
        ("data", format!("computed: the Cramér–Rao bound at {} poses; nothing was measured", map.samples.len())),
    ];
    if let Some(calibration) = head.calibration() {
        let said =
            format!("{}, hash {:016x}: what it leaves open is part of every σ", calibration.id, calibration.hash());
        conditions.insert(2, ("calibration", said));
    }
    let mut warnings = Vec::new();
    if let (NoiseOf::Channel | NoiseOf::Nothing, true, Err(error)) =
        (map.noise, file.front_end.is_some(), configuration(file))
    {
        warnings.push(format!("The noise is not that of the front end: {}.", with_causes(&error)));
    }
    Report {
        title: "Accuracy over the workspace",
        scene: file.name.clone(),
        conditions,
        warnings,
        sections: [accuracy(map)]
            .into_iter()
            .chain(planes(map))
            .chain([checks::redundancy(map)])
            .chain(proposed.map(checks::schedules))
            .chain(costs.map(|costs| checks::tolerances(costs, file.tolerance.is_some())))
            .collect(),
        data: vec![points(map), samples(map)],
    }
}

const POINTS: usize = 200;

/// Ratio of greatest to least σ from which an axis is logarithmic.
const WIDE: f64 = 10.0;

fn accuracy(map: &Map) -> Section {
    let shares = [0.5, 0.95, 0.99, 1.0];
    let row = |name: &str, (unit, scale): (&'static str, f64), of: &dyn Fn(&View) -> Option<f64>| {
        let at = map.quantiles(shares, of).map(|value| Value::from(value * scale));
        let density = map.per_root_hz().map(|by| map.quantile(0.5, of) * by * scale);
        let mut row = vec![name.into(), unit.into(), Value::optional(of(&map.home).map(|value| value * scale))];
        row.extend(at);
        row.push(Value::optional(density));
        row
    };
    let axis = |k: usize| {
        let Kind { unit, scale, .. } = if k < 3 { POSITION } else { ROTATION };
        row(AXES[k], (unit, scale), &move |view: &View| view.sigma.map(|sigma| sigma[k]))
    };
    let mut rows: Vec<_> = KINDS.iter().map(|kind| row(kind.name, (kind.unit, kind.scale), &kind.of)).collect();
    rows.extend((0..6).map(axis));
    let [[median_m, worst_m], [median_rad, worst_rad]] =
        KINDS.map(|kind| map.quantiles([0.5, 1.0], kind.of).map(|value| value * kind.scale));
    let with_pose = map.share(|view| view.sigma.is_some());
    let mut summary = Vec::new();
    if median_m.is_finite() {
        let worst = format!("; {worst_m:.2} µm and {worst_rad:.3} mrad at worst");
        summary.push(format!(
            "{} gives the position to {median_m:.2} µm and the rotation to {median_rad:.3} mrad in the median of \
             the workspace (σ, all three axes together){}.",
            map.noise.reading(),
            if worst_m.is_finite() { &worst } else { "" }
        ));
    }
    if with_pose < 1.0 {
        summary.push(format!("In {:.2} % of the workspace a frame gives no pose.", 100.0 * (1.0 - with_pose)));
    }
    if let Some(by) = map.per_root_hz().filter(|_| median_m.is_finite()) {
        summary.push(format!(
            "Filtered, that is {:.3} µm and {:.4} mrad per √Hz of bandwidth.",
            median_m * by,
            median_rad * by
        ));
    }
    let place = |kind: &Kind| {
        let (pose, value) = map.worst(kind.of)?;
        let (Kind { name, unit, scale, .. }, at) = (kind, pose_text(&pose).replace("mm, ", "mm and "));
        Some(format!("The {name} is worst, {:.2} {unit}, at {at}.", value * scale))
    };
    Section {
        name: "accuracy",
        title: "Accuracy of a single frame",
        summary,
        paragraphs: KINDS.iter().filter_map(place).collect(),
        pictures: vec![distribution(&[("", map)])],
        tables: vec![Table {
            name: "accuracy",
            caption: "σ of single frames: at home, and at shares of the workspace".to_owned(),
            columns: vec![
                ("axis", "axis"),
                ("unit", "unit"),
                ("home", "home"),
                ("median", "median"),
                ("of_95_percent", "95 %"),
                ("of_99_percent", "99 %"),
                ("worst", "worst"),
                ("median_per_root_hz", "median per √Hz"),
            ],
            rows,
        }],
    }
}

/// Share of the workspace by accuracy, for each of `maps`.
fn distribution(maps: &[(&str, &Map)]) -> Picture {
    let panel = |kind: &Kind| {
        let of_map = |(index, (name, map)): (usize, &(&str, &Map))| {
            let shares: [f64; POINTS] = std::array::from_fn(|k| (k + 1) as f64 / POINTS as f64);
            let values = map.quantiles(shares, kind.of).into_iter().zip(shares);
            let points = values.map(|(value, share)| [value * kind.scale, 100.0 * share]);
            curve(name, index, CurveStyle::Line, points.filter(|[value, _]| value.is_finite()).collect())
        };
        let label = format!("σ / {}", kind.unit);
        let x = |values: Vec<f64>| {
            let [least, most] = [values.iter().copied().reduce(f64::min), values.iter().copied().reduce(f64::max)];
            let is_wide = least.zip(most).is_some_and(|(least, most)| most > WIDE * least);
            if is_wide { Axis::logarithmic(&label, values) } else { Axis::around(&label, values) }
        };
        let y = |_| Axis::around("share of the workspace / %", [0.0, 100.0]);
        (kind.name.to_owned(), Chart::over(maps.iter().enumerate().map(of_map).collect(), x, y))
    };
    Sheet {
        title: "Share of the workspace by accuracy".to_owned(),
        note: "Share of evenly spread poses whose single frame has a σ of at most that; three axes together."
            .to_owned(),
        panels: KINDS.iter().map(panel).collect(),
    }
    .draw("distribution", "Distribution of σ over the workspace.")
}

/// `None` if the map has no planes.
fn planes(map: &Map) -> Option<Section> {
    let pictures = [
        ("position_by_translation", &KINDS[0], "translations"),
        ("position_by_rotation", &KINDS[0], "rotations"),
        ("rotation_by_translation", &KINDS[1], "translations"),
        ("rotation_by_rotation", &KINDS[1], "rotations"),
    ];
    (!map.planes.is_empty()).then(|| Section {
        name: "planes",
        title: "Accuracy over planes through home",
        paragraphs: vec!["A crossed-out point has poses that a single frame cannot tell.".to_owned()],
        pictures: pictures.map(|(name, kind, over)| picture(map, name, kind, over)).into(),
        ..Section::default()
    })
}

/// σ of one kind over the three planes of translations or rotations.
fn picture(map: &Map, name: &'static str, kind: &Kind, over: &str) -> Picture {
    let chosen = || map.planes.iter().filter(|plane| (plane.axes[0] < 3) == (over == "translations"));
    let in_plane = |point: &PlanePoint| (kind.of)(&point.view).unwrap_or(f64::INFINITY);
    let heats: Vec<Heat> = chosen()
        .map(|plane| heat(plane, "others at home", |point| in_plane(point) * kind.scale))
        .chain(chosen().map(|plane| heat(plane, "worst of the others", |point| (kind.worst)(point) * kind.scale)))
        .collect();
    let title = format!("σ of the {} over {over}", kind.name);
    let note = format!(
        "Upper row: the other coordinates at home. Lower row: the worst of {} poses over all of their range.",
        map.behind + 1
    );
    let unit = format!("σ of a single frame, {}, three axes together", kind.unit);
    Picture { name, caption: format!("{title}."), svg: heat_picture(&title, &note, &unit, 3, &heats) }
}

fn heat(plane: &Plane, heading: &str, value: impl Fn(&PlanePoint) -> f64) -> Heat {
    let degrees = |axis: usize| axis >= 3;
    Heat {
        heading: heading.to_owned(),
        labels: plane.axes.map(|axis| format!("{} / {}", AXES[axis], if degrees(axis) { "°" } else { "mm" })),
        extents: [0, 1].map(|k| {
            let extent = plane.extents[k];
            if degrees(plane.axes[k]) { extent.to_degrees() } else { extent * 1e3 }
        }),
        side: plane.side,
        values: plane.points.iter().map(value).collect(),
    }
}

/// Columns of a view, after those that say where it is.
const VIEW: [Getter<'_, View>; 9] = [
    ("lit", "lit", &|view| view.lit.into()),
    ("sigma_position_um", "σ / µm", &|view| Value::optional(view.sigma_m().map(|value| value * 1e6))),
    ("sigma_rotation_mrad", "σ / mrad", &|view| Value::optional(view.sigma_rad().map(|value| value * 1e3))),
    ("condition", "condition", &|view| Value::optional(view.condition)),
    ("unnoticed_sigmas", "unnoticed / σ", &|view| view.unnoticed_sigmas.into()),
    ("full_scale_margin", "full scale", &|view| view.full_scale.into()),
    ("saturation_margin", "saturation", &|view| view.saturation.into()),
    ("faint_margin", "faint", &|view| view.faint.into()),
    ("has_pose", "pose", &|view| usize::from(view.sigma.is_some()).into()),
];

/// A table of views and their places: `before` them and `after` them stand columns of the places.
fn of_views<T>(
    name: &'static str,
    caption: &str,
    rows: &[T],
    view: fn(&T) -> &View,
    before: &[Getter<'_, T>],
    after: &[Getter<'_, T>],
) -> Table {
    let views = VIEW.map(|(name, heading, value)| (name, heading, move |row: &T| value(view(row))));
    let views = views.iter().map(|(name, heading, value)| (*name, *heading, value as &dyn Fn(&T) -> Value));
    let columns: Vec<_> = before.iter().copied().chain(views).chain(after.iter().copied()).collect();
    Table::of(name, caption, rows, &columns)
}

fn points(map: &Map) -> Table {
    let rows: Vec<(&Plane, &PlanePoint)> =
        map.planes.iter().flat_map(|plane| plane.points.iter().map(move |point| (plane, point))).collect();
    let in_units = |axis: usize, value: f64| Value::from(if axis < 3 { value * 1e3 } else { value });
    of_views(
        "planes",
        "All points of the planes",
        &rows,
        |(_, point)| &point.view,
        &[
            ("axis_1", "axis", &|(plane, _)| AXES[plane.axes[0]].into()),
            ("axis_2", "axis", &|(plane, _)| AXES[plane.axes[1]].into()),
            ("value_1", "mm or rad", &|(plane, point)| in_units(plane.axes[0], point.at[0])),
            ("value_2", "mm or rad", &|(plane, point)| in_units(plane.axes[1], point.at[1])),
        ],
        &[
            ("worst_position_um", "worst / µm", &|(_, point)| Value::micro(point.worst_m)),
            ("worst_rotation_mrad", "worst / mrad", &|(_, point)| (point.worst_rad * 1e3).into()),
            ("least_lit", "fewest lit", &|(_, point)| point.least_lit.into()),
        ],
    )
}

fn samples(map: &Map) -> Table {
    of_views(
        "samples",
        "All poses that were spread over the workspace",
        &map.samples,
        |(_, view)| view,
        &[
            ("tx_mm", "tx_mm", &|(pose, _)| (pose.translation_m.x * 1e3).into()),
            ("ty_mm", "ty_mm", &|(pose, _)| (pose.translation_m.y * 1e3).into()),
            ("tz_mm", "tz_mm", &|(pose, _)| (pose.translation_m.z * 1e3).into()),
            ("rx_rad", "rx_rad", &|(pose, _)| pose.rotation_rad().x.into()),
            ("ry_rad", "ry_rad", &|(pose, _)| pose.rotation_rad().y.into()),
            ("rz_rad", "rz_rad", &|(pose, _)| pose.rotation_rad().z.into()),
        ],
        &[],
    )
}

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
    let workspace = |file: &SceneFile| format!("{}: {}", file.origin, workspace_text(&file.workspace));
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
