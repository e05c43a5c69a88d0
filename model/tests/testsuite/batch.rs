//! Many poses at once against the same one by one, bit for bit.

use glam::{DQuat, DVec2, DVec3};
use rand::{RngExt, SeedableRng};
use slitpose_model::{
    Batch, CompiledScene, MotionPrior, Outcome, Pair, Photocurrents, Pose, Profile, Reading, Scene, Solution, Solver,
    Start, Starts, Tier, Tracker, Twist, Width,
};
use std::num::NonZero;
use std::sync::atomic::{AtomicUsize, Ordering};

use crate::common::{SEED, generator, seen, six_cells, uniform, vector, wide};

const EXACT: Tier = Tier::Exact { tolerance: 1e-6 };

/// Poses of the smoke test, for each width and start.
const FEW: usize = 3_000;

/// A frame of `scene` with the noise of a front end; one in fifty has something else: a dark cell, an outlier, another
/// light, a value that is no number.
fn frame(solver: &Solver<f64>, rng: &mut rand_chacha::ChaCha8Rng, reach: f64) -> (Photocurrents, Pose) {
    let pose = Pose::from_vectors(vector(rng, 4e-3 * reach), vector(rng, 0.26 * reach));
    let cells = solver.plan().cell_count();
    let mut readings = seen(solver.plan(), &pose);
    for reading in &mut readings.cells {
        if let Reading::Light(pair) = reading {
            for current in [&mut pair.i_x1_a, &mut pair.i_x2_a] {
                *current += uniform(rng, -1e-9, 1e-9);
            }
        }
    }
    let cell = rng.random_range(0..cells);
    match rng.random_range(0..250) {
        0 => readings.cells[cell] = Reading::Light(Pair::default()),
        1 => readings.cells[cell] = Reading::Missing,
        2 => readings.cells[cell] = Reading::Light(Pair { i_x1_a: f64::NAN, i_x2_a: 1e-6 }),
        3 => readings.cells[cell] = Reading::Light(Pair { i_x1_a: 3e-6, i_x2_a: 1e-6 }),
        4 => readings.cells[cell] = Reading::Light(Pair { i_x1_a: -1e-6, i_x2_a: 3e-6 }),
        _ => {}
    }
    (readings, pose.perturbed(vector(rng, 3e-6), vector(rng, 3e-4)))
}

fn bits(solution: &Solution) -> Vec<u64> {
    let mut bits = vec![
        solution.chi2.to_bits(),
        solution.unnoticed_sigmas.to_bits(),
        solution.condition().map_or(0, f64::to_bits),
        solution.iterations as u64,
        solution.evaluations as u64,
        solution.redundancy as u64,
        u64::from(solution.cells_used.bits()),
        u64::from(solution.excluded.bits()),
    ];
    if let Some(estimate) = &solution.estimate {
        let Pose { rotation, translation_m } = estimate.pose;
        let numbers = rotation.to_array().into_iter().chain(translation_m.to_array());
        bits.extend(numbers.chain(estimate.covariance.into_iter().flatten()).map(f64::to_bits));
    }
    bits
}

/// Frames that are compared at a time.
const CHUNK: usize = 1_000;

/// Compares `count` frames of `scene` in every width that the processor has, on all cores.
fn compare(scene: &Scene, tier: Tier, count: usize, reach: f64) {
    compare_solutions(&Solver::new(scene, tier).expect("a possible scene"), &MotionPrior::AT_REST, count, reach);
}

/// [`compare`] of a tool that moves.
fn compare_solutions(solver: &Solver<f64>, motion: &MotionPrior, count: usize, reach: f64) {
    let next = &AtomicUsize::new(0);
    std::thread::scope(|scope| {
        for _ in 0..std::thread::available_parallelism().map_or(1, NonZero::get) {
            scope.spawn(move || {
                loop {
                    let first = next.fetch_add(CHUNK, Ordering::Relaxed);
                    if first >= count {
                        return;
                    }
                    compare_chunk(solver, motion, first, CHUNK.min(count - first), reach);
                }
            });
        }
    });
}

