//! Poses at which a spot reaches its detector's end: there the derivatives of its current jump.

use glam::DVec3;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use slitpose_model::{
    CompiledScene, DegradedReason, Outcome, Pair, Photocurrents, Pose, Scalar, Scene, Solution, Solver, Status, Tier,
};

use crate::common::{base, cold, generator, near, noisy, normal, pairs, pose_in_box, uniform, unit, vector};

/// Converter noise of a head at its full rate, amperes.
const NOISE_A: f64 = 1.8e-9;

const POSES: usize = 4000;

fn tier() -> Tier {
    Tier::Exact { tolerance: 1e-6 }
}

/// A pose within some micrometres of one at which a spot touches an end of its detector, all cells lit.
fn beside_a_kink(plan: &CompiledScene<f64>, rng: &mut ChaCha8Rng) -> Pose {
    let clipped = |pose: &Pose| (0..6).filter(|&cell| plan.respond(cell, pose).status == Status::Clipped).count();
    let is_lit = |pose: &Pose| (0..6).all(|cell| plan.respond(cell, pose).i_o_a > 1e-7);
    loop {
        let [from, to] = [(); 2].map(|()| pose_in_box(rng, 3.5, 12.0));
        if !is_lit(&from) || !is_lit(&to) || clipped(&from) == clipped(&to) {
            continue;
        }
        let (dt, dr) = to.displacement_from(&from);
        let (mut low, mut high) = (0.0, 1.0);
        for _ in 0..40 {
            let middle = 0.5 * (low + high);
            let is_before = clipped(&from.perturbed(dt * middle, dr * middle)) == clipped(&from);
            *(if is_before { &mut low } else { &mut high }) = middle;
        }
        let touching = from.perturbed(dt * low, dr * low);
        if is_lit(&touching) {
            return touching.perturbed(vector(rng, 10e-6), vector(rng, 1e-3));
        }
    }
}

/// What solvers of both starts make of light at [`POSES`] such poses with so much noise, cold and then where
/// the tool is expected to 5 µm and 0.5 mrad.
fn solved<S: Scalar>(noise_a: f64) -> [Vec<(Pose, Solution)>; 2] {
    let mut scene = base();
    scene.noise.as_mut().expect("noise").adc_a = NOISE_A;
    let light = CompiledScene::<f64>::compile(&scene, Tier::Exact { tolerance: 1e-9 }).expect("scene");
    let solver = Solver::<S>::new(&scene, tier()).expect("scene");
    let mut rng = generator();
    let mut solved = [const { Vec::new() }; 2];
    for _ in 0..POSES {
        let pose = beside_a_kink(&light, &mut rng);
        let readings = noisy(&pairs(&light, &pose), noise_a, &mut rng);
        let prior = pose.perturbed(vector(&mut rng, 5e-6), vector(&mut rng, 5e-4));
        solved[0].push((pose, cold(&solver, &readings.rounded()).widened()));
        solved[1].push((pose, near(&solver, &readings.rounded(), &prior).widened()));
    }
    solved
}

fn nees((pose, solution): &(Pose, Solution)) -> f64 {
    solution.estimate.and_then(|estimate| estimate.nees(pose)).expect("pose and covariance")
}

/// Both starts: all poses are found, in few evaluations, and few of them are off.
#[test]
fn a_minimum_on_a_kink_is_found_in_both_precisions() {
    let both = [solved::<f64>(NOISE_A), solved::<f32>(NOISE_A)];
    for (found, most) in both.into_iter().flat_map(|starts| starts.into_iter().zip([8.0, 3.0])) {
        for (pose, solution) in &found {
            assert_eq!(solution.outcome, Outcome::Converged, "{pose:?}");
        }
        let mean = found.iter().map(|(_, solution)| solution.evaluations).sum::<usize>() as f64 / POSES as f64;
        let off = found.iter().filter(|found| nees(found) > 50.0).count();
        println!("{mean:.2} evaluations, {off} of {POSES} beyond 50");
        assert!(mean < most, "{mean} evaluations");
        // Where noise puts a pose beyond the kink, a cut spot says where it is ten times better than one that is
        // whole: of 100 000 such poses 0.5 % are told so, in both number types and from both starts.
        assert!(off < POSES / 100, "{off}");
    }
}

