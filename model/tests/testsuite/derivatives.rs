//! Analytic derivatives against central differences.

use crate::common::{KINDS, Kind, generator, pose, scene, vector};
use glam::DVec3;
use rand_chacha::ChaCha8Rng;
use slitpose_model::{CompiledScene, Pose, Scene, Tier};

/// Metres and radians (arms of some 30 mm): the light moves by micrometres, 1e-3 of the spot.
const STEPS: [f64; 2] = [1e-6, 5e-5];

/// Difference quotient of fourth order: error h⁴·|f⁽⁵⁾|/30 plus rounding ε·|f|/h.
fn numeric(plan: &CompiledScene<f64>, pose: &Pose, axis: usize, h: f64) -> [f64; 2] {
    let at = |factor: f64| {
        let mut step = [0.0; 6];
        step[axis] = factor * h;
        let moved = pose.perturbed(DVec3::from_slice(&step[..3]), DVec3::from_slice(&step[3..]));
        let pair = plan.photocurrents(0, &moved);
        [pair.i_x1_a, pair.i_x2_a]
    };
    let (p2, p1, m1, m2) = (at(2.0), at(1.0), at(-1.0), at(-2.0));
    [0, 1].map(|i| (8.0 * (p1[i] - m1[i]) - (p2[i] - m2[i])) / (12.0 * h))
}

/// Compares the derivatives of the first cell at `count` poses with light, of scenes and poses that `draw` gives.
pub fn check(
    what: &str,
    mut draw: impl FnMut(&mut ChaCha8Rng) -> (Scene, Pose),
    tier: Tier,
    count: usize,
    tolerance: f64,
) {
    let mut rng = generator();
    let mut worst: f64 = 0.0;
    let (mut checked, mut at_kinks) = (0, 0);
    while checked < count {
        let (scene, pose) = draw(&mut rng);
        let plan = CompiledScene::<f64>::compile(&scene, tier).expect("scene");
        let (status, pair, jacobian) = plan.linearise(0, &pose);
        if !status.has_spot() || pair.total_a() < 1e-8 {
            continue;
        }
        let same = plan.photocurrents(0, &pose);
        assert!((pair.i_x1_a - same.i_x1_a).abs() <= 1e-9 * same.total_a(), "{what}: {pair:?} {same:?}");
        checked += 1;
        for axis in 0..6 {
            let h = STEPS[axis / 3];
            let (coarse, fine) = (numeric(&plan, &pose, axis, h), numeric(&plan, &pose, axis, 0.5 * h));
            // A natural size of the derivative: the current per spot width, per spot angle.
            let scale = pair.total_a() / if axis < 3 { 1e-3 } else { 0.1 };
            for electrode in 0..2 {
                // Where an edge of the spot passes a corner, the currents have a kink, and
                // difference quotients of different steps disagree: nothing to compare with.
                if (coarse[electrode] - fine[electrode]).abs() > 0.5 * tolerance * scale {
                    at_kinks += 1;
                    continue;
                }
                let (analytic, numeric) = (jacobian[electrode][axis], fine[electrode]);
                let error = (analytic - numeric).abs() / scale;
                worst = worst.max(error);
                assert!(
                    error <= tolerance,
                    "{what} {tier:?} axis {axis}: analytic {analytic:e}, numeric {numeric:e}, error {error:.1e}"
                );
            }
        }
    }
    let compared = 12 * count - at_kinks;
    assert!(compared >= 11 * count, "{what} {tier:?}: only {compared} of {} derivatives compared", 12 * count);
    println!("{what} {tier:?}: {checked} poses, {compared} derivatives, worst {worst:.1e}");
}

/// [`check`] of ordinary cells, where values with and without derivatives are the same to the last bit.
fn check_kind(kind: Kind, tier: Tier, count: usize, turn_rad: f64, tolerance: f64) {
    let draw = |rng: &mut ChaCha8Rng| {
        let scene = scene(rng, kind);
        let pose = pose(rng, &scene, 2.5e-3, turn_rad);
        let plan = CompiledScene::<f64>::compile(&scene, tier).expect("scene");
        assert_eq!(plan.linearise(0, &pose).1, plan.photocurrents(0, &pose), "{kind:?} {tier:?}");
        (scene, pose)
    };
    check(&format!("{kind:?}"), draw, tier, count, tolerance);
}

#[test]
fn paper_tier() {
    for kind in KINDS {
        // Step error (2e-3)⁴ of a spot width.
        check_kind(kind, Tier::Paper, 1000, 0.4, 2e-7);
    }
}

#[test]
fn exact_tier() {
    for kind in KINDS {
        check_kind(kind, Tier::Exact { tolerance: 1e-12 }, if kind == Kind::Table { 100 } else { 1000 }, 0.4, 2e-7);
    }
}

#[test]
fn exact_tier_across_the_horizon() {
    // The integrand vanishes like tⁿ at the horizon: its derivative is rough there, and so is the
    // difference quotient.
    for kind in [Kind::Thin, Kind::TiltedThick] {
        check_kind(kind, Tier::Exact { tolerance: 1e-11 }, 300, 1.5, 1e-4);
    }
}

#[test]
fn paper_tier_of_slits_that_are_hardly_tilted() {
    // 0.01° to 0.1°, where the definition of the beam's axis changes.
    let draw = |rng: &mut ChaCha8Rng| {
        let mut scene = scene(rng, Kind::Thin);
        scene.cells[0].slit.tilt_rad = vector(rng, 1e-3);
        let pose = pose(rng, &scene, 1.5e-3, 0.3);
        (scene, pose)
    };
    check("hardly tilted", draw, Tier::Paper, 200, 2e-7);
}
