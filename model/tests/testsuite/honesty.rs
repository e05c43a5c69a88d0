//! Outliers, gains nobody knows, and what a pose says of its own worth.

use crate::common::{base, generator, pose_in_box, uniform, wide};
use rand_distr::{Distribution, StandardNormal};
use slitpose_model::{
    DegradedReason, MotionPrior, Outcome, Pair, Photocurrents, Plan, Pose, Reading, Solver, Start, Status, Tier,
    Verified,
};

/// Converter noise of the scene, amperes: it outweighs the rest.
const NOISE_A: f64 = 0.6e-9;

fn pairs(plan: &Plan<f64>, pose: &Pose) -> [Pair<f64>; 6] {
    std::array::from_fn(|cell| plan.photocurrents(cell, pose))
}

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
        for pair in &mut cells {
            pair.i_x1_a += NOISE_A * <StandardNormal as Distribution<f64>>::sample(&StandardNormal, &mut rng);
            pair.i_x2_a += NOISE_A * <StandardNormal as Distribution<f64>>::sample(&StandardNormal, &mut rng);
        }
        tried += 1;
        for near in [None, Some(&pose)] {
            let solution = match near {
                None => solver.solve(&Photocurrents::of_pairs(cells), Start::Cold, &MotionPrior::AT_REST),
                Some(pose) => solver.solve(&Photocurrents::of_pairs(cells), Start::Near(pose), &MotionPrior::AT_REST),
            };
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
        let mut readings = Photocurrents::of_pairs(pairs(solver.plan(), &pose));
        readings.cells[0] = Reading::Missing;
        readings.cells[3] = Reading::Light(pairs(solver.plan(), &other)[3]);
        let solution = solver.solve(&readings, Start::Near(&pose), &MotionPrior::AT_REST);
        assert!(solution.excluded.is_empty());
        assert!(!matches!(solution.outcome, Outcome::Converged | Outcome::Degraded(DegradedReason::FewerCells)));
    }
}

#[test]
fn a_pose_says_how_well_it_was_checked() {
    let solver = Solver::<f64>::new(&wide(), Tier::Paper).expect("scene");
    let mut readings = Photocurrents::of_pairs(pairs(solver.plan(), &Pose::HOME));
    let all = solver.solve(&readings, Start::Cold, &MotionPrior::AT_REST);
    for cell in [0, 2, 4] {
        readings.cells[cell] = Reading::Missing;
    }
    let three = solver.solve(&readings, Start::Near(&Pose::HOME), &MotionPrior::AT_REST);
    assert!(all.unnoticed_sigmas.is_finite() && all.verified() != Verified::Not, "{}", all.unnoticed_sigmas);
    assert_eq!((three.redundancy, three.verified()), (0, Verified::Not));

    // The claim: an error that moves the pose this far has χ² at its gate, and a larger one above it.
    let mut rng = generator();
    let bound = all.unnoticed_sigmas;
    for trial in 0..600 {
        let mut cells = pairs(solver.plan(), &Pose::HOME);
        let size = uniform(&mut rng, 1e-9, 30e-9);
        let turn = uniform(&mut rng, 0.0, std::f64::consts::TAU);
        cells[trial % 6].i_x1_a += size * turn.cos();
        cells[trial % 6].i_x2_a += size * turn.sin();
        let solution = solver.solve(&Photocurrents::of_pairs(cells), Start::Cold, &MotionPrior::AT_REST);
        if solution.outcome == Outcome::Converged {
            let shift = solution.estimate.and_then(|estimate| estimate.nees(&Pose::HOME)).expect("pose").sqrt();
            // The gate is for noise and error together; without noise the error alone may fill it.
            assert!(shift < bound * 1.1, "{shift} σ unnoticed, {bound} told");
        }
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
            let cells = pairs(reference.plan(), &pose).map(|pair| {
                let factor =
                    if gain < 0.1 { 1.0 + uniform(&mut rng, -0.02, 0.02) } else { uniform(&mut rng, 0.5, 2.0) };
                Pair { i_x1_a: factor * pair.i_x1_a, i_x2_a: factor * pair.i_x2_a }
            });
            let solution = solver.solve(&Photocurrents::of_pairs(cells), Start::Cold, &MotionPrior::AT_REST);
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
        let readings = Photocurrents::of_pairs(pairs(solver.plan(), &pose));
        let status = |cell| solver.plan().respond(cell, &pose).status;
        let used = careful.solve(&readings, Start::Near(&pose), &MotionPrior::AT_REST).cells_used;
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
