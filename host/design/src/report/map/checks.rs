//! How well poses are conditioned and checked, and how far currents are from their limits.

use super::{Of, micro};
use crate::map::{Map, View, quantiles_of};
use crate::report::section::{Section, Table, Value, column};

pub(super) fn redundancy(map: &Map) -> Section {
    let lit = |count: usize| {
        let exactly = map.share(|view| view.lit == count);
        vec![Value::from(count), Value::from(100.0 * exactly), Value::from(100.0 * map.share(|view| view.lit >= count))]
    };
    let row = |what: &str, of: Of| {
        let mut row = vec![Value::from(what), Value::optional(of(&map.home))];
        row.extend(map.quantiles([0.5, 0.95, 0.99, 1.0], of).map(Value::from));
        row
    };
    let all = map.share(|view| view.lit == map.cells());
    let unnoticed: Of = |view| Some(view.unnoticed_sigmas);
    let [median, most] = map.quantiles([0.5, 0.95], unnoticed);
    let with_pose =
        |views: &Vec<View>| views.iter().filter(|view| view.sigma.is_some()).count() as f64 / views.len() as f64;
    let dark = |cell: usize, views: &Vec<View>| {
        let median = |of: Of| quantiles_of(views.iter(), [0.5], of)[0];
        vec![
            cell.into(),
            micro(median(View::sigma_m)),
            Value::from(median(View::sigma_rad) * 1e3),
            (100.0 * with_pose(views)).into(),
        ]
    };
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
                "A fault in one cell that is as likely as not to be noticed moves the pose by {median:.0} σ in the median{}.",
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
                rows: (0..=map.cells()).rev().map(lit).collect(),
            },
        ],
    }
}

pub(super) fn margins(map: &Map) -> Section {
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
