//! How well poses are conditioned and checked, how far currents are from their limits, and what schedules and tolerances do.

use glam::dvec2;
use slitpose_calibration::PartCosts;

use super::Of;
use crate::map::{Candidate, KNOWN, Map, Schedules, View, quantiles_of};
use crate::plot::{Axis, Chart, CurveStyle, Note, Scale, curve};
use crate::report::section::{Picture, Section, Sheet, Table, Value};

/// What is checked, its value, and what happens where that is above one, if it is a limit.
const CHECKS: [(&str, Of, Option<&str>); 5] = [
    ("condition", |view| view.condition, None),
    ("unnoticed / σ", |view| Some(view.unnoticed_sigmas), None),
    ("electrode current by full scale", |view| Some(view.full_scale.recip()), Some("Electrodes exceed the full scale")),
    ("photocurrent by saturation", |view| Some(view.saturation.recip()), Some("Detectors saturate")),
    ("faint current by photocurrent", |view| Some(view.faint.recip()), Some("A cell is faint or dark")),
];

pub(super) fn redundancy(map: &Map) -> Section {
    let row = |what: &str, of: Of| {
        let mut row = vec![Value::from(what), Value::optional(of(&map.home))];
        row.extend(map.quantiles([0.5, 0.95, 0.99, 1.0], of).map(Value::from));
        row
    };
    let rows = CHECKS.map(|(what, of, _)| row(what, of)).into();
    let all = map.share(|view| view.lit == map.cells());
    let unnoticed: Of = |view| Some(view.unnoticed_sigmas);
    let [median, most] = map.quantiles([0.5, 0.95], unnoticed);
    let with_pose =
        |views: &Vec<View>| views.iter().filter(|view| view.sigma.is_some()).count() as f64 / views.len() as f64;
    let while_dark_of = |cell: &usize, of: Of| quantiles_of(map.one_dark[*cell].iter(), [0.5], of)[0];
    let dark: Vec<usize> = (0..map.one_dark.len()).collect();
    let least_with_pose = map.one_dark.iter().map(with_pose).fold(1.0, f64::min);
    // As many numbers as unknowns.
    let unchecked = map.share(|view| view.sigma.is_some() && !view.unnoticed_sigmas.is_finite());
    let while_dark = match map.worst_dark(View::sigma_m) {
        Some((cell, worst)) if worst.is_finite() => {
            let usual = map.quantile(0.5, View::sigma_m);
            format!("With one cell dark, σ of the position is up to {:.2} times as great (cell {cell}).", worst / usual)
        }
        _ => {
            format!(
                "With one cell dark, a frame gives no pose in {:.2} % of the workspace.",
                100.0 - 100.0 * least_with_pose
            )
        }
    };
    let mut summary = vec![
        while_dark,
        format!("Every cell is lit in {:.2} % of the workspace.", 100.0 * all),
        if median.is_finite() {
            format!(
                "A fault in one cell that goes unnoticed every other time moves the pose by {median:.0} σ in the median{}.",
                if most.is_finite() { format!(", by {most:.0} σ at 95 % of the workspace") } else { String::new() }
            )
        } else {
            "The cells do not check each other: a fault in one of them goes unnoticed.".to_owned()
        },
    ];
    if unchecked > 0.0 {
        summary.push(format!(
            "In {:.2} % of the workspace three cells alone see light. There a frame has mirror images: σ is that of a tool that is \
             followed, and one that is found anew is `ambiguous`.",
            100.0 * unchecked
        ));
    }
    for (_, of, what) in CHECKS {
        let passed = map.share(|view| of(view).is_some_and(|share| share > 1.0));
        summary.extend(
            what.filter(|_| passed > 0.0).map(|what| format!("{what} in {:.2} % of the workspace.", 100.0 * passed)),
        );
    }
    Section {
        name: "redundancy",
        title: "How well it is conditioned and checked, and how near it is to its limits",
        summary,
        paragraphs: vec![
            "The condition is the ratio of the extreme singular values of the whitened Jacobian, lengths in units of the \
             emitters' distance from the tool's centre. Unnoticed is the external reliability of Baarda (1968): how far, in σ \
             of the pose, the least fault of one cell that χ² shows in one case of two moves the pose."
                .to_owned(),
        ],
        tables: vec![
            Table {
                name: "checks",
                caption: "Condition, what a fault can do unnoticed, and how near light is to its limits: of all cells, the \
                          nearest; above one, the limit is passed"
                    .to_owned(),
                columns: vec![
                    ("quantity", "quantity"),
                    ("home", "home"),
                    ("median", "median"),
                    ("of_95_percent", "95 %"),
                    ("of_99_percent", "99 %"),
                    ("worst", "worst"),
                ],
                rows,
            },
            Table::of(
                "one_dark",
                "While one cell is dark: medians over the workspace",
                &dark,
                &[
                    ("dark", "dark cell", &|cell| (*cell).into()),
                    ("sigma_position_um", "σ / µm", &|cell| Value::micro(while_dark_of(cell, View::sigma_m))),
                    ("sigma_rotation_mrad", "σ / mrad", &|cell| (while_dark_of(cell, View::sigma_rad) * 1e3).into()),
                    ("with_pose_percent", "with pose / %", &|cell| (100.0 * with_pose(&map.one_dark[*cell])).into()),
                ],
            ),
        ],
        ..Section::default()
    }
}

