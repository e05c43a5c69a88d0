//! Poses driven to extremes: layouts that hardly tell them, masked cells, turned frames, currents of any size.
//!
//! What can be attained at all: a relative error ρ of each current, and of each coordinate of detectors and
//! emitters, moves the pose by ρ times a factor that belongs to the head and the pose, the condition. No arithmetic can do
//! better with rounded data, and a stable one does little worse.

use std::f64::consts::PI;
use std::time::Instant;

use glam::DVec3;
use nalgebra::DMatrix;
use slitpose_model::{CompiledScene, Opening, Pair, Photocurrents, Pose, Reading, Scene, SceneError, rotation_exp};

use super::{Case, Expected, Reached, TIGHTEST, UNIT_ROUNDOFF};
use crate::report::Settings;
use crate::report::head::{Head, NoiseSource, currents};
use crate::report::section::Value;
use crate::report::solver::{Effort, Method, Start};

/// A pose whose rounding moves the emitters by less than this share of their distance can be had.
const TELLS_A_POSE: f64 = 1e-2;

pub(super) const POSES: usize = 20;

/// How far from home they are, per axis, metres and radians: so near that cases differ and not poses.
const NEAR_HOME: [f64; 2] = [0.3e-3, 0.02];

/// Repetitions of a timed solve; the least time counts, the others were disturbed.
const TIMES: usize = 3;

/// How far a warm start is off, per axis.
const PRIOR: [f64; 2] = [3e-6, 3e-4];

const ROLLS: [f64; 12] = [45.0, 10.0, 1.0, 0.1, 1e-2, 1e-3, 1e-4, 1e-5, 1e-6, 1e-7, 1e-8, 0.0];

pub(super) fn cases(head: &Head<'_>, settings: &Settings) -> Result<Vec<Case>, SceneError> {
    let mut cases = Vec::new();
    let trial = |scene: Scene, centre: &Pose, spread: f64| Trial::within(scene, centre, spread, settings.seed);
    // Where error and condition grow together: rolls of the detectors that come ever nearer to equal, at poses ever nearer
    // to home, where equal rolls leave directions free. A pose must come back where rounding leaves one.
    let telling = Expected::ValueBelow(TELLS_A_POSE * head.scene.length_scale_m() * 1e6);
    for (start, roll_deg) in Start::BOTH.into_iter().flat_map(|start| ROLLS.map(|roll_deg| (start, roll_deg))) {
        let trial = trial(rolled(head.arithmetic(), roll_deg), &Pose::HOME, roll_deg / ROLLS[0])?;
        let case = format!("rolls ±{}°, {}", Value::from(roll_deg).shown(), start.name());
        let expected = if roll_deg == 0.0 { Expected::Words(&["unobservable"]) } else { telling };
        cases.push(trial.case("near-parallel layout", case, start, expected, |_| true)?);
    }
    // Cells that cannot be used: the pose rests on the others, or is none.
    let cells = head.scene.cells.len();
    let faint = Reading::Light(Pair { i_x1_a: 1e-12, i_x2_a: 1e-12 });
    for (name, mask) in [("saturated", Reading::Saturated), ("without light", faint), ("missing", Reading::Missing)] {
        for masked in usize::from(mask != Reading::Saturated)..=cells {
            let mut trial = trial(head.arithmetic(), &Pose::HOME, 1.0)?;
            for readings in &mut trial.readings {
                readings.cells.iter_mut().take(masked).for_each(|reading| *reading = mask);
            }
            let expected = match cells - masked {
                0..3 => Expected::Words(&["unobservable", "too_dark"]),
                // Three cells have mirror images.
                3 => Expected::Honest,
                // Of other openings four may have them, too.
                4 if !head.is_of_slits() => Expected::Honest,
                _ => Expected::Value,
            };
            let case = format!("{masked} of {cells} {name}");
            cases.push(trial.case("masked cells", case, Start::Cold, expected, |cell| cell >= masked)?);
        }
    }
    // The same head, its emitters written in a tool frame that is turned by nearly half a turn. A slit on the tool is where
    // it is at home, in a frame that is not turned.
    let rides = head.scene.cells.iter().any(|cell| cell.opening() == Opening::RidingSlit);
    for short in [1.0, 1e-3, 1e-6, 0.0].into_iter().filter(|_| !rides) {
        let turn = rotation_exp(DVec3::new(0.36, -0.48, 0.8) * (PI - short));
        let mut scene = head.arithmetic();
        for cell in &mut scene.cells {
            cell.emitter.position_tool_m = turn.conjugate() * cell.emitter.position_tool_m;
            cell.emitter.axis_tool = turn.conjugate() * cell.emitter.axis_tool;
        }
        let trial = trial(scene, &Pose { rotation: turn, translation_m: DVec3::ZERO }, 1.0)?;
        let case = format!("warm solve, tool frame turned by π − {short}");
        cases.push(trial.case("rotation near π", case, Start::Warm, Expected::Value, |_| true)?);
    }
    // Currents from picoamperes to amperes: the pose does not depend on their unit.
    for exponent in (-9..=9).step_by(3) {
        let factor = 10f64.powi(exponent);
        let mut scene = head.arithmetic();
        for cell in &mut scene.cells {
            cell.emitter.radiant_intensity_w_per_sr *= factor;
            cell.detector.faint_a *= factor;
            cell.detector.dark_current_a *= factor;
            cell.detector.saturation_a = cell.detector.saturation_a.map(|limit| limit * factor);
        }
        let trial = trial(scene, &Pose::HOME, 1.0)?;
        let case = format!("{:.1e} A a cell", trial.plan.photocurrents(0, &Pose::HOME).total_a());
        cases.push(trial.case("scale of the currents", case, Start::Cold, Expected::Value, |_| true)?);
    }
    Ok(cases)
}

