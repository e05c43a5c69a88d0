//! The solver against poses it does not know.

use crate::common::{base, generator, pose_in_box, six_cells, vector, wide};
use glam::DVec3;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use slitpose_model::{
    DegradedReason, MotionPrior, Outcome, Pair, Photocurrents, Plan, Pose, Reading, Scene, Solver, Start, Tier, Twist,
};

fn readings(plan: &Plan<f64>, pose: &Pose) -> Photocurrents {
    Photocurrents::of_pairs((0..plan.cell_count()).map(|cell| plan.photocurrents(cell, pose)))
}

/// Noise of the scene's converter only: it outweighs the rest.
fn noisy(rng: &mut ChaCha8Rng, readings: &Photocurrents, sigma_a: f64) -> Photocurrents {
    let mut draw = || -> f64 { StandardNormal.sample(rng) };
    Photocurrents {
        cells: readings
            .cells
            .iter()
            .map(|reading| match reading {
                Reading::Light(pair) => Reading::Light(Pair {
                    i_x1_a: pair.i_x1_a + sigma_a * draw(),
                    i_x2_a: pair.i_x2_a + sigma_a * draw(),
                }),
                other => *other,
            })
            .collect(),
    }
}

fn lit(plan: &Plan<f64>, pose: &Pose) -> bool {
    (0..6).all(|cell| !plan.respond(cell, pose).flags.faint)
}

#[test]
fn cold_start_finds_noise_free_poses() {
    for (name, scene, least) in [("wide", wide(), 1.0), ("base", base(), 0.999)] {
        for tier in [Tier::Paper, Tier::Exact { tolerance: 1e-6 }] {
            let mut rng = generator();
            let solver = Solver::<f64>::new(&scene, tier).expect("scene");
            let (mut found, mut tried, mut worst_mm, mut worst_rad, mut iterations) = (0, 0, 0.0_f64, 0.0_f64, 0);
            while tried < 2000 {
                let pose = pose_in_box(&mut rng, 4.0, 15.0);
                if !lit(solver.plan(), &pose) {
                    continue;
                }
                tried += 1;
                let solution = solver.solve(&readings(solver.plan(), &pose), Start::Cold, &MotionPrior::AT_REST);
                iterations += solution.iterations;
                let Some(estimate) = solution.estimate else {
                    println!("{name} {tier:?}: {:?} at {pose:?}", solution.outcome);
                    continue;
                };
                let (dt, dr) = estimate.pose.displacement_from(&pose);
                if dt.length() < 1e-6 && dr.length() < 1e-4 {
                    found += 1;
                    worst_mm = worst_mm.max(dt.length() * 1e3);
                    worst_rad = worst_rad.max(dr.length());
                } else {
                    println!("{name} {tier:?}: {:?} wrong at {pose:?}", solution.outcome);
                }
            }
            let share = f64::from(found) / f64::from(tried);
            println!(
                "{name} {tier:?}: {found} of {tried}, worst {worst_mm:.1e} mm {worst_rad:.1e} rad, {:.2} steps",
                f64::from(iterations as u32) / f64::from(tried)
            );
            assert!(share >= least);
            // The last step is below a hundredth of σ (some 0.01 µm); what it leaves is second order.
            // The exact tier adds its tolerance, 1e-6 of the spot's millimetre.
            let bound = if tier == Tier::Paper { 1e-9 } else { 1e-6 };
            assert!(worst_mm < bound && worst_rad < bound);
        }
    }
}

