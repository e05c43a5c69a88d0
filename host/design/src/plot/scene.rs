//! A sensor head from above, from the front and from the side, and the light on its detectors.

use glam::{DVec2, DVec3, dvec2};
use slitpose_model::{Cell, CompiledScene, Pose, Response, Scene, Status};

use super::canvas::{
    ALERT, Anchor, Canvas, INK, MASK, PALE, SOFT_INK, Stroke, TOOL, TextStyle, WHITE, cell_colour, quantity,
    round_step, ticks,
};
use super::shape::{CellShape, FRONT, SIDE, TOP, View, bounds, hull};

const MARGIN: f64 = 28.0;
const COLUMN: f64 = 560.0;
const HEADER: f64 = 64.0;
const FOOTER: f64 = 12.0;

/// The height of the legend, which stands below the strips.
const LEGEND: f64 = 170.0;

/// Around the drawing inside a view: title above, axes and scale below.
const ABOVE: f64 = 40.0;
const BELOW: f64 = 64.0;
const BESIDE: f64 = 36.0;

/// No view is drawn higher than this.
const HIGHEST: f64 = 640.0;

/// Points that the letters of a cell's number cover.
const LETTERS: [DVec2; 5] = [DVec2::ZERO, dvec2(-16.0, -8.0), dvec2(16.0, -8.0), dvec2(16.0, 8.0), dvec2(-16.0, 8.0)];

/// A slit seen edge-on is drawn as a gap if it is narrower than this share of its mask.
const GAP_SHARE: f64 = 0.25;

/// Distances of a cell's number from the middle of its detector that are tried.
const NUMBER_DISTANCES: [f64; 8] = [16.0, 28.0, 40.0, 52.0, 64.0, 76.0, 88.0, 100.0];

/// Points that stand for an edge: nearer to each other than letters are high.
const EDGE_POINTS: u32 = 32;

/// Length of a drawn emitter axis: a little longer than an emitter's housing.
const AXIS_MM: f64 = 2.6;

/// Numbers of cells that would stand nearer to each other than this are written as one label.
const LABEL_ROOM: DVec2 = dvec2(30.0, 14.0);

/// Draws a scene with the tool at a pose: three views and one strip for each cell.
///
/// # Panics
/// If `plan` is not of `scene`.
pub fn scene_picture(name: &str, scene: &Scene, plan: &CompiledScene<f64>, pose: &Pose) -> String {
    let shapes = CellShape::all(scene, plan, pose);
    let [least, most] = bounds(&shapes);
    // Flat scenes still get a millimetre, so that nothing divides by zero.
    let extent = (most - least).max(DVec3::ONE);
    let across = COLUMN - 2.0 * BESIDE;
    let scale = (across / extent.x.max(extent.y)).min(HIGHEST / extent.y.max(extent.z));
    let row = |rise_mm: f64| ABOVE + rise_mm * scale + BELOW;
    let strips_height = strips_height(scene, COLUMN);
    let top_row = row(extent.y).max(strips_height + LEGEND);
    let size = dvec2(2.0 * COLUMN + 3.0 * MARGIN, HEADER + top_row + row(extent.z) + FOOTER);

    let mut canvas = Canvas::new(size.x, size.y, &format!("{name}: three views and the light on each detector"));
    canvas.text(dvec2(MARGIN, 34.0), name, TextStyle::new(20.0).bold());
    canvas.text(dvec2(MARGIN, 54.0), &pose_text(pose), TextStyle::new(13.0).coloured(SOFT_INK));
    let (left, right) = (MARGIN, 2.0 * MARGIN + COLUMN);
    let centre = 0.5 * (least + most);
    let mut draw = |view: View, corner: DVec2, rise_mm: f64| {
        let middle = corner + dvec2(0.5 * COLUMN, ABOVE + 0.5 * rise_mm * scale);
        let sheet = Sheet { view, middle, scale, centre: view.project(centre) };
        sheet.draw(&mut canvas, corner, corner.y + row(rise_mm), &shapes, pose);
    };
    draw(TOP, dvec2(left, HEADER), extent.y);
    draw(FRONT, dvec2(left, HEADER + top_row), extent.z);
    draw(SIDE, dvec2(right, HEADER + top_row), extent.z);
    draw_strips(&mut canvas, dvec2(right, HEADER), COLUMN, scene, plan, pose);
    draw_legend(&mut canvas, dvec2(right, HEADER + strips_height));
    canvas.into_svg()
}

