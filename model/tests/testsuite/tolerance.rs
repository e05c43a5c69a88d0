//! The exact tier keeps the tolerance it is given, and does not waste nodes on much less.

use crate::common::{KINDS, Kind, generator, pose, scene, uniform};
use rand_chacha::ChaCha8Rng;
use slitpose_model::{Plan, Pose, Profile, Scene, Tier};

/// Errors of the electrode currents relative to the total, ascending, against a tolerance a
/// hundred times tighter.
fn errors(kind: Kind, tolerance: f64, turn_rad: f64, count: usize) -> Vec<f64> {
    errors_of(kind, |_, _| (), tolerance, turn_rad, count)
}

/// The same for scenes that are changed.
fn errors_of(
    kind: Kind,
    change: impl Fn(&mut Scene, &mut ChaCha8Rng),
    tolerance: f64,
    turn_rad: f64,
    count: usize,
) -> Vec<f64> {
    let mut rng = generator();
    let mut errors = Vec::new();
    while errors.len() < count {
        let mut scene = scene(&mut rng, kind);
        change(&mut scene, &mut rng);
        let coarse = Plan::<f64>::compile(&scene, Tier::Exact { tolerance }).expect("scene");
        let fine = Plan::<f64>::compile(&scene, Tier::Exact { tolerance: 1e-2 * tolerance }).expect("scene");
        let pose = pose(&mut rng, &scene, 2.5e-3, turn_rad);
        let (a, b) = (coarse.photocurrents(0, &pose), fine.photocurrents(0, &pose));
        // Fainter light has fewer digits.
        if b.total_a() > 1e-290 {
            let error = |a: f64, b: f64| (a - b).abs() / fine.photocurrents(0, &pose).total_a();
            errors.push(error(a.i_x1_a, b.i_x1_a).max(error(a.i_x2_a, b.i_x2_a)));
        }
    }
    errors.sort_by(f64::total_cmp);
    errors
}

#[test]
fn the_tolerance_is_kept() {
    for kind in KINDS {
        for tolerance in [1e-3, 1e-6, 1e-9] {
            let count = if kind == Kind::Table { 150 } else { 1000 };
            let errors = errors(kind, tolerance, 0.4, count);
            let (median, worst) = (errors[count / 2], errors[count - 1]);
            println!("{kind:?} at {tolerance:e}: median {median:.1e}, worst {worst:.1e}");
            assert!(worst <= tolerance, "{kind:?} at {tolerance:e}: {worst:e}");
        }
    }
}

#[test]
fn the_tolerance_is_kept_across_the_horizon() {
    for kind in KINDS {
        // Turned by up to 90° about the emitter many beams leave at grazing angles.
        for tolerance in [1e-6, 1e-9] {
            let count = if kind == Kind::Table { 50 } else { 500 };
            let errors = errors(kind, tolerance, 1.6, count);
            let worst = errors[count - 1];
            println!("{kind:?} at {tolerance:e}: worst {worst:.1e}");
            assert!(worst <= tolerance, "{kind:?} at {tolerance:e}: {worst:e}");
        }
    }
}

/// Half angles from 0.5° to 30°, in and beside the spot.
fn narrow(scene: &mut Scene, rng: &mut ChaCha8Rng) {
    scene.cells[0].emitter.profile = Profile::Cosine { exponent: 10_f64.powf(uniform(rng, 0.7, 4.3)) };
}

#[test]
fn the_tolerance_is_kept_by_narrow_lobes() {
    for kind in [Kind::Thin, Kind::TiltedThick] {
        for tolerance in [1e-3, 1e-6, 1e-9] {
            let errors = errors_of(kind, narrow, tolerance, 0.4, 700);
            let worst = errors[errors.len() - 1];
            println!("{kind:?} at {tolerance:e}: worst {worst:.1e}");
            assert!(worst <= tolerance, "{kind:?} at {tolerance:e}: {worst:e}");
        }
    }
}

/// Work is counted, not timed: what a lobe of half angle 1° takes of the workspace of a head of six.
#[test]
fn a_lobe_narrower_than_its_spot_takes_few_values_of_its_profile() {
    let mut rng = generator();
    let mut scene = crate::common::wide();
    for cell in &mut scene.cells {
        cell.emitter.profile = Profile::from_half_angle(1_f64.to_radians());
    }
    let plan = Plan::<f64>::compile(&scene, Tier::Exact { tolerance: 1e-6 }).expect("scene");
    let poses: Vec<Pose> = (0..300).map(|_| crate::common::pose_in_box(&mut rng, 4.0, 15.0)).collect();
    let integrations = poses.iter().flat_map(|pose| (0..6).filter_map(|cell| plan.respond(cell, pose).integration));
    let evaluations: Vec<usize> = integrations.map(|integration| integration.evaluations).collect();
    let mean = evaluations.iter().sum::<usize>() as f64 / evaluations.len() as f64;
    println!("{} cells: {mean:.0} values on average", evaluations.len());
    // Without leaving out where the lobe has faded it is 1200, with nodes for the whole angle's slope 900.
    assert!(mean < 450.0, "{mean}");
}

/// Work is counted, not timed: what spots take where the light may end at the emitter's horizon.
#[test]
fn a_spot_across_the_horizon_takes_few_values_of_its_profile() {
    let mut rng = generator();
    let mut evaluations: Vec<usize> = Vec::new();
    while evaluations.len() < 5000 {
        let scene = scene(&mut rng, Kind::Thin);
        let plan = Plan::<f64>::compile(&scene, Tier::Exact { tolerance: 1e-6 }).expect("scene");
        let pose = pose(&mut rng, &scene, 2.5e-3, 1.6);
        evaluations.extend(plan.respond(0, &pose).integration.map(|integration| integration.evaluations));
    }
    evaluations.sort_unstable();
    let of_99 = evaluations[evaluations.len() * 99 / 100];
    let mean = evaluations.iter().sum::<usize>() as f64 / evaluations.len() as f64;
    println!("{mean:.1} values on average, 99 %: {of_99}");
    // Panels halved towards the horizon take 41 and 436.
    assert!(mean < 24.0 && of_99 < 120, "{mean} on average, 99 %: {of_99}");
}