#[test]
fn the_covariance_is_honest() {
    let scene = wide();
    let tier = Tier::Paper;
    let solver = Solver::<f64>::new(&scene, tier).expect("scene");
    let mut rng = generator();
    let (mut sum, mut count, mut beyond) = (0.0, 0, 0);
    let mut sigmas = Vec::new();
    while count < 2000 {
        let pose = pose_in_box(&mut rng, 3.5, 12.0);
        if !lit(solver.plan(), &pose) {
            continue;
        }
        let solution =
            solver.solve(&noisy(&mut rng, &readings(solver.plan(), &pose), 0.6e-9), Start::Cold, &MotionPrior::AT_REST);
        let estimate = solution.estimate.expect("pose");
        sum += estimate.nees(&pose).expect("covariance");
        count += 1;
        sigmas.push(estimate.sigma()[0]);
        let (dt, dr) = estimate.pose.displacement_from(&pose);
        let error = [dt.x, dt.y, dt.z, dr.x, dr.y, dr.z];
        beyond += error.iter().zip(estimate.sigma()).filter(|(e, s)| e.abs() > 5.0 * s).count();
    }
    let mean = sum / f64::from(count);
    sigmas.sort_by(f64::total_cmp);
    println!("mean NEES {mean:.3}, median σ_tx {:.3} µm", sigmas[1000] * 1e6);
    // Mean of 2000 draws of χ²₆ has σ = √(12/2000) = 0.077; the noise put in lacks the shot and
    // Johnson noise the covariance counts (7 % of the variance).
    assert!((5.2..6.3).contains(&mean), "{mean}");
    assert_eq!(beyond, 0);
    // The Cramér–Rao medians of an independent computation are 0.71 µm and 96 µrad.
    assert!((sigmas[1000] * 1e6 - 0.71).abs() < 0.1);
}

#[test]
fn fewer_cells_still_make_a_pose() {
    let solver = Solver::<f64>::new(&wide(), Tier::Paper).expect("scene");
    let mut rng = generator();
    for missing in 0..6 {
        let pose = pose_in_box(&mut rng, 2.0, 8.0);
        let mut readings = readings(solver.plan(), &pose);
        readings.cells[missing] = if missing % 2 == 0 { Reading::Missing } else { Reading::Saturated };
        let solution = solver.solve(&readings, Start::Cold, &MotionPrior::AT_REST);
        assert_eq!(solution.outcome, Outcome::Degraded(DegradedReason::FewerCells));
        assert_eq!((solution.cells_used.count(), solution.redundancy), (5, 4));
        let (dt, _) = solution.estimate.expect("pose").pose.displacement_from(&pose);
        assert!(dt.length() < 1e-9);
    }
}

#[test]
fn too_little_light_says_so() {
    let solver = Solver::<f64>::new(&wide(), Tier::Paper).expect("scene");
    let dark = Photocurrents::of_pairs([Pair { i_x1_a: 1e-9, i_x2_a: 1e-9 }; 6]);
    let solution = solver.solve(&dark, Start::Cold, &MotionPrior::AT_REST);
    assert_eq!(solution.outcome, Outcome::TooDark);
    assert!(solution.estimate.is_none());
}

#[test]
fn equal_rolls_leave_directions_free() {
    let solver = Solver::<f64>::new(&six_cells(7.5, 0.4, [0.0, 0.0]), Tier::Paper).expect("scene");
    let solution = solver.solve(&readings(solver.plan(), &Pose::HOME), Start::Cold, &MotionPrior::AT_REST);
    let Outcome::Unobservable(free) = solution.outcome else {
        panic!("{:?}", solution.outcome);
    };
    assert_eq!(free.names().collect::<Vec<_>>(), ["tz", "rx", "ry"]);
    assert!(solution.estimate.is_none());
}

#[test]
fn nonsense_is_no_pose() {
    let solver = Solver::<f64>::new(&wide(), Tier::Paper).expect("scene");
    let mut rng = generator();
    for _ in 0..200 {
        let pairs = [0; 6].map(|_| {
            let v = vector(&mut rng, 5e-6);
            Pair { i_x1_a: v.x.abs() + 1e-7, i_x2_a: v.y.abs() + 1e-7 }
        });
        let solution = solver.solve(&Photocurrents::of_pairs(pairs), Start::Cold, &MotionPrior::AT_REST);
        if let Some(estimate) = solution.estimate {
            assert_eq!(solution.outcome, Outcome::Degraded(DegradedReason::Misfit), "{pairs:?}");
            assert!(estimate.pose.is_finite());
        }
    }
    for bad in [f64::NAN, f64::INFINITY, -1.0, 0.0, 1e300, -1e300] {
        let mut pairs = [Pair { i_x1_a: 3e-6, i_x2_a: 3e-6 }; 6];
        pairs[2].i_x1_a = bad;
        pairs[3].i_x2_a = bad;
        let solution = solver.solve(&Photocurrents::of_pairs(pairs), Start::Cold, &MotionPrior::AT_REST);
        assert!(solution.estimate.is_none_or(|estimate| estimate.pose.is_finite()));
    }
}

