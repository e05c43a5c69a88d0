//! Narrow, steep and tabulated profiles over ordinary and very wide spots against an independent
//! program (`tests/data/profiles/profiles.py`): both currents keep the tolerance. Whatever a scene may hold, currents and
//! their derivatives are numbers.

use glam::{DVec2, DVec3};
use rand_chacha::ChaCha8Rng;
use slitpose_model::{Cell, CompiledScene, Detector, Emitter, Pair, Pose, Profile, Scene, Slit, Tier, Uncertainty};

use crate::common::{KINDS, Kind, generator, scene, uniform, vector};

/// Next to the end of the number range currents have fewer digits, or none: they are numbers all the same.
const MIN_A: f64 = 1e-290;

const EXACT: Tier = Tier::Exact { tolerance: 1e-10 };

struct Row {
    id: String,
    scene: Scene,
    profile: String,
    i_o_a: f64,
    electrodes_a: [f64; 2],
}

fn rows() -> Vec<Row> {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../tests/data/profiles/profiles.csv");
    let text = std::fs::read_to_string(path).expect("reference table");
    let mut lines = text.lines();
    let names: Vec<&str> = lines.next().expect("header").split(',').collect();
    lines.map(|line| row(&names, &line.split(',').collect::<Vec<_>>())).collect()
}

fn row(names: &[&str], fields: &[&str]) -> Row {
    let text = |name: &str| fields[names.iter().position(|column| *column == name).expect("column")];
    let number = |name: &str| text(name).parse::<f64>().expect("number");
    let mm = |name: &str| number(name) * 1e-3;
    let profile = text("profile");
    let cell = Cell {
        detector: Detector {
            centre_base_m: DVec3::ZERO,
            x_axis_base: DVec3::X,
            normal_base: DVec3::Z,
            length_m: mm("length"),
            width_m: mm("width"),
            responsivity_a_per_w: 0.54,
            dark_current_a: 0.0,
            interelectrode_ohm: None,
            saturation_a: None,
            faint_a: 0.0,
        },
        slit: Slit {
            distance_m: mm("slit_distance"),
            width_m: mm("slit_width"),
            length_m: mm("slit_length"),
            offset_m: DVec2::new(mm("slit_x"), mm("slit_y")),
            tilt_rad: DVec3::from(["tilt_x", "tilt_y", "tilt_z"].map(|name| number(name).to_radians())),
            thickness_m: mm("slit_thickness"),
        },
        emitter: Emitter {
            position_tool_m: DVec3::from(["ex", "ey", "ez"].map(mm)),
            axis_tool: DVec3::from(["ux", "uy", "uz"].map(number)),
            radiant_intensity_w_per_sr: 3.16e-3,
            profile: match profile.parse() {
                Ok(exponent) => Profile::Cosine { exponent },
                Err(_) => Profile::Table(profile.split(' ').map(point).collect()),
            },
        },
        effects: slitpose_model::Effects::default(),
    };
    Row {
        id: text("id").to_owned(),
        scene: Scene { cells: [cell].into_iter().collect(), noise: None, uncertainty: Uncertainty::default() },
        profile: profile.to_owned(),
        i_o_a: number("i_o_a"),
        electrodes_a: ["i_x1_a", "i_x2_a"].map(number),
    }
}

fn point(text: &str) -> (f64, f64) {
    let (degrees, value) = text.split_once(':').expect("degrees:value");
    (degrees.parse::<f64>().expect("degrees").to_radians(), value.parse().expect("value"))
}

