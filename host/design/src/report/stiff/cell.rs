//! One cell driven to extremes: no light, little light, light from far, from near and from aside.

use glam::{DVec2, DVec3};
use slitpose_model::{
    Cell, CompiledScene, Effects, Pair, Pose, Profile, Response, Scalar, Scene, SceneError, Tier, Uncertainty,
};

use super::case::{Case, Expected, Reached};
use super::reference::Reference;
use crate::report::head::exponent;
use crate::report::method::Precision;

/// As exact as `f64` can be: the rest is rounding.
const TIGHTEST: Tier = Tier::Exact { tolerance: 1e-14 };

/// A dark current, so that it can be seen to be all there is.
const DARK_A: f64 = 20e-9;

const CURRENT: &str = "current / relative";

/// A slit of the head's dimensions on the base, on its own and in its own frame.
struct Lone {
    scene: Scene,
    exponent: f64,
    /// From detector to emitter at home, along the detector's normal, metres.
    height_m: f64,
}

impl Lone {
    fn of(scene: &Scene) -> Self {
        let mut cell = Cell { effects: Effects::default(), ..scene.cells[0].clone() };
        let height_m = (cell.emitter.position_tool_m - cell.detector.centre_base_m).dot(cell.detector.normal_base);
        let exponent = exponent(&cell.emitter.profile);
        let (detector, slit) = (&mut cell.detector, &mut cell.slit);
        (detector.centre_base_m, detector.x_axis_base, detector.normal_base) = (DVec3::ZERO, DVec3::X, DVec3::Z);
        (detector.dark_current_a, detector.saturation_a, detector.faint_a) = (DARK_A, None, 0.0);
        (slit.offset_m, slit.tilt_rad, slit.thickness_m) = (DVec2::ZERO, DVec3::ZERO, 0.0);
        cell.emitter.position_tool_m = DVec3::ZERO;
        cell.emitter.profile = Profile::Cosine { exponent };
        let cells = [cell].into_iter().collect();
        Self { scene: Scene { cells, noise: None, uncertainty: Uncertainty::default() }, exponent, height_m }
    }

    fn slit_height_m(&self) -> f64 {
        self.scene.cells[0].slit.distance_m
    }

    fn half_slit_m(&self) -> f64 {
        0.5 * self.scene.cells[0].slit.width_m
    }

    /// The same with its slit changed.
    fn with_slit(&self, distance_m: f64, width_m: f64) -> Self {
        let mut scene = self.scene.clone();
        (scene.cells[0].slit.distance_m, scene.cells[0].slit.width_m) = (distance_m, width_m);
        Self { scene, ..*self }
    }

    fn facing(&self, axis: DVec3) -> Self {
        let mut scene = self.scene.clone();
        scene.cells[0].emitter.axis_tool = axis;
        Self { scene, ..*self }
    }

    fn reference(&self, emitter_m: DVec3) -> Option<Pair<f64>> {
        let (cell, half) = (&self.scene.cells[0], |size: f64| 0.5 * size);
        Reference {
            half_m: [half(cell.detector.length_m), half(cell.detector.width_m)],
            slit_half_m: [half(cell.slit.width_m), half(cell.slit.length_m)],
            slit_height_m: cell.slit.distance_m,
            emitter_m,
            axis: cell.emitter.axis_tool,
            exponent: self.exponent,
            gain_a_per_sr: cell.detector.responsivity_a_per_w * cell.emitter.radiant_intensity_w_per_sr,
        }
        .currents()
    }

    /// The model's currents in a number type, the dark current subtracted exactly.
    fn respond<S: Scalar>(&self, tier: Tier, emitter_m: DVec3) -> Result<(Response<S>, Pair<f64>), SceneError> {
        let plan = CompiledScene::<S>::compile(&self.scene, tier)?;
        let pose = at(emitter_m);
        let pair = plan.photocurrents(0, &pose);
        Ok((plan.respond(0, &pose), Pair { i_x1_a: pair.i_x1_a.as_f64(), i_x2_a: pair.i_x2_a.as_f64() }))
    }