#[test]
fn exposures_and_twist_are_inverted_together() {
    let offsets = [-40e-6, 0.0, 40e-6, -36e-6, 4e-6, 44e-6];
    let solver = Solver::<f64>::new(&wide(), Tier::Paper).expect("scene").with_exposures(&offsets);
    let mut rng = generator();
    for _ in 0..100 {
        let pose = pose_in_box(&mut rng, 2.0, 8.0);
        let twist = Twist { linear_m_per_s: vector(&mut rng, 0.5), angular_rad_per_s: vector(&mut rng, 5.0) };
        let pairs = (0..6).map(|cell| solver.plan().photocurrents(cell, &twist.advance(&pose, offsets[cell])));
        let readings = Photocurrents::of_pairs(pairs);
        let known = MotionPrior { twist, ..MotionPrior::AT_REST };
        let prior = pose.perturbed(DVec3::splat(2e-5), DVec3::splat(1e-3));
        let estimate = solver.solve(&readings, Start::Near(&prior), &known).estimate.expect("pose");
        let (dt, dr) = estimate.pose.displacement_from(&pose);
        // Following a tool leaves a thousandth of σ: of 0.7 µm and 96 µrad, six axes together.
        assert!(dt.length() < 2e-9 && dr.length() < 3e-7, "{dt} {dr}");
        // Ignoring the order of exposure would be seen.
        let ignored = solver.solve(&readings, Start::Cold, &MotionPrior::AT_REST).estimate.expect("pose");
        assert!(ignored.pose.displacement_from(&pose).0.length() > 1e-7);
    }
}

#[test]
fn single_precision_finds_the_same_pose() {
    let scene: Scene = wide();
    let double = Solver::<f64>::new(&scene, Tier::Paper).expect("scene");
    let single = Solver::<f32>::new(&scene, Tier::Paper).expect("scene");
    let mut rng = generator();
    for _ in 0..500 {
        let pose = pose_in_box(&mut rng, 3.0, 10.0);
        let readings = readings(double.plan(), &pose);
        let estimate = single.solve(&readings.rounded(), Start::Cold, &MotionPrior::AT_REST).estimate.expect("pose");
        let (dt, dr) = estimate.pose.displacement_from(&pose);
        // Rounding of f32: 6e-8 of lengths up to 25 mm, times a condition of some ten.
        assert!(dt.length() < 3e-8 && dr.length() < 4e-6, "{dt} {dr}");
    }
}

#[test]
fn a_solver_takes_another_scene_where_it_is() {
    let pose = Pose::from_vectors(DVec3::splat(1e-3), DVec3::splat(0.05));
    let same = |a: &Solver<f64>, b: &Solver<f64>| {
        let readings = readings(b.plan(), &pose);
        let [a, b] = [a, b].map(|solver| solver.solve(&readings, Start::Cold, &MotionPrior::AT_REST));
        assert!(b.estimate.is_some());
        assert_eq!((a.outcome, a.estimate, a.chi2), (b.outcome, b.estimate, b.chi2));
    };
    let mut solver = Solver::<f64>::empty();
    for (scene, tier) in [(wide(), Tier::Paper), (base(), Tier::Exact { tolerance: 1e-6 }), (wide(), Tier::Paper)] {
        // Whatever it was before.
        solver.set_scene(&scene, tier).expect("scene");
        same(&solver, &Solver::new(&scene, tier).expect("scene"));
        solver = solver.with_exposures(&[1e-3; 6]);
    }
    let seen = readings(solver.plan(), &pose);
    assert!(solver.set_scene(&Scene::default(), Tier::Paper).is_err());
    for none in [solver, Solver::empty()] {
        assert_eq!(
            (none.plan().cell_count(), none.solve(&seen, Start::Cold, &MotionPrior::AT_REST).outcome.has_pose()),
            (0, false)
        );
        assert!(!none.solve(&seen, Start::Near(&pose), &MotionPrior::AT_REST).outcome.has_pose());
    }
}
