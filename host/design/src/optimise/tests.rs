use std::sync::atomic::AtomicBool;

use slitpose_head::scene_file::{FINE, MAGLEV, REDUNDANT, SPACEMOUSE, SceneFile, WIDE};

use super::quantity::{current, with_values};
use super::*;
use crate::map::{Fineness, Map, View};
use crate::survey::Survey;

const GOAL: Goal = Goal { demand: Demand::Median, lever_m: 10e-3 };

/// In a box that is as large as its spots and its full scale allow, and a little larger.
fn wide() -> SceneFile {
    SceneFile::parse("wide", &WIDE.text.replace("[3.3, 3.3, 3.3]", "[4.0, 4.0, 4.0]")).expect("a scene")
}

fn set(file: &SceneFile, values: &[(Quantity, f64)]) -> SceneFile {
    SceneFile::parse("found.toml", &with_values(file, values).expect("a text")).expect("a scene")
}

fn score(file: &SceneFile, limits: Limits) -> Score {
    Judge::new(&file.workspace, GOAL, limits).score(file).expect("a score")
}

fn search(file: SceneFile, free: &[&str], goal: Goal) -> Search {
    let free = free.iter().map(|text| text.parse().expect("a quantity")).collect();
    Search { file, free, goal, limits: Limits::default(), seed: 1 }
}

fn run(search: &Search) -> Result<Found, DesignError> {
    search.run(&mut |_, _| (), &AtomicBool::new(false))
}

fn map(file: SceneFile, samples: usize) -> Map {
    Map::of(file.into(), Fineness { samples, side: 0, behind: 0 }, || ()).expect("a map")
}

/// Holes have a diameter, and both axes of a detector move with the first.
#[test]
fn heads_with_other_openings_change_where_their_drawings_have_it() {
    let file = MAGLEV.read().expect("a scene");
    for (quantity, value) in [
        (Quantity::EmitterRadius, 55.0),
        (Quantity::EmitterDistance, 90.0),
        (Quantity::SlitDistance, 11.0),
        (Quantity::SlitWidth, 4.0),
        (Quantity::Roll, 20.0),
    ] {
        let changed = set(&file, &[(quantity, value)]);
        assert!((current(&changed, quantity) - value).abs() < 1e-9, "{quantity}");
        for pair in changed.scene.cells.chunks(2) {
            assert_eq!(pair[0].detector.centre_base_m, pair[1].detector.centre_base_m, "{quantity}");
            assert_eq!(pair[0].emitter, pair[1].emitter, "{quantity}");
        }
    }
    for (quantity, value, part) in [(Quantity::SlitLength, 4.0, "round"), (Quantity::Cells, 8.0, "two axes")] {
        let error = with_values(&file, &[(quantity, value)]).expect_err("refused").to_string();
        assert!(error.contains(part), "{error}");
    }
    let refused = run(&search(file, &["cells"], GOAL)).expect_err("refused").to_string();
    assert!(refused.contains("two axes"), "{refused}");
    let mixed = WIDE.text.replacen("[[cell]]", "[[cell]]\nslit = { diameter_mm = 0.7 }", 1);
    let mixed = SceneFile::parse("mixed.toml", &mixed).expect("a scene");
    let error = with_values(&mixed, &[(Quantity::SlitWidth, 0.5)]).expect_err("refused").to_string();
    assert!(error.contains("some cells have slits and some holes"), "{error}");
    let riding = set(&SPACEMOUSE.read().expect("a scene"), &[(Quantity::SlitWidth, 0.4)]);
    assert!(riding.scene.cells.iter().all(|cell| cell.opening() == slitpose_model::Opening::RidingSlit));
}

