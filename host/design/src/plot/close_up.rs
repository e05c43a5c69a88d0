//! One cell seen from the side: emitter, slit and detector with the paper's dimensions.

use glam::{DVec2, DVec3, dvec2};
use slitpose_model::{Cell, CompiledScene, Opening, Pose, Response};

use super::canvas::{ALERT, Anchor, Canvas, INK, MASK, PALE, SOFT_INK, Stroke, TextStyle, cell_colour, quantity};
use super::scene::{condition, pose_text};
use super::shape::MaskFrame;

const WIDTH: f64 = 900.0;
/// Room at either side: for d_A and d_B, and for names.
const SIDE: f64 = 215.0;
const TOP: f64 = 96.0;
const BOTTOM: f64 = 150.0;
const HIGHEST: f64 = 560.0;

const DIMENSION: Stroke = Stroke::new(SOFT_INK, 1.1);
const LABEL: TextStyle = TextStyle::new(15.0);

/// Draws one cell in its own frame, looking along its y: x to the right, z up.
///
/// # Panics
/// If there is no such cell.
pub fn cell_picture(name: &str, number: usize, cell: &Cell, plan: &CompiledScene<f64>, pose: &Pose) -> String {
    let side = SideView::of(number, cell, plan, pose);
    let height = TOP + side.top_mm * side.scale + BOTTOM;
    let mut canvas = Canvas::new(WIDTH, height, &format!("{name}, cell {number} from the side"));
    canvas.text(dvec2(28.0, 36.0), name, TextStyle::new(20.0).bold());
    let view = format!("cell {number}, seen along its $y$ axis; {}", pose_text(pose));
    canvas.text(dvec2(28.0, 58.0), &view, TextStyle::new(13.0).coloured(SOFT_INK));
    side.draw_parts(&mut canvas);
    side.draw_light(&mut canvas);
    side.draw_dimensions(&mut canvas);
    side.draw_readout(&mut canvas, height);
    canvas.into_svg()
}

/// A cell cut by its x–z plane, in millimetres of the cell frame.
struct SideView<'a> {
    cell: &'a Cell,
    colour: &'static str,
    response: Response<f64>,
    /// Pixels per millimetre, and the pixel of the detector's centre.
    scale: f64,
    origin: DVec2,
    top_mm: f64,
    emitter: DVec2,
    axis: DVec2,
    slit: [DVec2; 2],
    spot: Option<[f64; 2]>,
}

impl<'a> SideView<'a> {
    fn of(number: usize, cell: &'a Cell, plan: &CompiledScene<f64>, pose: &Pose) -> Self {
        let (detector, slit) = (&cell.detector, &cell.slit);
        let section = |v: DVec3| dvec2(v.dot(detector.x_axis_base), v.dot(detector.normal_base));
        let emitter_base = pose.rotation * cell.emitter.position_tool_m + pose.translation_m;
        let emitter = section(emitter_base - detector.centre_base_m) * 1e3;
        let mask = MaskFrame::of(cell, pose);
        let edge = |sign: f64| section(mask.at(dvec2(0.5 * sign * slit.width_m, 0.0)) - detector.centre_base_m) * 1e3;
        let slit = [edge(-1.0), edge(1.0)];
        let outline = plan.spot_outline_m(number, pose);
        let ends = outline
            .iter()
            .fold([f64::INFINITY, f64::NEG_INFINITY], |[least, most], [x, _]| [least.min(x * 1e3), most.max(x * 1e3)]);
        let half_mm = 0.5e3 * detector.length_m;
        let top_mm = emitter.y.max(slit[0].y).max(slit[1].y).max(1.0);
        let reach = half_mm.max(emitter.x.abs());
        let scale = ((WIDTH - 2.0 * SIDE) / (2.0 * reach)).min(HIGHEST / top_mm);
        Self {
            cell,
            colour: cell_colour(number),
            response: plan.respond(number, pose),
            scale,
            origin: dvec2(0.5 * WIDTH, TOP + top_mm * scale),
            top_mm,
            emitter,
            axis: section(pose.rotation * cell.emitter.axis_tool),
            slit,
            spot: (!outline.is_empty()).then_some(ends),
        }
    }

