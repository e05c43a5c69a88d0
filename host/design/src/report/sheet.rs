//! Charts side by side on one sheet, as all pictures of a report are.

use glam::dvec2;

use super::section::Picture;
use crate::plot::{Anchor, Canvas, Chart, TextStyle};

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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plot::{Axis, CurveStyle, curve};

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