/// The scene with its detectors turned about their normals: each long axis `roll_deg` out of the
/// plane of the ring, up and down in turn.
fn rolled(mut scene: Scene, roll_deg: f64) -> Scene {
    for (number, cell) in scene.cells.iter_mut().enumerate() {
        let detector = &mut cell.detector;
        let tangent = detector.normal_base.cross(DVec3::Z).normalize_or(DVec3::X);
        let sign = if number % 2 == 0 { 1.0 } else { -1.0 };
        let (sine, cosine) = (sign * roll_deg.to_radians()).sin_cos();
        detector.x_axis_base = tangent * cosine + detector.normal_base.cross(tangent) * sine;
    }
    scene
}

struct Trial {
    scene: Scene,
    plan: CompiledScene<f64>,
    poses: Vec<Pose>,
    readings: Vec<Photocurrents>,
    priors: Vec<Pose>,
}

impl Trial {
    /// Noise-free currents of `scene` at poses around `centre`, `spread` times the usual distance away.
    fn within(scene: Scene, centre: &Pose, spread: f64, seed: u64) -> Result<Self, SceneError> {
        let plan = CompiledScene::compile(&scene, TIGHTEST)?;
        let mut noise = NoiseSource::seeded(seed);
        let poses: Vec<Pose> = (0..POSES).map(|_| noise.near(centre, NEAR_HOME.map(|sigma| spread * sigma))).collect();
        let readings = poses.iter().map(|pose| currents(&plan, pose)).collect();
        let priors = poses.iter().map(|pose| noise.near(pose, PRIOR)).collect();
        Ok(Self { scene, plan, poses, readings, priors })
    }

    /// Solves all of it with a full effort, against what rounding allows to the cells that are `used`.
    fn case(
        &self,
        study: &'static str,
        case: String,
        start: Start,
        expected: Expected,
        used: impl Fn(usize) -> bool,
    ) -> Result<Case, SceneError> {
        let attainable = |pose| Attainable::at(&self.scene, &self.plan, pose, &used);
        let attainable: Vec<Attainable> = self.poses.iter().map(attainable).collect();
        let mut reached = self.reached(start, &attainable)?;
        // Where there is no pose, nothing is attainable.
        let has_pose = !matches!(expected, Expected::Words(_));
        reached.attainable = reached.attainable.filter(|_| has_pose);
        let condition = slitpose_calibration::median(attainable.iter().map(|it| it.condition).collect());
        let quantity = "pose at the emitters / µm";
        Ok(Case { study, case, condition: has_pose.then_some(condition), quantity, expected, reached })
    }