/// Dimensions of the drawing, put in and read back from the scene.
#[test]
fn quantities_are_where_the_drawing_has_them() {
    let file = wide();
    for (quantity, of_wide, other) in [
        (Quantity::EmitterRadius, 10.0, 12.5),
        (Quantity::EmitterDistance, 15.0, 17.0),
        (Quantity::SlitDistance, 5.0, 4.25),
        (Quantity::SlitWidth, 0.6, 1.05),
        (Quantity::SlitLength, 10.0, 8.0),
        (Quantity::Roll, 45.0, 60.0),
        (Quantity::EmitterTilt, 0.0, 10.0),
        (Quantity::Lift, 0.0, 2.0),
        (Quantity::FullScale, 10.0, 7.3),
    ] {
        assert!((current(&file, quantity) - of_wide).abs() < 1e-9, "{quantity}");
        let changed = set(&file, &[(quantity, other)]);
        for like in Quantity::all() {
            let expected = if like == quantity { other } else { current(&file, like) };
            assert!((current(&changed, like) - expected).abs() < 1e-6, "{quantity}: {like}");
        }
        // Those of the drawing change nothing but rounding.
        assert_eq!(set(&file, &[(quantity, of_wide)]).scene.cells.len(), 6);
    }
    let cells = |file: &SceneFile| file.scene.cells.clone();
    // Signs alternate from cell to cell.
    for (quantity, value, of) in [
        (Quantity::Roll, 30.0, (|cell| cell.detector.x_axis_base.z) as fn(&slitpose_model::Cell) -> f64),
        (Quantity::EmitterTilt, 30.0, |cell| cell.emitter.axis_tool.z),
        (Quantity::Lift, 500.0, |cell| cell.emitter.position_tool_m.z),
    ] {
        let changed = set(&file, &[(quantity, value)]);
        for (number, cell) in cells(&changed).iter().enumerate() {
            let sign = if number % 2 == 0 { 1.0 } else { -1.0 };
            assert!((of(cell) - 0.5 * sign).abs() < 1e-9, "{quantity} of cell {number}");
        }
    }
    let eight = set(&file, &[(Quantity::Cells, 8.0)]);
    assert_eq!((cells(&eight).len(), eight.lighting.slots.len()), (8, 9));
    // Rolls alternate in the ring of eight as in that of six, and all face the axis.
    for (number, cell) in cells(&eight).iter().enumerate() {
        let sign = if number % 2 == 0 { 1.0 } else { -1.0 };
        assert!((cell.detector.x_axis_base.z - sign * 0.5_f64.sqrt()).abs() < 1e-9);
        assert!(cell.detector.normal_base.dot(cell.detector.centre_base_m.normalize()) < -0.999_999);
    }
    // Remarks on parts stay; what described the head before does not.
    assert!(eight.source.contains("# Hamamatsu S3932"), "{}", eight.source);
    assert!(!["The default scene", "circle of 25 mm", "3.4 uA"].iter().any(|old| eight.source.contains(old)));
    for file in [&eight, &set(&eight, &[])] {
        assert_eq!(file.name, "optimised from: six cells, rolled 45 degrees");
    }
}

#[test]
fn limits_are_told_by_how_much_they_are_passed() {
    let excesses = |values: &[(Quantity, f64)], limits: Limits| score(&set(&wide(), values), limits).excesses;
    let limits = Limits { lit: 0.99, in_scale: 0.99, ..Limits::default() };
    assert!(excesses(&[], limits).is_empty());
    // The only limit that is not kept, by how much at worst and in all.
    let only = |values: &[(Quantity, f64)], limits: Limits, limit: Limit| {
        let found = excesses(values, limits);
        let [excess] = found.iter().collect::<Vec<_>>()[..] else { panic!("{found:?}") };
        assert_eq!(excess.limit, limit, "{found:?}");
        (excess.worst, violation(&found))
    };
    // Emitters 10 mm before the detector, slits at 5 mm: motions of up to 4 mm along each axis, which the corners of a
    // cube reach, and rotations of 10 mm come nearer than 1 mm.
    let near = excesses(&[(Quantity::EmitterDistance, 10.0)], limits);
    let clearance = near.iter().find(|excess| excess.limit == Limit::Clearance).expect("too near");
    assert!((0.5..3.0).contains(&clearance.worst), "{clearance:?}");
    // The ends of the detectors: 25 mm out, 6 mm and a housing of 1 mm along, half of it across.
    let radius_m = (25.0_f64.powi(2) + (7.0 * 0.5_f64.sqrt()).powi(2)).sqrt() * 1e-3;
    assert!(excesses(&[], Limits { radius_m: radius_m + 1e-6, ..limits }).is_empty());
    let (worst, all) = only(&[], Limits { radius_m: radius_m - 0.1e-3, ..limits }, Limit::Radius);
    assert!((worst / 0.1 - 1.0).abs() < 1e-6, "{worst}");
    assert!((all / (12.0 * 0.1) - 1.0).abs() < 1e-6, "twelve ends, 0.1 mm each: {all}");
    // What a tenth of the poses pass at 10 µA, they pass by so much more at a scale that is so much less.
    let scale = |full_scale_ua| {
        only(&[(Quantity::FullScale, full_scale_ua)], Limits { in_scale: 0.9, ..limits }, Limit::InScale).0
    };
    assert!((scale(3.0) / scale(4.5) - 1.5).abs() < 1e-9, "{} {}", scale(3.0), scale(4.5));
    // Lower slits, larger spots: they leave the detector.
    let (worst, all) = only(&[(Quantity::SlitDistance, 7.5)], Limits { in_scale: 0.0, ..limits }, Limit::Lit);
    assert!(worst > 0.5 && all == worst, "{worst} {all}");
    // All emitters at once.
    let mut together = wide();
    together.lighting.slots = vec![(0..6).collect(), Vec::new()];
    let found = score(&together, limits).excesses;
    let crosstalk = found.iter().find(|excess| excess.limit == Limit::Crosstalk).expect("cross-talk");
    let limit = limits.crosstalk * crosstalk.worst;
    let loose = Limits { crosstalk: limit * 1.000_001, ..limits };
    assert!(score(&together, loose).excesses.iter().all(|excess| excess.limit != Limit::Crosstalk), "{found:?}");
}

