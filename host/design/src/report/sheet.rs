//! Charts side by side on one sheet, as all pictures of a report are.

use glam::dvec2;

use super::section::{Picture, Value};
use crate::plot::{Anchor, Axis, Canvas, Chart, CurveStyle, SOFT_INK, Scale, Stroke, TextStyle, cell_colour, curve};

const LEFT: f64 = 84.0;
const GAP: f64 = 84.0;
const RIGHT: f64 = 24.0;
const HEIGHT: f64 = 380.0;

/// Between legend and plotting area: the headings of the panels.
const HEADING: f64 = 22.0;

/// Width of a plotting area that has the sheet for itself, and of one of two.
const ALONE: f64 = 660.0;
const OF_TWO: f64 = 400.0;

/// Charts with a common legend: that of the first.
pub(super) struct Sheet {
    pub(super) title: String,
    /// Conditions, in one line.
    pub(super) note: String,
    pub(super) panels: Vec<(String, Chart)>,
}

impl Sheet {
    pub(super) fn draw(mut self, name: &'static str, caption: &str) -> Picture {
        for (_, chart) in self.panels.iter_mut().skip(1) {
            for curve in &mut chart.curves {
                curve.label.clear();
            }
        }
        let width = if self.panels.len() == 1 { ALONE } else { OF_TWO };
        let legend = self.panels.first().map_or(0.0, |(_, chart)| chart.legend_height());
        let top = 66.0 + legend + HEADING;
        let full = LEFT + self.panels.len() as f64 * (width + GAP) - GAP + RIGHT;
        let mut canvas = Canvas::titled(full, top + HEIGHT + 56.0, &self.title, &self.note);
        for (index, (heading, chart)) in self.panels.iter().enumerate() {
            let left = LEFT + index as f64 * (width + GAP);
            let (top_left, bottom_right) = (dvec2(left, top), dvec2(left + width, top + HEIGHT));
            chart.draw_with_legend(&mut canvas, top_left, bottom_right, top_left - dvec2(0.0, HEADING));
            let at = dvec2(bottom_right.x, top - 10.0);
            canvas.text(at, heading, TextStyle::new(13.0).bold().anchored(Anchor::End));
        }
        Picture { name, caption: caption.to_owned(), svg: canvas.into_svg() }
    }
}

/// One row of a chart of ratios.
pub(super) struct Row {
    pub(super) label: String,
    /// Ratios, one of each kind.
    pub(super) ratios: Vec<f64>,
    /// Whether a gap precedes it.
    pub(super) opens_group: bool,
}

/// Ratios as stalks that grow from 1 to either side, on a logarithmic axis, several kinds of them
/// for each row.
pub(super) fn ratios(
    name: &'static str,
    title: &str,
    note: &str,
    caption: &str,
    kinds: &[&str],
    rows: &[Row],
) -> Picture {
    const LABELS: f64 = 230.0;
    const STALK: f64 = 13.0;
    let height = STALK * kinds.len() as f64 + 5.0;
    let gaps = 8.0 * rows.iter().filter(|row| row.opens_group).count() as f64;
    let top = 76.0 + 18.0 * kinds.len() as f64;
    let bottom = top + height * rows.len() as f64 + gaps + 6.0;
    let mut canvas = Canvas::titled(LABELS + ALONE, bottom + 56.0, title, note);
    let all = || rows.iter().flat_map(|row| row.ratios.iter().copied());
    // Room for the number beside the longest stalk.
    let mut x = Axis::logarithmic("ratio of times", all().chain([0.5, 10.0]));
    x.range[1] *= 2.0;
    let kind = |(index, label): (usize, &&str)| curve(label, index, CurveStyle::Joined, Vec::new());
    let y = Axis { label: String::new(), range: [0.0, 1.0], scale: Scale::Bare };
    let chart = Chart { x, y, curves: kinds.iter().enumerate().map(kind).collect(), notes: Vec::new() };
    let (top_left, bottom_right) = (dvec2(LABELS, top), dvec2(LABELS + ALONE - RIGHT, bottom));
    chart.draw(&mut canvas, top_left, bottom_right);
    let place = |ratio: f64| top_left.x + chart.x.share(ratio) * (bottom_right.x - top_left.x);
    let one = place(1.0);
    canvas.line(dvec2(one, top), dvec2(one, bottom), Stroke::new(SOFT_INK, 1.2));
    let mut y = top + 4.0;
    for row in rows {
        y += if row.opens_group { 8.0 } else { 0.0 };
        let middle = y + 0.5 * STALK * kinds.len() as f64 + 4.5;
        canvas.text(dvec2(LABELS - 10.0, middle), &row.label, TextStyle::new(13.0).anchored(Anchor::End));
        for (kind, &ratio) in row.ratios.iter().enumerate().filter(|(_, ratio)| **ratio > 0.0 && ratio.is_finite()) {
            let (at, colour) = (dvec2(place(ratio), y + STALK * (kind as f64 + 0.5)), cell_colour(kind));
            canvas.line(dvec2(one, at.y), at, Stroke::new(colour, 3.0));
            canvas.disc(at, 3.4, colour, Stroke::new(colour, 0.5));
            // Beside the end, never on the stalk.
            let number = at.with_x(at.x.max(one)) + dvec2(8.0, 4.0);
            canvas.text(number, &Value::from(ratio).shown(), TextStyle::new(11.0).coloured(SOFT_INK));
        }
        y += height;
    }
    Picture { name, caption: caption.to_owned(), svg: canvas.into_svg() }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_legend_stands_above_the_headings_however_long_it_is() {
        let label = "a curve with a name as long as the panel is wide, or longer";
        let chart = |label: &str| Chart {
            x: Axis::around("x", [0.0, 1.0]),
            y: Axis::around("y", [0.0, 1.0]),
            curves: vec![curve(label, 0, CurveStyle::Line, vec![[0.0, 0.0], [1.0, 1.0]])],
            notes: Vec::new(),
        };
        let panels = vec![("first heading".to_owned(), chart(label)), ("second heading".to_owned(), chart(label))];
        let svg = Sheet { title: "t".to_owned(), note: "n".to_owned(), panels }.draw("name", "").svg;
        let height_of = |text: &str| -> f64 {
            let element = svg[..svg.find(text).unwrap()].rfind("translate(").unwrap();
            let place = svg[element..].split([' ', ')']).nth(1).unwrap();
            place.parse().unwrap()
        };
        // Letters of 13 pixels reach some 10 above their base line.
        for heading in ["first heading", "second heading"] {
            assert!(height_of(heading) - height_of(label) >= 14.0, "{svg}");
        }
    }
}
