//! Poses driven to extremes: layouts that hardly tell them, masked cells, turned frames, currents
//! of any size, noise of any size.

use std::f64::consts::PI;

use glam::DVec3;
use slitpose_model::{
    Noise, Opening, Pair, Photocurrents, Pose, Reading, Scene, SceneError, Solver, rotation_exp, rotation_log,
};

use super::case::{Case, Expected, Reached};
use super::trial::{AT_EMITTERS, Trial, condition};
use crate::report::Settings;
use crate::report::head::Head;
use crate::report::method::{Precision, Start};
use crate::report::noise::NoiseSource;
use crate::report::section::Value;
use slitpose_head::front_end::ROOM_TEMPERATURE_K;

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
            let mut reached = trial.solve_to_rounding(start, &attainable)?;
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

/// A pose must come back where rounding and noise leave one.
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
                reached: trial.solve_to_rounding(Start::Cold, &attainable)?,
            });
        }
    }
    Ok(cases)
}

/// Rotation vectors near π there and back, and solves in a tool frame turned that far.
pub(super) fn rotations(head: &Head<'_>, settings: &Settings) -> Result<Vec<Case>, SceneError> {
    let axis = DVec3::new(0.36, -0.48, 0.8);
    let mut cases = Vec::new();
    for short in [1.0, 1e-2, 1e-4, 1e-6, 1e-8, 1e-10, 1e-12, 1e-15] {
        let vector = axis * (PI - short);
        let error = (rotation_log(rotation_exp(vector)) - vector).length();
        let reached = Reached::once("value", Some(error), Some(Precision::Double.unit_roundoff() * PI));
        cases.push(Case {
            study: "rotation near π",
            case: format!("exp and log of π − {short:e}"),
            condition: None,
            quantity: "rotation vector / rad",
            expected: Expected::Value,
            reached: vec![(Precision::Double, reached)],
        });
    }
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
            reached: trial.solve_to_rounding(Start::Warm, &attainable)?,
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
            reached: trial.solve_to_rounding(Start::Cold, &attainable)?,
        })
    };
    (-9..=9).step_by(3).map(case).collect()
}

/// Noise from none to more than there is light.
pub(super) fn noises(head: &Head<'_>, settings: &Settings) -> Result<Vec<Case>, SceneError> {
    let case = |adc_a: f64| {
        let (shot_bandwidth_hz, johnson_bandwidth_hz, temperature_k) = (0.0, 0.0, ROOM_TEMPERATURE_K);
        let noise = Noise { shot_bandwidth_hz, johnson_bandwidth_hz, temperature_k, adc_a };
        let scene = Scene { noise: Some(noise), ..head.arithmetic() };
        let mut trial = Trial::around(scene, &Pose::HOME, settings.seed)?;
        let mut noise = NoiseSource::seeded(settings.seed);
        let disturbed: Vec<Photocurrents> = trial
            .poses
            .iter()
            .zip(&trial.readings)
            .map(|(pose, clean)| noise.disturb(&trial.scene, &trial.plan, pose, clean))
            .collect();
        trial.readings = disturbed;
        let (rounding, arm_m) = (trial.attainable(|_| true), trial.scene.length_scale_m());
        let solvers = Precision::BOTH.map(|precision| Solver::<f64>::new(&trial.scene, precision.tightest_tier()));
        let [double, single] = solvers;
        let (double, single) = (double?, single?);
        // Noise and rounding together.
        let attainable_m = |index: usize, precision| {
            let solver = if precision == Precision::Double { &double } else { &single };
            let bound = solver.bound(&trial.poses[index]).map_or(f64::NAN, |covariance| {
                let axes = |axes: std::ops::Range<usize>| axes.map(|axis| covariance[axis][axis]).sum::<f64>();
                (axes(0..3) + arm_m * arm_m * axes(3..6)).sqrt()
            });
            bound.hypot(rounding[index].at_emitters_m(precision, arm_m))
        };
        Ok(Case {
            study: "noise",
            case: format!("{adc_a:e} A at each electrode"),
            condition: Some(condition(&rounding)),
            quantity: AT_EMITTERS,
            expected: telling(head),
            reached: trial.solve(Start::Cold, attainable_m)?,
        })
    };
    [0.0, 1e-15, 1e-13, 1e-11, 1e-9, 1e-8, 1e-7, 3e-7, 1e-6].into_iter().map(case).collect()
}
