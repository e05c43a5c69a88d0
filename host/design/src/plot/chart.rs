//! Curves over axes.

use glam::{DVec2, dvec2};

use super::canvas::{
    Anchor, Canvas, Colour, FAINT, INK, PALE, SOFT_INK, Stroke, TextStyle, cell_colour, decades, quantity, ticks,
};

const LABEL: TextStyle = TextStyle::new(13.0);
/// Of numbers and notes.
const TICK: TextStyle = TextStyle::new(12.0).coloured(SOFT_INK);
const MARKER_RADIUS: f64 = 3.2;

/// A curve with markers is thinner than one without: the markers are the measured points.
const JOINED_WIDTH: f64 = 1.2;

/// Pixels between ticks, at least: room for a number.
const TICK_ROOM: DVec2 = DVec2::new(70.0, 30.0);

/// How numbers are spread along an axis.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Scale {
    /// Equal differences are equal distances.
    Linear,
    /// Equal ratios are equal distances; every number must be above zero.
    Logarithmic,
    /// As linear, but without ticks and numbers: its entries have names.
    Bare,
}

#[derive(Clone, Debug)]
pub(crate) struct Axis {
    /// Name and unit; formulas between `$`.
    pub(crate) label: String,
    /// The least and the largest number shown.
    pub(crate) range: [f64; 2],
    /// How numbers are spread between them.
    pub(crate) scale: Scale,
}

impl Axis {
    /// An axis that shows all of `values`, with a twentieth of their span around them.
    pub(crate) fn around(label: &str, values: impl IntoIterator<Item = f64>) -> Self {
        let [least, most] = extent(values);
        let margin = if most > least { 0.05 * (most - least) } else { 1.0 };
        Self { label: label.to_owned(), range: [least - margin, most + margin], scale: Scale::Linear }
    }

    /// A logarithmic axis that shows all of `values` that are above zero, with a twentieth of their
    /// span around them, and at least one whole decade.
    pub(crate) fn logarithmic(label: &str, values: impl IntoIterator<Item = f64>) -> Self {
        let positive = values.into_iter().filter(|value| *value > 0.0 && value.is_finite()).map(f64::log10);
        let [least, most] = extent(positive);
        let (least, most) = if most >= least { (least, most) } else { (0.0, 1.0) };
        let margin = (0.05 * (most - least)).max(0.5 * (1.0 - (most - least)));
        let range = [10f64.powf(least - margin), 10f64.powf(most + margin)];
        Self { label: label.to_owned(), range, scale: Scale::Logarithmic }
    }

    /// The same axis, with zero at its lower end.
    pub(crate) fn starting_at_zero(self) -> Self {
        Self { range: [0.0, self.range[1]], ..self }
    }

    /// Whether the axis has a place for `value`.
    fn shows(&self, value: f64) -> bool {
        value.is_finite() && (self.scale != Scale::Logarithmic || value > 0.0)
    }

    /// Where `value` stands: 0 at the beginning of the axis, 1 at its end.
    pub(crate) fn share(&self, value: f64) -> f64 {
        let [from, to] = self.range;
        match self.scale {
            Scale::Linear | Scale::Bare => (value - from) / (to - from),
            Scale::Logarithmic => (value / from).ln() / (to / from).ln(),
        }
    }

    /// Positions and texts of the numbered ticks, `count` of them at most or nearly so, and the
    /// positions of grid lines without number.
    fn ticks(&self, count: usize) -> (Vec<(f64, String)>, Vec<f64>) {
        match self.scale {
            Scale::Bare => (Vec::new(), Vec::new()),
            Scale::Linear => {
                let (positions, decimals) = ticks(self.range, count);
                (positions.into_iter().map(|tick| (tick, tick_text(tick, decimals))).collect(), Vec::new())
            }
            Scale::Logarithmic => {
                let decades = decades(self.range, count);
                let text = |tick: f64| if decades.plain { quantity(tick) } else { power_text(tick) };
                (decades.numbered.iter().map(|&tick| (tick, text(tick))).collect(), decades.minor)
            }
        }
    }
}

fn extent(values: impl IntoIterator<Item = f64>) -> [f64; 2] {
    let start = [f64::INFINITY, f64::NEG_INFINITY];
    values.into_iter().fold(start, |[least, most], value| [least.min(value), most.max(value)])
}

/// How a curve is drawn.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum CurveStyle {
    Line,
    Dashed,
    /// Discs only.
    Markers,
    /// Rings only: let a line below show through.
    Rings,
    /// Discs joined by a thin line.
    Joined,
}

#[derive(Clone, Debug)]
pub(crate) struct Curve {
    /// Name in the legend, where formulas stand between `$`; without one, the curve is not in it.
    pub(crate) label: String,
    pub(crate) colour: Colour,
    pub(crate) style: CurveStyle,
    /// The points, in the units of the axes.
    pub(crate) points: Vec<[f64; 2]>,
}

