//! Charts side by side on one sheet, as all pictures of a report are.

use glam::dvec2;

use super::section::Picture;
use crate::plot::{Anchor, Canvas, Chart, Colour, Curve, CurveStyle, Stroke, TextStyle, cell_colour};

const LEFT: f64 = 84.0;
const GAP: f64 = 84.0;
const RIGHT: f64 = 24.0;
const HEIGHT: f64 = 380.0;

/// Width of a plotting area that has the sheet for itself, and of one of two.
const ALONE: f64 = 660.0;
const OF_TWO: f64 = 400.0;

/// Charts with a common legend: that of the first.
pub(super) struct Sheet {
    pub(super) title: String,
    /// Conditions, in one line.
    pub(super) note: String,
    /// Heading and chart of each panel.
    pub(super) panels: Vec<(String, Chart)>,
}

impl Sheet {
    /// The finished picture.
    pub(super) fn draw(mut self, name: &'static str, caption: &str) -> Picture {
        for (_, chart) in self.panels.iter_mut().skip(1) {
            for curve in &mut chart.curves {
                curve.label.clear();
            }
        }
        let width = if self.panels.len() == 1 { ALONE } else { OF_TWO };
        let legend = self.panels.first().map_or(0.0, |(_, chart)| chart.legend_height());
        let top = 66.0 + legend;
        let full = LEFT + self.panels.len() as f64 * (width + GAP) - GAP + RIGHT;
        let mut canvas = Canvas::new(full, top + HEIGHT + 56.0, &self.title);
        canvas.text(dvec2(20.0, 30.0), &self.title, TextStyle::new(16.0).bold());
        canvas.text(dvec2(20.0, 50.0), &self.note, TextStyle::new(12.0));
        for (index, (heading, chart)) in self.panels.iter().enumerate() {
            let left = LEFT + index as f64 * (width + GAP);
            let (top_left, bottom_right) = (dvec2(left, top), dvec2(left + width, top + HEIGHT));
            chart.draw(&mut canvas, top_left, bottom_right);
            let at = dvec2(bottom_right.x, top - 10.0);
            canvas.text(at, heading, TextStyle::new(13.0).bold().anchored(Anchor::End));
        }
        Picture { name, caption: caption.to_owned(), svg: canvas.into_svg() }
    }
}

/// A curve of the report's own colours.
pub(super) fn curve(label: &str, colour: usize, style: CurveStyle, points: Vec<[f64; 2]>) -> Curve {
    Curve { label: label.to_owned(), colour: cell_colour(colour), style, points }
}

/// One row of a chart of bars.
pub(super) struct Bar {
    pub(super) label: String,
    /// Lengths, one for each kind of bar.
    pub(super) lengths: Vec<f64>,
    /// Whether a gap precedes it.
    pub(super) opens_group: bool,
}

/// Horizontal bars with their numbers, several kinds of them for each row.
pub(super) fn bars(
    name: &'static str,
    title: &str,
    note: &str,
    caption: &str,
    kinds: &[&str],
    bars: &[Bar],
) -> Picture {
    const LABELS: f64 = 250.0;
    const NUMBERS: f64 = 56.0;
    const THICK: f64 = 9.0;
    let row = THICK * kinds.len() as f64 + 7.0;
    let groups = bars.iter().filter(|bar| bar.opens_group).count() as f64;
    let top = 72.0 + 18.0 * kinds.len() as f64;
    let mut canvas = Canvas::new(LABELS + ALONE, top + row * bars.len() as f64 + 12.0 * groups + 16.0, title);
    canvas.text(dvec2(20.0, 30.0), title, TextStyle::new(16.0).bold());
    canvas.text(dvec2(20.0, 50.0), note, TextStyle::new(12.0));
    let longest = bars.iter().flat_map(|bar| &bar.lengths).copied().filter(|l| l.is_finite()).fold(1.0, f64::max);
    let scale = (ALONE - NUMBERS - RIGHT) / longest;
    for (kind, label) in kinds.iter().enumerate() {
        let y = 66.0 + 18.0 * kind as f64;
        block(&mut canvas, [LABELS, y], [28.0, THICK], cell_colour(kind));
        canvas.text(dvec2(LABELS + 36.0, y + 9.0), label, TextStyle::new(13.0));
    }
    let mut y = top;
    for bar in bars {
        y += if bar.opens_group { 12.0 } else { 0.0 };
        let middle = y + 0.5 * THICK * kinds.len() as f64 + 4.5;
        canvas.text(dvec2(LABELS - 10.0, middle), &bar.label, TextStyle::new(13.0).anchored(Anchor::End));
        for (kind, &length) in bar.lengths.iter().enumerate().filter(|(_, length)| length.is_finite()) {
            let at = y + THICK * kind as f64;
            block(&mut canvas, [LABELS, at], [length * scale, THICK - 1.0], cell_colour(kind));
            let number = dvec2(LABELS + length * scale + 6.0, at + THICK - 1.0);
            canvas.text(number, &format!("{length:.2}"), TextStyle::new(10.5));
        }
        y += row;
    }
    // What the ratios are of.
    let one = LABELS + scale;
    canvas.line(dvec2(one, top), dvec2(one, y), Stroke::new(crate::plot::SOFT_INK, 1.0).dashed(3.0, 3.0));
    Picture { name, caption: caption.to_owned(), svg: canvas.into_svg() }
}

fn block(canvas: &mut Canvas, [x, y]: [f64; 2], [width, height]: [f64; 2], fill: Colour) {
    let corners = [dvec2(x, y), dvec2(x + width, y), dvec2(x + width, y + height), dvec2(x, y + height)];
    canvas.area(&corners, fill, 1.0);
}
