//! Stiff and extreme cases, which are numerically difficult, and their results.
//!
//! Currents of one cell are compared with those of thirty digits in `extremes.csv`, which
//! `tests/data/reference/generate.py` writes; poses with the truth. A [`Case`] is judged by the ratio of its error to what
//! is attainable: what remains when every number that goes in is rounded once. No arithmetic can do better with rounded
//! data, and a stable one does little worse.

use std::collections::BTreeMap;
use std::f64::consts::PI;
use std::time::Instant;

use glam::DVec3;
use slitpose_head::scene_file::BENCH;
use slitpose_model::{
    CompiledScene, MotionPrior, Opening, Outcome, Pair, Photocurrents, Pose, Reading, Scene, SceneError, Solution,
    Solver, Start, Tier, Uncertainty, rotation_exp,
};

use super::Settings;
use super::head::{Errors, Head, NoiseSource, PRIOR, currents, rms_of_covariances};
use super::section::{Section, Table, Value};
use crate::DesignError;

pub(super) const TITLE: &str = "Stiff and extreme cases";

/// Errors this many times what is attainable are as good as attained: algorithms round more than
/// once, and a solver that takes its currents for rounded sixteen times stops where that leaves it.
const ENOUGH: f64 = 100.0;

/// A solve that takes longer is not good, however exact: twenty scans at 4 kHz.
const SLOW_S: f64 = 5e-3;

/// The exact tier at the tightest tolerance that is of use: a solver weighs by it, and stops when it has come so near.
const TIGHTEST: Tier = Tier::Exact { tolerance: 1e-15 };

const UNIT_ROUNDOFF: f64 = 0.5 * f64::EPSILON;

#[derive(Clone, Copy, Debug, PartialEq)]
enum Expected {
    /// One of these words, whatever the number.
    Words(&'static [&'static str]),
    /// A number, as exact as rounding allows.
    Value,
    /// Such a number, or a word that says why there is none.
    Honest,
}

#[derive(Clone, Debug)]
struct Case {
    study: &'static str,
    case: String,
    /// Condition number of the problem, where it has one.
    condition: Option<f64>,
    /// What the error is of, with its unit.
    quantity: &'static str,
    expected: Expected,
    outcomes: BTreeMap<&'static str, usize>,
    /// How many came back without a value.
    without_value: usize,
    /// Error, in the unit of the case; `None` without a value.
    error: Option<f64>,
    /// The attainable error, in the same unit.
    attainable: Option<f64>,
    /// The slowest of the solves, seconds.
    slowest_s: Option<f64>,
}

impl Case {
    fn ratio(&self) -> Option<f64> {
        let (error, attainable) = self.error.zip(self.attainable)?;
        Some(if error == 0.0 { 0.0 } else { error / attainable })
    }

    fn is_good(&self) -> bool {
        let exact = self.ratio().map(|ratio| ratio <= ENOUGH);
        match self.expected {
            Expected::Words(words) => self.outcomes.keys().all(|word| words.contains(word)),
            Expected::Value => exact == Some(true) && self.without_value == 0,
            // That a search has found nothing is no reason why there is nothing.
            Expected::Honest => exact != Some(false) && !self.outcomes.contains_key(Outcome::Diverged.as_str()),
        }
    }

    /// The slowest solve of all, where it is too slow, seconds.
    fn slow_s(&self) -> Option<f64> {
        self.slowest_s.filter(|it| *it > SLOW_S)
    }

    fn verdict(&self) -> Value {
        match (self.is_good(), self.slow_s()) {
            (true, None) => "good".into(),
            (true, Some(slow_s)) => Value::Alert(format!("slow: {:.0} ms", slow_s * 1e3)),
            (false, _) => Value::Alert("short".to_owned()),
        }
    }

    fn outcome(&self) -> String {
        let counted: Vec<_> = self.outcomes.iter().map(|(word, count)| format!("{word} {count}")).collect();
        if let [_] = counted[..] { self.outcomes.keys().copied().collect() } else { counted.join(", ") }
    }
}

pub(super) fn section(head: &Head, settings: &Settings) -> Result<Section, DesignError> {
    let mut cases = currents_of_one_cell()?;
    cases.extend(poses(head, settings)?);
    let summary = summary(&cases);
    Ok(Section {
        name: "stiff",
        title: TITLE,
        summary: vec![format!("Extreme cases: {}{}", summary[..1].to_lowercase(), &summary[1..])],
        paragraphs: vec![
            format!(
                "Each case is driven towards the point where it must fail. The condition number of a case says by how \
                 much it magnifies a relative error of what goes in; what is attainable is what remains when every \
                 number that goes in is rounded once. Currents of one cell, that of the shipped scene `bench`, are \
                 compared with those of a program of thirty digits; poses of this head, {POSES} near home in each case, \
                 with the truth."
            ),
            summary,
        ],
        tables: vec![table(&cases)],
        ..Section::default()
    })
}

