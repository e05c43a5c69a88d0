//! The solver against poses it does not know, outliers, gains nobody knows, and what a pose says of its own worth.

use slitpose_model::{DegradedReason, Outcome, Pair, Photocurrents, Reading, Solver, Status, Tier};

use crate::common::{base, cold, generator, near, noisy, pairs, pose_in_box, seen, uniform, wide};

#[test]
fn too_little_light_says_so() {
    let solver = Solver::<f64>::new(&wide(), Tier::Paper).expect("scene");
    let dark = Pair { i_x1_a: 1e-9, i_x2_a: 1e-9 };
    let solution = cold(&solver, &Photocurrents::of_pairs([dark; 6]));
    assert_eq!(solution.outcome, Outcome::TooDark);
    assert!(solution.estimate.is_none());
    // Two lit cells, and so many dark ones.
    let outcome = |count: usize| {
        let mut cells = [Reading::Missing; 6];
        cells[..2].fill(Reading::Light(Pair { i_x1_a: 3e-6, i_x2_a: 3e-6 }));
        cells[2..2 + count].fill(Reading::Light(dark));
        cold(&solver, &Photocurrents { cells: cells.into_iter().collect() }).outcome
    };
    assert_eq!(outcome(1), Outcome::TooDark);
    assert!(matches!(outcome(0), Outcome::Unobservable(_)));
}

#[test]
fn a_pose_from_currents_that_are_none_is_finite() {
    let solver = Solver::<f64>::new(&wide(), Tier::Paper).expect("scene");
    for bad in [f64::NAN, f64::INFINITY, -1.0, 0.0, 1e300, -1e300] {
        let mut pairs = [Pair { i_x1_a: 3e-6, i_x2_a: 3e-6 }; 6];
        pairs[2].i_x1_a = bad;
        pairs[3].i_x2_a = bad;
        let solution = cold(&solver, &Photocurrents::of_pairs(pairs));
        assert!(solution.estimate.is_none_or(|estimate| estimate.pose.is_finite()));
    }
}

/// Converter noise of the scene, amperes: it outweighs the rest.
const NOISE_A: f64 = 0.6e-9;

#[test]
fn a_cell_that_answers_for_another_pose_is_left_out_and_named() {
    let solver = Solver::<f64>::new(&wide(), Tier::Paper).expect("scene");
    let mut rng = generator();
    let (mut named, mut tried) = (0, 0);
    while tried < 500 {
        let (pose, other) = (pose_in_box(&mut rng, 3.0, 12.0), pose_in_box(&mut rng, 3.0, 12.0));
        let outlier = tried % 6;
        let (mut cells, error) = (pairs(solver.plan(), &pose), pairs(solver.plan(), &other));
        cells[outlier] = error[outlier];
        let readings = noisy(&cells, NOISE_A, &mut rng);
        tried += 1;
        for solution in [cold(&solver, &readings), near(&solver, &readings, &pose)] {
            assert_ne!(solution.outcome, Outcome::Converged, "cell {outlier} at {pose:?} for {other:?}");
            if solution.outcome == Outcome::Degraded(DegradedReason::CellExcluded) {
                assert!(solution.excluded.contains(outlier) && solution.excluded.count() == 1);
                assert_eq!((solution.cells_used.count(), solution.redundancy), (5, 4));
                let nees = solution.estimate.and_then(|estimate| estimate.nees(&pose)).expect("covariance");
                // χ² of six degrees exceeds 40 once in two million times.
                assert!(nees < 40.0, "{nees}");
                named += 1;
            }
        }
    }
    println!("{named} of {} outliers named", 2 * tried);
    // The rest are too small to be told from noise with certainty, or too wild for a fit.
    assert!(named >= 990);
}

#[test]
fn five_cells_do_not_tell_which_of_them_lies() {
    let solver = Solver::<f64>::new(&wide(), Tier::Paper).expect("scene");
    let mut rng = generator();
    for _ in 0..20 {
        let (pose, other) = (pose_in_box(&mut rng, 2.0, 8.0), pose_in_box(&mut rng, 2.0, 8.0));
        let mut readings = seen(solver.plan(), &pose);
        readings.cells[0] = Reading::Missing;
        readings.cells[3] = Reading::Light(pairs(solver.plan(), &other)[3]);
        let solution = near(&solver, &readings, &pose);
        assert!(solution.excluded.is_empty());
        assert!(!matches!(solution.outcome, Outcome::Converged | Outcome::Degraded(DegradedReason::FewerCells)));
    }
}

#[test]
fn gains_that_nobody_knows_leave_the_positions() {
    let mut rng = generator();
    let mut known = wide();
    known.noise.as_mut().expect("noise").adc_a = NOISE_A;
    let mut unknown = known.clone();
    let reference = Solver::<f64>::new(&known, Tier::Paper).expect("scene");
    for gain in [0.01, 1.0, 100.0] {
        unknown.uncertainty.emitter_gain_relative = gain;
        let solver = Solver::<f64>::new(&unknown, Tier::Paper).expect("scene");
        for _ in 0..50 {
            let pose = pose_in_box(&mut rng, 3.0, 10.0);
            // Gains as far off as one may think of them.
            let cells = pairs(reference.plan(), &pose).into_iter().map(|pair| {
                let factor =
                    if gain < 0.1 { 1.0 + uniform(&mut rng, -0.02, 0.02) } else { uniform(&mut rng, 0.5, 2.0) };
                Pair { i_x1_a: factor * pair.i_x1_a, i_x2_a: factor * pair.i_x2_a }
            });
            let solution = cold(&solver, &Photocurrents::of_pairs(cells));
            assert_eq!(solution.outcome, Outcome::Converged, "gain {gain}");
            let estimate = solution.estimate.expect("pose");
            let nees = estimate.nees(&pose).expect("covariance");
            // Two σ of each gain at most: Σ of six squares of those, all of it in the pose.
            assert!(nees < 24.0, "gain {gain}: {nees}");
            let bound = reference.bound(&pose).expect("observable");
            assert!(estimate.covariance[0][0] > 2.0 * bound[0][0], "gain {gain}");
        }
    }
}

#[test]
fn clipped_cells_are_left_out_where_that_is_asked_for() {
    let solver = Solver::<f64>::new(&base(), Tier::Paper).expect("scene");
    let careful = solver.clone().without_clipped();
    let mut rng = generator();
    let mut left_out = 0;
    for _ in 0..1000 {
        let pose = pose_in_box(&mut rng, 4.0, 15.0);
        let readings = seen(solver.plan(), &pose);
        let status = |cell| solver.plan().respond(cell, &pose).status;
        let used = near(&careful, &readings, &pose).cells_used;
        for cell in 0..6 {
            // The end of the unclipped range is that of an emitter at home, and moves with it.
            let reading = readings.cells[cell];
            let Reading::Light(pair) = reading else { unreachable!("all are measured") };
            let share = ((pair.i_x2_a - pair.i_x1_a) / pair.total_a()).abs();
            if status(cell) == Status::Clipped && share > 0.95 {
                assert!(!used.contains(cell), "cell {cell} at {pose:?}");
                left_out += 1;
            }
            if status(cell) == Status::Lit && share < 0.9 {
                assert!(used.contains(cell), "cell {cell} at {pose:?}");
            }
        }
    }
    assert!(left_out > 10, "{left_out}");
}