/// A curve in the colour of a cell.
pub(crate) fn curve(label: &str, colour: usize, style: CurveStyle, points: Vec<[f64; 2]>) -> Curve {
    Curve { label: label.to_owned(), colour: cell_colour(colour), style, points }
}

#[derive(Clone, Debug)]
pub(crate) struct Note {
    /// The point, in the units of the axes.
    pub(crate) at: [f64; 2],
    /// From the point to the word's base line, pixels, y down.
    pub(crate) offset: DVec2,
    /// The word, which begins there; formulas between `$`.
    pub(crate) text: String,
}

/// Curves over a pair of axes.
#[derive(Clone, Debug)]
pub(crate) struct Chart {
    pub(crate) x: Axis,
    pub(crate) y: Axis,
    /// The curves, drawn in this order.
    pub(crate) curves: Vec<Curve>,
    pub(crate) notes: Vec<Note>,
}

impl Chart {
    /// `curves` over axes that `x` and `y` make of all their coordinates.
    pub(crate) fn over(curves: Vec<Curve>, x: impl FnOnce(Vec<f64>) -> Axis, y: impl FnOnce(Vec<f64>) -> Axis) -> Self {
        let along = |axis: usize| curves.iter().flat_map(|curve| &curve.points).map(|at| at[axis]).collect();
        Self { x: x(along(0)), y: y(along(1)), curves, notes: Vec::new() }
    }

    /// Draws the chart with its plotting area in the rectangle from `top_left` to `bottom_right`. Tick numbers and axis names
    /// stand to the left of and below it, the legend above it, `heading` pixels higher.
    pub(crate) fn draw(&self, canvas: &mut Canvas, top_left: DVec2, bottom_right: DVec2, heading: f64) {
        self.draw_axes(canvas, top_left, bottom_right);
        let place = |[x, y]: [f64; 2]| {
            let share = dvec2(self.x.share(x), 1.0 - self.y.share(y));
            top_left + share * (bottom_right - top_left)
        };
        for curve in &self.curves {
            let shown = curve.points.iter().filter(|[x, y]| self.x.shows(*x) && self.y.shows(*y));
            draw_curve(canvas, curve, &shown.map(|point| place(*point)).collect::<Vec<_>>());
        }
        for note in &self.notes {
            canvas.text(place(note.at) + note.offset, &note.text, TICK);
        }
        self.draw_legend(canvas, top_left - dvec2(0.0, heading));
    }

    fn draw_axes(&self, canvas: &mut Canvas, top_left: DVec2, bottom_right: DVec2) {
        let (size, grid, fine) = (bottom_right - top_left, Stroke::new(PALE, 0.8), Stroke::new(FAINT, 0.8));
        let counts = (size / TICK_ROOM).floor().max(DVec2::ONE);
        let (across, fine_across) = self.x.ticks(counts.x as usize);
        let (up, fine_up) = self.y.ticks(counts.y as usize);
        let upright = |canvas: &mut Canvas, tick: f64, stroke| {
            let x = top_left.x + self.x.share(tick) * size.x;
            canvas.line(dvec2(x, top_left.y), dvec2(x, bottom_right.y), stroke);
            dvec2(x, bottom_right.y + 18.0)
        };
        let level = |canvas: &mut Canvas, tick: f64, stroke| {
            let y = bottom_right.y - self.y.share(tick) * size.y;
            canvas.line(dvec2(top_left.x, y), dvec2(bottom_right.x, y), stroke);
            dvec2(top_left.x - 8.0, y + 4.0)
        };
        for tick in fine_across {
            upright(canvas, tick, fine);
        }
        for tick in fine_up {
            level(canvas, tick, fine);
        }
        for (tick, text) in across {
            let at = upright(canvas, tick, grid);
            canvas.text(at, &text, TICK.anchored(Anchor::Middle));
        }
        for (tick, text) in up {
            let at = level(canvas, tick, grid);
            canvas.text(at, &text, TICK.anchored(Anchor::End));
        }
        let frame = [top_left, dvec2(bottom_right.x, top_left.y), bottom_right, dvec2(top_left.x, bottom_right.y)];
        canvas.outline(&frame, Stroke::new(INK, 1.0));
        let middle = 0.5 * (top_left + bottom_right);
        let below = dvec2(middle.x, bottom_right.y + 40.0);
        canvas.text(below, &self.x.label, LABEL.anchored(Anchor::Middle));
        let upwards = TextStyle { upwards: true, ..LABEL };
        canvas.text(dvec2(top_left.x - 56.0, middle.y), &self.y.label, upwards.anchored(Anchor::Middle));
    }

    /// One line for each curve, upwards from the plotting area.
    fn draw_legend(&self, canvas: &mut Canvas, top_left: DVec2) {
        for (index, curve) in self.named().rev().enumerate() {
            let at = top_left + dvec2(4.0, -12.0 - 18.0 * index as f64);
            let sample = [at + dvec2(0.0, -4.0), at + dvec2(28.0, -4.0)];
            match curve.style {
                CurveStyle::Markers | CurveStyle::Rings => {
                    draw_curve(canvas, curve, &[0.5 * (sample[0] + sample[1])]);
                }
                _ => draw_curve(canvas, curve, &sample),
            }
            canvas.text(at + dvec2(36.0, 0.0), &curve.label, LABEL);
        }
    }