/// How many cases fall short, by study.
fn summary(cases: &[Case]) -> String {
    let mut short: BTreeMap<&str, usize> = BTreeMap::new();
    for case in cases.iter().filter(|case| !case.is_good()) {
        *short.entry(case.study).or_default() += 1;
    }
    let slow: Vec<f64> = cases.iter().filter_map(Case::slow_s).collect();
    let slow = match slow.iter().copied().reduce(f64::max) {
        Some(slow_s) => format!(" Slow cases: {}, up to {} ms a solve.", slow.len(), Value::from(slow_s * 1e3).shown()),
        None => String::new(),
    };
    if short.is_empty() {
        return format!("All {} cases came out as they must.{slow}", cases.len());
    }
    let of = |study: &str| cases.iter().filter(|case| case.study == study).count();
    let names: Vec<String> =
        short.into_iter().map(|(study, count)| format!("{study} ({count} of {})", of(study))).collect();
    format!("Of {} cases these fall short, and are marked in the table: {}.{slow}", cases.len(), names.join(", "))
}

fn table(cases: &[Case]) -> Table {
    let expected = |case: &Case| match case.expected {
        Expected::Words(words) => words.join(" or "),
        Expected::Value => "value".to_owned(),
        Expected::Honest => "value, or why not".to_owned(),
    };
    let caption = format!(
        "Extreme cases: what came back, its error, what is attainable, and their ratio. Good: \
         the ratio is at most {ENOUGH}, each pose came back or a reason why it cannot, and no solve took longer \
         than {:.0} ms",
        SLOW_S * 1e3
    );
    Table::of(
        "stiff",
        caption,
        cases,
        &[
            ("study", "study", &|case| case.study.into()),
            ("case", "case", &|case| case.case.as_str().into()),
            ("condition", "condition number", &|case| Value::optional(case.condition)),
            ("quantity", "error of", &|case| case.quantity.into()),
            ("expected", "expected", &|case| expected(case).into()),
            ("outcome", "outcome", &|case| case.outcome().into()),
            ("error", "error", &|case| Value::optional(case.error)),
            ("attainable", "attainable", &|case| Value::optional(case.attainable)),
            ("ratio", "ratio", &|case| Value::optional(case.ratio())),
            ("slowest_us", "slowest / µs", &|case| Value::optional(case.slowest_s.map(|s| 1e6 * s))),
            ("verdict", "verdict", &Case::verdict),
        ],
    )
}

/// One cell driven to extremes: no light, little light, light from far, from near and from aside. Study, case, distance of
/// the slit, emitter and its axis in the detector's frame, status, and currents of both electrodes; SI.
const EXTREMES: &str = include_str!("extremes.csv");

fn currents_of_one_cell() -> Result<Vec<Case>, DesignError> {
    let mut scene = BENCH.read()?.scene;
    scene.cells[0].detector.centre_base_m = DVec3::ZERO;
    EXTREMES.lines().skip(1).map(|row| Ok(of_one_cell(&mut scene, row)?)).collect()
}

/// The model's currents against those of `row`, relative to their sum.
fn of_one_cell(scene: &mut Scene, row: &'static str) -> Result<Case, SceneError> {
    let fields: Vec<&str> = row.split(',').collect();
    let number = |index: usize| fields[index].parse().unwrap_or(f64::NAN);
    let [emitter_m, axis] = [3, 6].map(|from| DVec3::from_array(std::array::from_fn(|k| number(from + k))));
    let cell = &mut scene.cells[0];
    (cell.slit.distance_m, cell.emitter.axis_tool) = (number(2), axis);
    let along = emitter_m.x.abs() + 0.5 * cell.slit.width_m;
    let up = emitter_m.z + cell.slit.distance_m;
    // The tool's frame sits on the emitter.
    let pose = Pose::from_vectors(emitter_m, DVec3::ZERO);
    let plan = CompiledScene::<f64>::compile(scene, TIGHTEST)?;
    let (status, pair, jacobian) = plan.linearise(0, &pose);
    let expected = Pair { i_x1_a: number(10), i_x2_a: number(11) };
    let is_lit = expected.total_a() > 0.0;
    let error_a = (pair.i_x1_a - expected.i_x1_a).abs().max((pair.i_x2_a - expected.i_x2_a).abs());
    // The relative change of a current when every number that goes in is rounded once, in units of the rounding.
    let rounding = [(pair.i_x1_a, jacobian[0]), (pair.i_x2_a, jacobian[1])].map(|(current, row)| {
        // The axis is a unit vector: its rounding is an angle.
        let turn = row[3] * row[3] + row[4] * row[4] + row[5] * row[5];
        let moved = (row[0] * along).powi(2) + (row[1] * emitter_m.y).powi(2) + (row[2] * up).powi(2);
        ((current * current + moved + turn) / 3.0).sqrt()
    });
    let condition = is_lit.then(|| rounding[0].max(rounding[1]) / pair.total_a());
    let status = status.as_str();
    Ok(Case {
        study: fields[0],
        case: fields[1].to_owned(),
        condition,
        quantity: if is_lit { "current / relative" } else { "current / A" },
        expected: match fields[9] {
            "behind" => Expected::Words(&["behind"]),
            "dark" => Expected::Words(&["dark"]),
            _ => Expected::Value,
        },
        outcomes: BTreeMap::from([(status, 1)]),
        without_value: usize::from(status != fields[9]),
        error: Some(if is_lit { error_a / expected.total_a() } else { error_a }),
        attainable: condition.map(|condition| UNIT_ROUNDOFF * condition).or(Some(0.0)),
        slowest_s: None,
    })
}