struct Sheet {
    view: View,
    /// Pixels of the middle of the drawing.
    middle: DVec2,
    scale: f64,
    centre: DVec2,
}

impl Sheet {
    fn place(&self, point: DVec3) -> DVec2 {
        let offset = (self.view.project(point) - self.centre) * self.scale;
        self.middle + dvec2(offset.x, -offset.y)
    }

    fn places(&self, points: &[DVec3]) -> Vec<DVec2> {
        points.iter().map(|point| self.place(*point)).collect()
    }

    fn draw(&self, canvas: &mut Canvas, corner: DVec2, bottom: f64, shapes: &[CellShape], pose: &Pose) {
        canvas.text(corner + dvec2(0.0, 14.0), self.view.name, TextStyle::new(15.0).bold());
        let mut shapes: Vec<_> = shapes.iter().collect();
        shapes.sort_by(|a, b| self.view.nearness(a.centre()).total_cmp(&self.view.nearness(b.centre())));
        for shape in shapes.iter().filter(|shape| !shape.repeats) {
            self.draw_receiver(canvas, shape);
        }
        let origin = self.place(pose.translation_m * 1e3);
        for shape in &shapes {
            canvas.line(origin, self.place(shape.emitter), Stroke::new(TOOL, 1.4));
        }
        canvas.disc(origin, 2.6, TOOL, Stroke::new(TOOL, 1.0));
        for shape in shapes.iter().filter(|shape| !shape.repeats) {
            self.draw_light(canvas, shape);
        }
        self.draw_numbers(canvas, &shapes);
        self.draw_axes(canvas, dvec2(corner.x + 14.0, bottom - 16.0));
        self.draw_scale(canvas, dvec2(corner.x + COLUMN, bottom - 16.0));
    }

    fn draw_receiver(&self, canvas: &mut Canvas, shape: &CellShape) {
        let colour = cell_colour(shape.number);
        let detector = self.places(&shape.detector);
        canvas.area(&detector, colour, 0.25);
        canvas.outline(&detector, Stroke::new(colour, 2.4));
        let mask = self.places(&shape.mask);
        canvas.area(&mask, MASK, 0.07);
        canvas.outline(&mask, Stroke::new(MASK, 1.2));
        let slit = self.places(&shape.slit);
        canvas.area(&slit, WHITE, 0.9);
        canvas.outline(&slit, Stroke::new(MASK, 0.7));
        if span(&slit) < GAP_SHARE * span(&mask) {
            canvas.outline(&slit, Stroke::new(WHITE, 3.0));
        }
    }

    fn draw_light(&self, canvas: &mut Canvas, shape: &CellShape) {
        let colour = cell_colour(shape.number);
        let emitter = self.place(shape.emitter);
        if let Some(x_a) = shape.x_a {
            let mut beam = self.places(&shape.spot);
            canvas.area(&beam, colour, 0.9);
            let mut from = emitter;
            if shape.bends {
                // To the lens, and from it on.
                let mut lens = self.places(&shape.slit);
                beam.extend_from_slice(&lens);
                lens.push(emitter);
                canvas.area(&hull(&lens), colour, 0.2);
                from = self.place(shape.slit_centre());
                canvas.line(emitter, from, Stroke::new(colour, 0.9));
            } else {
                beam.push(emitter);
            }
            canvas.area(&hull(&beam), colour, 0.2);
            canvas.line(from, self.place(x_a), Stroke::new(colour, 0.9));
        }
        let tip = self.place(shape.emitter + AXIS_MM * shape.emitter_axis);
        // An axis that points at the eye has no arrow.
        if tip.distance(emitter) > 6.0 {
            canvas.arrow(emitter, tip, Stroke::new(INK, 1.3));
        }
        canvas.disc(emitter, 3.6, colour, Stroke::new(INK, 0.9));
    }

    /// The cells' numbers outside the detectors; those of cells in line with each other together.
    fn draw_numbers(&self, canvas: &mut Canvas, shapes: &[&CellShape]) {
        let mut labels: Vec<(DVec2, Vec<usize>)> = Vec::new();
        for shape in shapes {
            let at = self.number_place(shape, shapes);
            match labels.iter_mut().find(|(other, _)| (*other - at).abs().cmplt(LABEL_ROOM).all()) {
                Some((_, numbers)) => numbers.push(shape.number),
                None => labels.push((at, vec![shape.number])),
            }
        }
        for (at, mut numbers) in labels {
            numbers.sort_unstable();
            let colour = if numbers.len() == 1 { cell_colour(numbers[0]) } else { INK };
            let text: Vec<_> = numbers.iter().map(ToString::to_string).collect();
            let style = TextStyle::new(14.0).bold().coloured(colour).anchored(Anchor::Middle);
            canvas.text(at + dvec2(0.0, 5.0), &text.join(", "), style);
        }
    }

