//! Mirror images: other poses with nearly the same currents.

use glam::{DQuat, DVec3};
use rand_chacha::ChaCha8Rng;
use slitpose_model::{
    CompiledScene, DegradedReason, Outcome, Pair, Photocurrents, Pose, Profile, Reading, Scalar, Scene, Solution,
    Solver, Tier, Tracker,
};

use crate::common::{
    self, TIERS, base, cold, errors_in_sigmas, generator, near, noisy, pairs, pose_in_box, six_cells, uniform, vector,
    wide,
};

/// The geometry of `wide` with rolls of `middle_deg` ± `delta_rad` in turn.
fn rolled(middle_deg: f64, delta_rad: f64) -> Scene {
    let delta = delta_rad.to_degrees();
    six_cells(5.0, 0.6, [middle_deg + delta, middle_deg - delta])
}

/// Three cells of a ring of six, each twice.
fn doubled(rolls_deg: [f64; 3]) -> Scene {
    let mut scene = six_cells(5.0, 0.6, [0.0; 2]);
    for (k, roll_deg) in rolls_deg.into_iter().enumerate() {
        let mut cell = scene.cells[2 * k].clone();
        let detector = &mut cell.detector;
        let turn = DQuat::from_axis_angle(detector.normal_base, -roll_deg.to_radians());
        detector.x_axis_base = turn * detector.x_axis_base;
        (scene.cells[2 * k], scene.cells[2 * k + 1]) = (cell.clone(), cell);
    }
    scene
}

/// What a workshop makes of `scene`: directions to `rad`, places to `mm`.
fn machined(mut scene: Scene, rng: &mut ChaCha8Rng, rad: f64, mm: f64) -> Scene {
    for cell in &mut scene.cells {
        let turn = DQuat::from_scaled_axis(vector(rng, rad));
        let detector = &mut cell.detector;
        (detector.normal_base, detector.x_axis_base) = (turn * detector.normal_base, turn * detector.x_axis_base);
        detector.centre_base_m += vector(rng, mm * 1e-3);
        cell.emitter.position_tool_m += vector(rng, mm * 1e-3);
    }
    scene
}

/// Currents at `pose` with the converter's noise, which outweighs the rest.
fn seen(solver: &Solver<f64>, pose: &Pose, rng: &mut ChaCha8Rng) -> Photocurrents {
    noisy(&pairs(solver.plan(), pose), 0.6e-9, rng)
}

/// How many of `count` random poses were found, and how many were said to be ambiguous or not observable.
///
/// # Panics
/// If a pose is given that is beyond 8 σ of the truth, which no one of 10¹³ honest ones is.
fn honest(name: &str, scene: &Scene, tier: Tier, rng: &mut ChaCha8Rng, count: usize) -> [usize; 2] {
    let solver = Solver::<f64>::new(scene, tier).expect("scene");
    assert!(solver.has_mirror_images(), "{name}");
    let (mut right, mut refused) = (0, 0);
    for _ in 0..count {
        let pose = pose_in_box(rng, 2.5, 9.0);
        let solution = cold(&solver, &seen(&solver, &pose, rng));
        match (solution.outcome, solution.estimate) {
            (Outcome::Ambiguous | Outcome::Unobservable(_), None) => refused += 1,
            // Of cells that are there twice one more or less is the same pose.
            (Outcome::Converged | Outcome::Degraded(DegradedReason::CellExcluded), Some(estimate)) => {
                let worst = errors_in_sigmas(&estimate, &pose).into_iter().fold(0.0, f64::max);
                assert!(worst < 8.0, "{name}, {tier:?}: {worst:.1} σ off at {pose:?}");
                right += 1;
            }
            (Outcome::Degraded(DegradedReason::Misfit) | Outcome::Diverged, _) => {}
            other => panic!("{name}, {tier:?}: {other:?}"),
        }
    }
    println!("{name}, {tier:?}: {right} right, {refused} refused");
    [right, refused]
}

#[test]
fn heads_that_are_nearly_their_own_mirror_image_give_no_wrong_pose() {
    let mut rng = generator();
    for tier in TIERS {
        for middle_deg in [0.0, 45.0, 90.0] {
            for delta_rad in [1e-4, 1e-3, 3e-3, 2e-2] {
                let name = format!("rolls {middle_deg}° ± {delta_rad}");
                let [right, refused] = honest(&name, &rolled(middle_deg, delta_rad), tier, &mut rng, 40);
                // An image in the plane of the ring is told by the sines of the rolls alone: by 0.1 µm
                // of light at 1e-4, which noise of 0.7 µm hides, and by 20 µm at 2e-2.
                match delta_rad {
                    1e-4 if middle_deg == 0.0 => assert!(refused > 35),
                    2e-2 => assert!(right > 35),
                    _ => assert!(right + refused > 35),
                }
            }
        }
    }
}

