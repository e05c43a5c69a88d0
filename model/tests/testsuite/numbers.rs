//! Whatever a scene may hold, currents and their derivatives are numbers.

use crate::common::{KINDS, Kind, generator, scene, uniform, vector};
use glam::{DVec2, DVec3};
use rand_chacha::ChaCha8Rng;
use slitpose_model::{Plan, Pose, Profile, Scene, Tier};

/// Fails unless everything the plan says of cell 0 is finite and no current is negative.
fn check(scene: &Scene, pose: &Pose, tier: Tier, name: &str) {
    let plan = Plan::<f64>::compile(scene, tier).expect("scene");
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
        let plan = Plan::<f64>::compile(&scene, Tier::Exact { tolerance: 1e-10 }).expect("scene");
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