#[test]
fn derivatives_are_not_kept_across_a_kink() {
    let [cold, warm] = solved::<f64>(0.0);
    for found in [cold, warm] {
        // Without noise a pose is off by what the refinement leaves, a fiftieth of σ, or lies in a minimum of its
        // own beyond the kink: 5 of 200 000.
        let off = found.iter().filter(|found| nees(found) > 30.0).count();
        assert!(off <= 1, "{off} of {POSES}");
    }
}

/// A head of seven to ten cells on one side of the tool, whose detectors are so short that many spots reach
/// an end.
fn crowded(rng: &mut ChaCha8Rng) -> Scene {
    let mut scene = base();
    let like = scene.cells[0].clone();
    scene.cells.clear();
    let (length_m, width_m, slit_m) =
        (uniform(rng, 5e-3, 8e-3), uniform(rng, 0.8e-3, 1.2e-3), uniform(rng, 0.3e-3, 0.6e-3));
    for _ in 0..rng.random_range(7..=10) {
        let mut cell = like.clone();
        let outward = (DVec3::Z + vector(rng, 0.6)).normalize();
        let emitter = vector(rng, 6e-3);
        cell.emitter.position_tool_m = emitter;
        cell.emitter.axis_tool = outward;
        let detector = &mut cell.detector;
        detector.centre_base_m = emitter + outward * uniform(rng, 26e-3, 32e-3);
        detector.normal_base = -outward;
        detector.x_axis_base = outward.cross(unit(rng)).normalize();
        (detector.length_m, detector.width_m) = (length_m, width_m);
        (cell.slit.distance_m, cell.slit.width_m) = (uniform(rng, 14e-3, 18e-3), slit_m);
        scene.cells.push(cell).expect("ten of sixteen");
    }
    scene
}

/// Poses with two clipped spots and six lit cells or more, of 40 such heads that have mirror images and of those that have
/// none. Beyond a kink lie minima that fit as well but for noise, and all places for images have to be looked at.
#[test]
fn poses_among_many_clipped_spots_are_found() {
    let mut rng = generator();
    for noise_a in [0.0, 0.6e-9] {
        let (mut tried, mut none, mut off, mut with_images) = (0, 0, 0, 0);
        for _ in 0..40 {
            let scene = crowded(&mut rng);
            let plan = CompiledScene::<f64>::compile(&scene, tier()).expect("scene");
            let solver = Solver::<f64>::new(&scene, tier()).expect("scene");
            for _ in 0..200 {
                let pose = pose_in_box(&mut rng, 3.0, 20.0);
                let lit = (0..scene.cells.len()).map(|cell| plan.respond(cell, &pose)).filter(|seen| seen.i_o_a > 1e-7);
                let (lit, clipped) = lit.fold((0, 0), |(lit, clipped), seen| {
                    (lit + 1, clipped + usize::from(seen.status == Status::Clipped))
                });
                if lit < 6 || clipped < 2 {
                    continue;
                }
                let mut noisy = |current: f64| {
                    let normal = normal(&mut rng);
                    if current > 0.0 { current + noise_a * normal } else { 0.0 }
                };
                let readings = Photocurrents::of_pairs((0..scene.cells.len()).map(|cell| {
                    let Pair { i_x1_a, i_x2_a } = plan.photocurrents(cell, &pose);
                    Pair { i_x1_a: noisy(i_x1_a), i_x2_a: noisy(i_x2_a) }
                }));
                let solution = cold(&solver, &readings);
                tried += 1;
                with_images += usize::from(solver.has_mirror_images());
                match solution.estimate.filter(|_| solution.outcome != Outcome::Degraded(DegradedReason::Misfit)) {
                    Some(estimate) => off += usize::from(estimate.nees(&pose).expect("covariance") > 54.0),
                    None => none += 1,
                }
            }
        }
        println!(
            "noise {noise_a} A: {off} off and {none} without a pose of {tried}, {with_images} of heads with images"
        );
        assert!(with_images > tried / 4 && with_images < tried * 3 / 4, "{with_images} of {tried}");
        // Of 11 445 without noise 54 had no pose. A search that looked for images only as long as for a pose left
        // 5 257 without, and 10 off, in a minimum of their own whose χ² passes.
        assert!(off <= tried / 1000 && none < tried / 50, "{off} and {none} of {tried}");
    }
}