#[test]
fn machined_rings_and_doubled_cells_give_no_wrong_pose() {
    let mut rng = generator();
    for tier in TIERS {
        for (rad, mm) in [(2e-3, 0.02), (1e-2, 0.1)] {
            for roll_deg in [0.0, 90.0] {
                let scene = machined(rolled(roll_deg, 0.0), &mut rng, rad, mm);
                honest(&format!("ring of {roll_deg}°, {rad}"), &scene, tier, &mut rng, 30);
            }
            for rolls_deg in [[45.0; 3], [45.0, -45.0, 45.0]] {
                let scene = machined(doubled(rolls_deg), &mut rng, rad, mm);
                let [right, refused] = honest(&format!("doubled {rolls_deg:?}, {rad}"), &scene, tier, &mut rng, 30);
                assert!(right + refused > 25);
            }
        }
    }
}

#[test]
fn cells_that_are_there_twice_tell_no_more_than_once() {
    let mut rng = generator();
    for rolls_deg in [[45.0; 3], [45.0, -45.0, 45.0]] {
        let solver = Solver::<f64>::new(&doubled(rolls_deg), Tier::Paper).expect("scene");
        let ambiguous = (0..30).filter(|_| {
            let pose = pose_in_box(&mut rng, 2.5, 9.0);
            cold(&solver, &seen(&solver, &pose, &mut rng)).outcome == Outcome::Ambiguous
        });
        let ambiguous = ambiguous.count();
        assert!(ambiguous > 25, "{rolls_deg:?}: {ambiguous} of 30");
    }
}

#[test]
fn a_head_of_equal_rolls_is_refused_where_it_is_singular_only() {
    let mut rng = generator();
    // What is free at home: see the singular values of its factor.
    for (roll_deg, free) in [(45.0, "tz;rz"), (90.0, "rz")] {
        let solver = Solver::<f64>::new(&rolled(roll_deg, 0.0), Tier::Paper).expect("scene");
        assert_eq!(solver.free_directions(&Pose::HOME).expect("singular").to_string(), free);
        let at_home = cold(&solver, &seen(&solver, &Pose::HOME, &mut rng));
        assert!(at_home.estimate.is_none(), "{roll_deg}°: {:?}", at_home.outcome);
        let found = (0..20).filter(|_| {
            let pose = pose_in_box(&mut rng, 2.5, 9.0);
            let solution = cold(&solver, &seen(&solver, &pose, &mut rng));
            solution.estimate.is_some_and(|estimate| estimate.nees(&pose).is_some_and(|nees| nees < 50.0))
        });
        let found = found.count();
        assert!(found > 15, "{roll_deg}°: {found} of 20");
    }
}

/// What a solver makes of noise-free light at home, expected there to 3 µm and 0.3 mrad, or anywhere.
fn found_at_home<S: Scalar>(scene: &Scene, tier: Tier, rng: &mut ChaCha8Rng) -> Vec<Solution> {
    let light = CompiledScene::<f64>::compile(scene, Tier::Exact { tolerance: 1e-15 }).expect("scene");
    let readings = common::seen(&light, &Pose::HOME);
    let solver = Solver::<S>::new(scene, tier).expect("scene");
    let mut solve = |_| {
        let prior = Pose::from_vectors(vector(rng, 3e-6), vector(rng, 3e-4));
        near(&solver, &readings.rounded(), &prior).widened()
    };
    (0..20).map(&mut solve).chain([cold(&solver, &readings.rounded()).widened()]).collect()
}

#[test]
fn equal_rolls_at_home_are_not_observable_wherever_the_search_begins() {
    let mut rng = generator();
    for roll_rad in [0.0, 1e-10, 1e-7, 1e-4] {
        let scene = Scene { noise: None, ..rolled(0.0, roll_rad) };
        let mut found = found_at_home::<f32>(&scene, Tier::Exact { tolerance: 1e-6 }, &mut rng);
        if roll_rad == 0.0 {
            found.extend(found_at_home::<f64>(&scene, Tier::Exact { tolerance: 1e-15 }, &mut rng));
        }
        for Solution { outcome, estimate, .. } in found {
            let Outcome::Unobservable(free) = outcome else { panic!("±{roll_rad}: {outcome:?}") };
            assert!(roll_rad > 0.0 || free.to_string() == "tz;rx;ry", "{free}");
            assert!(estimate.is_none());
        }
    }
}