#[test]
fn both_currents_keep_the_tolerance() {
    let mut failures = Vec::new();
    for tolerance in [1e-3, 1e-6, 1e-10, 1e-12] {
        let (mut worst, mut most) = (0.0_f64, 0);
        for row in rows() {
            let plan = CompiledScene::<f64>::compile(&row.scene, Tier::Exact { tolerance }).expect("scene");
            let pair = plan.photocurrents(0, &Pose::HOME);
            if row.i_o_a < MIN_A {
                let jacobian = plan.linearise(0, &Pose::HOME).2;
                assert!((0.0..=MIN_A).contains(&pair.total_a()), "{}: {pair:?}", row.id);
                assert!(jacobian.as_flattened().iter().all(|slope| slope.is_finite()), "{}: {jacobian:?}", row.id);
                continue;
            }
            let integration = plan.respond(0, &Pose::HOME).integration.expect("light");
            let errors = [pair.i_x1_a, pair.i_x2_a, pair.total_a()].into_iter().zip([
                row.electrodes_a[0],
                row.electrodes_a[1],
                row.i_o_a,
            ]);
            let error = errors.map(|(a, b)| (a - b).abs() / row.i_o_a).fold(0.0, f64::max);
            // Where the limit of work is met, the plan says what it has reached.
            let achieved = integration.relative_error;
            // The reference is good to 1e-13; an exponent of 20000 multiplies the rounding of axes.
            let allowed = achieved + 1e-12;
            worst = worst.max(error / achieved);
            most = most.max(integration.evaluations);
            // A table over a spot wider than itself may end at the limit of work, a power only at its rounding.
            let may_end_early = tolerance < 1e-6 && row.profile.contains(':');
            if error > allowed || (achieved > tolerance.max(1e-11) && !may_end_early) {
                failures.push(format!(
                    "{} {} at {tolerance:e}: {error:.1e}, said {achieved:.1e}, {} evaluations",
                    row.id, row.profile, integration.evaluations
                ));
            }
            assert!(integration.evaluations <= CompiledScene::<f64>::MAX_EVALUATIONS, "{integration:?}");
        }
        println!("at {tolerance:e}: worst {worst:.2} of the achieved error, most evaluations {most}");
    }
    assert!(failures.is_empty(), "{}", failures.join("\n"));
}

/// Greatest difference of both currents and their sum, relative to the sum.
fn difference(one: &Pair<f64>, other: &Pair<f64>) -> f64 {
    let differences = [one.i_x1_a - other.i_x1_a, one.i_x2_a - other.i_x2_a, one.total_a() - other.total_a()];
    differences.into_iter().map(f64::abs).fold(0.0, f64::max) / other.total_a()
}

#[test]
fn a_table_of_a_power_is_that_power() {
    let mut count = 0;
    for row in rows() {
        let Some(exponent) = row.profile.parse::<f64>().ok().filter(|&exponent| exponent < 10.0) else { continue };
        let mut scene = row.scene.clone();
        let angles = (0..18).map(|i| f64::from(5 * i).to_radians());
        scene.cells[0].emitter.profile =
            Profile::Table(angles.map(|gamma| (gamma, gamma.cos().powf(exponent))).collect());
        let pair = CompiledScene::<f64>::compile(&scene, EXACT).expect("scene").photocurrents(0, &Pose::HOME);
        let reference = Pair { i_x1_a: row.electrodes_a[0], i_x2_a: row.electrodes_a[1] };
        // The table's values round, and so does n.
        assert!(difference(&pair, &reference) < 1e-10 + 1e-12, "{}: {pair:?} {reference:?}", row.id);
        count += 1;
    }
    assert!(count >= 20, "{count}");
}