    /// Outward of the detector, as near as no cell is in the way; below the whole drawing where that is too far.
    fn number_place(&self, shape: &CellShape, shapes: &[&CellShape]) -> DVec2 {
        let centre = self.place(shape.centre());
        let outward = (centre - self.middle).normalize_or(DVec2::Y);
        let taken: Vec<_> =
            shapes.iter().flat_map(|other| [self.places(&other.detector), self.places(&other.mask)]).collect();
        // A shape seen edge-on covers no point, but its outline crosses letters; so does light.
        let outlines =
            taken.iter().flat_map(|corners| corners.iter().copied().zip(corners.iter().copied().cycle().skip(1)));
        let light = shapes.iter().filter_map(|other| Some((self.place(other.emitter), self.place(other.x_a?))));
        let edges = outlines.chain(light);
        let along = |(from, to): (DVec2, DVec2)| {
            (0..EDGE_POINTS).map(move |k| from.lerp(to, f64::from(k) / f64::from(EDGE_POINTS)))
        };
        let lines: Vec<DVec2> = edges.flat_map(along).collect();
        let is_free = |at: &DVec2| {
            let is_covered = |letter: &DVec2| taken.iter().any(|corners| contains(corners, *at + *letter));
            let is_crossed = |point: &DVec2| (*point - *at).abs().cmplt(LETTERS[3] - DVec2::ONE).all();
            !LETTERS.iter().any(is_covered) && !lines.iter().any(is_crossed)
        };
        if let Some(free) = NUMBER_DISTANCES.map(|distance| centre + distance * outward).iter().find(|at| is_free(at)) {
            return *free;
        }
        let corners = shapes.iter().flat_map(|other| other.mask.iter().chain(&other.detector));
        let lowest = corners.map(|corner| self.place(*corner).y).fold(centre.y, f64::max);
        dvec2(self.place(shape.slit_centre()).x, lowest + 16.0)
    }

    fn draw_axes(&self, canvas: &mut Canvas, origin: DVec2) {
        let (stroke, style) = (Stroke::new(SOFT_INK, 1.3), TextStyle::new(13.0).coloured(SOFT_INK));
        canvas.arrow(origin, origin + dvec2(34.0, 0.0), stroke);
        canvas.arrow(origin, origin - dvec2(0.0, 34.0), stroke);
        canvas.text(origin + dvec2(39.0, 4.0), &format!("${}$", self.view.right.1), style);
        canvas.text(origin - dvec2(0.0, 39.0), &format!("${}$", self.view.up.1), style.anchored(Anchor::Middle));
    }

    fn draw_scale(&self, canvas: &mut Canvas, end: DVec2) {
        let length_mm = round_step(50.0 / self.scale);
        let start = end - dvec2(length_mm * self.scale, 0.0);
        let stroke = Stroke::new(SOFT_INK, 1.3);
        canvas.line(start, end, stroke);
        for at in [start, end] {
            canvas.line(at - dvec2(0.0, 4.0), at + dvec2(0.0, 4.0), stroke);
        }
        let style = TextStyle::new(13.0).coloured(SOFT_INK).anchored(Anchor::Middle);
        canvas.text(0.5 * (start + end) - dvec2(0.0, 8.0), &format!("{length_mm} mm"), style);
    }
}

/// The distance between the two corners that are farthest apart.
fn span(corners: &[DVec2]) -> f64 {
    let pairs = corners.iter().flat_map(|a| corners.iter().map(move |b| a.distance(*b)));
    pairs.fold(0.0, f64::max)
}

/// Whether a point is inside a convex polygon; never inside one that is seen edge-on.
fn contains(corners: &[DVec2], point: DVec2) -> bool {
    let sides = corners.iter().zip(corners.iter().cycle().skip(1));
    let (mut left, mut right) = (0, 0);
    for (from, to) in sides {
        let side = (*to - *from).perp_dot(point - *from);
        left += usize::from(side > 0.0);
        right += usize::from(side < 0.0);
    }
    left == corners.len() || right == corners.len()
}

