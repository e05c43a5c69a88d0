use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;
use slitpose_head::scene_file::{MAGLEV, SPACEMOUSE, SceneFile, Shipped, WIDE};
use slitpose_head::simulator::noisy_reading;
use slitpose_model::{MotionPrior, Photocurrents, Solver, Start, Tier};

use super::*;
use crate::report::frame_scene;

const SEED: u64 = 11;

/// Frames of each pose: a root mean square over three axes is then known to a percent.
const FRAMES: usize = 3000;
const POSES: usize = 100;

/// Errors of poses that were solved from noisy frames, against the map. Five σ of a root mean square of three axes with
/// like variances are 3.7 %, of a single one 6.5 %.
#[test]
fn a_map_has_the_errors_that_solving_makes() {
    const TIER: Tier = Tier::Exact { tolerance: 1e-6 };
    let wide = || WIDE.read().expect("a scene");
    // The same head with a detector turned away, and one seen by a measuring channel.
    let turned =
        wide().source.replacen("x_axis = [0.0, 0.707106781186548, 0.707106781186547]", "x_axis = [0.0, 1.0, 0.0]", 1);
    let base = Shipped::named("base").expect("a scene").read().expect("a scene");
    let others = [SPACEMOUSE, MAGLEV].map(|shipped| shipped.read().expect("a scene"));
    let slits = [wide(), SceneFile::parse("turned.toml", &turned).expect("a scene"), base];
    // Integrals over polygons take ten times as long.
    let slits = slits.map(|file| (file, POSES)).into_iter();
    for (file, poses) in slits.chain(others.map(|file| (file, POSES / 5))) {
        let (scene, _) = frame_scene(&file);
        let solver = Solver::<f64>::new(&scene, TIER).unwrap();
        let plan = solver.plan();
        let (noise, workspace) = (scene.noise.expect("noise"), file.workspace);
        let outlook = Outlook::of(file.clone().into()).expect("a head");
        let mut rng = ChaCha8Rng::seed_from_u64(SEED);
        let (mut tried, mut worst, mut sums) = (0, 0.0_f64, [0.0; 2]);
        for pose in workspace.poses(poses) {
            let view = outlook.at(&pose);
            let (Some(sigma_m), Some(sigma_rad)) = (view.sigma_m(), view.sigma_rad()) else { continue };
            let mut squares = [0.0; 2];
            for _ in 0..FRAMES {
                let read = |cell: usize| {
                    let pair = plan.photocurrents(cell, &pose);
                    noisy_reading(pair, &scene.cells[cell].detector, &noise, || rng.sample(StandardNormal))
                };
                let readings = Photocurrents::of_pairs((0..plan.cell_count()).map(read).collect::<Vec<_>>());
                let solution = solver.solve(&readings, Start::Near(&pose), &MotionPrior::AT_REST);
                let (t, r) = solution.estimate.expect("a pose").pose.displacement_from(&pose);
                squares[0] += t.length_squared() / FRAMES as f64;
                squares[1] += r.length_squared() / FRAMES as f64;
            }
            tried += 1;
            for (k, sigma) in [sigma_m, sigma_rad].into_iter().enumerate() {
                let ratio = squares[k].sqrt() / sigma;
                worst = worst.max((ratio - 1.0).abs());
                sums[k] += ratio;
            }
        }
        let mean = sums.map(|sum| sum / tried as f64);
        println!(
            "seed {SEED}, {}: {tried} poses, error/sigma {mean:.4?} in the mean, off by {worst:.3} at most",
            file.origin
        );
        assert!(tried > poses * 9 / 10 && worst < 0.05, "{}", file.origin);
        assert!(mean.iter().all(|mean| (mean - 1.0).abs() < 0.01), "{}", file.origin);
    }
}