    fn place(&self, point_mm: DVec2) -> DVec2 {
        self.origin + self.scale * dvec2(point_mm.x, -point_mm.y)
    }

    fn half_mm(&self) -> f64 {
        0.5e3 * self.cell.detector.length_m
    }

    fn draw_parts(&self, canvas: &mut Canvas) {
        let (half, [left, right]) = (self.half_mm(), self.slit);
        let bar = |from: DVec2, to: DVec2, up: f64, down: f64| {
            let (up, down) = (dvec2(0.0, -up), dvec2(0.0, down));
            [from + up, to + up, to + down, from + down]
        };
        let (from, to) = (self.place(dvec2(-half, 0.0)), self.place(dvec2(half, 0.0)));
        canvas.area(&bar(from, to, 0.0, 14.0), self.colour, 0.3);
        canvas.outline(&bar(from, to, 0.0, 14.0), Stroke::new(self.colour, 1.6));
        let along = (right - left).normalize_or(DVec2::X);
        let rides = self.cell.opening() == Opening::RidingSlit;
        // A mask that rides is drawn beside its slit only, that on the base over the detector.
        let plate = if rides { 0.5 * (left.x + right.x) + 0.25 * half } else { half + 1.0 };
        let thickness = 0.5 * (1e3 * self.cell.slit.thickness_m * self.scale).max(4.0);
        for (edge, outward) in [(left, -along), (right, along)] {
            let reach = if rides { 0.25 * half } else { (plate - edge.dot(outward)).max(0.5) };
            let far = edge + outward * reach;
            canvas.area(&bar(self.place(edge), self.place(far), thickness, thickness), MASK, 1.0);
        }
        if let Opening::Lens { .. } = self.cell.opening() {
            canvas.area(&self.lens(), self.colour, 0.3);
            canvas.outline(&self.lens(), Stroke::new(self.colour, 1.2));
        }
        let mask = match self.cell.opening() {
            Opening::Slit => "mask with slit",
            Opening::RidingSlit => "mask with slit, on the tool",
            Opening::Pinhole => "mask with pinhole",
            Opening::Lens { .. } => "mask with lens",
        };
        canvas.text(self.place(dvec2(plate, left.y)) + dvec2(12.0, 5.0), mask, LABEL);
        canvas.text(from + dvec2(-10.0, 13.0), "$I_{X1}$", LABEL.anchored(Anchor::End));
        canvas.text(to + dvec2(10.0, 13.0), "$I_{X2}$   detector (PSD)", LABEL);
        let normal = [self.place(DVec2::ZERO), self.place(dvec2(0.0, self.top_mm))];
        canvas.line(normal[0], normal[1], Stroke::new(PALE, 1.0).dashed(7.0, 5.0));
    }

    /// The outline of a lens that fills the hole: a fifth as thick as wide.
    fn lens(&self) -> Vec<DVec2> {
        let [left, right] = self.slit;
        let (middle, half) = (0.5 * (left + right), 0.5 * (right - left));
        let angles = (0..48).map(|i| f64::from(i) * std::f64::consts::TAU / 48.0);
        angles.map(|angle| self.place(middle + half * angle.cos() + 0.2 * half.perp() * angle.sin())).collect()
    }

