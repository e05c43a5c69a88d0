//! All poses of a map as tables.

use slitpose_model::Pose;

use super::micro;
use crate::map::{Map, Plane, PlanePoint, View};
use crate::report::section::{Column, Table, Value, column};
use crate::survey::AXES;

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

const VIEW: [Column; 9] = [
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

pub(super) fn points(map: &Map) -> Table {
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

pub(super) fn samples(map: &Map) -> Table {
    let mut columns: Vec<_> =
        ["tx_mm", "ty_mm", "tz_mm", "rx_rad", "ry_rad", "rz_rad"].map(|name| column(name, name)).into();
    columns.extend(VIEW);
    let row = |(pose, view): &(Pose, View)| {
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
