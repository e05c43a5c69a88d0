//! A page on the accuracy of a head over its workspace.

use glam::dvec2;
use slitpose_calibration::{Head, PartCosts, PoseRms};
use slitpose_head::front_end::configuration;
use slitpose_head::scene_file::Workspace;

use super::section::{Picture, Report, Section, Table, Value, column};
use super::sheet::{Sheet, curve};
use crate::map::{Candidate, KNOWN, Map, NoiseOf, Plane, PlanePoint, Schedules, Tolerances, View};
use crate::plot::{Anchor, Axis, Canvas, Chart, CurveStyle, Heat, Scale, Stroke, TextStyle, cell_colour, heat_picture};
use crate::survey::AXES;

/// A value of a view.
type Of = fn(&View) -> Option<f64>;

/// Points of a curve.
const POINTS: usize = 200;

/// Ratio of greatest to least σ from which an axis is logarithmic.
const WIDE: f64 = 10.0;

/// The report on `map` of `head`, with what its tolerances cost and schedules do, if that was studied.
pub fn map_report(head: &Head, map: &Map, studied: Option<&Tolerances>, schedules: Option<&Schedules>) -> Report {
    let file = &head.file;
    let noise = match map.noise {
        NoiseOf::FrontEnd => "that of a single frame by `[front_end]` and `[lighting]`",
        NoiseOf::Channel => "that of the measuring channel of `[noise]`",
        NoiseOf::Nothing => "none: what is left is the arithmetic of the model",
    };
    let mut conditions = vec![
        ("program", format!("slitpose {}", env!("CARGO_PKG_VERSION"))),
        ("scene", format!("{} ({}), hash {:016x}", file.name, file.origin, file.hash)),
        ("workspace", extents(&file.workspace)),
        ("noise", noise.to_owned()),
        ("data", format!("computed: the Cramér–Rao bound at {} poses; nothing was measured", map.samples.len())),
    ];
    if let Some(calibration) = head.calibration() {
        let said =
            format!("{}, hash {:016x}: what it leaves open is part of every σ", calibration.id(), calibration.hash());
        conditions.insert(2, ("calibration", said));
    }
    let mut warnings = Vec::new();
    if let (NoiseOf::Channel | NoiseOf::Nothing, true, Err(error)) =
        (map.noise, file.front_end.is_some(), configuration(file))
    {
        warnings.push(format!("The noise is not that of the front end: {error}."));
    }
    Report {
        title: "Accuracy over the workspace",
        scene: file.name.clone(),
        conditions,
        warnings,
        sections: [accuracy(map), planes(map), redundancy(map), margins(map)]
            .into_iter()
            .chain(schedules.map(of_schedules))
            .chain(studied.map(tolerances))
            .collect(),
        leading: 0,
        data: vec![points(map), samples(map)],
    }
}

/// A workspace as people write it.
pub(super) fn extents(workspace: &Workspace) -> String {
    let joined = |extents: [f64; 3]| {
        let short = extents.map(|extent| format!("{extent:.3}").trim_end_matches('0').trim_end_matches('.').to_owned());
        short.join(", ")
    };
    let [m, rad] = [workspace.half_extent_m, workspace.half_extent_rad].map(|extent| extent.to_array());
    format!("±({}) mm, ±({})°", joined(m.map(|extent| extent * 1e3)), joined(rad.map(f64::to_degrees)))
}

fn micro(value: f64) -> Value {
    Value::from(value * 1e6)
}