#[test]
fn schedules_fit_and_more_conversions_tell_more() {
    let file = WIDE.read().expect("a scene");
    let found = Schedules::of(&file, 4000.0).expect("schedules");
    assert!(found.at_rate.iter().chain(&found.best_by_rate).all(|candidate| candidate.busy <= 1.0));
    let own = |oversampling: u32| {
        let is_it = |one: &&Candidate| one.slots == file.lighting.slots && one.oversampling == oversampling;
        found.at_rate.iter().find(is_it).expect("a candidate").sigma_m
    };
    // Noise of the converters, of one step and more, averages; that of light and resistance is white beyond a conversion's
    // time, too.
    for oversampling in [1, 2, 4] {
        let ratio = own(oversampling) / own(2 * oversampling);
        assert!((1.3..1.45).contains(&ratio), "{oversampling}: {ratio}");
    }
    assert!(found.at_rate[0].sigma_m < own(4) && found.at_rate[0].busy < 0.7);
    // Emitters on a ring of six face outward: every other one shines past the others' slits.
    assert_eq!(found.at_rate[0].slots, [vec![0, 2, 4], vec![1, 3, 5], vec![]]);
    // All in one slot would be faster yet, and each would see its neighbours' light.
    assert!(found.at_rate.iter().all(|candidate| candidate.slots.iter().all(|slot| slot.len() <= 3)));
    assert!(Schedules::of(&file, 30e3).unwrap_err().to_string().contains("the frame period is 33.3 µs"));
    let single = SceneFile { front_end: None, ..file };
    assert!(Schedules::of(&single, 4000.0).unwrap_err().to_string().contains("[front_end]"));
}

#[test]
fn a_dark_cell_tells_what_a_head_without_it_does_not() {
    let file = SceneFile { front_end: None, ..WIDE.read().expect("a scene") };
    let outlook = Outlook::of(file.clone().into()).expect("a head");
    let pose = file.workspace.poses(7).last().expect("a pose");
    for dark in 0..6 {
        let mut fewer = file.clone();
        fewer.scene.cells.remove(dark);
        let expected = Outlook::of(fewer.into()).expect("a head").at(&pose).sigma.expect("a pose");
        let found = outlook.at_without(&pose, Some(dark)).sigma.expect("a pose");
        for (found, expected) in found.into_iter().zip(expected) {
            assert!((found / expected - 1.0).abs() < 1e-6, "{found} {expected}");
        }
        assert!(found[0] > outlook.at(&pose).sigma.expect("a pose")[0]);
    }
}

#[test]
fn electrodes_above_full_scale_tell_nothing() {
    let mut file = WIDE.read().expect("a scene");
    let at = |file: &SceneFile| Outlook::of(file.clone().into()).expect("a head").at(&Pose::HOME);
    let usual = at(&file);
    // 6.8 µA of a cell at home, half on each electrode.
    assert!((usual.full_scale - 10.0 / 3.408).abs() < 0.01 && usual.sigma.is_some());
    file.front_end.as_mut().expect("a front end").full_scale_a = 3.4e-6;
    assert!(at(&file).full_scale < 1.0 && at(&file).sigma.is_none());
}

#[test]
fn planes_go_through_home_and_end_at_the_edge() {
    let fineness = Fineness { samples: 50, side: 5, behind: 3 };
    let file = WIDE.read().expect("a scene");
    let mut looked_at = 0;
    let map = Map::of(file.into(), fineness, || looked_at += 1).expect("a map");
    assert_eq!(looked_at, fineness.poses());
    for plane in &map.planes {
        assert_eq!(plane.points[12].view, map.home);
        assert_eq!(plane.points[0].at, plane.extents.map(|extent| -extent));
        assert_eq!(plane.points[24].at, plane.extents);
        for point in &plane.points {
            assert!(point.worst_m >= point.view.sigma_m().unwrap() && point.least_lit <= point.view.lit);
        }
    }
    // Half of the poses are as good as the median, and none is better than the best.
    let median = map.quantile(0.5, View::sigma_m);
    let share = map.share(|view| view.sigma_m().unwrap() <= median);
    assert!((share - 0.5).abs() < 1.5 / 50.0, "{share}");
    assert_eq!(map.worst(View::sigma_m).unwrap().1, map.quantile(1.0, View::sigma_m));
    let flat = Map::of(WIDE.read().expect("a scene").into(), Fineness { side: 0, ..fineness }, || ()).expect("a map");
    assert!(flat.planes.is_empty() && flat.home == map.home);
    // 4000 frames/s fill 2 kHz.
    assert!((map.per_root_hz().unwrap() * 2000.0_f64.sqrt() - 1.0).abs() < 1e-4);
}