    fn reached(&self, start: Start, attainable: &[Attainable]) -> Result<Reached, SceneError> {
        let arm_m = self.scene.length_scale_m();
        let solve = Method { tier: TIGHTEST, start, effort: Effort::Full }.compile(&self.scene)?;
        let mut reached = Reached::default();
        let (mut squares, mut best, mut found, mut slowest_s) = (0.0, 0.0, 0.0, 0.0_f64);
        for (index, pose) in self.poses.iter().enumerate() {
            let timed = || {
                let clock = Instant::now();
                let solved = solve(&self.readings[index], &self.priors[index]);
                (clock.elapsed().as_secs_f64(), solved)
            };
            let (mut least_s, solved) = timed();
            for _ in 1..TIMES {
                least_s = least_s.min(timed().0);
            }
            slowest_s = slowest_s.max(least_s);
            *reached.outcomes.entry(solved.outcome.as_str().to_owned()).or_default() += 1;
            reached.without_value += usize::from(solved.estimate.is_none());
            best += attainable[index].at_emitters_m(arm_m).powi(2);
            if let Some(estimate) = solved.estimate {
                let (dt, dr) = estimate.pose.displacement_from(pose);
                squares += dt.length_squared() + arm_m * arm_m * dr.length_squared();
                found += 1.0;
            }
        }
        let rms_um = |sum: f64, count: f64| (sum / count).sqrt() * 1e6;
        reached.error = Some(rms_um(squares, found)).filter(|error| error.is_finite());
        reached.slowest_s = Some(slowest_s);
        reached.attainable = Some(rms_um(best, self.poses.len() as f64));
        Ok(reached)
    }
}

/// The amplification of relative errors into errors of a pose.
#[derive(Clone, Copy, Debug)]
struct Attainable {
    /// Ratio of the extreme singular values of the Jacobian, each current in units of its own
    /// rounding, translations in units of the emitters' distance from the tool's origin.
    condition: f64,
    /// Translation per relative error, metres.
    translation_m: f64,
    /// Rotation per relative error, radians.
    rotation_rad: f64,
}

impl Attainable {
    /// With the tool of `scene` at `pose`, from the cells that `used` lets pass.
    fn at(scene: &Scene, plan: &CompiledScene<f64>, pose: &Pose, used: impl Fn(usize) -> bool) -> Self {
        let arm_m = scene.length_scale_m();
        let mut rows = Vec::new();
        for (number, cell) in scene.cells.iter().enumerate().filter(|(number, _)| used(*number)) {
            let (_, pair, jacobian) = plan.linearise(number, pose);
            let coordinates =
                cell.detector.centre_base_m.length_squared() + cell.emitter.position_tool_m.length_squared();
            for (current, row) in [pair.i_x1_a, pair.i_x2_a].into_iter().zip(jacobian) {
                let slope = row[0] * row[0] + row[1] * row[1] + row[2] * row[2];
                let rounding_a = ((current * current + slope * coordinates) / 3.0).sqrt();
                if rounding_a > 0.0 {
                    rows.extend((0..6).map(|axis| row[axis] * if axis < 3 { arm_m } else { 1.0 } / rounding_a));
                }
            }
        }
        // Rows of zeros change no singular value; without them two cells would have four.
        rows.resize(rows.len().max(36), 0.0);
        // The right singular vectors of A are the left ones of its transpose.
        let svd = DMatrix::from_column_slice(6, rows.len() / 6, &rows).svd(true, false);
        let values = &svd.singular_values;
        let variance = |axes: std::ops::Range<usize>| -> f64 {
            let of = |vectors: &DMatrix<f64>| {
                let weighted = |k: usize| vectors.column(k).rows_range(axes.clone()).norm_squared() / values[k].powi(2);
                (0..6).map(weighted).sum()
            };
            svd.u.as_ref().map_or(f64::NAN, of)
        };
        Self {
            condition: values[0] / values[5],
            translation_m: arm_m * variance(0..3).sqrt(),
            rotation_rad: variance(3..6).sqrt(),
        }
    }

    /// How far rounding moves the emitters of a tool with the given arm: root mean square, metres.
    fn at_emitters_m(&self, arm_m: f64) -> f64 {
        UNIT_ROUNDOFF * self.translation_m.hypot(arm_m * self.rotation_rad)
    }
}

#[cfg(test)]
mod tests {
    use slitpose_head::scene_file::WIDE;
    use slitpose_model::Tier;

    use super::*;

    #[test]
    fn rounding_moves_a_pose_by_a_few_roundings_of_the_heads_size() {
        let scene = WIDE.read().unwrap().scene;
        let plan = CompiledScene::compile(&scene, Tier::Paper).unwrap();
        let all = Attainable::at(&scene, &plan, &Pose::HOME, |_| true);
        assert!((1.0..10.0).contains(&all.condition), "{}", all.condition);
        // Detectors lie 25 mm from the middle.
        let roundings = all.at_emitters_m(scene.length_scale_m()) / (UNIT_ROUNDOFF * 25e-3);
        assert!((0.3..10.0).contains(&roundings), "{roundings}");
        let half = Attainable::at(&scene, &plan, &Pose::HOME, |cell| cell > 1);
        assert!(half.condition > all.condition, "fewer cells tell no more");
    }
}
