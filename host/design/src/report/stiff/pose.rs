//! Poses driven to extremes: layouts that hardly tell them, masked cells, turned frames, currents of any size.
//!
//! What a number type can attain at all: a relative error ρ of each current, and of each coordinate of detectors and
//! emitters, moves the pose by ρ times a factor that belongs to the head and the pose, the condition. No arithmetic can do
//! better with rounded data, and a stable one does little worse.

use std::f64::consts::PI;
use std::time::Instant;

use glam::DVec3;
use nalgebra::DMatrix;
use slitpose_model::{CompiledScene, Opening, Pair, Photocurrents, Pose, Reading, Scene, SceneError, rotation_exp};

use super::case::{Case, Expected, Reached};
use crate::report::Settings;
use crate::report::head::{Head, currents};
use crate::report::method::{Effort, Method, Precision, Start};
use crate::report::noise::NoiseSource;
use crate::report::section::Value;

/// A pose whose rounding moves the emitters by less than this share of their distance can be had.
const TELLS_A_POSE: f64 = 1e-2;

pub(super) const LAYOUTS: &str = "near-parallel layout";

/// Where error and condition grow together: rolls of the detectors that come ever nearer to equal,
/// at poses ever nearer to home, where equal rolls leave directions free.
pub(super) fn layouts(head: &Head<'_>, settings: &Settings) -> Result<Vec<Case>, SceneError> {
    let degrees = [45.0, 10.0, 1.0, 0.1, 1e-2, 1e-3, 1e-4, 1e-5, 1e-6, 1e-7, 1e-8, 0.0];
    let mut cases = Vec::new();
    for start in Start::BOTH {
        for roll_deg in degrees {
            let scene = rolled(&head.arithmetic(), roll_deg);
            let trial = Trial::within(scene, &Pose::HOME, roll_deg / degrees[0], settings.seed)?;
            let attainable = trial.attainable(|_| true);
            let mut reached = trial.solve(start, &attainable)?;
            let is_equal = roll_deg == 0.0;
            if is_equal {
                reached.iter_mut().for_each(|(_, reached)| reached.attainable = None);
            }
            cases.push(Case {
                study: LAYOUTS,
                case: format!("rolls ±{}°, {}", Value::from(roll_deg).shown(), start.name()),
                condition: (!is_equal).then(|| condition(&attainable)),
                quantity: AT_EMITTERS,
                expected: if is_equal { Expected::Words(&["unobservable"]) } else { telling(head) },
                reached,
            });
        }
    }
    Ok(cases)
}

/// A pose must come back where rounding leaves one.
fn telling(head: &Head<'_>) -> Expected {
    Expected::ValueBelow(TELLS_A_POSE * head.scene.length_scale_m() * 1e6)
}

/// The scene with its detectors turned about their normals: each long axis `roll_deg` out of the
/// plane of the ring, up and down in turn.
fn rolled(scene: &Scene, roll_deg: f64) -> Scene {
    let mut scene = scene.clone();
    for (number, cell) in scene.cells.iter_mut().enumerate() {
        let detector = &mut cell.detector;
        let tangent = detector.normal_base.cross(DVec3::Z).normalize_or(DVec3::X);
        let sign = if number % 2 == 0 { 1.0 } else { -1.0 };
        let (sine, cosine) = (sign * roll_deg.to_radians()).sin_cos();
        detector.x_axis_base = tangent * cosine + detector.normal_base.cross(tangent) * sine;
    }
    scene
}

