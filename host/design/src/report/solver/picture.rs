//! Error against time, drawn.

use glam::dvec2;
use slitpose_model::Tier;

use super::{Entry, searched};
use crate::plot::curve;
use crate::plot::{Anchor, Axis, Chart, Curve, CurveStyle, Note, SOFT_INK, cell_colour};
use crate::report::head::{Errors, Head, STREAM};
use crate::report::method::{Effort, Method, Precision, Start, effort_name, tier_name};
use crate::report::section::{Picture, Value};
use crate::report::sheet::Sheet;

/// Which half of a pose a picture shows.
pub(super) struct Half {
    name: &'static str,
    /// What of the pose, in the picture's title.
    what: &'static str,
    caption: &'static str,
    axis: &'static str,
    rms: fn(&Errors) -> f64,
}

pub(super) const TRANSLATION: Half = Half {
    name: "work-precision",
    what: "translation",
    caption: "Error of the translation against time per solve. Each curve goes from the first guess step by step, a lone \
              point is the full solve; lower and further left is better; below the bound nothing comes but by chance.",
    axis: "rms error of the translation / µm",
    rms: Errors::rms_m,
};

pub(super) const ROTATION: Half = Half {
    name: "work-precision-rotation",
    what: "rotation",
    caption: "The same for the rotation.",
    axis: "rms error of the rotation / µrad",
    rms: Errors::rms_rad,
};

/// Draws noisy and noise-free currents side by side; `bound` is the Cramér–Rao bound, m or rad.
pub(super) fn picture(entries: &[Entry], head: &Head<'_>, bound: f64, half: &Half) -> Picture {
    let tight = format!("{}, cold start", tier_name(head.truth_tier).replace("exact", "exact tier at"));
    let panel = |heading: &str, errors: fn(&Entry) -> &Errors, floor: Option<f64>| {
        let point = |entry: &Entry| [entry.run_time.least_s * 1e6, (half.rms)(errors(entry)) * 1e6];
        let chosen = |tier: Tier, start, precision| {
            entries.iter().filter(move |entry| {
                let Method { tier: t, precision: p, start: s, .. } = entry.method;
                (t, p, s) == (tier, precision, start)
            })
        };
        let is_shown = |entry: &&Entry| !searched(errors(entry));
        let mut curves = Vec::new();
        for (colour, (name, tier, start)) in [
            ("exact tier, cold start", STREAM, Start::Cold),
            ("exact tier, warm start", STREAM, Start::Warm),
            ("paper tier, cold start", Tier::Paper, Start::Cold),
            ("paper tier, warm start", Tier::Paper, Start::Warm),
            (tight.as_str(), head.truth_tier, Start::Cold),
        ]
        .into_iter()
        .enumerate()
        {
            let points = |precision, full: bool| {
                let is_full = move |entry: &&Entry| (entry.method.effort == Effort::Full) == full;
                chosen(tier, start, precision).filter(is_shown).filter(is_full).map(point).collect::<Vec<_>>()
            };
            curves.push(curve(name, colour, CurveStyle::Joined, points(Precision::Double, false)));
            curves.push(curve("", colour, CurveStyle::DashedRings, points(Precision::Single, false)));
            // A full solve goes its own way: it is no further step.
            curves.push(curve("", colour, CurveStyle::Markers, points(Precision::Double, true)));
            curves.push(curve("", colour, CurveStyle::Rings, points(Precision::Single, true)));
        }
        let all = || curves.iter().flat_map(|curve: &Curve| curve.points.clone());
        let x = Axis::logarithmic("time per solve / µs", all().map(|point| point[0]));
        let y = Axis::logarithmic(half.axis, all().map(|point| point[1]).chain(floor.map(|floor| floor * 1e6)));
        let mut notes = Vec::new();
        let mut note = |at, offset, anchor, text: &str, colour| {
            notes.push(Note { at, offset, anchor, text: text.to_owned(), colour });
        };
        // The clearest curve says what its points are, as far as they do not lie on the bound.
        let is_apart = |entry: &&Entry| floor.is_none_or(|floor| (half.rms)(errors(entry)) > 2.0 * floor);
        for entry in chosen(STREAM, Start::Cold, Precision::Double).take(2).filter(is_apart) {
            let text = effort_name(entry.method.effort);
            note(point(entry), dvec2(9.0, -5.0), Anchor::Start, &text, cell_colour(0));
        }
        for start in Start::BOTH {
            let full = chosen(STREAM, start, Precision::Double).filter(is_shown).rfind(is_apart);
            if let Some(entry) = full.filter(|_| floor.is_none()) {
                let colour = if start == Start::Cold { 0 } else { 1 };
                note(point(entry), dvec2(0.0, 18.0), Anchor::Middle, "full", cell_colour(colour));
            }
        }
        let beyond = chosen(Tier::Paper, Start::Cold, Precision::Double).find(|entry| !is_shown(entry));
        if let Some(entry) = beyond {
            let [time, error] = point(entry);
            let text = format!("paper tier in full: {} µs →", Value::from(time).shown());
            note([x.range[1], error], dvec2(-8.0, 16.0), Anchor::End, &text, cell_colour(2));
        }
        if let Some(floor) = floor {
            let points = x.range.map(|x| [x, floor * 1e6]).to_vec();
            let text = "Cramér–Rao bound of one frame";
            note([x.range[0], floor * 1e6], dvec2(8.0, 16.0), Anchor::Start, text, SOFT_INK);
            curves.push(Curve { label: String::new(), colour: SOFT_INK, style: CurveStyle::Dashed, points });
        }
        (heading.to_owned(), Chart { x, y, curves, notes })
    };
    Sheet {
        title: format!("Pose from {} cells: error of the {} against time", head.scene.cells.len(), half.what),
        note: format!(
            "{}; {} poses, one frame each; one thread. Discs f64, rings f32; curves: planes (from a cold start), 1, 2, 3, 4 \
             steps; lone points: full.",
            head.file.name,
            head.poses.len()
        ),
        panels: vec![
            panel("noisy currents", |entry| &entry.noisy, Some(bound)),
            panel("currents free of noise", |entry| &entry.clean, None),
        ],
    }
    .draw(half.name, half.caption)
}