/// Slots as a scene file has them.
fn slots(candidate: &Candidate) -> String {
    format!("{:?}", candidate.slots)
}

pub(super) fn schedules(schedules: &Schedules) -> Section {
    let table = |name, caption: &str, candidates: &[Candidate]| {
        Table::of(
            name,
            caption,
            candidates,
            &[
                ("frame_rate_hz", "frames/s", &|one| one.frame_rate_hz.into()),
                ("bandwidth_hz", "bandwidth / Hz", &|one| (one.frame_rate_hz / 2.0).into()),
                ("slots", "slots", &|one| slots(one).into()),
                ("oversampling", "oversampling", &|one| Value::from(one.oversampling as usize)),
                ("busy_percent", "busy / %", &|one| (100.0 * one.busy).into()),
                ("sigma_position_um", "σ / µm", &|one| Value::micro(one.sigma_m)),
                ("sigma_rotation_mrad", "σ / mrad", &|one| (one.sigma_rad * 1e3).into()),
                ("position_um_per_root_hz", "µm/√Hz", &|one| Value::micro(one.sigma_m * one.per_root_hz())),
                ("rotation_mrad_per_root_hz", "mrad/√Hz", &|one| (one.sigma_rad * 1e3 * one.per_root_hz()).into()),
            ],
        )
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
        tables: vec![
            table("schedules", "Schedules at the wanted rate, the best first", &schedules.at_rate),
            table("rates", "The best at each rate", &schedules.best_by_rate),
        ],
        ..Section::default()
    }
}

pub(super) fn tolerances(costs: &PartCosts, are_stated: bool) -> Section {
    let mut parts: Vec<_> = costs.parts.iter().map(|part| (part.part, part.key, [part.before, part.after])).collect();
    parts.push(("all together", "", [costs.before, costs.after]));
    let mut summary = vec![format!(
        "Heads of parts within their tolerances err by {:.0} µm uncalibrated, by {:.2} µm calibrated at {} known poses (rms).",
        costs.before[0] * 1e6,
        costs.after[0] * 1e6,
        KNOWN.count
    )];
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
             poses by an instrument of {:.0} µm and {:.0} µrad, {:.0} frames at each. Errors are root mean squares over the \
             workspace, three axes together.",
            KNOWN.count,
            KNOWN.instrument[0] * 1e6,
            KNOWN.instrument[1] * 1e6,
            KNOWN.frames
        )],
        pictures: vec![cost_picture(costs)],
        tables: vec![Table::of(
            "tolerances",
            "By kind of part, the dearest first",
            &parts,
            &[
                ("part", "part", &|(part, ..)| (*part).into()),
                ("key", "key in [tolerance]", &|(_, key, _)| (*key).into()),
                ("before_um", "before / µm", &|(.., [before, _])| Value::micro(before[0])),
                ("before_mrad", "mrad", &|(.., [before, _])| (before[1] * 1e3).into()),
                ("after_um", "after / µm", &|(.., [_, after])| Value::micro(after[0])),
                ("after_mrad", "mrad", &|(.., [_, after])| (after[1] * 1e3).into()),
            ],
        )],
    }
}

/// Errors by kind of part, on a logarithmic axis: a row for each, with its name beside the greater error.
fn cost_picture(costs: &PartCosts) -> Picture {
    let rows: Vec<(&str, [f64; 2])> = (costs.parts.iter().map(|part| (part.part, [part.before, part.after])))
        .chain([("all together", [costs.before, costs.after])])
        .map(|(part, errors)| (part, errors.map(|error| error[0] * 1e6)))
        .collect();
    let height = |row: usize| -(row as f64);
    let kind = |(k, label): (usize, &str)| {
        let points = rows.iter().enumerate().map(|(row, (_, errors))| [errors[k], height(row)]);
        curve(label, k, CurveStyle::Markers, points.filter(|[error, _]| *error > 0.0).collect())
    };
    let curves = ["before calibration", "after it"].into_iter().enumerate().map(kind).collect();
    let y = |_| Axis { label: String::new(), range: [height(rows.len()), 1.0], scale: Scale::Bare };
    let mut chart = Chart::over(curves, |x| Axis::logarithmic("error of the position / µm", x), y);
    // Room for the names.
    chart.x.range[1] *= 30.0;
    let note = |(row, (part, errors)): (usize, &(&str, [f64; 2]))| Note {
        at: [errors[0].max(errors[1]).max(chart.x.range[0]), height(row)],
        offset: dvec2(10.0, 4.5),
        text: (*part).to_owned(),
    };
    chart.notes = rows.iter().enumerate().map(note).collect();
    Sheet {
        title: "What tolerances cost in position".to_owned(),
        note: "Errors of poses, root mean square over the workspace.".to_owned(),
        panels: vec![(String::new(), chart)],
    }
    .draw("tolerances", "What each kind of part costs, before calibration and after it.")
}