#[test]
fn a_way_that_ends_damped_leaves_the_covariance_as_it_is() {
    let mut rng = generator();
    for roll_rad in [1e-8, 1e-9, 1e-10] {
        let scene = Scene { noise: None, ..rolled(0.0, roll_rad) };
        for solution in found_at_home::<f64>(&scene, Tier::Exact { tolerance: 1e-15 }, &mut rng) {
            let estimate = solution.estimate.expect("pose");
            let worst = errors_in_sigmas(&estimate, &Pose::HOME).into_iter().fold(0.0, f64::max);
            // Currents count as rounded sixteen times; damping by 1e-10 of the information makes tens of σ of that.
            assert!(worst < 3.0, "±{roll_rad}: {worst} σ");
        }
    }
}

#[test]
fn ordinary_heads_are_not_searched_for_images() {
    let mut rng = generator();
    for tier in TIERS {
        for (name, scene) in [("wide", wide()), ("base", base())] {
            let solver = Solver::<f64>::new(&scene, tier).expect("scene");
            assert!(!solver.has_mirror_images(), "{name}, {tier:?}");
            let evaluations = (0..50).map(|_| {
                let pose = pose_in_box(&mut rng, 2.0, 8.0);
                cold(&solver, &seen(&solver, &pose, &mut rng)).evaluations
            });
            let evaluations: usize = evaluations.sum();
            assert!(evaluations < 50 * 6, "{name}, {tier:?}: {evaluations} for 50 poses");
        }
    }
}

#[test]
fn five_cells_have_images_that_the_sixth_tells_apart() {
    // Rolls of 0 make a ring its own mirror image in its plane; one cell that is turned does not.
    let mut scene = six_cells(5.0, 0.6, [0.0; 2]);
    let turned = wide().cells[0].clone();
    scene.cells[0] = turned;
    let mut rng = generator();
    for tier in TIERS {
        let solver = Solver::<f64>::new(&scene, tier).expect("scene");
        for _ in 0..20 {
            let lift = DVec3::new(0.0, 0.0, uniform(&mut rng, 1e-3, 2.5e-3));
            let pose =
                Pose::from_vectors(vector(&mut rng, 1e-3) * DVec3::new(1.0, 1.0, 0.0) + lift, vector(&mut rng, 0.05));
            let mut readings = seen(&solver, &pose, &mut rng);
            let six = cold(&solver, &readings);
            if let Some(estimate) = six.estimate {
                assert!(estimate.nees(&pose).is_some_and(|nees| nees < 60.0), "{tier:?} at {pose:?}");
            }
            readings.cells[0] = Reading::Missing;
            let five = cold(&solver, &readings);
            assert_eq!(five.outcome, Outcome::Ambiguous, "{tier:?} at {pose:?}");
        }
    }
}

#[test]
fn three_cells_alone_have_no_pose_from_nothing() {
    let solver = Solver::<f64>::new(&wide(), Tier::Paper).expect("scene");
    let mut rng = generator();
    for _ in 0..40 {
        let pose = pose_in_box(&mut rng, 2.0, 8.0);
        let mut readings = seen(&solver, &pose, &mut rng);
        let dark = Reading::Light(Pair { i_x1_a: 0.0, i_x2_a: 0.0 });
        // Covered, or not measured: nothing tells the pose from its images.
        for cells in [[Reading::Missing; 3], [dark; 3]] {
            for (cell, reading) in [1, 3, 4].into_iter().zip(cells) {
                readings.cells[cell] = reading;
            }
            let solution = cold(&solver, &readings);
            assert!(solution.estimate.is_none(), "{pose:?}");
            assert!(matches!(solution.outcome, Outcome::Ambiguous | Outcome::Diverged), "{:?}", solution.outcome);
        }
        // Where the tool was followed to, it is known.
        let followed = near(&solver, &readings, &pose);
        assert!(followed.estimate.is_some() || followed.outcome == Outcome::Ambiguous, "{:?}", followed.outcome);
    }
}