fn accuracy(map: &Map) -> Section {
    let shares = [0.5, 0.95, 0.99, 1.0];
    let row = |name: &str, unit: &'static str, scale: f64, of: &dyn Fn(&View) -> Option<f64>| {
        let at = map.quantiles(shares, of).map(|value| Value::from(value * scale));
        let density = map.per_root_hz().map(|by| map.quantile(0.5, of) * by * scale);
        let mut row = vec![name.into(), unit.into(), Value::optional(of(&map.home).map(|value| value * scale))];
        row.extend(at);
        row.push(Value::optional(density));
        row
    };
    let axis = |k: usize| {
        let (unit, scale) = if k < 3 { ("µm", 1e6) } else { ("mrad", 1e3) };
        row(AXES[k], unit, scale, &move |view: &View| view.sigma.map(|sigma| sigma[k]))
    };
    let mut rows = vec![row("position", "µm", 1e6, &View::sigma_m), row("rotation", "mrad", 1e3, &View::sigma_rad)];
    rows.extend((0..6).map(axis));
    let [median_m, worst_m] = map.quantiles([0.5, 1.0], View::sigma_m).map(|value| value * 1e6);
    let [median_rad, worst_rad] = map.quantiles([0.5, 1.0], View::sigma_rad).map(|value| value * 1e3);
    let with_pose = map.share(|view| view.sigma.is_some());
    let mut summary = Vec::new();
    if median_m.is_finite() {
        let worst = format!("; {worst_m:.2} µm and {worst_rad:.3} mrad at worst");
        summary.push(format!(
            "A single frame tells the position to {median_m:.2} µm and the rotation to {median_rad:.3} mrad in the median of \
             the workspace (σ, all three axes together){}.",
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
    let place = |what: &str, scale: f64, unit: &str, of: Of| {
        map.worst(of).map(|(pose, value)| {
            let (t, r) = (pose.translation_m * 1e3, pose.rotation_rad());
            format!(
                "The {what} is worst, {:.2} {unit}, at ({:+.2}, {:+.2}, {:+.2}) mm and ({:+.1}, {:+.1}, {:+.1})°.",
                value * scale,
                t.x,
                t.y,
                t.z,
                r.x.to_degrees(),
                r.y.to_degrees(),
                r.z.to_degrees()
            )
        })
    };
    let worst = [place("position", 1e6, "µm", View::sigma_m), place("rotation", 1e3, "mrad", View::sigma_rad)];
    let picture = distribution(&[("", map)]);
    Section {
        name: "accuracy",
        title: "What a frame tells",
        summary,
        paragraphs: worst.into_iter().flatten().collect(),
        pictures: vec![picture],
        tables: vec![Table {
            name: "accuracy",
            caption: "σ of single frames: at home, and at shares of the workspace".to_owned(),
            columns: vec![
                column("axis", "axis"),
                column("unit", "unit"),
                column("home", "home"),
                column("median", "median"),
                column("of_95_percent", "95 %"),
                column("of_99_percent", "99 %"),
                column("worst", "worst"),
                column("median_per_root_hz", "median per √Hz"),
            ],
            rows,
        }],
    }
}

/// How much of the workspace is how accurate, for each of `maps`.
pub(super) fn distribution(maps: &[(&str, &Map)]) -> Picture {
    let panel = |heading: &str, label: &str, scale: f64, of: Of| {
        let of_map = |(index, (name, map)): (usize, &(&str, &Map))| {
            let points = (1..=POINTS).map(|k| {
                let share = k as f64 / POINTS as f64;
                [map.quantile(share, of) * scale, 100.0 * share]
            });
            curve(name, index, CurveStyle::Line, points.filter(|[value, _]| value.is_finite()).collect())
        };
        let curves: Vec<_> = maps.iter().enumerate().map(of_map).collect();
        let values = || curves.iter().flat_map(|curve| curve.points.iter().map(|point| point[0]));
        let [least, most] =
            values().fold([f64::INFINITY, 0.0], |[least, most]: [f64; 2], value| [least.min(value), most.max(value)]);
        let x = if most > WIDE * least { Axis::logarithmic(label, values()) } else { Axis::around(label, values()) };
        let y = Axis::around("share of the workspace / %", [0.0, 100.0]);
        (heading.to_owned(), Chart { x, y, curves, notes: Vec::new() })
    };
    Sheet {
        title: "How much of the workspace is how accurate".to_owned(),
        note: "Share of evenly spread poses whose single frame has a σ of at most that; three axes together."
            .to_owned(),
        panels: vec![
            panel("position", "σ / µm", 1e6, View::sigma_m),
            panel("rotation", "σ / mrad", 1e3, View::sigma_rad),
        ],
    }
    .draw("distribution", "Distribution of σ over the workspace.")
}

fn planes(map: &Map) -> Section {
    let picture = |name,
                   axes: &str,
                   wanted: &dyn Fn(&Plane) -> bool,
                   of: Of,
                   worst: fn(&PlanePoint) -> f64,
                   what: &str| {
        let (scale, unit) = if what == "position" { (1e6, "µm") } else { (1e3, "mrad") };
        let heat = |plane: &Plane, heading: &str, value: &dyn Fn(&PlanePoint) -> f64| Heat {
            heading: heading.to_owned(),
            labels: plane.axes.map(|axis| format!("{} / {}", AXES[axis], if axis < 3 { "mm" } else { "°" })),
            extents: [0, 1].map(|k| {
                let extent = plane.extents[k];
                if plane.axes[k] < 3 { extent * 1e3 } else { extent.to_degrees() }
            }),
            side: plane.side,
            values: plane.points.iter().map(|point| value(point) * scale).collect(),
        };
        let in_plane = |point: &PlanePoint| of(&point.view).unwrap_or(f64::INFINITY);
        let heats: Vec<Heat> = (map.planes.iter().filter(|plane| wanted(plane)))
            .map(|plane| heat(plane, "others at home", &in_plane))
            .chain(
                map.planes.iter().filter(|plane| wanted(plane)).map(|plane| heat(plane, "worst of the others", &worst)),
            )
            .collect();
        let title = format!("σ of the {what} over {axes}");
        let note = format!(
            "Upper row: the other coordinates at home. Lower row: the worst of {} poses over all of their range.",
            map.behind + 1
        );
        let svg = heat_picture(&title, &note, &format!("σ of a single frame, {unit}, three axes together"), 3, &heats);
        Picture { name, caption: format!("{title}."), svg }
    };
    let translations: &dyn Fn(&Plane) -> bool = &|plane| plane.axes[0] < 3;
    let rotations: &dyn Fn(&Plane) -> bool = &|plane| plane.axes[0] >= 3;
    let worst_m = |point: &PlanePoint| point.worst_m;
    let worst_rad = |point: &PlanePoint| point.worst_rad;
    Section {
        name: "planes",
        title: "Where it tells it",
        summary: Vec::new(),
        paragraphs: vec!["Where a point is crossed out, there is a pose at which a frame gives none.".to_owned()],
        pictures: vec![
            picture("position_by_translation", "translations", translations, View::sigma_m, worst_m, "position"),
            picture("position_by_rotation", "rotations", rotations, View::sigma_m, worst_m, "position"),
            picture("rotation_by_translation", "translations", translations, View::sigma_rad, worst_rad, "rotation"),
            picture("rotation_by_rotation", "rotations", rotations, View::sigma_rad, worst_rad, "rotation"),
        ],
        tables: Vec::new(),
    }
}

fn redundancy(map: &Map) -> Section {
    let lit = |count: usize| {
        let exactly = map.share(|view| view.lit == count);
        vec![Value::from(count), Value::from(100.0 * exactly), Value::from(100.0 * map.share(|view| view.lit >= count))]
    };
    let row = |what: &str, of: Of| {
        let mut row = vec![Value::from(what), Value::optional(of(&map.home))];
        row.extend(map.quantiles([0.5, 0.95, 0.99, 1.0], of).map(Value::from));
        row
    };
    let all = map.share(|view| view.lit == map.cells);
    let unnoticed: Of = |view| Some(view.unnoticed_sigmas);
    let [median, most] = map.quantiles([0.5, 0.95], unnoticed);
    let dark = |cell: usize, views: &Vec<View>| {
        let median = |of: Of| crate::map::quantiles_of(views.iter(), [0.5], of)[0];
        let with_pose = views.iter().filter(|view| view.sigma.is_some()).count() as f64 / views.len() as f64;
        vec![
            cell.into(),
            micro(median(View::sigma_m)),
            Value::from(median(View::sigma_rad) * 1e3),
            (100.0 * with_pose).into(),
        ]
    };
    let while_dark = match map.worst_dark(View::sigma_m) {
        Some((cell, worst)) if worst.is_finite() => {
            let usual = map.quantile(0.5, View::sigma_m);
            format!("With one cell dark, σ of the position is up to {:.2} times as great (cell {cell}).", worst / usual)
        }
        _ => "With one cell dark, there is a head without poses in half of the workspace.".to_owned(),
    };
    let summary = vec![
        while_dark,
        format!("Every cell is lit in {:.2} % of the workspace.", 100.0 * all),
        if median.is_finite() {
            format!(
                "A fault in one cell that is as likely as not to be noticed moves the pose by {median:.0} σ in the median{}.",
                if most.is_finite() { format!(", by {most:.0} σ at 95 % of the workspace") } else { String::new() }
            )
        } else {
            "The cells do not check each other: a fault in one of them goes unnoticed.".to_owned()
        },
    ];
    Section {
        name: "redundancy",
        title: "How well it is conditioned and checked",
        summary,
        paragraphs: vec![
            "The condition is the ratio of the extreme singular values of the whitened Jacobian, lengths in units of the \
             emitters' distance from the tool's centre. Unnoticed is the external reliability of Baarda (1968): how far, in σ \
             of the pose, the least fault of one cell that χ² shows in one case of two moves the pose."
                .to_owned(),
        ],
        pictures: Vec::new(),
        tables: vec![
            Table {
                name: "condition",
                caption: "Condition, and what a fault can do unnoticed".to_owned(),
                columns: vec![
                    column("quantity", "quantity"),
                    column("home", "home"),
                    column("median", "median"),
                    column("of_95_percent", "95 %"),
                    column("of_99_percent", "99 %"),
                    column("worst", "worst"),
                ],
                rows: vec![row("condition", |view| view.condition), row("unnoticed / σ", unnoticed)],
            },
            Table {
                name: "one_dark",
                caption: "While one cell is dark: medians over the workspace".to_owned(),
                columns: vec![
                    column("dark", "dark cell"),
                    column("sigma_position_um", "σ / µm"),
                    column("sigma_rotation_mrad", "σ / mrad"),
                    column("with_pose_percent", "with pose / %"),
                ],
                rows: map.one_dark.iter().enumerate().map(|(cell, views)| dark(cell, views)).collect(),
            },
            Table {
                name: "lit",
                caption: "Cells whose whole spot is on the detector".to_owned(),
                columns: vec![
                    column("cells", "cells"),
                    column("share_percent", "of the workspace / %"),
                    column("at_least_percent", "so many or more / %"),
                ],
                rows: (0..=map.cells).rev().map(lit).collect(),
            },
        ],
    }
}

fn margins(map: &Map) -> Section {
    let row = |what: &str, of: Of| {
        let finite = |value: f64| Value::optional(Some(value).filter(|value| value.is_finite()));
        let [worst, one, median] = map.quantiles([0.0, 0.01, 0.5], of).map(finite);
        vec![what.into(), finite(of(&map.home).unwrap_or(f64::INFINITY)), median, one, worst]
    };
    let below = |of: Of| 100.0 * map.share(|view| of(view).is_some_and(|margin| margin < 1.0));
    let kinds: [(&str, Of); 3] = [
        ("full scale over the greatest electrode current", |view| Some(view.full_scale)),
        ("saturation over the greatest photocurrent", |view| Some(view.saturation)),
        ("least photocurrent over what is faint", |view| Some(view.faint)),
    ];
    let summary = ["Electrodes exceed the full scale", "Detectors saturate", "A cell is faint or dark"]
        .into_iter()
        .zip(kinds)
        .filter(|(_, (_, of))| below(*of) > 0.0)
        .map(|(what, (_, of))| format!("{what} in {:.2} % of the workspace.", below(of)));
    Section {
        name: "margins",
        title: "How far it is from the limits",
        summary: summary.collect(),
        paragraphs: vec![
            "Ratios: below one, the limit is passed. Of all cells, the one nearest to it counts.".to_owned(),
        ],
        pictures: Vec::new(),
        tables: vec![Table {
            name: "margins",
            caption: "Margins".to_owned(),
            columns: vec![
                column("margin", "margin"),
                column("home", "home"),
                column("median", "median"),
                column("of_1_percent", "1 %"),
                column("least", "least"),
            ],
            rows: kinds.map(|(what, of)| row(what, of)).into(),
        }],
    }
}

/// Slots as a scene file has them.
fn slots(candidate: &Candidate) -> String {
    format!("{:?}", candidate.slots)
}

fn of_schedules(schedules: &Schedules) -> Section {
    let row = |candidate: &Candidate| {
        let by = (2.0 / candidate.frame_rate_hz).sqrt();
        vec![
            candidate.frame_rate_hz.into(),
            (candidate.frame_rate_hz / 2.0).into(),
            slots(candidate).into(),
            Value::from(candidate.oversampling as usize),
            (100.0 * candidate.busy).into(),
            micro(candidate.sigma_m),
            Value::from(candidate.sigma_rad * 1e3),
            micro(candidate.sigma_m * by),
            Value::from(candidate.sigma_rad * 1e3 * by),
        ]
    };
    let table = |name, caption: &str, candidates: &[Candidate]| Table {
        name,
        caption: caption.to_owned(),
        columns: vec![
            column("frame_rate_hz", "frames/s"),
            column("bandwidth_hz", "bandwidth / Hz"),
            column("slots", "slots"),
            column("oversampling", "oversampling"),
            column("busy_percent", "busy / %"),
            column("sigma_position_um", "σ / µm"),
            column("sigma_rotation_mrad", "σ / mrad"),
            column("position_um_per_root_hz", "µm/√Hz"),
            column("rotation_mrad_per_root_hz", "mrad/√Hz"),
        ],
        rows: candidates.iter().map(row).collect(),
    };
    let summary = schedules.at_rate.first().map(|best| {
        format!(
            "Best at {} frames/s: `lighting.slots = {}` and `front_end.oversampling = {}`, {:.2} µm and {:.3} mrad in the \
             median of the workspace.",
            best.frame_rate_hz,
            slots(best),
            best.oversampling,
            best.sigma_m * 1e6,
            best.sigma_rad * 1e3
        )
    });
    Section {
        name: "schedules",
        title: "What the schedule does",
        summary: summary.into_iter().collect(),
        paragraphs: vec![
            "Emitters are lit as the scene says, one by one, or as many together as do not shine on each other's detectors; \
             words are sums of as many conversions as the board adds up; settling and conversion are those of `[front_end]`. \
             Only schedules that fit the frame are listed. σ is that of a single frame, three axes together, the median of the \
             workspace; frames follow motion up to half their rate."
                .to_owned(),
        ],
        pictures: Vec::new(),
        tables: vec![
            table("schedules", "Schedules at the wanted rate, the best first", &schedules.at_rate),
            table("rates", "The best at each rate", &schedules.best_by_rate),
        ],
    }
}

/// Median of the heads' errors; `None` of none.
fn median(heads: &Tolerances, of: impl Fn(&[PoseRms; 2]) -> f64) -> Option<f64> {
    let mut values: Vec<f64> = heads.heads.iter().map(of).collect();
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied()
}

fn tolerances(studied: &Tolerances) -> Section {
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
    let medians = [0, 1].map(|k| median(studied, |head| head[k][0]));
    if let [Some(before), Some(after)] = medians {
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
    let whose = if studied.are_stated { "of `[tolerance]`" } else { "of usual parts: the scene has no `[tolerance]`" };
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

/// Columns of a view, after those that say where it is.
fn of_view(view: &View) -> [Value; 9] {
    let finite = |value: f64| Value::optional(Some(value));
    [
        view.lit.into(),
        Value::optional(view.sigma_m().map(|value| value * 1e6)),
        Value::optional(view.sigma_rad().map(|value| value * 1e3)),
        Value::optional(view.condition),
        finite(view.unnoticed_sigmas),
        finite(view.full_scale),
        finite(view.saturation),
        finite(view.faint),
        Value::from(usize::from(view.sigma.is_some())),
    ]
}

const VIEW: [super::Column; 9] = [
    column("lit", "lit"),
    column("sigma_position_um", "σ / µm"),
    column("sigma_rotation_mrad", "σ / mrad"),
    column("condition", "condition"),
    column("unnoticed_sigmas", "unnoticed / σ"),
    column("full_scale_margin", "full scale"),
    column("saturation_margin", "saturation"),
    column("faint_margin", "faint"),
    column("has_pose", "pose"),
];

fn points(map: &Map) -> Table {
    let in_units = |axis: usize, value: f64| if axis < 3 { value * 1e3 } else { value };
    let row = |plane: &Plane, point: &PlanePoint| {
        let mut row: Vec<Value> = plane.axes.map(|axis| AXES[axis].into()).into();
        row.extend([0, 1].map(|k| Value::from(in_units(plane.axes[k], point.at[k]))));
        row.extend(of_view(&point.view));
        row.extend([micro(point.worst_m), Value::from(point.worst_rad * 1e3), point.least_lit.into()]);
        row
    };
    let mut columns = vec![
        column("axis_1", "axis"),
        column("axis_2", "axis"),
        column("value_1", "mm or rad"),
        column("value_2", "mm or rad"),
    ];
    columns.extend(VIEW);
    columns.extend([
        column("worst_position_um", "worst / µm"),
        column("worst_rotation_mrad", "worst / mrad"),
        column("least_lit", "fewest lit"),
    ]);
    Table {
        name: "planes",
        caption: "All points of the planes".to_owned(),
        columns,
        rows: map.planes.iter().flat_map(|plane| plane.points.iter().map(move |point| row(plane, point))).collect(),
    }
}

fn samples(map: &Map) -> Table {
    let mut columns: Vec<_> =
        ["tx_mm", "ty_mm", "tz_mm", "rx_rad", "ry_rad", "rz_rad"].map(|name| column(name, name)).into();
    columns.extend(VIEW);
    let row = |(pose, view): &(slitpose_model::Pose, View)| {
        let (t, r) = (pose.translation_m * 1e3, pose.rotation_rad());
        let mut row: Vec<Value> = [t.x, t.y, t.z, r.x, r.y, r.z].map(Value::from).into();
        row.extend(of_view(view));
        row
    };
    Table {
        name: "samples",
        caption: "All poses that were spread over the workspace".to_owned(),
        columns,
        rows: map.samples.iter().map(row).collect(),
    }
}
