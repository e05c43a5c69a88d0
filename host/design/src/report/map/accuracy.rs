//! How accurate single frames are, over all of the workspace.

use super::{KINDS, Kind, POSITION, ROTATION};
use crate::map::{Map, View};
use crate::plot::{Axis, Chart, CurveStyle};
use crate::report::section::{Picture, Section, Table, Value, column};
use crate::report::sheet::{Sheet, curve};
use crate::survey::AXES;

/// Points of a curve.
const POINTS: usize = 200;

/// Ratio of greatest to least σ from which an axis is logarithmic.
const WIDE: f64 = 10.0;

pub(super) fn section(map: &Map) -> Section {
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
        map.worst(kind.of).map(|(pose, value)| {
            let (t, r) = (pose.translation_m * 1e3, pose.rotation_rad());
            format!(
                "The {} is worst, {:.2} {}, at ({:+.2}, {:+.2}, {:+.2}) mm and ({:+.1}, {:+.1}, {:+.1})°.",
                kind.name,
                value * kind.scale,
                kind.unit,
                t.x,
                t.y,
                t.z,
                r.x.to_degrees(),
                r.y.to_degrees(),
                r.z.to_degrees()
            )
        })
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

/// Share of the workspace by accuracy, for each of `maps`.
pub(in crate::report) fn distribution(maps: &[(&str, &Map)]) -> Picture {
    let panel = |kind: &Kind| {
        let of_map = |(index, (name, map)): (usize, &(&str, &Map))| {
            let shares: [f64; POINTS] = std::array::from_fn(|k| (k + 1) as f64 / POINTS as f64);
            let values = map.quantiles(shares, kind.of).into_iter().zip(shares);
            let points = values.map(|(value, share)| [value * kind.scale, 100.0 * share]);
            curve(name, index, CurveStyle::Line, points.filter(|[value, _]| value.is_finite()).collect())
        };
        let curves: Vec<_> = maps.iter().enumerate().map(of_map).collect();
        let values = || curves.iter().flat_map(|curve| curve.points.iter().map(|point| point[0]));
        let [least, most] =
            values().fold([f64::INFINITY, 0.0], |[least, most]: [f64; 2], value| [least.min(value), most.max(value)]);
        let label = format!("σ / {}", kind.unit);
        let x = if most > WIDE * least { Axis::logarithmic(&label, values()) } else { Axis::around(&label, values()) };
        let y = Axis::around("share of the workspace / %", [0.0, 100.0]);
        (kind.name.to_owned(), Chart { x, y, curves, notes: Vec::new() })
    };
    Sheet {
        title: "Share of the workspace by accuracy".to_owned(),
        note: "Share of evenly spread poses whose single frame has a σ of at most that; three axes together."
            .to_owned(),
        panels: KINDS.iter().map(panel).collect(),
    }
    .draw("distribution", "Distribution of σ over the workspace.")
}