fn draw_legend(canvas: &mut Canvas, top_left: DVec2) {
    let text = TextStyle::new(13.0).coloured(SOFT_INK);
    let colour = cell_colour(0);
    let mut at = top_left + dvec2(4.0, 26.0);
    let mut entry = |label: &str, symbol: &dyn Fn(&mut Canvas, [DVec2; 4])| {
        symbol(canvas, [dvec2(0.0, -9.0), dvec2(26.0, -9.0), dvec2(26.0, 0.0), dvec2(0.0, 0.0)].map(|p| at + p));
        canvas.text(at + dvec2(38.0, 0.0), label, text);
        at.y += 24.0;
    };
    let across = |[_, _, right, left]: [DVec2; 4]| [left - dvec2(0.0, 4.5), right - dvec2(0.0, 4.5)];
    entry("detector, in its cell's colour", &|canvas, bar| {
        canvas.area(&bar, colour, 0.25);
        canvas.outline(&bar, Stroke::new(colour, 2.0));
    });
    entry("mask with its slit (outer size arbitrary)", &|canvas, bar| {
        canvas.area(&bar, MASK, 0.07);
        canvas.outline(&bar, Stroke::new(MASK, 1.2));
    });
    entry("emitter and its axis", &|canvas, bar| {
        let [left, right] = across(bar);
        canvas.arrow(left, right, Stroke::new(INK, 1.3));
        canvas.disc(left, 3.6, colour, Stroke::new(INK, 0.9));
    });
    entry("light that reaches the detector, and its position", &|canvas, bar| {
        canvas.area(&bar, colour, 0.2);
        let [left, right] = across(bar);
        canvas.line(left, right, Stroke::new(colour, 0.9));
    });
    entry("tool, from its origin to the emitters", &|canvas, bar| {
        let [left, right] = across(bar);
        canvas.line(left, right, Stroke::new(TOOL, 1.4));
        canvas.disc(left, 2.6, TOOL, Stroke::new(TOOL, 1.0));
    });
}

/// The pose of the tool in words.
pub(super) fn pose_text(pose: &Pose) -> String {
    if *pose == Pose::HOME {
        return "tool at home".to_owned();
    }
    let (t, r) = ((pose.translation_m * 1e3).to_array(), pose.rotation_rad().to_array().map(f64::to_degrees));
    let list = |values: [f64; 3]| values.map(quantity).join(", ");
    format!("tool at ({}) mm, turned by the rotation vector ({})°", list(t), list(r))
}

/// Room for the numbers at the right of a strip.
const READOUT: f64 = 226.0;
/// Room for the cell's number at the left.
const NUMBER: f64 = 34.0;
/// From one strip to the next, at least, and for title and axis together.
const ROW: f64 = 46.0;
const FRAME: f64 = 76.0;
/// Between strips, and the height that a wide one may have.
const GAP: f64 = 16.0;
const STRIP_HIGHEST: f64 = 114.0;
/// Room for the number of a tick.
const TICK: f64 = 36.0;

/// Cells with a strip of their own: both axes of a detector share one.
fn rows(scene: &Scene) -> impl Iterator<Item = (usize, &Cell)> {
    scene.cells.iter().enumerate().filter(|(number, cell)| !cell.is_second_axis(*number))
}

/// Pixels per metre, and from one strip to the next.
fn scale(scene: &Scene, width: f64) -> (f64, f64) {
    let longest_m = scene.cells.iter().map(|cell| cell.detector.length_m).fold(0.0, f64::max);
    let widest_m = rows(scene).map(|(_, cell)| cell.detector.width_m).fold(0.0, f64::max);
    let highest = if widest_m < 0.25 * longest_m { ROW - GAP } else { STRIP_HIGHEST };
    let scale = (across(width) / longest_m).min(highest / widest_m);
    (scale, ROW.max(scale * widest_m + GAP))
}

fn across(width: f64) -> f64 {
    width - NUMBER - READOUT - 16.0
}

/// The height of a panel of strips of that width.
fn strips_height(scene: &Scene, width: f64) -> f64 {
    FRAME + scale(scene, width).1 * rows(scene).count() as f64
}

