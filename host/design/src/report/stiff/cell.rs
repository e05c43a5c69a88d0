//! One cell driven to extremes: no light, little light, light from far, from near and from aside.

use glam::{DVec2, DVec3};
use slitpose_model::{
    Cell, CompiledScene, Effects, Pair, Pose, Profile, Response, Scene, SceneError, Tier, Uncertainty,
};

use super::{Case, Expected, Reached, UNIT_ROUNDOFF};
use crate::report::head::exponent;

/// As exact as can be: the rest is rounding.
const TIGHTEST: Tier = Tier::Exact { tolerance: 1e-14 };

/// A dark current, so that it can be seen to be all there is.
const DARK_A: f64 = 20e-9;

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

    fn cell(&self) -> &Cell {
        &self.scene.cells[0]
    }

    fn with(&self, change: impl FnOnce(&mut Cell)) -> Self {
        let mut scene = self.scene.clone();
        change(&mut scene.cells[0]);
        Self { scene, ..*self }
    }

    fn facing(&self, axis: DVec3) -> Self {
        self.with(|cell| cell.emitter.axis_tool = axis)
    }

    /// The model's response, and its currents above dark.
    fn respond(&self, emitter_m: DVec3) -> Result<(Response<f64>, Pair<f64>), SceneError> {
        let plan = CompiledScene::<f64>::compile(&self.scene, TIGHTEST)?;
        Ok((plan.respond(0, &at(emitter_m)), plan.photocurrents(0, &at(emitter_m))))
    }

    /// A case without light: the status, and how much current there is in spite of it.
    fn without_light(&self, case: &str, emitter_m: DVec3, word: &'static [&'static str]) -> Result<Case, SceneError> {
        let (response, _) = self.respond(emitter_m)?;
        let above_dark_a = (response.i_o_a - DARK_A).abs();
        Ok(Case {
            study: "no light",
            case: case.to_owned(),
            condition: None,
            quantity: "current above dark / A",
            expected: Expected::Words(word),
            reached: Reached::once(response.status.as_str(), Some(above_dark_a), Some(0.0)),
        })
    }

    /// A case with light: error of the electrodes' currents relative to their sum.
    fn with_light(&self, study: &'static str, case: String, emitter_m: DVec3) -> Result<Case, SceneError> {
        let (response, pair) = self.respond(emitter_m)?;
        let reference = self.reference(emitter_m).unwrap_or_default();
        let rounding = self.rounding(emitter_m)?;
        let error_a = (pair.i_x1_a - reference.i_x1_a).abs().max((pair.i_x2_a - reference.i_x2_a).abs());
        let error = Some(error_a / reference.total_a());
        Ok(Case {
            study,
            case,
            condition: Some(rounding),
            quantity: "current / relative",
            expected: Expected::Value,
            reached: Reached::once(response.status.as_str(), error, Some(UNIT_ROUNDOFF * rounding)),
        })
    }

    /// The relative change of a current when every number that goes in is rounded once, in units of
    /// the rounding: the condition of the forward problem.
    fn rounding(&self, emitter_m: DVec3) -> Result<f64, SceneError> {
        let plan = CompiledScene::<f64>::compile(&self.scene, TIGHTEST)?;
        let (_, pair, jacobian) = plan.linearise(0, &at(emitter_m));
        let along = emitter_m.x.abs() + 0.5 * self.cell().slit.width_m;
        let up = emitter_m.z + self.cell().slit.distance_m;
        let of = |current: f64, row: [f64; 6]| {
            // The axis is a unit vector: its rounding is an angle.
            let turn = row[3] * row[3] + row[4] * row[4] + row[5] * row[5];
            let moved = (row[0] * along).powi(2) + (row[1] * emitter_m.y).powi(2) + (row[2] * up).powi(2);
            ((current * current + moved + turn) / 3.0).sqrt()
        };
        Ok(of(pair.i_x1_a, jacobian[0]).max(of(pair.i_x2_a, jacobian[1])) / pair.total_a())
    }

    /// The photocurrents of both electrodes above dark; `None` without spot.
    ///
    /// Nothing here is shared with the model: the spot's sides come from differences that are exact in
    /// the near field, and the integrals are done by the double exponential rule (Takahashi and Mori
    /// 1974), which does not mind that the light ends within the spot.
    fn reference(&self, emitter_m: DVec3) -> Option<Pair<f64>> {
        let Cell { detector, slit, emitter, .. } = self.cell();
        let above = emitter_m.z - slit.distance_m;
        // Where the rays past the slit's edges land. Near the slit the edge's distance from the emitter is exact; far from
        // it the emitter's own share is small. Either way no two large numbers are subtracted.
        let side = |emitter: f64, slit_m: f64, length_m: f64| {
            let landing = |edge: f64| match above < slit.distance_m {
                true => edge + (edge - emitter) * (slit.distance_m / above),
                false => (edge * emitter_m.z - emitter * slit.distance_m) / above,
            };
            [landing(-0.5 * slit_m).max(-0.5 * length_m), landing(0.5 * slit_m).min(0.5 * length_m)]
        };
        let x = side(emitter_m.x, slit.width_m, detector.length_m);
        let y = side(emitter_m.y, slit.length_m, detector.width_m);
        if above <= 0.0 || x[1] <= x[0] || y[1] <= y[0] {
            return None;
        }
        // The part of a row that is not behind the emitter's horizon.
        let lit = |[from, to]: [f64; 2], y_m: f64| {
            let [at_from, at_to] = [from, to].map(|x_m| emitter.axis_tool.dot(DVec3::new(x_m, y_m, 0.0) - emitter_m));
            let cut = (from + (to - from) * at_from / (at_from - at_to)).clamp(from, to);
            match (at_from > 0.0, at_to > 0.0) {
                (true, true) => [from, to],
                (true, false) => [from, cut],
                (false, true) => [cut, to],
                (false, false) => [from, from],
            }
        };
        // I_rel·dΩ/dA, 1/m².
        let density = |x_m: f64, y_m: f64| {
            let ray = DVec3::new(x_m, y_m, 0.0) - emitter_m;
            let distance = ray.length();
            let cosine = (emitter.axis_tool.dot(ray) / distance).max(0.0);
            cosine.powf(self.exponent) * emitter_m.z / (distance * distance * distance)
        };
        let (mut power, mut moment) = (Sum::default(), Sum::default());
        double_exponential(y, |y_m, weight| {
            double_exponential(lit(x, y_m), |x_m, column_weight| {
                let light = weight * column_weight * density(x_m, y_m);
                power.add(light);
                moment.add(light * x_m);
            });
        });
        let gain_a_per_sr = detector.responsivity_a_per_w * emitter.radiant_intensity_w_per_sr;
        let total_a = gain_a_per_sr * power.total();
        let imbalance_a = gain_a_per_sr * moment.total() / detector.length_m;
        Some(Pair { i_x1_a: 0.5 * total_a - imbalance_a, i_x2_a: 0.5 * total_a + imbalance_a })
    }
}

