//! A page on the accuracy of a head over its workspace: `slitpose scene map`.

mod accuracy;
mod checks;
mod data;
mod planes;
mod schedules;
mod tolerances;

use slitpose_calibration::Head;
use slitpose_head::causes::with_causes;
use slitpose_head::front_end::configuration;

pub(super) use accuracy::distribution;

use super::conditions::{program, scene};
use super::section::{Report, Value};
use crate::map::{Map, NoiseOf, PlanePoint, Schedules, Tolerances, View};
use crate::survey::WorkspaceFacts;

/// A value of a view.
type Of = fn(&View) -> Option<f64>;

/// What of a pose is shown, its three axes together.
pub(super) struct Kind {
    pub(super) name: &'static str,
    pub(super) unit: &'static str,
    /// From SI to `unit`.
    pub(super) scale: f64,
    pub(super) of: Of,
    /// The worst behind a point of a plane.
    worst: fn(&PlanePoint) -> f64,
}

const POSITION: Kind =
    Kind { name: "position", unit: "µm", scale: 1e6, of: View::sigma_m, worst: |point| point.worst_m };
const ROTATION: Kind =
    Kind { name: "rotation", unit: "mrad", scale: 1e3, of: View::sigma_rad, worst: |point| point.worst_rad };
pub(super) const KINDS: [Kind; 2] = [POSITION, ROTATION];

/// The report on `map` of `head`, with what its tolerances cost and schedules do, if that was studied.
pub fn map_report(head: &Head, map: &Map, studied: Option<&Tolerances>, proposed: Option<&Schedules>) -> Report {
    let file = &head.file;
    let noise = match map.noise {
        NoiseOf::FrontEnd => "that of a single frame by `[front_end]` and `[lighting]`",
        NoiseOf::Channel => "that of the measuring channel of `[noise]`",
        NoiseOf::Nothing => "none: what is left is the arithmetic of the model",
    };
    let mut conditions = vec![
        program(),
        scene(file),
        ("workspace", WorkspaceFacts::from(file.workspace).to_string()),
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
        warnings.push(format!("The noise is not that of the front end: {}.", with_causes(&error)));
    }
    Report {
        title: "Accuracy over the workspace",
        scene: file.name.clone(),
        conditions,
        warnings,
        sections: [accuracy::section(map)]
            .into_iter()
            .chain(planes::section(map))
            .chain([checks::redundancy(map), checks::margins(map)])
            .chain(proposed.map(schedules::section))
            .chain(studied.map(|studied| tolerances::section(studied, file.tolerance.is_some())))
            .collect(),
        leading: 0,
        data: vec![data::points(map), data::samples(map)],
    }
}

fn micro(value: f64) -> Value {
    Value::from(value * 1e6)
}
