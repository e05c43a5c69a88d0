//! The numbers of the solver's study.

use slitpose_model::{Photocurrents, Plan, Pose, Scene, Tier};

use super::{Entry, Light, PRIOR_M, PRIOR_RAD, Run};
use crate::report::accuracy::Errors;
use crate::report::head::{Head, STREAM, currents};
use crate::report::method::{Effort, Method, Precision, Start, effort_name, tier_name};
use crate::report::noise::NoiseSource;
use crate::report::section::{Column, Table, Value, column};
use crate::report::{ReportError, Settings};

/// Columns that identify a run in a table.
fn names(run: &Run) -> Vec<Value> {
    let light = if run.light == Light::Exact { "exact" } else { "paper" };
    let Method { tier, precision, start, effort } = run.method;
    vec![light.into(), tier_name(tier).into(), precision.name().into(), start.name().into(), effort_name(effort).into()]
}

const NAMES: [Column; 5] = [
    column("light", "light"),
    column("tier", "tier"),
    column("number", "numbers"),
    column("start", "start"),
    column("effort", "effort"),
];

pub(super) fn noisy(entries: &[Entry], bound: (f64, f64)) -> Table {
    let row = |entry: &Entry| {
        let (rms_m, rms_rad) = (entry.noisy.rms_m(), entry.noisy.rms_rad());
        let mut row = names(&entry.run);
        row.extend([
            Value::from(100.0 * entry.noisy.solved()),
            Value::from(rms_m * 1e6),
            Value::from(rms_rad * 1e6),
            Value::from(rms_m / bound.0),
            Value::from(rms_rad / bound.1),
            Value::from(entry.noisy.mean_iterations()),
            Value::from(entry.run_time.least_s * 1e6),
            Value::from(entry.run_time.median_s * 1e6),
        ]);
        row
    };
    Table {
        name: "solver_noisy",
        caption: "Noisy currents: error, its ratio to the Cramér–Rao bound, and time per solve".to_owned(),
        columns: NAMES
            .into_iter()
            .chain([
                column("solved_percent", "solved / %"),
                column("rms_um", "rms / µm"),
                column("rms_urad", "rms / µrad"),
                column("ratio_to_bound_translation", "translation to bound"),
                column("ratio_to_bound_rotation", "rotation to bound"),
                column("steps", "steps, mean"),
                column("least_us", "least / µs"),
                column("median_us", "median / µs"),
            ])
            .collect(),
        rows: entries.iter().map(row).collect(),
    }
}

pub(super) fn clean(entries: &[Entry]) -> Table {
    let row = |entry: &Entry| {
        let mut row = names(&entry.run);
        row.extend([
            Value::from(100.0 * entry.clean.solved()),
            Value::from(entry.clean.rms_m() * 1e6),
            Value::from(entry.clean.rms_rad() * 1e6),
            Value::from(entry.clean.median_m() * 1e6),
            Value::from(entry.clean.median_rad() * 1e6),
            Value::from(entry.clean.mean_iterations()),
        ]);
        row
    };
    Table {
        name: "solver_clean",
        caption: "The same with currents free of noise: what is left is the method's own error".to_owned(),
        columns: NAMES
            .into_iter()
            .chain([
                column("solved_percent", "solved / %"),
                column("rms_um", "rms / µm"),
                column("rms_urad", "rms / µrad"),
                column("median_um", "median / µm"),
                column("median_urad", "median / µrad"),
                column("steps", "steps, mean"),
            ])
            .collect(),
        rows: entries.iter().map(row).collect(),
    }
}

/// The numerical floor: no noise in the currents and none in the weights, so that a solve goes on
/// until arithmetic ends it.
pub(super) fn floor(head: &Head<'_>, settings: &Settings) -> Result<Table, ReportError> {
    let silent: Scene = head.silent();
    let mut noise = NoiseSource::seeded(settings.seed);
    let priors: Vec<Pose> = head.poses.iter().map(|pose| noise.near(pose, PRIOR_M, PRIOR_RAD)).collect();
    let mut rows = Vec::new();
    for tier in [Tier::Paper, STREAM, head.truth_tier] {
        // Each tier on its own light: the model is no part of this error.
        let own = if tier == Tier::Paper { tier } else { head.truth_tier };
        let plan = Plan::<f64>::compile(&silent, own)?;
        let readings: Vec<Photocurrents> = head.poses.iter().map(|pose| currents(&plan, pose)).collect();
        // What `f32` cannot keep it is not asked for.
        let kept = Precision::BOTH.into_iter().filter(|p| *p == Precision::Double || tier != head.truth_tier);
        for precision in kept {
            for start in Start::BOTH {
                let method = Method { tier, precision, start, effort: Effort::Full };
                let solve = method.compile(&silent)?;
                let solved = readings.iter().zip(&priors).map(|(readings, prior)| solve(readings, prior));
                let errors = Errors::of(solved.zip(&head.poses));
                rows.push(vec![
                    tier_name(tier).into(),
                    precision.name().into(),
                    start.name().into(),
                    Value::from(100.0 * errors.solved()),
                    Value::from(errors.rms_m() * 1e6),
                    Value::from(errors.rms_rad() * 1e6),
                    Value::from(errors.median_m() * 1e6),
                    Value::from(errors.median_rad() * 1e6),
                    Value::from(errors.mean_iterations()),
                ]);
            }
        }
    }
    Ok(Table {
        name: "solver_floor",
        caption: "Numerical floor: no noise in currents and weights, each tier in its own light".to_owned(),
        columns: vec![
            column("tier", "tier"),
            column("number", "numbers"),
            column("start", "start"),
            column("solved_percent", "solved / %"),
            column("rms_um", "rms / µm"),
            column("rms_urad", "rms / µrad"),
            column("median_um", "median / µm"),
            column("median_urad", "median / µrad"),
            column("steps", "steps, mean"),
        ],
        rows,
    })
}