/// Emitters so narrow that at many poses three cells alone see light: that the others are dark, as they are, too, at most of
/// the images, tells no pose.
#[test]
fn three_cells_beside_dark_ones_have_no_pose_from_nothing() {
    let mut scene = wide();
    scene.cells.iter_mut().for_each(|cell| cell.emitter.profile = Profile::from_half_angle(12_f64.to_radians()));
    let solver = Solver::<f64>::new(&scene, Tier::Paper).expect("scene");
    let (mut rng, mut of_three) = (generator(), 0);
    while of_three < 40 {
        let pose = pose_in_box(&mut rng, 4.0, 15.0);
        let readings = seen(&solver, &pose, &mut rng);
        let solution = cold(&solver, &readings);
        if solution.cells_used.count() != 3 {
            continue;
        }
        of_three += 1;
        assert!(solution.estimate.is_none(), "{pose:?}");
        let followed = near(&solver, &readings, &pose);
        let is_open = matches!(followed.outcome, Outcome::Ambiguous | Outcome::Unobservable(_));
        assert!(followed.estimate.is_some() || is_open, "{:?}", followed.outcome);
    }
}

#[test]
fn an_outlier_does_not_make_an_image_a_pose() {
    const POSES: usize = 200;
    let mut rng = generator();
    for (delta_rad, most_refused) in [(1e-3, POSES * 2 / 3), (3e-3, POSES / 10)] {
        let solver = Solver::<f64>::new(&rolled(0.0, delta_rad), TIERS[0]).expect("scene");
        assert!(solver.has_mirror_images());
        let (mut right, mut refused) = (0, 0);
        for cell in (0..6).cycle().take(POSES) {
            let pose = pose_in_box(&mut rng, 2.5, 9.0);
            let mut readings = seen(&solver, &pose, &mut rng);
            let elsewhere = seen(&solver, &pose_in_box(&mut rng, 2.5, 9.0), &mut rng);
            readings.cells[cell] = elsewhere.cells[cell];
            let solution = cold(&solver, &readings);
            match solution.estimate.filter(|_| solution.excluded.contains(cell)) {
                Some(estimate) => {
                    // 7e-10 of honest poses have more: χ² with six degrees of freedom.
                    let nees = estimate.nees(&pose).expect("covariance");
                    assert!(nees < 54.0, "rolls ± {delta_rad}: {nees:.0} at {pose:?}");
                    right += 1;
                }
                None => refused += usize::from(solution.outcome == Outcome::Ambiguous),
            }
        }
        println!("rolls ± {delta_rad}: {right} right, {refused} ambiguous of {POSES}");
        // Both the outlier and the image have to be found out: images at 1e-3 differ by little more than noise.
        assert!(right > POSES / 4 && refused < most_refused, "{right} right, {refused} ambiguous");
    }
}

#[test]
fn a_tracker_finds_a_tool_without_its_outlier_and_not_an_image() {
    const TOOLS: usize = 12;
    const FRAMES: u64 = 600;
    const PERIOD_S: f64 = 250e-6;
    let mut rng = generator();
    let solver = Solver::<f64>::new(&rolled(0.0, 3e-3), TIERS[0]).expect("scene");
    let mut found = 0;
    for cell in (0..6).cycle().take(TOOLS) {
        let [pose, other] = [(); 2].map(|()| pose_in_box(&mut rng, 2.5, 9.0));
        let mut tracker = Tracker::new(solver.clone(), PERIOD_S);
        for frame in 0..20 {
            tracker.track(frame, &seen(&solver, &pose, &mut rng));
        }
        // Out of sight for a second, and then with a cell that contradicts the others.
        let first = (4000..4000 + FRAMES).find(|&frame| {
            let mut readings = seen(&solver, &pose, &mut rng);
            readings.cells[cell] = seen(&solver, &other, &mut rng).cells[cell];
            let solution = tracker.track(frame, &readings).solution;
            let estimate = solution.estimate.filter(|_| solution.excluded.contains(cell));
            if let Some(estimate) = estimate {
                let nees = estimate.nees(&pose).expect("covariance");
                assert!(nees < 54.0, "frame {frame}: {nees:.0} at {pose:?}");
            }
            estimate.is_some()
        });
        println!("cell {cell}: {:?} frames", first.map(|frame| frame - 4000));
        found += usize::from(first.is_some());
    }
    // Of the others two cells contradict the rest alike, or a misfit of all cells is near enough to be followed.
    assert!(found >= TOOLS / 4, "{found} of {TOOLS} found");
}