/// The tool's frame sits on the emitter.
fn at(emitter_m: DVec3) -> Pose {
    Pose::from_vectors(emitter_m, DVec3::ZERO)
}

/// A sum with the rounding of each addition carried along (Neumaier 1974).
#[derive(Clone, Copy, Debug, Default)]
struct Sum {
    sum: f64,
    lost: f64,
}

impl Sum {
    fn add(&mut self, value: f64) {
        let sum = self.sum + value;
        self.lost += if self.sum.abs() >= value.abs() { self.sum - sum + value } else { value - sum + self.sum };
        self.sum = sum;
    }

    fn total(self) -> f64 {
        self.sum + self.lost
    }
}

/// Nodes and weights between two ends, handed to `add`: some 1e-15 of smooth integrals.
fn double_exponential([from, to]: [f64; 2], mut add: impl FnMut(f64, f64)) {
    const STEP: f64 = 1.0 / 16.0;
    const STEPS: i32 = 54;
    let (middle, half) = (0.5 * (from + to), 0.5 * (to - from));
    for step in -STEPS..=STEPS {
        let t = f64::from(step) * STEP;
        let inner = std::f64::consts::FRAC_PI_2 * t.sinh();
        let weight = std::f64::consts::FRAC_PI_2 * t.cosh() / inner.cosh().powi(2);
        add(middle + half * inner.tanh(), half * STEP * weight);
    }
}

