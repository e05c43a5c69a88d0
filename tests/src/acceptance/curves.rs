//! Curves over time, as a picture.

use glam::dvec2;
use slitpose_design::plot::{Anchor, Axis, Canvas, Chart, Curve, CurveStyle, Note, SOFT_INK, Scale, cell_colour};

/// A panel: what it shows, and its curves by name, each of (time in seconds, value).
#[derive(Clone, Debug)]
pub struct Panel {
    /// What it shows, with the unit.
    pub label: String,
    /// Whether the axis is logarithmic.
    pub is_logarithmic: bool,
    /// Names and points; a curve breaks where a value is no number.
    pub curves: Vec<(String, Vec<[f64; 2]>)>,
}

/// Sizes in pixels: of a plotting area, and of the room around it.
const WIDTH: f64 = 800.0;
const HEIGHT: f64 = 130.0;
const LEFT: f64 = 80.0;
const RIGHT: f64 = 20.0;
const ABOVE: f64 = 66.0;
const BELOW: f64 = 50.0;

/// The panels below each other as SVG, with a vertical line and a word at each of `marks`.
pub fn svg(title: &str, panels: &[Panel], marks: &[(f64, String)]) -> String {
    let points = || panels.iter().flat_map(|panel| &panel.curves).flat_map(|(_, points)| points);
    let end_s = points().map(|[at_s, _]| *at_s).fold(1.0, f64::max);
    let pitch = ABOVE + HEIGHT + BELOW;
    let mut canvas = Canvas::new(LEFT + WIDTH + RIGHT, panels.len() as f64 * pitch, title);
    for (number, panel) in panels.iter().enumerate() {
        let x = Axis { label: "$t$ (s)".to_owned(), range: [0.0, end_s], scale: Scale::Linear };
        let top_left = dvec2(LEFT, number as f64 * pitch + ABOVE);
        panel.chart(x, marks).draw(&mut canvas, top_left, top_left + dvec2(WIDTH, HEIGHT));
    }
    canvas.into_svg()
}

impl Panel {
    fn chart(&self, x: Axis, marks: &[(f64, String)]) -> Chart {
        let values = self.curves.iter().flat_map(|(_, points)| points).map(|[_, value]| *value);
        let values = values.filter(|value| value.is_finite());
        let y = if self.is_logarithmic {
            Axis::logarithmic(&self.label, values)
        } else {
            Axis::around(&self.label, values).starting_at_zero()
        };
        let line = |label: &str, colour, points: &[[f64; 2]]| Curve {
            label: label.to_owned(),
            colour,
            style: CurveStyle::Line,
            points: points.to_vec(),
        };
        let mark = |(at_s, _): &(f64, String)| Curve {
            style: CurveStyle::Dashed,
            ..line("", SOFT_INK, &y.range.map(|value| [*at_s, value]))
        };
        let mut curves: Vec<Curve> = marks.iter().map(mark).collect();
        for (number, (name, points)) in self.curves.iter().enumerate() {
            let parts = points.chunk_by(|[_, before], [_, value]| before.is_finite() == value.is_finite());
            let parts = parts.filter(|part| part[0][1].is_finite());
            // A name for the first part only, or the legend would have it again and again.
            let names = std::iter::once(name.as_str()).chain(std::iter::repeat(""));
            curves.extend(parts.zip(names).map(|(part, name)| line(name, cell_colour(number), part)));
        }
        let note = |(at_s, word): &(f64, String)| Note {
            at: [*at_s, y.range[1]],
            offset: dvec2(3.0, 13.0),
            anchor: Anchor::Start,
            text: word.clone(),
            colour: SOFT_INK,
        };
        let notes = marks.iter().map(note).collect();
        Chart { x, y, curves, notes }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_curve_breaks_where_nothing_was_measured() {
        let points = vec![[0.0, 1.0], [1.0, 2.0], [2.0, f64::NAN], [3.0, 1.0]];
        let panel = Panel { label: "h".to_owned(), is_logarithmic: false, curves: vec![("c".to_owned(), points)] };
        let chart = panel.chart(Axis::around("t", [0.0, 3.0]), &[(1.5, "K".to_owned())]);
        let parts: Vec<(&str, usize)> =
            chart.curves.iter().skip(1).map(|curve| (curve.label.as_str(), curve.points.len())).collect();
        assert_eq!(parts, [("c", 2), ("", 1)]);
        let text = svg("t", &[panel], &[(1.5, "K".to_owned())]);
        assert!(text.contains(">K<") && !text.contains("NaN"), "{text}");
    }
}
