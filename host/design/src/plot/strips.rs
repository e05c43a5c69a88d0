//! The detectors side by side, with the light on them.

use glam::{DVec2, dvec2};
use slitpose_model::{Cell, CompiledScene, Pose, Response, Scene, Status};

use super::canvas::{Anchor, Canvas, Stroke, TextStyle};
use super::style::quantity;
use super::style::ticks;
use super::style::{ALERT, INK, PALE, SOFT_INK, cell_colour};

/// Room for the numbers at the right of a strip.
const READOUT: f64 = 226.0;
/// Room for the cell's number at the left.
const NUMBER: f64 = 34.0;
/// From one strip to the next, at least, and for title and axis together.
const ROW: f64 = 46.0;
const FRAME: f64 = 76.0;
/// Between strips, and the height that a wide one may have.
const GAP: f64 = 16.0;
const HIGHEST: f64 = 114.0;
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
    let highest = if widest_m < 0.25 * longest_m { ROW - GAP } else { HIGHEST };
    let scale = (across(width) / longest_m).min(highest / widest_m);
    (scale, ROW.max(scale * widest_m + GAP))
}

fn across(width: f64) -> f64 {
    width - NUMBER - READOUT - 16.0
}

/// The height of a panel of that width.
pub(super) fn height(scene: &Scene, width: f64) -> f64 {
    FRAME + scale(scene, width).1 * rows(scene).count() as f64
}

/// Draws the panel with its corner at `top_left`.
pub(super) fn draw(
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