/// Compares `count` frames, of which the first is number `first`.
fn compare_chunk(solver: &Solver<f64>, motion: &MotionPrior, first: usize, count: usize, reach: f64) {
    let seed = SEED + first as u64;
    let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(seed);
    let (frames, starts): (Vec<_>, Vec<_>) = (0..count).map(|_| frame(solver, &mut rng, reach)).unzip();
    for warm in [false, true] {
        let alone: Vec<Solution> = frames
            .iter()
            .zip(&starts)
            .map(|(readings, pose)| {
                let start = if warm { Start::Near(pose) } else { Start::Cold };
                solver.solve(readings, start, motion)
            })
            .collect();
        for width in Width::all() {
            let mut next = 0;
            let starts = if warm { Starts::Near(&starts) } else { Starts::Cold };
            Batch::with_width(solver, width).solve(&frames, starts, motion, |index, solution| {
                assert_eq!(index, next, "out of order");
                next += 1;
                let expected = &alone[index];
                assert!(
                    solution.outcome == expected.outcome && bits(&solution) == bits(expected),
                    "seed {seed}, frame {index}, {width:?}, warm {warm}:\n{solution:?}\n{expected:?}",
                );
            });
            assert_eq!(next, frames.len(), "{width:?}");
            let mut next = 0;
            Batch::with_width(solver, width).conditions(&alone, |index, condition| {
                assert_eq!(index, next, "out of order");
                next += 1;
                let [at_once, alone] = [condition, alone[index].condition()].map(|one| one.map(f64::to_bits));
                assert_eq!(at_once, alone, "seed {seed}, frame {index}, {width:?}");
            });
            assert_eq!(next, alone.len(), "{width:?}");
        }
    }
}

fn thick() -> Scene {
    let mut scene = wide();
    scene.cells.iter_mut().for_each(|cell| cell.slit.thickness_m = 0.15e-3);
    scene
}

#[test]
fn many_frames_at_once_have_the_bits_of_each_alone() {
    compare(&wide(), Tier::Paper, FEW, 1.0);
}

#[test]
fn frames_at_the_ends_of_detectors_have_the_bits_of_each_alone() {
    compare(&wide(), Tier::Paper, FEW / 3, 1.6);
    compare(&thick(), Tier::Paper, FEW / 3, 1.3);
}

#[test]
fn many_frames_at_once_have_the_bits_of_each_alone_in_the_exact_tier() {
    compare(&wide(), EXACT, FEW, 1.0);
    compare(&wide(), EXACT, FEW / 3, 1.6);
    compare(&thick(), EXACT, FEW / 3, 1.3);
    compare(&wide(), Tier::Exact { tolerance: 1e-11 }, FEW / 3, 1.0);
}

#[test]
fn many_frames_of_unknown_light_level_have_the_bits_of_each_alone() {
    let mut scene = wide();
    scene.uncertainty.light_level_relative = 0.1;
    compare(&scene, Tier::Paper, FEW / 3, 1.0);
    compare(&scene, EXACT, FEW / 3, 1.0);
    compare(&scene, EXACT, FEW / 3, 1.6);
}

/// A head of `count` cells of which no two are alike; masks of two thicknesses by turns.
fn unlike(count: usize, thicknesses_m: [f64; 2]) -> Scene {
    let mut scene = wide();
    let ring = scene.cells.clone();
    let cells = (0..count).map(|k| {
        let mut cell = ring[k % 6].clone();
        let step = k as f64;
        let turn = DQuat::from_rotation_z(0.35 * (k / 6) as f64);
        let (detector, slit, emitter) = (&mut cell.detector, &mut cell.slit, &mut cell.emitter);
        for vector in [
            &mut detector.centre_base_m,
            &mut detector.x_axis_base,
            &mut detector.normal_base,
            &mut emitter.position_tool_m,
            &mut emitter.axis_tool,
        ] {
            *vector = turn * *vector;
        }
        detector.length_m += 1e-4 * step;
        detector.width_m += 2e-5 * step;
        detector.responsivity_a_per_w += 0.01 * step;
        detector.dark_current_a = 1e-9 * step;
        slit.distance_m += 2e-5 * step;
        slit.width_m += 1e-5 * step;
        slit.offset_m = DVec2::new(1e-5, -2e-5) * step;
        slit.thickness_m = thicknesses_m[k % 2];
        emitter.radiant_intensity_w_per_sr += 5e-5 * step;
        emitter.profile = Profile::Cosine { exponent: 1.1 + 0.1 * step };
        cell
    });
    scene.cells = cells.collect();
    scene
}

#[test]
fn heads_of_unlike_cells_have_the_bits_of_each_frame_alone() {
    for tier in [Tier::Paper, EXACT] {
        for count in [6, 7, 16] {
            for thicknesses_m in [[0.0; 2], [0.1e-3, 0.0]] {
                compare(&unlike(count, thicknesses_m), tier, 200, 1.0);
            }
        }
    }
}