/// Draws the detectors side by side, with the light on them, with the corner of the panel at `top_left`.
fn draw_strips(
    canvas: &mut Canvas,
    top_left: DVec2,
    width: f64,
    scene: &Scene,
    plan: &CompiledScene<f64>,
    pose: &Pose,
) {
    canvas.text(top_left + dvec2(0.0, 14.0), "light on the detectors", TextStyle::new(15.0).bold());
    let longest_m = scene.cells.iter().map(|cell| cell.detector.length_m).fold(0.0, f64::max);
    let (scale, row) = scale(scene, width);
    let centre_x = top_left.x + NUMBER + 0.5 * across(width);
    let mut centre = dvec2(centre_x, top_left.y + 30.0 + 0.5 * row);
    for (number, cell) in rows(scene) {
        let place = |[x, y]: [f64; 2]| centre + scale * dvec2(x, -y);
        let (half_x, half_y) = (0.5 * cell.detector.length_m, 0.5 * cell.detector.width_m);
        let corners = [[-half_x, -half_y], [half_x, -half_y], [half_x, half_y], [-half_x, half_y]].map(place);
        canvas.area(&corners, PALE, 0.35);
        let spot: Vec<_> = plan.spot_outline_m(number, pose).into_iter().map(place).collect();
        let colour = cell_colour(number);
        if !spot.is_empty() {
            canvas.area(&spot, colour, 0.45);
            canvas.outline(&spot, Stroke::new(colour, 1.0));
        }
        canvas.outline(&corners, Stroke::new(INK, 1.0));
        let response = plan.respond(number, pose);
        if let Some(x_a_m) = response.x_a_m {
            let reach = half_y + 4.0 / scale;
            canvas.line(place([x_a_m, -reach]), place([x_a_m, reach]), Stroke::new(colour, 2.0));
        }
        let mut readings = vec![(number, response)];
        if let Some(other) = cell.other_axis() {
            let response = plan.respond(other, pose);
            if let Some(y_a_m) = response.x_a_m {
                let reach = half_x + 4.0 / scale;
                canvas.line(place([-reach, y_a_m]), place([reach, y_a_m]), Stroke::new(cell_colour(other), 2.0));
            }
            readings.push((other, response));
        }
        let mut y = centre.y - 0.5 * ROW * (readings.len() - 1) as f64;
        for (number, response) in &readings {
            let style = TextStyle::new(15.0).bold().coloured(cell_colour(*number));
            canvas.text(dvec2(top_left.x + 8.0, y + 5.0), &number.to_string(), style);
            draw_readout(canvas, dvec2(top_left.x + width - READOUT, y), response);
            y += ROW;
        }
        centre.y += row;
    }
    let axis_y = centre.y - 0.5 * row + 4.0;
    draw_axis(canvas, dvec2(centre_x, axis_y), scale, longest_m);
}

/// Status and flags in words, and whether there are flags.
pub(super) fn condition(response: &Response<f64>) -> (String, bool) {
    let flags = response.flags.to_string().replace(';', ", ").replace('_', " ");
    let separator = if flags.is_empty() { "" } else { ", " };
    (format!("{}{separator}{flags}", response.status), !flags.is_empty())
}

fn draw_readout(canvas: &mut Canvas, at: DVec2, response: &Response<f64>) {
    let (condition, has_flags) = condition(response);
    let colour = if response.status == Status::Lit && !has_flags { SOFT_INK } else { ALERT };
    let numbers = match response.x_a_m {
        Some(x_a_m) => format!("$X_A$ = {} mm", quantity(x_a_m * 1e3)),
        None => "no light".to_owned(),
    };
    let line = format!("{numbers}, $I_O$ = {} µA", quantity(response.i_o_a * 1e6));
    canvas.text(at - dvec2(0.0, 4.0), &line, TextStyle::new(13.0));
    canvas.text(at + dvec2(0.0, 13.0), &condition, TextStyle::new(12.0).coloured(colour));
}

fn draw_axis(canvas: &mut Canvas, centre: DVec2, scale: f64, length_m: f64) {
    let stroke = Stroke::new(SOFT_INK, 1.0);
    let half_mm = 0.5e3 * length_m;
    let end = dvec2(0.5 * length_m * scale, 0.0);
    canvas.line(centre - end, centre + end, stroke);
    let (positions, decimals) = ticks([-half_mm, half_mm], ((2.0 * end.x / TICK) as usize).clamp(2, 6));
    for tick in positions {
        let at = centre + dvec2(tick * 1e-3 * scale, 0.0);
        canvas.line(at, at + dvec2(0.0, 5.0), stroke);
        let text = format!("{tick:.decimals$}").replace('-', "−");
        let style = TextStyle::new(12.0).coloured(SOFT_INK).anchored(Anchor::Middle);
        canvas.text(at + dvec2(0.0, 18.0), &text, style);
    }
    canvas.text(centre + end + dvec2(20.0, 18.0), "$x$ / mm", TextStyle::new(12.0).coloured(SOFT_INK));
}