/// A search of two dimensions, twice; what is found is what is printed, and a search that begins there stays.
#[test]
fn a_search_finds_better_heads_and_the_same_for_a_seed() {
    let search = search(wide(), &["slit_width=0.3..1.2", "full_scale=5..20"], GOAL);
    let run = |search: &Search| run(search).expect("a head");
    let found = run(&search);
    println!("{:?}, {:.3} µm of {:.3} µm", found.values, found.after.sigma_m * 1e6, found.before.sigma_m * 1e6);
    assert!(found.after.excesses.is_empty(), "{:?}", found.after.excesses);
    assert_eq!(run(&search).file.source, found.file.source);
    assert_eq!(score(&found.file, search.limits), found.after);
    // `scene check` says the same of the spots.
    let coverage = Survey::of(&found.file, 20_000, |_| ()).expect("a survey").coverage;
    assert!(coverage.at_least_lit[6] >= 0.999, "{:?}", coverage.at_least_lit);
    let again = run(&Search { file: found.file.clone(), ..search.clone() });
    assert!(again.after.sigma_m <= found.after.sigma_m * 1.000_001);
    // Brute force over the same plane.
    let mut best = f64::INFINITY;
    for width in 0..19 {
        for scale in 0..16 {
            let values =
                [(Quantity::SlitWidth, 0.3 + 0.05 * f64::from(width)), (Quantity::FullScale, 5.0 + f64::from(scale))];
            let score = score(&set(&search.file, &values), search.limits);
            if score.excesses.is_empty() {
                best = best.min(score.sigma_m);
            }
        }
    }
    assert!(found.after.sigma_m <= best, "{} of {best}", found.after.sigma_m);
}

/// Between the poses that candidates are looked at a head of four cells may be singular.
#[test]
fn the_worst_pose_is_that_of_all_the_workspace() {
    let four = wide().source.split("[[cell]]").take(5).collect::<Vec<_>>().join("[[cell]]");
    let four = four.replace("slots = [[0, 2, 4], [1, 3, 5], []]", "slots = [[0], [1], [2], [3], []]");
    let file = SceneFile::parse("four.toml", &four).expect("a scene");
    let goal = Goal { demand: Demand::Worst, lever_m: 0.0 };
    let found = run(&search(file, &["roll=0..90"], goal)).expect("a head");
    println!("{:?}, {:.1} µm of {:.1} µm", found.values, found.after.sigma_m * 1e6, found.before.sigma_m * 1e6);
    let anew = Judge::new(&found.file.workspace, goal, Limits::default()).score(&found.file).expect("a score");
    assert!(anew.sigma_m <= found.after.sigma_m && found.after.sigma_m <= found.before.sigma_m, "{anew:?}");
    // Ten times as many poses as are looked at: the worst lies between them.
    let worst_m = map(found.file, 40_000).quantile(1.0, View::sigma_m);
    assert!(worst_m <= found.after.sigma_m, "{worst_m}");
}

#[test]
fn fine_is_a_third_more_accurate_than_wide() {
    let [wide, fine] = [wide(), FINE.read().expect("a scene")].map(|file| map(file, 4000));
    for of in [View::sigma_m, View::sigma_rad] {
        for share in [0.5, 1.0] {
            let ratio = wide.quantile(share, of) / fine.quantile(share, of);
            assert!(ratio > 4.0 / 3.0, "{share}: {ratio}");
        }
    }
    assert!(fine.share(|view| view.lit == 6) >= 0.999);
}

#[test]
fn redundant_keeps_its_accuracy_whichever_cell_is_dark() {
    let redundant = map(REDUNDANT.read().expect("a scene"), 500);
    let usual = redundant.quantile(0.5, View::sigma_m);
    let (_, worst) = redundant.worst_dark(View::sigma_m).expect("cells");
    assert!(worst < 1.2 * usual, "{worst} of {usual}");
    assert!(redundant.one_dark.iter().flatten().all(|view| view.sigma.is_some()));
    // Six cells without one have a third less to go by, and next to nothing to check it with.
    let unnoticed = |map: &Map| map.quantile(0.5, |view| Some(view.unnoticed_sigmas));
    assert!(unnoticed(&redundant) < 0.5 * unnoticed(&map(wide(), 500)));
}

#[test]
fn what_may_be_free_is_named() {
    let error = |text: &str| text.parse::<Free>().expect_err("no quantity");
    assert!(error("slit").contains("slit_width, slit_length"));
    assert!(error("roll=90..0").contains("e.g. roll=0..90"));
    assert!(error("roll=a..b").contains("`a..b` are no bounds"));
    // Bounds reach as far as the scene does, unless they are given.
    let file = MAGLEV.read().expect("a scene");
    let around = |text: &str| text.parse::<Free>().expect("a quantity").around(&file);
    let [from, to] = around("emitter_distance").bounds;
    assert!(from == 9.0 && (to - 165.0).abs() < 1e-9);
    assert_eq!(around("roll").bounds, [0.0, 90.0]);
    assert!(!around("slit_distance=2..10").has(&file) && around("slit_distance").has(&file));
    let bench = SceneFile { front_end: None, ..wide() };
    let refused = with_values(&bench, &[(Quantity::FullScale, 1.0)]).expect_err("no front end");
    assert!(refused.to_string().contains("[front_end]"));
}