    fn draw_light(&self, canvas: &mut Canvas) {
        let emitter = self.place(self.emitter);
        if let (Some([from, to]), Some(x_a_m)) = (self.spot, self.response.x_a_m) {
            let (from, to) = (self.place(dvec2(from, 0.0)), self.place(dvec2(to, 0.0)));
            let x_a = self.place(dvec2(1e3 * x_a_m, 0.0));
            let mut ray = vec![emitter, x_a];
            if let Opening::Lens { .. } = self.cell.opening() {
                let [left, right] = self.slit.map(|edge| self.place(edge));
                canvas.area(&[emitter, left, right], self.colour, 0.18);
                canvas.area(&[left, right, to, from], self.colour, 0.18);
                ray.insert(1, 0.5 * (left + right));
            } else {
                canvas.area(&[emitter, from, to], self.colour, 0.18);
            }
            canvas.line(from, to, Stroke::new(self.colour, 5.0));
            canvas.path(&ray, Stroke::new(self.colour, 1.2));
            canvas.disc(x_a, 3.4, self.colour, Stroke::new(INK, 0.8));
        }
        self.draw_gamma(canvas, emitter);
        canvas.arrow(emitter, emitter + 56.0 * dvec2(self.axis.x, -self.axis.y), Stroke::new(INK, 1.6));
        canvas.disc(emitter, 6.0, self.colour, Stroke::new(INK, 1.1));
        // Below its point where the mask's own name would be in the way.
        let beside_mask = (self.emitter.y - self.slit[1].y).abs() * self.scale < 36.0;
        let drop = if beside_mask { 36.0 } else { -6.0 };
        canvas.text(emitter + dvec2(14.0, drop), "emitter (IRED)", LABEL);
    }

    /// An arc from the emitter's axis to the beam, where it is wide enough to see and lies in the
    /// plane of the picture, so that it is γ and not its shadow.
    fn draw_gamma(&self, canvas: &mut Canvas, emitter: DVec2) {
        let Some((x_a_m, gamma)) = self.response.x_a_m.zip(self.response.gamma_rad) else {
            return;
        };
        let sweep = self.axis.angle_to(dvec2(1e3 * x_a_m, 0.0) - self.emitter);
        if sweep.abs() < 8f64.to_radians() || (sweep.abs() - gamma).abs() > 1f64.to_radians() {
            return;
        }
        let at = |share: f64, radius: f64| {
            let direction = DVec2::from_angle(sweep * share).rotate(self.axis.normalize_or(DVec2::NEG_Y));
            emitter + radius * dvec2(direction.x, -direction.y)
        };
        let arc: Vec<_> = (0..=16).map(|step| at(f64::from(step) / 16.0, 44.0)).collect();
        canvas.path(&arc, DIMENSION);
        canvas.text(at(0.5, 62.0) + dvec2(0.0, 4.0), "$γ$", LABEL.anchored(Anchor::Middle));
    }

    fn draw_dimensions(&self, canvas: &mut Canvas) {
        let half = self.half_mm();
        let slit_height = 0.5 * (self.slit[0].y + self.slit[1].y);
        let mut height = |column: f64, top: DVec2, label_mm: f64, label: &str| {
            let (foot, head) = (dvec2(column, self.origin.y), dvec2(column, self.place(top).y));
            canvas.line(self.place(top), dvec2(column - 6.0, head.y), Stroke::new(PALE, 0.9));
            canvas.line(self.place(dvec2(-half, 0.0)), dvec2(column - 6.0, foot.y), Stroke::new(PALE, 0.9));
            canvas.dimension(foot, head, DIMENSION);
            canvas.text(dvec2(column + 8.0, self.place(dvec2(0.0, label_mm)).y), label, LABEL);
        };
        let (d_a, d_b) = (quantity(self.emitter.y), quantity(slit_height));
        // Beside the part that d_B does not span.
        let above = if self.emitter.y > slit_height { slit_height } else { 0.0 };
        height(80.0, self.emitter, 0.5 * (self.emitter.y + above), &format!("$d_A$ = {d_a} mm"));
        let rides = self.cell.opening() == Opening::RidingSlit;
        let mask = if rides { self.slit[0].x - 0.25 * half } else { -half - 1.0 };
        height(185.0, dvec2(mask, slit_height), 0.5 * slit_height, &format!("$d_B$ = {d_b} mm"));
        self.draw_slit_width(canvas);
        self.draw_spot_position(canvas);
        let below = self.origin.y + 78.0;
        let (from, to) = (self.place(dvec2(-half, 0.0)), self.place(dvec2(half, 0.0)));
        for end in [from, to] {
            canvas.line(end + dvec2(0.0, 18.0), dvec2(end.x, below + 6.0), Stroke::new(PALE, 0.9));
        }
        canvas.dimension(dvec2(from.x, below), dvec2(to.x, below), DIMENSION);
        let label = format!("$L_x$ = {} mm", quantity(2.0 * half));
        canvas.text(dvec2(self.origin.x, below + 20.0), &label, LABEL.anchored(Anchor::Middle));
    }