#[test]
fn a_smooth_table_keeps_the_tolerance_and_takes_no_more_nodes_than_a_power() {
    let relative = |gamma: f64| gamma.cos().powf(1.247) * (1.0 + 0.1 * gamma.sin().powi(2) - 0.1 * gamma.sin().powi(4));
    let rounded = |degrees: i32| {
        let gamma = f64::from(degrees).to_radians();
        (gamma, (relative(gamma) * 1e3).round() / 1e3)
    };
    let smooth = Profile::Table((0..18).map(|i| rounded(5 * i)).collect());
    for tolerance in [1e-3, 1e-6, 1e-10] {
        let (mut worst, mut evaluations) = (0.0_f64, [0_usize; 2]);
        for row in rows().into_iter().filter(|row| row.profile == "1.247") {
            let at = |profile: &Profile, tolerance: f64| {
                let mut scene = row.scene.clone();
                scene.cells[0].emitter.profile = profile.clone();
                let plan = CompiledScene::<f64>::compile(&scene, Tier::Exact { tolerance }).expect("scene");
                (plan.photocurrents(0, &Pose::HOME), plan.respond(0, &Pose::HOME).integration.expect("light"))
            };
            let ((pair, table), (fine, _)) = (at(&smooth, tolerance), at(&smooth, 1e-13));
            worst = worst.max(difference(&pair, &fine) / tolerance);
            for (sum, of) in evaluations.iter_mut().zip([table, at(&row.scene.cells[0].emitter.profile, tolerance).1]) {
                *sum += of.evaluations;
            }
        }
        println!("at {tolerance:e}: {worst:.2} of it, {evaluations:?} evaluations");
        assert!(worst < 1.0 && 10 * evaluations[0] <= 13 * evaluations[1]);
    }
}

/// Fails unless everything the plan says of cell 0 is finite and no current is negative.
fn check(scene: &Scene, pose: &Pose, tier: Tier, name: &str) {
    let plan = CompiledScene::<f64>::compile(scene, tier).expect("scene");
    let response = plan.respond(0, pose);
    let (_, pair, jacobian) = plan.linearise(0, pose);
    assert_eq!(pair, plan.photocurrents(0, pose), "{name} {tier:?}: {scene:?} {pose:?}");
    let numbers = [response.i_o_a, response.currents.i_x1_a, response.currents.i_x2_a, response.solid_angle_sr];
    let places = [response.x_a_m.unwrap_or(0.0), response.gamma_rad.unwrap_or(0.0)];
    let all = numbers.into_iter().chain(places).chain([pair.i_x1_a, pair.i_x2_a]).chain(jacobian.into_iter().flatten());
    for number in all {
        assert!(number.is_finite(), "{name} {tier:?}: {response:?} {jacobian:?} {scene:?} {pose:?}");
    }
    assert!(
        response.i_o_a >= 0.0 && response.solid_angle_sr >= 0.0,
        "{name} {tier:?}: {response:?} {scene:?} {pose:?}"
    );
    let half_m = 0.5 * scene.cells[0].detector.length_m;
    assert!(places[0].abs() <= half_m * (1.0 + 1e-9), "{name} {tier:?}: {response:?} {scene:?} {pose:?}");
}

const TIERS: [Tier; 3] = [Tier::Paper, Tier::Exact { tolerance: 1e-6 }, Tier::Exact { tolerance: 1e-10 }];

/// The least lit corner of the number range: an emitter turned until cⁿ falls below 1e-308.
#[test]
fn light_next_to_the_end_of_the_number_range() {
    let mut rng = generator();
    for kind in KINDS {
        for exponent in [50.0, 100.0, 200.0, 1000.0, 1e6] {
            let mut scene = scene(&mut rng, kind);
            scene.cells[0].emitter.profile = Profile::Cosine { exponent };
            let emitter = scene.cells[0].emitter.position_tool_m;
            let axis = vector(&mut rng, 1.0).normalize();
            // In steps up to 100°, and in small ones around the horizon of spots half a degree wide.
            let angles = (0..30).map(|i| 0.06 * f64::from(i)).chain((0..20).map(|i| 1.52 + 0.005 * f64::from(i)));
            for angle_rad in angles {
                let turned = Pose::from_vectors(DVec3::ZERO, axis * angle_rad);
                let pose = Pose { translation_m: emitter - turned.rotation * emitter, ..turned };
                for tier in TIERS {
                    check(&scene, &pose, tier, "narrow");
                }
            }
        }
    }
}