    /// A case without light: the status, and how much current there is in spite of it.
    fn without_light(&self, case: &str, emitter_m: DVec3, expected: Expected) -> Result<Case, SceneError> {
        let (double, _) = self.respond::<f64>(TIGHTEST, emitter_m)?;
        let (single, _) = self.respond::<f32>(Precision::Single.tightest_tier(), emitter_m)?;
        let reached =
            |word: &str, i_o_a: f64, dark_a: f64| Reached::once(word, Some((i_o_a - dark_a).abs()), Some(0.0));
        let dark = f64::from(DARK_A as f32);
        Ok(Case {
            study: "no light",
            case: case.to_owned(),
            condition: None,
            quantity: "current above dark / A",
            expected,
            reached: vec![
                (Precision::Double, reached(double.status.as_str(), double.i_o_a, DARK_A)),
                (Precision::Single, reached(single.status.as_str(), f64::from(single.i_o_a), dark)),
            ],
        })
    }

    /// A case with light: error of the electrodes' currents relative to their sum.
    fn with_light(&self, study: &'static str, case: String, emitter_m: DVec3) -> Result<Case, SceneError> {
        let (double, double_pair) = self.respond::<f64>(TIGHTEST, emitter_m)?;
        let (single, single_pair) = self.respond::<f32>(Precision::Single.tightest_tier(), emitter_m)?;
        let reference = self.reference(emitter_m).unwrap_or_default();
        let rounding = self.rounding(emitter_m)?;
        let total_a = reference.total_a();
        let reached = |precision: Precision, word: &str, pair: Pair<f64>| {
            let error = (pair.i_x1_a - reference.i_x1_a).abs().max((pair.i_x2_a - reference.i_x2_a).abs());
            let attainable = precision.unit_roundoff() * rounding;
            (precision, Reached::once(word, Some(error / total_a), Some(attainable)))
        };
        Ok(Case {
            study,
            case,
            condition: Some(rounding),
            quantity: CURRENT,
            expected: Expected::Value,
            reached: vec![
                reached(Precision::Double, double.status.as_str(), double_pair),
                reached(Precision::Single, single.status.as_str(), single_pair),
            ],
        })
    }

    /// The relative change of a current when every number that goes in is rounded once, in units of
    /// the rounding: the condition of the forward problem.
    fn rounding(&self, emitter_m: DVec3) -> Result<f64, SceneError> {
        let plan = CompiledScene::<f64>::compile(&self.scene, TIGHTEST)?;
        let (_, pair, jacobian) = plan.linearise(0, &at(emitter_m));
        let along = emitter_m.x.abs() + self.half_slit_m();
        let up = emitter_m.z + self.slit_height_m();
        let of = |current: f64, row: [f64; 6]| {
            // The axis is a unit vector: its rounding is an angle.
            let turn = row[3] * row[3] + row[4] * row[4] + row[5] * row[5];
            let moved = (row[0] * along).powi(2) + (row[1] * emitter_m.y).powi(2) + (row[2] * up).powi(2);
            ((current * current + moved + turn) / 3.0).sqrt()
        };
        Ok(of(pair.i_x1_a, jacobian[0]).max(of(pair.i_x2_a, jacobian[1])) / pair.total_a())
    }
}

/// The tool's frame sits on the emitter.
fn at(emitter_m: DVec3) -> Pose {
    Pose::from_vectors(emitter_m, DVec3::ZERO)
}

/// An axis in the x-z plane, `degrees` from straight down.
fn turned(degrees: f64) -> DVec3 {
    let (sine, cosine) = degrees.to_radians().sin_cos();
    DVec3::new(sine, 0.0, -cosine)
}

pub(super) fn cases(scene: &Scene) -> Result<Vec<Case>, SceneError> {
    let lone = Lone::of(scene);
    let down = lone.facing(-DVec3::Z);
    let mut cases = no_light(&down)?;
    cases.extend(horizon(&lone)?);
    cases.extend(far(&down)?);
    cases.extend(near(&down)?);
    cases.extend(grazing(&lone)?);
    Ok(cases)
}