    /// Above the mask, because the beam is below it; arrows from outside, because it is narrow.
    fn draw_slit_width(&self, canvas: &mut Canvas) {
        let [left, right] = self.slit.map(|edge| self.place(edge) - dvec2(0.0, 16.0));
        for edge in [left, right] {
            canvas.line(edge - dvec2(0.0, 5.0), edge + dvec2(0.0, 12.0), Stroke::new(PALE, 0.9));
        }
        canvas.arrow(left - dvec2(24.0, 0.0), left, DIMENSION);
        canvas.arrow(right + dvec2(24.0, 0.0), right, DIMENSION);
        let width = 1e3 * self.cell.slit.width_m;
        let clear = if self.emitter.x > 0.0 { left - dvec2(30.0, -5.0) } else { right + dvec2(30.0, 5.0) };
        let anchor = if self.emitter.x > 0.0 { Anchor::End } else { Anchor::Start };
        let name = if self.cell.opening().is_hole() { "⌀" } else { "$w$ =" };
        canvas.text(clear, &format!("{name} {} mm", quantity(width)), LABEL.anchored(anchor));
    }

    fn draw_spot_position(&self, canvas: &mut Canvas) {
        let Some(x_a_m) = self.response.x_a_m else {
            return;
        };
        let row = self.origin.y + 34.0;
        let (zero, x_a) = (dvec2(self.origin.x, row), dvec2(self.place(dvec2(1e3 * x_a_m, 0.0)).x, row));
        for at in [zero, x_a] {
            canvas.line(dvec2(at.x, self.origin.y + 18.0), at + dvec2(0.0, 6.0), Stroke::new(PALE, 0.9));
        }
        canvas.arrow(zero, x_a, Stroke::new(self.colour, 1.4));
        let label = format!("$X_A$ = {} mm", quantity(1e3 * x_a_m));
        let middle = dvec2(0.5 * (zero.x + x_a.x), row + 20.0);
        canvas.text(middle, &label, LABEL.coloured(self.colour).anchored(Anchor::Middle));
    }

    fn draw_readout(&self, canvas: &mut Canvas, height: f64) {
        let response = &self.response;
        let (condition, has_flags) = condition(response);
        let mut parts = vec![condition];
        if let Some(gamma) = response.gamma_rad {
            parts.push(format!("$γ$ = {}°", quantity(gamma.to_degrees())));
        }
        parts.push(format!("$Ω$ = {} msr", quantity(1e3 * response.solid_angle_sr)));
        parts.push(format!("$I_O$ = {} µA", quantity(1e6 * response.i_o_a)));
        parts.push(format!("$I_{{X1}}$ = {} µA", quantity(1e6 * response.currents.i_x1_a)));
        parts.push(format!("$I_{{X2}}$ = {} µA", quantity(1e6 * response.currents.i_x2_a)));
        let colour = if response.status.has_spot() && !has_flags { INK } else { ALERT };
        canvas.text(dvec2(28.0, height - 14.0), &parts.join("   ·   "), TextStyle::new(14.0).coloured(colour));
    }
}