/// Currents down to the least numbers there are, of which the reciprocal is none any more: rows `grazing_n…` of the
/// reference table, all of the default cell.
#[test]
fn light_fainter_than_the_least_normal_number_keeps_its_digits_and_its_place() {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../tests/data/reference/single_cell.csv");
    let table = std::fs::read_to_string(path).expect("reference table");
    let names: Vec<&str> = table.lines().next().expect("header").split(',').collect();
    let rows: Vec<Vec<&str>> =
        table.lines().filter(|line| line.starts_with("grazing_n")).map(|line| line.split(',').collect()).collect();
    assert_eq!(rows.len(), 3);
    for row in rows {
        let number = |name: &str| {
            let column = names.iter().position(|column| *column == name).expect("column");
            row[column].parse::<f64>().expect("number")
        };
        let mut scene = scene(&mut generator(), Kind::Thin);
        let cell = &mut scene.cells[0];
        let detector = &mut cell.detector;
        (detector.centre_base_m, detector.x_axis_base, detector.normal_base) = (DVec3::ZERO, DVec3::X, DVec3::Z);
        (detector.length_m, detector.width_m, detector.dark_current_a) = (12e-3, 1e-3, 0.0);
        (cell.slit.distance_m, cell.slit.width_m, cell.slit.offset_m) = (7.5e-3, 0.4e-3, DVec2::ZERO);
        cell.emitter.position_tool_m = DVec3::Z * 15e-3;
        cell.emitter.axis_tool = DVec3::from(["ux", "uy", "uz"].map(number));
        cell.emitter.profile = Profile::Cosine { exponent: number("profile_exponent") };
        let plan = CompiledScene::<f64>::compile(&scene, Tier::Exact { tolerance: 1e-10 }).expect("scene");
        let response = plan.respond(0, &Pose::HOME);
        // Half of the least number is what any of them is rounded by.
        let (current, least) = (number("exact_i_o_a"), f64::from_bits(1));
        assert!((response.i_o_a - current).abs() <= 1e-10 * current + least, "{}: {:e}", row[0], response.i_o_a);
        let x_a_mm = response.x_a_m.expect("light") * 1e3;
        assert!((x_a_mm - number("exact_x_a_mm")).abs() < 1e-9, "{}: {x_a_mm}", row[0]);
        check(&scene, &Pose::HOME, Tier::Exact { tolerance: 1e-10 }, row[0]);
    }
}

fn magnitude(rng: &mut ChaCha8Rng, low: f64, high: f64) -> f64 {
    10_f64.powf(uniform(rng, low, high))
}

#[test]
fn sizes_of_any_magnitude() {
    let mut rng = generator();
    for kind in KINDS {
        for _ in 0..150 {
            let mut scene = scene(&mut rng, kind);
            let cell = &mut scene.cells[0];
            let toward = cell.emitter.position_tool_m - cell.detector.centre_base_m;
            let far = magnitude(&mut rng, -6.0, 6.0);
            cell.emitter.position_tool_m = cell.detector.centre_base_m + toward * far;
            cell.slit.distance_m *= magnitude(&mut rng, -6.0, 0.5) * far.min(1.0);
            cell.slit.thickness_m = cell.slit.thickness_m.min(1.9 * cell.slit.distance_m);
            cell.slit.width_m *= magnitude(&mut rng, -12.0, 3.0);
            cell.slit.length_m *= magnitude(&mut rng, -12.0, 3.0);
            cell.detector.length_m *= magnitude(&mut rng, -3.0, 3.0);
            cell.detector.width_m *= magnitude(&mut rng, -3.0, 3.0);
            let pose = Pose::from_vectors(DVec3::ZERO, vector(&mut rng, 1.5));
            for pose in [Pose::HOME, pose] {
                for tier in TIERS {
                    check(&scene, &pose, tier, "size");
                }
            }
        }
    }
}