    /// Curves without a name stand in no legend.
    fn named(&self) -> impl DoubleEndedIterator<Item = &Curve> {
        self.curves.iter().filter(|curve| !curve.label.is_empty())
    }

    /// The height of the legend above the plotting area.
    pub(crate) fn legend_height(&self) -> f64 {
        12.0 + 18.0 * self.named().count() as f64
    }
}

fn draw_curve(canvas: &mut Canvas, curve: &Curve, points: &[DVec2]) {
    let (line, joint) = (Stroke::new(curve.colour, 1.8), Stroke::new(curve.colour, JOINED_WIDTH));
    match curve.style {
        CurveStyle::Line => canvas.path(points, line),
        CurveStyle::Dashed => canvas.path(points, line.dashed(6.0, 4.0)),
        CurveStyle::Joined => canvas.path(points, joint),
        CurveStyle::Markers | CurveStyle::Rings => {}
    }
    let (radius, fill, rim) = match curve.style {
        CurveStyle::Line | CurveStyle::Dashed => return,
        CurveStyle::Markers | CurveStyle::Joined => (MARKER_RADIUS, curve.colour, Stroke::new(curve.colour, 0.5)),
        CurveStyle::Rings => (MARKER_RADIUS + 0.8, "none", Stroke::new(curve.colour, 1.4)),
    };
    for point in points {
        canvas.disc(*point, radius, fill, rim);
    }
}

fn tick_text(tick: f64, decimals: usize) -> String {
    // A true minus sign is as wide as the digits; adding zero turns −0 into 0.
    format!("{:.decimals$}", tick + 0.0).replace('-', "−")
}

/// A power of ten, or a small multiple of one: 10⁻⁶, 2·10³.
fn power_text(tick: f64) -> String {
    let exponent = (tick.log10() + 1e-9).floor();
    let factor = (tick / 10f64.powf(exponent)).round();
    let digits: String = format!("{exponent}")
        .chars()
        .map(|digit| match digit {
            '-' => '⁻',
            _ => ['⁰', '¹', '²', '³', '⁴', '⁵', '⁶', '⁷', '⁸', '⁹'][digit.to_digit(10).unwrap_or(0) as usize],
        })
        .collect();
    if factor > 1.0 { format!("{factor}·10{digits}") } else { format!("10{digits}") }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn equal_ratios_are_equal_distances() {
        let axis = Axis::logarithmic("", [1e-6, 1e2]);
        let step = axis.share(1e-5) - axis.share(1e-6);
        for decade in -6..2 {
            let share = axis.share(10f64.powi(decade + 1)) - axis.share(10f64.powi(decade));
            assert!((share - step).abs() < 1e-12, "{decade}: {share} {step}");
        }
        // A twentieth of the span is left at either end.
        assert!((axis.share(1e-6) - 0.05 / 1.1).abs() < 1e-12 && (axis.share(1e2) - 1.05 / 1.1).abs() < 1e-12);
    }

    #[test]
    fn what_has_no_logarithm_has_no_place() {
        let axis = Axis::logarithmic("", [0.0, -3.0, f64::NAN, f64::INFINITY, 2.0]);
        assert!(axis.range[0] > 0.0 && axis.range[1] / axis.range[0] >= 9.999, "{:?}", axis.range);
        assert!(axis.shows(2.0) && !axis.shows(0.0) && !axis.shows(f64::NAN));
        let mut canvas = Canvas::new(200.0, 200.0, "");
        let points = vec![[1.0, 0.0], [1.0, f64::INFINITY], [1.0, 2.0]];
        let curve = Curve { label: String::new(), colour: INK, style: CurveStyle::Joined, points };
        let x = Axis::around("", [0.0, 2.0]);
        let chart = Chart { x, y: axis, curves: vec![curve], notes: Vec::new() };
        chart.draw(&mut canvas, DVec2::ZERO, DVec2::splat(100.0), 0.0);
        let svg = canvas.into_svg();
        assert!(!svg.contains("NaN") && !svg.contains("inf") && svg.matches("<circle").count() == 1, "{svg}");
        // Of nothing at all there is still an axis.
        let empty = Axis::logarithmic("", []);
        assert!(empty.range[0] > 0.0 && empty.range[1].is_finite());
    }

    #[test]
    fn powers_of_ten_are_written_as_such() {
        let cases = [(1e-6, "10⁻⁶"), (1.0, "10⁰"), (1e12, "10¹²"), (2e-3, "2·10⁻³"), (5e4, "5·10⁴")];
        for (value, text) in cases {
            assert_eq!(power_text(value), text);
        }
    }
}