/// Cells that cannot be used: the pose rests on the others, or is none.
pub(super) fn masks(head: &Head<'_>, settings: &Settings) -> Result<Vec<Case>, SceneError> {
    let cells = head.scene.cells.len();
    let faint = Reading::Light(Pair { i_x1_a: 1e-12, i_x2_a: 1e-12 });
    let mut cases = Vec::new();
    for (name, mask) in [("saturated", Reading::Saturated), ("without light", faint), ("missing", Reading::Missing)] {
        for masked in 0..=cells {
            if masked == 0 && mask != Reading::Saturated {
                continue;
            }
            let mut trial = Trial::around(head.arithmetic(), &Pose::HOME, settings.seed)?;
            for readings in &mut trial.readings {
                readings.cells.iter_mut().take(masked).for_each(|reading| *reading = mask);
            }
            let attainable = trial.attainable(|cell| cell >= masked);
            let left = cells - masked;
            cases.push(Case {
                study: "masked cells",
                case: format!("{masked} of {cells} {name}"),
                condition: (left >= 3).then(|| condition(&attainable)),
                quantity: AT_EMITTERS,
                expected: match left {
                    0..3 => Expected::Words(&["unobservable", "too_dark"]),
                    // Three cells have mirror images.
                    3 => Expected::Honest,
                    // Of other openings four may have them, too.
                    4 if !head.is_of_slits() => Expected::Honest,
                    _ => Expected::Value,
                },
                reached: trial.solve(Start::Cold, &attainable)?,
            });
        }
    }
    Ok(cases)
}

/// Solves in a tool frame that is turned by nearly half a turn.
pub(super) fn rotations(head: &Head<'_>, settings: &Settings) -> Result<Vec<Case>, SceneError> {
    let axis = DVec3::new(0.36, -0.48, 0.8);
    let mut cases = Vec::new();
    // A slit on the tool is where it is at home, in a frame that is not turned.
    let rides = head.scene.cells.iter().any(|cell| cell.opening() == Opening::RidingSlit);
    for short in [1.0, 1e-3, 1e-6, 0.0].into_iter().filter(|_| !rides) {
        // The same head, its emitters written in a turned frame.
        let turn = rotation_exp(axis * (PI - short));
        let mut scene = head.arithmetic();
        for cell in &mut scene.cells {
            cell.emitter.position_tool_m = turn.conjugate() * cell.emitter.position_tool_m;
            cell.emitter.axis_tool = turn.conjugate() * cell.emitter.axis_tool;
        }
        let centre = Pose { rotation: turn, translation_m: DVec3::ZERO };
        let trial = Trial::around(scene, &centre, settings.seed)?;
        let attainable = trial.attainable(|_| true);
        cases.push(Case {
            study: "rotation near π",
            case: format!("warm solve, tool frame turned by π − {short}"),
            condition: Some(condition(&attainable)),
            quantity: AT_EMITTERS,
            expected: Expected::Value,
            reached: trial.solve(Start::Warm, &attainable)?,
        });
    }
    Ok(cases)
}

/// Currents from picoamperes to amperes: the pose does not depend on their unit.
pub(super) fn scales(head: &Head<'_>, settings: &Settings) -> Result<Vec<Case>, SceneError> {
    let case = |exponent: i32| {
        let factor = 10f64.powi(exponent);
        let mut scene = head.arithmetic();
        for cell in &mut scene.cells {
            cell.emitter.radiant_intensity_w_per_sr *= factor;
            cell.detector.faint_a *= factor;
            cell.detector.dark_current_a *= factor;
            cell.detector.saturation_a = cell.detector.saturation_a.map(|limit| limit * factor);
        }
        let trial = Trial::around(scene, &Pose::HOME, settings.seed)?;
        let attainable = trial.attainable(|_| true);
        let total_a = trial.plan.photocurrents(0, &Pose::HOME).total_a();
        Ok(Case {
            study: "scale of the currents",
            case: format!("{total_a:.1e} A a cell"),
            condition: Some(condition(&attainable)),
            quantity: AT_EMITTERS,
            expected: Expected::Value,
            reached: trial.solve(Start::Cold, &attainable)?,
        })
    };
    (-9..=9).step_by(3).map(case).collect()
}

pub(super) const POSES: usize = 20;

/// How far from home they are, per axis: so near that cases differ and not poses.
const NEAR_HOME_M: f64 = 0.3e-3;
const NEAR_HOME_RAD: f64 = 0.02;

/// Repetitions of a timed solve; the least time counts, the others were disturbed.
const TIMES: usize = 3;

/// How far a warm start is off, per axis.
const PRIOR_M: f64 = 3e-6;
const PRIOR_RAD: f64 = 3e-4;

/// The measure of a pose error.
const AT_EMITTERS: &str = "pose at the emitters / µm";