fn no_light(lone: &Lone) -> Result<Vec<Case>, SceneError> {
    let (slit_m, behind, dark) = (lone.slit_height_m(), Expected::Words(&["behind"]), Expected::Words(&["dark"]));
    let length_m = lone.scene.cells[0].detector.length_m;
    Ok(vec![
        lone.without_light("emitter in the slit's plane", DVec3::Z * slit_m, behind)?,
        lone.without_light("emitter 1 nm behind it", DVec3::Z * (slit_m - 1e-9), behind)?,
        lone.without_light("emitter 1 mm behind it", DVec3::Z * (slit_m - 1e-3), behind)?,
        lone.without_light("emitter behind the detector", DVec3::Z * -slit_m, behind)?,
        lone.without_light("spot beside the detector", DVec3::new(2.0 * length_m, 0.0, lone.height_m), dark)?,
        lone.with_slit(slit_m, 0.0).without_light("slit of no width", DVec3::Z * lone.height_m, dark)?,
    ])
}

/// γ = 90° crosses the spot: only part of it is lit.
fn horizon(lone: &Lone) -> Result<Vec<Case>, SceneError> {
    let half_angle = (lone.half_slit_m() / (lone.height_m - lone.slit_height_m())).atan().to_degrees();
    [0.0, 0.5, 0.9, 0.99, 0.999]
        .into_iter()
        .map(|share| {
            let angle = 90.0 + share * half_angle;
            lone.facing(turned(angle)).with_light("horizon", format!("axis at {angle:.3}°"), DVec3::Z * lone.height_m)
        })
        .collect()
}

fn far(lone: &Lone) -> Result<Vec<Case>, SceneError> {
    let case = |(exponent, aside): (i32, f64)| {
        let distance_m = 10f64.powi(exponent);
        let place = if aside > 0.0 { format!(", {:e} m aside", aside * distance_m) } else { String::new() };
        let case = format!("emitter at {distance_m:e} m{place}");
        lone.with_light("small solid angle", case, DVec3::new(aside * distance_m, 0.0, distance_m))
    };
    (-1..=7)
        .map(|exponent| (exponent, 0.0))
        .chain((0..=6).step_by(2).map(|exponent| (exponent, 0.1)))
        .map(case)
        .collect()
}

/// The emitter comes down to the slit, beside its edge so that the spot ends on the detector: where
/// it ends then hangs on a difference of nearly equal numbers.
fn near(lone: &Lone) -> Result<Vec<Case>, SceneError> {
    let case = |exponent: i32| {
        let above_m = 10f64.powi(exponent);
        let height_m = lone.slit_height_m() + above_m;
        // The ray past the edge lands a quarter of the detector's length off its middle.
        let landing_m = 0.25 * lone.scene.cells[0].detector.length_m;
        let edge_m = lone.half_slit_m();
        let x_m = (edge_m * height_m - landing_m * above_m) / lone.slit_height_m();
        lone.with_light("near field", format!("emitter {above_m:e} m above the slit"), DVec3::new(x_m, 0.0, height_m))
    };
    (-9..=-3).rev().map(case).collect()
}

/// The slit comes down to the detector, and the light comes in ever more from the side.
fn grazing(lone: &Lone) -> Result<Vec<Case>, SceneError> {
    let reach_m = 0.4 * lone.scene.cells[0].detector.length_m;
    let case = |slit_m: f64| {
        let angle = (reach_m / slit_m).atan();
        let axis = DVec3::new(-angle.sin(), 0.0, -angle.cos());
        let low = lone.with_slit(slit_m, lone.scene.cells[0].slit.width_m).facing(axis);
        let away_m = lone.height_m;
        let emitter_m = DVec3::new(-reach_m, 0.0, 0.0) - axis * away_m;
        low.with_light("grazing light", format!("incidence {:.3}°", angle.to_degrees()), emitter_m)
    };
    [5e-3, 2e-3, 1e-3, 1e-4, 1e-5, 1e-6].into_iter().map(case).collect()
}