#[test]
fn frames_of_heads_that_have_no_lanes_are_solved_one_by_one() {
    let mut turned = wide();
    turned.cells[0].slit.tilt_rad.x = 0.01;
    compare(&turned, EXACT, 40, 1.0);
    let mut narrow = wide();
    narrow.cells[5].emitter.profile = Profile::Cosine { exponent: 45.0 };
    let mut displaced = wide();
    displaced.uncertainty.position_m = 20e-6;
    let mut five = wide();
    five.cells.truncate(5);
    // Poses of a ring whose slits are all rolled alike, but for a little, have mirror images near them.
    let near_mirror = six_cells(5.0, 0.6, [0.06, -0.06]);
    for scene in [&narrow, &displaced, &five, &near_mirror] {
        for tier in [Tier::Paper, EXACT] {
            compare(scene, tier, 40, 1.0);
        }
    }
    let moving = MotionPrior {
        twist: Twist { linear_m_per_s: DVec3::new(0.3, -0.2, 0.1), angular_rad_per_s: DVec3::new(2.0, 5.0, -3.0) },
        linear_sigma_m_per_s: 0.01,
        angular_sigma_rad_per_s: 0.1,
    };
    for tier in [Tier::Paper, EXACT] {
        let solver = Solver::new(&wide(), tier).expect("a possible scene");
        compare_solutions(&solver, &moving, 40, 1.0);
        compare_solutions(&solver.clone().with_max_steps(2), &MotionPrior::AT_REST, 40, 1.0);
        let offsets_s: Vec<f64> = (0..6).map(|cell| 34e-6 * f64::from(cell)).collect();
        compare_solutions(&solver.with_exposures(&offsets_s), &moving, 40, 1.0);
    }
}

#[test]
fn many_poses_at_once_have_the_light_and_derivatives_of_each_alone() {
    let mut turned = wide();
    turned.cells[3].slit.tilt_rad.x = 0.01;
    let mut rng = generator();
    let unlike = unlike(6, [0.1e-3, 0.0]);
    for (scene, tier) in [
        (wide(), Tier::Paper),
        (thick(), Tier::Paper),
        (unlike.clone(), Tier::Paper),
        (wide(), EXACT),
        (thick(), EXACT),
        (unlike, EXACT),
        (turned, EXACT),
    ] {
        let plan = CompiledScene::<f64>::compile(&scene, tier).expect("a possible scene");
        // From poses where all cells are lit to some where emitters are behind their slits.
        let poses: Vec<Pose> = (0..500)
            .map(|i| {
                Pose::from_vectors(
                    vector(&mut rng, 2e-3 + 4e-5 * f64::from(i)),
                    vector(&mut rng, 0.2 + 4e-3 * f64::from(i)),
                )
            })
            .collect();
        for width in Width::all() {
            let mut expected = (0..poses.len()).flat_map(|pose| (0..6).map(move |cell| (pose, cell)));
            plan.linearise_many(&poses, width, |pose, cell, (status, pair, jacobian)| {
                assert_eq!(expected.next(), Some((pose, cell)), "out of order");
                let alone = plan.linearise(cell, &poses[pose]);
                let bits = |pair: Pair<f64>, jacobian: [[f64; 6]; 2]| {
                    let numbers = [pair.i_x1_a, pair.i_x2_a].into_iter().chain(jacobian.into_iter().flatten());
                    numbers.map(f64::to_bits).collect::<Vec<_>>()
                };
                assert_eq!(status, alone.0, "pose {pose}, cell {cell}, {width:?}");
                assert_eq!(bits(pair, jacobian), bits(alone.1, alone.2), "pose {pose}, cell {cell}, {width:?}");
            });
            assert_eq!(expected.next(), None);
        }
    }
}

/// `cargo test --release -p slitpose-model --features batch --test testsuite a_million -- --ignored`, also without
/// `--release`.
#[test]
#[ignore = "takes minutes"]
fn a_million_frames_at_once_have_the_bits_of_each_alone() {
    compare(&wide(), Tier::Paper, 1_000_000, 1.1);
}

#[test]
#[ignore = "takes minutes"]
fn a_million_frames_at_once_have_the_bits_of_each_alone_in_the_exact_tier() {
    compare(&wide(), EXACT, 1_000_000, 1.1);
}

/// Callers move solvers by value, which a build without optimisation copies. With the cells of its plan in place a solver
/// has 128 kB, and the daemon's judge of a head took more than the 2 MiB that a thread has by default.
#[test]
fn solvers_and_trackers_pass_through_small_stacks() {
    let whole_chain = || {
        for tier in [Tier::Paper, Tier::Exact { tolerance: 1e-6 }] {
            let solver = Solver::<f64>::new(&wide(), tier).expect("scene").with_exposures(&[0.0; 6]).with_max_steps(9);
            let pose = Pose::from_vectors(DVec3::ZERO, DVec3::ZERO);
            let seen = seen(solver.plan(), &pose);
            let mut tracker = Tracker::new(solver.clone(), 250e-6).with_filter(1e-3);
            for frame in 0..3 {
                assert!(matches!(tracker.track(frame, &seen).solution.outcome, Outcome::Converged));
            }
        }
    };
    let thread = std::thread::Builder::new().stack_size(384 << 10).spawn(whole_chain);
    thread.expect("a thread").join().expect("it has stack enough");
}