/// A pose whose rounding moves the emitters by less than this share of their distance can be had.
const TELLS_A_POSE: f64 = 1e-2;

const POSES: usize = 20;

/// How far from home they are, per axis, metres and radians: so near that cases differ and not poses.
const NEAR_HOME: [f64; 2] = [0.3e-3, 0.02];

/// Repetitions of a timed solve; the least time counts, the others were disturbed.
const TIMES: usize = 3;

const ROLLS: [f64; 12] = [45.0, 10.0, 1.0, 0.1, 1e-2, 1e-3, 1e-4, 1e-5, 1e-6, 1e-7, 1e-8, 0.0];

/// Poses driven to extremes: layouts that hardly tell them, masked cells, turned frames, currents of any size.
fn poses(head: &Head, settings: &Settings) -> Result<Vec<Case>, SceneError> {
    let mut cases = Vec::new();
    let trial = |scene: Scene, centre: &Pose, spread: f64| Trial::within(scene, centre, spread, settings.seed);
    // Where error and condition grow together: rolls of the detectors that come ever nearer to equal, at poses ever nearer
    // to home, where equal rolls leave directions free. A pose must come back where rounding leaves one.
    for (start, is_warm) in [("cold", false), ("warm", true)] {
        for roll_deg in ROLLS {
            let trial = trial(rolled(head.arithmetic(), roll_deg), &Pose::HOME, roll_deg / ROLLS[0])?;
            let case = format!("rolls ±{}°, {start}", Value::from(roll_deg).shown());
            let expected = if roll_deg == 0.0 { Expected::Words(&["unobservable"]) } else { Expected::Value };
            cases.push(trial.case("near-parallel layout", case, is_warm, expected)?);
        }
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
            cases.push(trial.case("masked cells", format!("{masked} of {cells} {name}"), false, expected)?);
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
        cases.push(trial.case("rotation near π", case, true, Expected::Value)?);
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
        let case = format!("{:.1e} A a cell", trial.solver.plan().photocurrents(0, &Pose::HOME).total_a());
        cases.push(trial.case("scale of the currents", case, false, Expected::Value)?);
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
    solver: Solver<f64>,
    poses: Vec<Pose>,
    readings: Vec<Photocurrents>,
    priors: Vec<Pose>,
}

impl Trial {
    /// Noise-free currents of `scene` at poses around `centre`, `spread` times the usual distance away.
    fn within(scene: Scene, centre: &Pose, spread: f64, seed: u64) -> Result<Self, SceneError> {
        let solver = Solver::new(&scene, TIGHTEST)?;
        let mut noise = NoiseSource::of(&scene, solver.plan(), seed);
        let poses: Vec<Pose> = (0..POSES).map(|_| noise.near(centre, NEAR_HOME.map(|sigma| spread * sigma))).collect();
        let readings = poses.iter().map(|pose| currents(solver.plan(), pose)).collect();
        let priors = poses.iter().map(|pose| noise.near(pose, PRIOR)).collect();
        Ok(Self { scene, solver, poses, readings, priors })
    }

    /// Solves all of it, against what rounding allows. A value is only expected where rounding leaves one.
    fn case(&self, study: &'static str, case: String, is_warm: bool, expected: Expected) -> Result<Case, SceneError> {
        let arm_m = self.scene.length_scale_m();
        let at_emitters_um = |[translation_m, rotation_rad]: [f64; 2]| translation_m.hypot(arm_m * rotation_rad) * 1e6;
        let (mut outcomes, mut slowest_s, mut solved) = (BTreeMap::new(), 0.0_f64, Vec::new());
        for (readings, prior) in self.readings.iter().zip(&self.priors) {
            let start = if is_warm { Start::Near(prior) } else { Start::Cold };
            let timed = |_| {
                let clock = Instant::now();
                let solution = self.solver.solve(readings, start, &MotionPrior::AT_REST);
                (clock.elapsed().as_secs_f64(), solution)
            };
            let [(first_s, solution), others @ ..] = [0; TIMES].map(timed);
            slowest_s = slowest_s.max(others.iter().map(|(took_s, _)| *took_s).fold(first_s, f64::min));
            *outcomes.entry(solution.outcome.as_str()).or_default() += 1;
            solved.push(solution);
        }
        let without_value = solved.iter().filter(|solution| solution.estimate.is_none()).count();
        let error = at_emitters_um(Errors::of(solved.into_iter().zip(&self.poses)).rms);
        // Where there is no pose, nothing is attainable.
        let rounded = if matches!(expected, Expected::Words(_)) { Vec::new() } else { self.rounded()? };
        let of_all = rounded.iter().filter_map(|solution| Some(solution.estimate?.covariance));
        let attainable = Some(UNIT_ROUNDOFF / ROUGH * at_emitters_um(rms_of_covariances(of_all)));
        let attainable = attainable.filter(|attainable| attainable.is_finite());
        let limit_um = TELLS_A_POSE * arm_m * 1e6;
        let is_vague = attainable.is_none_or(|attainable| attainable >= limit_um);
        let conditions: Vec<f64> = rounded.iter().filter_map(Solution::condition).collect();
        Ok(Case {
            study,
            case,
            condition: (!conditions.is_empty()).then(|| slitpose_calibration::median(conditions)),
            quantity: "pose at the emitters / µm",
            expected: if expected == Expected::Value && is_vague { Expected::Honest } else { expected },
            outcomes,
            without_value,
            error: Some(error).filter(|error| error.is_finite()),
            attainable,
            slowest_s: Some(slowest_s),
        })
    }

    /// Solutions at the truth, as of a head whose gains and coordinates were rounded to [`ROUGH`]: condition and covariance
    /// are those of rounding, and the latter grows with its square.
    fn rounded(&self) -> Result<Vec<Solution>, SceneError> {
        let cells = &self.scene.cells;
        let squares: f64 = (cells.iter())
            .map(|cell| cell.detector.centre_base_m.length_squared() + cell.emitter.position_tool_m.length_squared())
            .sum();
        // A rounding is evenly spread.
        let sigma = ROUGH / 3f64.sqrt();
        let uncertainty = Uncertainty {
            electrode_gain_relative: sigma,
            position_m: sigma * (squares / cells.len() as f64).sqrt(),
            ..Uncertainty::default()
        };
        let solver = Solver::<f64>::new(&Scene { uncertainty, ..self.scene.clone() }, TIGHTEST)?;
        let at_truth = |(readings, pose)| solver.solve(readings, Start::Near(pose), &MotionPrior::AT_REST);
        Ok(self.readings.iter().zip(&self.poses).map(at_truth).collect())
    }
}

/// A relative rounding far above that of the solver's own arithmetic.
const ROUGH: f64 = 3e-14;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn verdicts_follow_from_what_is_expected_and_from_the_time() {
        let none = |expected, word| Case {
            study: "",
            case: String::new(),
            condition: None,
            quantity: "",
            expected,
            outcomes: BTreeMap::from([(word, 1)]),
            without_value: 1,
            error: None,
            attainable: Some(1e-17),
            slowest_s: None,
        };
        let value = |expected, error| Case { without_value: 0, error: Some(error), ..none(expected, "converged") };
        for (case, good) in [
            (value(Expected::Value, 1e-15), true),
            (value(Expected::Value, 1e-14), false),
            (none(Expected::Value, "unobservable"), false),
            (Case { without_value: 1, ..value(Expected::Value, 1e-15) }, false),
            (none(Expected::Honest, "unobservable"), true),
            (none(Expected::Honest, "diverged"), false),
            (value(Expected::Honest, 1e-14), false),
            (Case { without_value: 1, ..value(Expected::Honest, 1e-15) }, true),
            (none(Expected::Words(&["unobservable"]), "unobservable"), true),
            (value(Expected::Words(&["unobservable"]), 0.0), false),
        ] {
            assert_eq!(case.is_good(), good, "{case:?}");
        }
        let slow = |slowest_s| Case { slowest_s: Some(slowest_s), ..value(Expected::Value, 1e-17) }.verdict();
        assert_eq!(slow(0.1), Value::Alert("slow: 100 ms".to_owned()));
        assert_eq!(slow(1e-4), Value::from("good"));
    }
}
