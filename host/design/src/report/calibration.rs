//! A page on one calibration: residuals, what the data showed, and what a user may quote.

use slitpose_calibration::{Calibrated, Calibration, Residual};
use slitpose_head::scene_file::SceneFile;
use slitpose_model::Pose;

use super::section::{Report, Section, Sheet, Table, program, scene};
use crate::plot::{Axis, Chart, CurveStyle, curve};
use crate::survey::AXES;

/// Readings drawn of each cell, at most: more hide each other.
const DRAWN: usize = 400;

/// Bars of a histogram, each half a σ wide.
const BARS: usize = 24;

/// The report on `calibrated`, made with the scene `file` at most `date`.
pub fn calibration_report(file: &SceneFile, calibrated: &Calibrated) -> Report {
    let calibration = &calibrated.calibration;
    let statistics = &calibration.statistics;
    let mut conditions = vec![
        program(),
        scene(file),
        ("calibration", format!("{}, hash {:016x}", calibration.id, calibration.hash())),
        ("data", format!("{} rows, {} readings of single cells", statistics.rows, statistics.readings)),
        (
            "left out",
            format!("{} readings and {} poses as outliers", statistics.readings_rejected, statistics.poses_rejected),
        ),
    ];
    if let Some(date) = &calibration.date {
        conditions.insert(2, ("date", date.to_owned()));
    }
    Report {
        title: "Calibration",
        scene: file.name.clone(),
        conditions,
        warnings: calibrated.remarks.clone(),
        sections: [fit(calibrated), open(file, calibration), observability(calibration)]
            .into_iter()
            .chain(instruments(calibration))
            .chain([parameters(calibration)])
            .collect(),
        data: Vec::new(),
    }
}

fn fit(calibrated: &Calibrated) -> Section {
    let (calibration, residuals) = (&calibrated.calibration, &calibrated.residuals);
    let statistics = &calibration.statistics;
    let cells = calibration.model_errors.len();
    let mut summary = vec![format!(
        "χ² is {:.2} of its expectation, model errors and priors counted.",
        statistics.chi2 / statistics.redundancy
    )];
    if let (Some(metres), Some(radians)) = (statistics.held_out_m, statistics.held_out_rad) {
        summary.insert(
            0,
            format!(
                "Poses that were left out in turn, in four blocks, miss those of the instrument by {:.1} µm and {:.3} mrad \
                 (rms), errors of the instrument included: the number to quote.",
                metres * 1e6,
                radians * 1e3
            ),
        );
    }
    let rms = |cell: usize, of: &dyn Fn(&Residual) -> f64| {
        let values: Vec<f64> = residuals.iter().filter(|residual| residual.cell == cell).map(of).collect();
        (values.iter().map(|value| value * value).sum::<f64>() / values.len().max(1) as f64).sqrt()
    };
    let before = |cell: &usize, axis: usize| rms(*cell, &|residual| residual.before[axis]);
    let after = |cell: &usize, axis: usize| rms(*cell, &|residual| residual.after[axis]);
    let numbers: Vec<usize> = (0..cells).collect();
    let over = |name, title: &str, caption: &str, label: &str, x: &dyn Fn(&Residual) -> f64| {
        let panel = |heading: &str, y: &dyn Fn(&Residual) -> f64| {
            let of_cell = |cell: usize| {
                let own: Vec<_> = residuals.iter().filter(|residual| residual.cell == cell).collect();
                let every = own.len().div_ceil(DRAWN).max(1);
                let points = own.iter().step_by(every).map(|residual| [x(residual), y(residual)]).collect();
                curve(&format!("cell {cell}"), cell, CurveStyle::Markers, points)
            };
            let curves = (0..cells).map(of_cell).collect();
            let chart = Chart::over(curves, |x| Axis::around(label, x), |y| Axis::around("position / µm", y));
            (heading.to_owned(), chart)
        };
        Sheet {
            title: title.to_owned(),
            note: "Position of the light on each detector, measured minus model; mind the scales.".to_owned(),
            panels: vec![
                panel("before", &|residual| residual.before[1] * 1e6),
                panel("after", &|residual| residual.after[1] * 1e6),
            ],
        }
        .draw(name, caption)
    };
    Section {
        name: "fit",
        title: "How well the model fits",
        summary,
        paragraphs: vec![
            "Before: against the most probable head of the tolerances. After: against the calibrated one. A pattern that \
             is left after calibration is what the model cannot describe; its size is the model error of the cell, \
             which is part of the uncertainty of every pose."
                .to_owned(),
        ],
        pictures: vec![
            over("over_position", "Residuals over the position on the detector", "Residuals over position, before and after.", "position on the detector / mm", &|residual| {
                residual.position_m * 1e3
            }),
            over("over_angle", "Residuals over the angle of the beam", "Residuals over the angle at the emitter, before and after.", "angle γ / °", &|residual| {
                residual.angle_rad.to_degrees()
            }),
            histogram(residuals),
        ],
        tables: vec![Table::of(
            "cells",
            "Residuals of each cell, rms, and the model error that its poses are told",
            &numbers,
            &[
                ("cell", "cell", &|cell| (*cell).into()),
                ("light_before_percent", "light before / %", &|cell| (1e2 * before(cell, 0)).into()),
                ("light_after_percent", "after / %", &|cell| (1e2 * after(cell, 0)).into()),
                ("position_before_um", "position before / µm", &|cell| (1e6 * before(cell, 1)).into()),
                ("position_after_um", "after / µm", &|cell| (1e6 * after(cell, 1)).into()),
                ("model_error_percent", "model error / %", &|cell| {
                    (1e2 * calibration.model_errors[*cell].relative).into()
                }),
                ("model_error_um", "/ µm", &|cell| (1e6 * calibration.model_errors[*cell].position_m).into()),
            ],
        )],
    }
}

