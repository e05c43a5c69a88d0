//! Curves over axes.

use glam::{DVec2, dvec2};

use super::canvas::{Anchor, Canvas, Stroke, TextStyle};
use super::palette::{Colour, INK, PALE, SOFT_INK};
use super::ticks::ticks;

const LABEL: TextStyle = TextStyle::new(13.0);
const TICK: TextStyle = TextStyle::new(12.0).coloured(SOFT_INK);
const MARKER_RADIUS: f64 = 3.2;

/// Pixels between ticks, at least: room for a number.
const TICK_ROOM: DVec2 = DVec2::new(70.0, 30.0);

/// One axis of a chart.
#[derive(Clone, Debug)]
pub struct Axis {
    /// Name and unit; formulas between `$`.
    pub label: String,
    /// The least and the largest number shown.
    pub range: [f64; 2],
}

impl Axis {
    /// An axis that shows all of `values`, with a twentieth of their span around them.
    pub fn around(label: &str, values: impl IntoIterator<Item = f64>) -> Self {
        let start = [f64::INFINITY, f64::NEG_INFINITY];
        let [least, most] = values.into_iter().fold(start, |[least, most], value| [least.min(value), most.max(value)]);
        let margin = if most > least { 0.05 * (most - least) } else { 1.0 };
        Self { label: label.to_owned(), range: [least - margin, most + margin] }
    }

    /// The same axis, with zero at its lower end.
    pub fn from_zero(self) -> Self {
        Self { range: [0.0, self.range[1]], ..self }
    }

    fn share(&self, value: f64) -> f64 {
        (value - self.range[0]) / (self.range[1] - self.range[0])
    }
}

/// How a curve is drawn.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CurveStyle {
    /// A solid line.
    Line,
    /// A dashed line.
    Dashed,
    /// Discs only.
    Markers,
    /// Rings only: let a line below show through.
    Rings,
}

/// Points to draw.
#[derive(Clone, Debug)]
pub struct Curve {
    /// Name in the legend, where formulas stand between `$`; without one, the curve is not in it.
    pub label: String,
    /// Colour.
    pub colour: Colour,
    /// Style.
    pub style: CurveStyle,
    /// The points, in the units of the axes.
    pub points: Vec<[f64; 2]>,
}

/// Curves over a pair of axes.
#[derive(Clone, Debug)]
pub struct Chart {
    /// Horizontal axis.
    pub x: Axis,
    /// Vertical axis.
    pub y: Axis,
    /// The curves, drawn in this order.
    pub curves: Vec<Curve>,
}

impl Chart {
    /// Draws the chart with its plotting area in the rectangle from `top_left` to `bottom_right`.
    /// Tick numbers and axis names stand to the left of and below it, the legend above it.
    pub fn draw(&self, canvas: &mut Canvas, top_left: DVec2, bottom_right: DVec2) {
        self.draw_axes(canvas, top_left, bottom_right);
        let place = |[x, y]: [f64; 2]| {
            let share = dvec2(self.x.share(x), 1.0 - self.y.share(y));
            top_left + share * (bottom_right - top_left)
        };
        for curve in &self.curves {
            let points: Vec<_> = curve.points.iter().map(|point| place(*point)).collect();
            draw_curve(canvas, curve, &points);
        }
        self.draw_legend(canvas, top_left);
    }

    fn draw_axes(&self, canvas: &mut Canvas, top_left: DVec2, bottom_right: DVec2) {
        let (size, grid) = (bottom_right - top_left, Stroke::new(PALE, 0.8));
        let counts = (size / TICK_ROOM).floor().max(DVec2::ONE);
        let (positions, decimals) = ticks(self.x.range, counts.x as usize);
        for tick in positions {
            let x = top_left.x + self.x.share(tick) * size.x;
            canvas.line(dvec2(x, top_left.y), dvec2(x, bottom_right.y), grid);
            let at = dvec2(x, bottom_right.y + 18.0);
            canvas.text(at, &tick_text(tick, decimals), TICK.anchored(Anchor::Middle));
        }
        let (positions, decimals) = ticks(self.y.range, counts.y as usize);
        for tick in positions {
            let y = bottom_right.y - self.y.share(tick) * size.y;
            canvas.line(dvec2(top_left.x, y), dvec2(bottom_right.x, y), grid);
            let at = dvec2(top_left.x - 8.0, y + 4.0);
            canvas.text(at, &tick_text(tick, decimals), TICK.anchored(Anchor::End));
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
                CurveStyle::Line | CurveStyle::Dashed => draw_curve(canvas, curve, &sample),
                CurveStyle::Markers | CurveStyle::Rings => {
                    draw_curve(canvas, curve, &[0.5 * (sample[0] + sample[1])]);
                }
            }
            canvas.text(at + dvec2(36.0, 0.0), &curve.label, LABEL);
        }
    }

    /// Curves without a name stand in no legend.
    fn named(&self) -> impl DoubleEndedIterator<Item = &Curve> {
        self.curves.iter().filter(|curve| !curve.label.is_empty())
    }

    /// The height of the legend above the plotting area.
    pub fn legend_height(&self) -> f64 {
        12.0 + 18.0 * self.named().count() as f64
    }
}

fn draw_curve(canvas: &mut Canvas, curve: &Curve, points: &[DVec2]) {
    let line = Stroke::new(curve.colour, 1.8);
    match curve.style {
        CurveStyle::Line => canvas.path(points, line),
        CurveStyle::Dashed => canvas.path(points, line.dashed(6.0, 4.0)),
        CurveStyle::Markers => {
            points
                .iter()
                .for_each(|point| canvas.disc(*point, MARKER_RADIUS, curve.colour, Stroke::new(curve.colour, 0.5)));
        }
        CurveStyle::Rings => {
            points
                .iter()
                .for_each(|point| canvas.disc(*point, MARKER_RADIUS + 0.8, "none", Stroke::new(curve.colour, 1.4)));
        }
    }
}

fn tick_text(tick: f64, decimals: usize) -> String {
    // A true minus sign is as wide as the digits; adding zero turns −0 into 0.
    format!("{:.decimals$}", tick + 0.0).replace('-', "−")
}