struct Trial {
    scene: Scene,
    plan: CompiledScene<f64>,
    poses: Vec<Pose>,
    readings: Vec<Photocurrents>,
    priors: Vec<Pose>,
}

impl Trial {
    /// Noise-free currents of `scene` at poses around `centre`.
    fn around(scene: Scene, centre: &Pose, seed: u64) -> Result<Self, SceneError> {
        Self::within(scene, centre, 1.0, seed)
    }

    /// The same with poses `spread` times as far from `centre`.
    fn within(scene: Scene, centre: &Pose, spread: f64, seed: u64) -> Result<Self, SceneError> {
        let plan = CompiledScene::compile(&scene, Precision::Double.tightest_tier())?;
        let mut noise = NoiseSource::seeded(seed);
        let poses: Vec<Pose> =
            (0..POSES).map(|_| noise.near(centre, spread * NEAR_HOME_M, spread * NEAR_HOME_RAD)).collect();
        let readings = poses.iter().map(|pose| currents(&plan, pose)).collect();
        let priors = poses.iter().map(|pose| noise.near(pose, PRIOR_M, PRIOR_RAD)).collect();
        Ok(Self { scene, plan, poses, readings, priors })
    }

    /// Solves all of it with a full effort, against what rounding allows.
    fn solve(&self, start: Start, attainable: &[Attainable]) -> Result<Vec<(Precision, Reached)>, SceneError> {
        let arm_m = self.scene.length_scale_m();
        let of = |precision: Precision| {
            let tier = precision.tightest_tier();
            let solve = Method { tier, precision, start, effort: Effort::Full }.compile(&self.scene)?;
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
                reached.without_value += usize::from(solved.pose.is_none());
                best += attainable[index].at_emitters_m(precision, arm_m).powi(2);
                if let Some(found_pose) = solved.pose {
                    let (dt, dr) = found_pose.displacement_from(pose);
                    squares += dt.length_squared() + arm_m * arm_m * dr.length_squared();
                    found += 1.0;
                }
            }
            let rms_um = |sum: f64, count: f64| (sum / count).sqrt() * 1e6;
            reached.error = Some(rms_um(squares, found)).filter(|error| error.is_finite());
            reached.slowest_s = Some(slowest_s);
            reached.attainable = Some(rms_um(best, self.poses.len() as f64));
            Ok((precision, reached))
        };
        Precision::BOTH.into_iter().map(of).collect()
    }

    /// What rounding allows at each pose, from the cells that `used` lets pass.
    fn attainable(&self, used: impl Fn(usize) -> bool) -> Vec<Attainable> {
        self.poses.iter().map(|pose| Attainable::at(&self.scene, &self.plan, pose, &used)).collect()
    }
}

fn condition(attainable: &[Attainable]) -> f64 {
    slitpose_calibration::median(attainable.iter().map(|attainable| attainable.condition).collect())
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

    /// How far rounding in `precision` moves the emitters of a tool with the given arm: root mean
    /// square, metres.
    fn at_emitters_m(&self, precision: Precision, arm_m: f64) -> f64 {
        precision.unit_roundoff() * self.translation_m.hypot(arm_m * self.rotation_rad)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use slitpose_head::scene_file::WIDE;
    use slitpose_model::Tier;

    #[test]
    fn rounding_moves_a_pose_by_a_few_roundings_of_the_heads_size() {
        let scene = WIDE.read().unwrap().scene;
        let plan = CompiledScene::compile(&scene, Tier::Paper).unwrap();
        let all = Attainable::at(&scene, &plan, &Pose::HOME, |_| true);
        assert!((1.0..10.0).contains(&all.condition), "{}", all.condition);
        for precision in Precision::BOTH {
            // Detectors lie 25 mm from the middle.
            let roundings = all.at_emitters_m(precision, scene.length_scale_m()) / (precision.unit_roundoff() * 25e-3);
            assert!((0.3..10.0).contains(&roundings), "{roundings}");
        }
        let half = Attainable::at(&scene, &plan, &Pose::HOME, |cell| cell > 1);
        assert!(half.condition > all.condition, "fewer cells tell no more");
    }
}