fn histogram(residuals: &[Residual]) -> super::section::Picture {
    let values: Vec<f64> = residuals.iter().flat_map(|residual| residual.normalised).collect();
    let width = 12.0 / BARS as f64;
    let density = |bar: usize| {
        let from = -6.0 + width * bar as f64;
        let count = values.iter().filter(|value| **value >= from && **value < from + width).count();
        count as f64 / (values.len().max(1) as f64 * width)
    };
    let steps = (0..BARS).flat_map(|bar| {
        let from = -6.0 + width * bar as f64;
        [[from, density(bar)], [from + width, density(bar)]]
    });
    let normal = (0..=120).map(|k| {
        let x = 0.1 * f64::from(k) - 6.0;
        [x, (-0.5 * x * x).exp() / std::f64::consts::TAU.sqrt()]
    });
    let curves = vec![
        curve("residuals", 0, CurveStyle::Line, steps.collect()),
        curve("normal distribution", 1, CurveStyle::Dashed, normal.collect()),
    ];
    let x = |_| Axis::around("residual / σ", [-6.0, 6.0]);
    let chart = Chart::over(curves, x, |y| Axis::around("density", y).starting_at_zero());
    Sheet {
        title: "Residuals in units of their σ".to_owned(),
        note: "Noise and model error together; parameters and poses take up a part.".to_owned(),
        panels: vec![(String::new(), chart)],
    }
    .draw("histogram", "Distribution of the normalised residuals after calibration.")
}

fn observability(calibration: &Calibration) -> Section {
    let directions = calibration.directions();
    let points: Vec<[f64; 2]> =
        directions.iter().enumerate().map(|(k, direction)| [(k + 1) as f64, direction.sigma.max(1e-6)]).collect();
    let chart = Chart::over(
        vec![curve("", 0, CurveStyle::Line, points)],
        |x| Axis::around("direction, the weakest first", x),
        |y| Axis::logarithmic("σ after by σ before", y),
    );
    let picture = Sheet {
        title: "What the data showed".to_owned(),
        note: "Singular values of what is left open, in units of the tolerances: 1 is as unknown as before.".to_owned(),
        panels: vec![(String::new(), chart)],
    }
    .draw("spectrum", "Uncertainty along the principal directions of the parameters.");
    let row = |(number, direction): (usize, &slitpose_calibration::Direction<'_>)| {
        let shares: Vec<String> =
            direction.shares.iter().map(|(entry, share)| format!("{:+.2} {}", share, entry.name())).collect();
        vec![(number + 1).into(), direction.sigma.into(), shares.join(", ").into()]
    };
    Section {
        name: "observability",
        title: "What the data showed, and what not",
        summary: calibration.weak.iter().map(|weak| format!("Open: {weak}.")).collect(),
        paragraphs: vec![
            "Each direction is a mixture of parameters that changes the readings as one. A weak direction harms poses only \
             if it changes them; the chapter before shows how much all of them do together."
                .to_owned(),
        ],
        pictures: vec![picture],
        tables: vec![Table {
            name: "weak_directions",
            caption: "The weakest directions, and the parameters with the largest shares, in units of their tolerances".to_owned(),
            columns: vec![("number", "no."), ("sigma_ratio", "σ after by before"), ("shares", "shares")],
            rows: directions.iter().take(5).enumerate().map(row).collect(),
        }],
    }
}

