//! The calculated curves in the manner of the paper's figures 7 and 15 to 17.

use glam::dvec2;
use slitpose_model::{Cell, Profile};

use crate::plot::{Axis, Canvas, Chart, Curve, CurveStyle, curve};

use super::{Point, Study};

const WIDTH: f64 = 760.0;
const LEFT: f64 = 92.0;
const RIGHT: f64 = 24.0;
const UPPER: f64 = 330.0;
const LOWER: f64 = 120.0;

pub(super) const POSITION: &str = "emitter position along $x_{PSD}$ / mm";
const NO_MEASUREMENT: &str = "Calculated points only: the paper's measured ones were published without numbers.";
pub(super) const SIMULATED: &str =
    "All currents are simulated: the paper's measured ones were published without numbers.";

/// Every figure, as a file name and an SVG text.
pub fn figures(study: &Study, cell: &Cell) -> Vec<(&'static str, String)> {
    vec![
        ("figure_15.svg", spot_position(study)),
        ("figure_16.svg", photocurrent(study)),
        ("figure_17.svg", photocurrent_with_profile(study)),
        ("identified_profile.svg", profile(study, cell)),
    ]
}

fn spot_position(study: &Study) -> String {
    let x_a = |response: &slitpose_model::Response<f64>| response.x_a_m.map(|x_a_m| x_a_m * 1e3);
    let paper = points(&study.translation, |point| x_a(&point.paper));
    let exact = points(&study.translation, |point| x_a(&point.exact));
    let difference = points(&study.translation, |point| Some(1e3 * (x_a(&point.exact)? - x_a(&point.paper)?)));
    Figure {
        title: "Light spot position, experiment 1 (the paper's figure 15)",
        note: NO_MEASUREMENT,
        x: POSITION,
        y: "$X_A$ / mm",
        curves: vec![
            curve("geometric centre of the spot (paper tier)", 0, CurveStyle::Line, paper),
            curve("power-weighted centroid (exact tier)", 1, CurveStyle::Rings, exact),
        ],
        starting_at_zero: false,
        lower_y: "difference / µm",
        lower: vec![difference_curve("exact tier − paper tier", difference)],
    }
    .draw()
}

fn photocurrent(study: &Study) -> String {
    let paper = points(&study.translation, |point| Some(point.paper.i_o_a * 1e6));
    let exact = points(&study.translation, |point| Some(point.exact.i_o_a * 1e6));
    let difference = points(&study.translation, |point| Some(100.0 * (point.exact.i_o_a / point.paper.i_o_a - 1.0)));
    Figure {
        title: "Photocurrent, experiment 1 (the paper's figure 16)",
        note: NO_MEASUREMENT,
        x: POSITION,
        y: "$I_O$ / µA",
        curves: vec![
            curve("equation (5), one $γ$ for the whole beam (paper tier)", 0, CurveStyle::Line, paper),
            curve("integrated over the spot (exact tier)", 1, CurveStyle::Rings, exact),
        ],
        starting_at_zero: true,
        lower_y: "difference / %",
        lower: vec![difference_curve("exact tier, relative to paper tier", difference)],
    }
    .draw()
}

fn photocurrent_with_profile(study: &Study) -> String {
    let both = || study.translation.iter().zip(&study.with_identified);
    let refit = both().map(|(point, refit)| [point.amount, refit.i_o_a * 1e6]).collect();
    let exact = points(&study.translation, |point| Some(point.exact.i_o_a * 1e6));
    let difference =
        both().map(|(point, refit)| [point.amount, 100.0 * (refit.i_o_a / point.exact.i_o_a - 1.0)]).collect();
    Figure {
        title: "Photocurrent, experiment 1, identified profile (the paper's figure 17)",
        note: SIMULATED,
        x: POSITION,
        y: "$I_O$ / µA",
        curves: vec![
            curve("equation (5) with the profile identified by equation (6)", 2, CurveStyle::Line, refit),
            curve("simulated (exact tier)", 1, CurveStyle::Rings, exact),
        ],
        starting_at_zero: true,
        lower_y: "difference / %",
        lower: vec![difference_curve("calculated, relative to simulated", difference)],
    }
    .draw()
}

fn profile(study: &Study, cell: &Cell) -> String {
    let given = |gamma_deg: f64| match &cell.emitter.profile {
        Profile::Cosine { exponent } => Some(gamma_deg.to_radians().cos().max(0.0).powf(*exponent)),
        Profile::Table(_) => None,
    };
    let angles = || study.rotation.iter().zip(&study.identified);
    let identified = angles().map(|(point, found)| [point.amount, found.relative_intensity]).collect();
    let cosine = points(&study.rotation, |point| given(point.amount));
    let relative = |(point, found): (&Point, &crate::identification::Identified)| {
        Some(100.0 * (found.relative_intensity / given(point.amount)? - 1.0))
    };
    let difference = angles().filter_map(|pair| Some([pair.0.amount, relative(pair)?])).collect();
    Figure {
        title: "Relative radiant intensity from experiment 2, by equation (6)",
        note: SIMULATED,
        x: "emitter angle / °",
        y: "$I_{rel}$",
        curves: vec![
            curve("the scene's profile, half intensity at 55°", 0, CurveStyle::Line, cosine),
            curve("identified from simulated currents (exact tier)", 1, CurveStyle::Rings, identified),
        ],
        starting_at_zero: true,
        lower_y: "difference / %",
        lower: vec![difference_curve("identified, relative to the scene's", difference)],
    }
    .draw()
}

fn points(points: &[Point], value: impl Fn(&Point) -> Option<f64>) -> Vec<[f64; 2]> {
    points.iter().filter_map(|point| Some([point.amount, value(point)?])).collect()
}

fn difference_curve(label: &str, points: Vec<[f64; 2]>) -> Curve {
    curve(label, 6, CurveStyle::Markers, points)
}

/// Curves above, their difference below, over the same horizontal axis.
pub(super) struct Figure<'a> {
    pub(super) title: &'a str,
    pub(super) note: &'a str,
    pub(super) x: &'a str,
    pub(super) y: &'a str,
    pub(super) curves: Vec<Curve>,
    pub(super) starting_at_zero: bool,
    pub(super) lower_y: &'a str,
    pub(super) lower: Vec<Curve>,
}

impl Figure<'_> {
    pub(super) fn draw(self) -> String {
        let all = || self.curves.iter().flat_map(|curve| &curve.points);
        let x = |label: &str| Axis::around(label, all().map(|point| point[0]));
        let y = Axis::around(self.y, all().map(|point| point[1]));
        let lower = Chart {
            x: x(self.x),
            y: Axis::around(
                self.lower_y,
                self.lower.iter().flat_map(|curve| &curve.points).map(|point| point[1]).chain([0.0]),
            ),
            curves: self.lower,
            notes: Vec::new(),
        };
        let upper = Chart {
            x: x(""),
            y: if self.starting_at_zero { y.starting_at_zero() } else { y },
            curves: self.curves,
            notes: Vec::new(),
        };
        let top = 64.0 + upper.legend_height();
        let lower_top = top + UPPER + 30.0 + lower.legend_height();
        let mut canvas = Canvas::titled(WIDTH, lower_top + LOWER + 56.0, self.title, self.note);
        upper.draw(&mut canvas, dvec2(LEFT, top), dvec2(WIDTH - RIGHT, top + UPPER));
        lower.draw(&mut canvas, dvec2(LEFT, lower_top), dvec2(WIDTH - RIGHT, lower_top + LOWER));
        canvas.into_svg()
    }
}