pub(super) fn cases(scene: &Scene) -> Result<Vec<Case>, SceneError> {
    let lone = Lone::of(scene);
    let down = lone.facing(-DVec3::Z);
    let (length_m, slit_m, height_m) = (lone.cell().detector.length_m, lone.cell().slit.distance_m, lone.height_m);
    let half_slit_m = 0.5 * lone.cell().slit.width_m;
    let behind = |case: &str, z_m: f64| down.without_light(case, DVec3::Z * z_m, &["behind"]);
    let mut cases = vec![
        behind("emitter in the slit's plane", slit_m)?,
        behind("emitter 1 nm behind it", slit_m - 1e-9)?,
        behind("emitter 1 mm behind it", slit_m - 1e-3)?,
        behind("emitter behind the detector", -slit_m)?,
        down.without_light("spot beside the detector", DVec3::new(2.0 * length_m, 0.0, height_m), &["dark"])?,
        down.with(|cell| cell.slit.width_m = 0.0).without_light("slit of no width", DVec3::Z * height_m, &["dark"])?,
    ];
    // γ = 90° crosses the spot: only part of it is lit.
    let half_angle_deg = (half_slit_m / (height_m - slit_m)).atan().to_degrees();
    for share in [0.0, 0.5, 0.9, 0.99, 0.999] {
        let angle_deg: f64 = 90.0 + share * half_angle_deg;
        let (sine, cosine) = angle_deg.to_radians().sin_cos();
        let turned = lone.facing(DVec3::new(sine, 0.0, -cosine));
        cases.push(turned.with_light("horizon", format!("axis at {angle_deg:.3}°"), DVec3::Z * height_m)?);
    }
    for (exponent, aside) in (-1..=7).map(|exponent| (exponent, 0.0)).chain((0..=6).step_by(2).map(|e| (e, 0.1))) {
        let distance_m = 10f64.powi(exponent);
        let place = if aside > 0.0 { format!(", {:e} m aside", aside * distance_m) } else { String::new() };
        let case = format!("emitter at {distance_m:e} m{place}");
        cases.push(down.with_light("small solid angle", case, DVec3::new(aside * distance_m, 0.0, distance_m))?);
    }
    // The emitter comes down to the slit, beside its edge so that the spot ends on the detector: where it ends then hangs
    // on a difference of nearly equal numbers. The ray past the edge lands a quarter of the detector's length off its
    // middle.
    for exponent in (-9..=-3).rev() {
        let above_m = 10f64.powi(exponent);
        let x_m = (half_slit_m * (slit_m + above_m) - 0.25 * length_m * above_m) / slit_m;
        let case = format!("emitter {above_m:e} m above the slit");
        cases.push(down.with_light("near field", case, DVec3::new(x_m, 0.0, slit_m + above_m))?);
    }
    // The slit comes down to the detector, and the light comes in ever more from the side.
    let reach_m = 0.4 * length_m;
    for slit_m in [5e-3, 2e-3, 1e-3, 1e-4, 1e-5, 1e-6] {
        let angle = (reach_m / slit_m).atan();
        let axis = DVec3::new(-angle.sin(), 0.0, -angle.cos());
        let low = lone.facing(axis).with(|cell| cell.slit.distance_m = slit_m);
        let emitter_m = DVec3::new(-reach_m, 0.0, 0.0) - axis * height_m;
        let case = format!("incidence {:.3}°", angle.to_degrees());
        cases.push(low.with_light("grazing light", case, emitter_m)?);
    }
    Ok(cases)
}

#[cfg(test)]
mod tests {
    use slitpose_head::scene_file::BENCH;

    use super::*;

    #[test]
    fn the_numbers_are_those_of_fifty_digits() {
        let bench = Lone::of(&BENCH.read().unwrap().scene);
        let (down, nominal_m) = (bench.facing(-DVec3::Z), DVec3::Z * 15e-3);
        // tests/data/reference/single_cell.csv: nominal, near_8.0, far_1e6, grazing_92deg.
        // The last one's axis is at 91° from the detector's normal; its name counts otherwise.
        let angle = 91f64.to_radians();
        let grazing = bench.facing(DVec3::new(angle.sin(), 0.0, -angle.cos()));
        for (lone, emitter_m, expected) in [
            (&down, nominal_m, [3.029_692_458_806_154e-6, 3.029_692_458_806_154e-6]),
            (&down, DVec3::new(0.3e-3, 0.1e-3, 8e-3), [6.133_932_375_119_397e-5, 1.790_669_607_930_650_4e-5]),
            (&down, DVec3::Z * 1e3, [3.412_825_596_191_271_4e-16, 3.412_825_596_191_271_4e-16]),
            (&grazing, nominal_m, [6.333_633_794_185_823e-10, 7.136_066_487_273_359e-10]),
        ] {
            let pair = lone.reference(emitter_m).unwrap();
            for (found, expected) in [pair.i_x1_a, pair.i_x2_a].into_iter().zip(expected) {
                assert!((found / expected - 1.0).abs() < 3e-15, "{found:e} {expected:e}");
            }
        }
        // No light where there is none.
        assert!(down.reference(DVec3::Z * 7.5e-3).is_none());
        assert!(down.reference(DVec3::new(6.5e-3, 0.0, 15e-3)).is_none());
        assert_eq!(bench.facing(DVec3::Z).reference(nominal_m).unwrap().total_a(), 0.0);
    }
}