fn open(file: &SceneFile, calibration: &Calibration) -> Section {
    const STEPS: i32 = 20;
    let panel = |heading: &str, unit: f64, axes: std::ops::Range<usize>, label: &str| {
        let along = |axis: usize| {
            let points = (-STEPS..=STEPS).map(|step| {
                let share = f64::from(step) / f64::from(STEPS);
                let mut translation = glam::DVec3::ZERO;
                translation[axis] = share * file.workspace.half_extent_m[axis];
                let pose = Pose { translation_m: translation, ..Pose::HOME };
                let covariance = calibration.pose_covariance(&pose);
                let variance: f64 = axes.clone().map(|k| covariance[k][k]).sum();
                [translation[axis] * 1e3, variance.sqrt() * unit]
            });
            curve(["along x", "along y", "along z"][axis], axis, CurveStyle::Line, points.collect())
        };
        let x = |x| Axis::around("translation / mm", x);
        let chart = Chart::over((0..3).map(along).collect(), x, |y| Axis::around(label, y).starting_at_zero());
        (heading.to_owned(), chart)
    };
    let home = calibration.pose_covariance(&Pose::HOME);
    let root = |axes: std::ops::Range<usize>| axes.map(|k| home[k][k]).sum::<f64>().sqrt();
    let picture = Sheet {
        title: "What calibration leaves open in poses".to_owned(),
        note: "The same error at every visit of a pose; noise and model error of a frame come on top.".to_owned(),
        panels: vec![panel("translation", 1e6, 0..3, "σ / µm"), panel("rotation", 1e3, 3..6, "σ / mrad")],
    }
    .draw("open", "Standard deviation of poses by the parameters, over the workspace.");
    Section {
        name: "open",
        title: "What it means for poses",
        summary: vec![format!(
            "With the tool at home the parameters leave {:.2} µm and {:.3} mrad open.",
            root(0..3) * 1e6,
            root(3..6) * 1e3
        )],
        pictures: vec![picture],
        ..Section::default()
    }
}

/// Frames of the instruments, if they have their own.
fn instruments(calibration: &Calibration) -> Option<Section> {
    let rows = calibration.frames.iter().flat_map(|frames| {
        let transforms = [
            ("base_from_reference", frames.base_from_reference, frames.base_from_reference_sigma),
            ("tool_from_marker", frames.tool_from_marker, frames.tool_from_marker_sigma),
        ];
        let each = transforms.into_iter().flat_map(|transform| (0..6).map(move |axis| (transform, axis)));
        each.map(|((name, values, sigmas), axis)| (frames.file.as_str(), name, axis, [values[axis], sigmas[axis]]))
    });
    let rows: Vec<(&str, &str, usize, [f64; 2])> = rows.collect();
    (!rows.is_empty()).then(|| Section {
        name: "instruments",
        title: "Instruments",
        paragraphs: vec!["Where an instrument's frame and marker lie, as found.".to_owned()],
        tables: vec![Table::of(
            "instruments",
            "Frames of the instruments",
            &rows,
            &[
                ("file", "file", &|(file, ..)| (*file).into()),
                ("quantity", "quantity", &|(_, name, axis, _)| format!("{name}, {}", AXES[*axis]).into()),
                ("unit", "unit", &|(_, _, axis, _)| if *axis < 3 { "mm" } else { "mrad" }.into()),
                ("value", "value", &|(.., [value, _])| (value * 1e3).into()),
                ("sigma", "σ", &|(.., [_, sigma])| (sigma * 1e3).into()),
            ],
        )],
        ..Section::default()
    })
}

fn parameters(calibration: &Calibration) -> Section {
    Section {
        name: "parameters",
        title: "Parameters",
        paragraphs: vec![
            "Each as its deviation from the scene. The shift is counted in σ of the tolerance: far beyond 3, the part is \
             not what the scene says, or the tolerance is too narrow."
                .to_owned(),
        ],
        tables: vec![Table::of(
            "parameters",
            "All parameters",
            calibration.parameters(),
            &[
                ("parameter", "parameter", &|entry| entry.name().into()),
                ("unit", "unit", &|entry| entry.quantity.unit().into()),
                ("value", "value", &|entry| entry.value.into()),
                ("sigma", "σ", &|entry| entry.sigma.into()),
                ("prior", "before", &|entry| entry.prior.into()),
                ("prior_sigma", "σ before", &|entry| entry.prior_sigma.into()),
                ("shift", "shift / σ before", &|entry| entry.shift().into()),
                ("sigma_ratio", "σ after by before", &|entry| (entry.sigma / entry.prior_sigma).into()),
            ],
        )],
        ..Section::default()
    }
}
