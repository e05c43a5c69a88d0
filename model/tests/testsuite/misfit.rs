//! Heads that are not as their scene says: a pose with the errors that its misfit shows, at a bounded cost.

use crate::common::{generator, pose_in_box, wide};
use glam::DVec3;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use slitpose_model::{
    DegradedReason, MotionPrior, Outcome, Photocurrents, Plan, Pose, Scene, Solver, Start, Tier, Tracker,
};

const TIER: Tier = Tier::Exact { tolerance: 1e-6 };

/// Evaluations of one cold solve: its budget, a refinement that has begun, and a rough one.
const MOST_EVALUATIONS: usize = 640;

/// As in `track`.
const MOST_OF_A_FRAME: usize = 24 + 64 + 12;
const MEAN_OF_A_FRAME: f64 = 24.0 + 2.0 + 3.0;

fn normal(rng: &mut ChaCha8Rng) -> f64 {
    StandardNormal.sample(rng)
}

/// The scene as the parts of a workshop make it: places off by 0.06 mm, emitters brighter or dimmer by 30 %.
fn assembled(rng: &mut ChaCha8Rng) -> Scene {
    let mut scene = wide();
    for cell in &mut scene.cells {
        let mut place = || DVec3::new(normal(rng), normal(rng), normal(rng)) * 0.06e-3;
        cell.detector.centre_base_m += place();
        cell.emitter.position_tool_m += place();
        cell.slit.offset_m.x += place().x;
        cell.emitter.radiant_intensity_w_per_sr *= (0.3 * normal(rng)).exp();
    }
    scene
}

fn readings(plan: &Plan<f64>, pose: &Pose) -> Photocurrents {
    Photocurrents::of_pairs((0..plan.cell_count()).map(|cell| plan.photocurrents(cell, pose)))
}

#[test]
fn a_misfit_has_a_pose_that_owns_up_to_it() {
    let solver = Solver::<f64>::new(&wide(), TIER).expect("scene");
    let mut rng = generator();
    let (mut squares, mut count, mut most, mut worst_m) = (0.0, 0, 0, 0.0_f64);
    for _ in 0..40 {
        let plan = Plan::<f64>::compile(&assembled(&mut rng), TIER).expect("scene");
        for _ in 0..10 {
            let truth = pose_in_box(&mut rng, 3.0, 12.0);
            let solution = solver.solve(&readings(&plan, &truth), Start::Cold, &MotionPrior::AT_REST);
            let outcome = solution.outcome;
            // One of six cells may be off by so much more than the others that it passes for an outlier.
            assert!(
                matches!(outcome, Outcome::Degraded(DegradedReason::Misfit | DegradedReason::CellExcluded)),
                "{outcome:?} at {truth:?}"
            );
            most = most.max(solution.evaluations);
            let estimate = solution.estimate.expect("a pose");
            let (dt, dr) = estimate.pose.displacement_from(&truth);
            let sigma = estimate.sigma();
            let errors = [dt.x, dt.y, dt.z, dr.x, dr.y, dr.z].into_iter().zip(sigma);
            squares += errors.map(|(error, sigma)| (error / sigma).powi(2)).sum::<f64>() / 6.0;
            worst_m = worst_m.max(dt.length());
            count += 1;
        }
    }
    let rms = (squares / f64::from(count)).sqrt();
    println!("{count} poses, error/sigma {rms:.2}, {:.2} mm at most, {most} evaluations at most", worst_m * 1e3);
    // Six degrees of freedom tell how large errors are to a third; and coarse weights are one guess for all heads.
    assert!((0.4..2.0).contains(&rms), "{rms}");
    assert!(most <= MOST_EVALUATIONS, "{most}");
}

#[test]
fn a_misfit_is_tracked_within_the_budget_of_a_frame() {
    let mut rng = generator();
    for head in 0..10 {
        let plan = Plan::<f64>::compile(&assembled(&mut rng), TIER).expect("scene");
        let mut tracker = Tracker::new(Solver::<f64>::new(&wide(), TIER).expect("scene"), 250e-6);
        let (mut without, mut evaluations, mut largest) = (0, Vec::new(), 0.0_f64);
        for frame in 0..2000 {
            let phase = 2.0 * std::f64::consts::PI * f64::from(frame) * 250e-6;
            let shift = DVec3::new(phase.sin(), (2.0 * phase).sin(), phase.cos()) * 2e-3;
            let truth = Pose::from_vectors(shift, DVec3::new(phase.cos(), 0.0, phase.sin()) * 0.1);
            let tracked = tracker.track(frame as u64, &readings(&plan, &truth));
            evaluations.push(tracked.solution.evaluations);
            match tracked.solution.estimate {
                Some(estimate) => {
                    largest = largest.max((estimate.pose.translation_m - truth.translation_m).length());
                }
                None => without += 1,
            }
        }
        // The first search of all is that of a cold solve.
        let most = evaluations[1..].iter().max().expect("frames");
        let mean = evaluations[1..].iter().sum::<usize>() as f64 / 1999.0;
        println!(
            "head {head}: {without} without a pose, {:.2} mm, {mean:.1} evaluations, {most} at most",
            largest * 1e3
        );
        assert!(*most <= MOST_OF_A_FRAME && mean <= MEAN_OF_A_FRAME);
        // A first search takes 600 evaluations more than its first frame has, 22 a frame; parts off by 0.06 mm and gains by
        // 30 % move a pose by half a millimetre, the worst of many by three times that.
        assert!(without < 40 && largest < 2e-3);
    }
}
