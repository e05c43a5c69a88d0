//! Each kind of noise, and each thing that calibration has left open, where it dominates: currents are
//! drawn as physics makes them, and the solver must know their scatter.
//!
//! Shot noise is counted in electrons, Johnson noise in the energy of a capacitor: neither uses the
//! formulas of the solver's weights.

use glam::DVec3;
use rand_chacha::ChaCha8Rng;
use slitpose_model::{
    CompiledScene, MotionPrior, Noise, Outcome, Pair, Photocurrents, Pose, Scene, Solver, Start, Tier, Uncertainty,
};

use crate::common::{cold, errors_in_sigmas, generator, normal, pose_in_box, seen, wide};

/// CODATA 2018, exact: coulombs and joules per kelvin.
const ELECTRON_C: f64 = 1.602_176_634e-19;
const BOLTZMANN_J_PER_K: f64 = 1.380_649e-23;

/// Converter noise beside that under study: it keeps all directions finite.
const SOME_A: f64 = 2e-11;

const TRIALS: usize = 2000;

/// The default head without noise, dark current or uncertainty.
fn quiet() -> Scene {
    let mut scene = wide();
    scene.noise =
        Some(Noise { shot_bandwidth_hz: 0.0, johnson_bandwidth_hz: 0.0, temperature_k: 300.0, adc_a: SOME_A });
    scene.uncertainty = Uncertainty::default();
    for cell in &mut scene.cells {
        cell.detector.dark_current_a = 0.0;
        cell.detector.interelectrode_ohm = None;
    }
    scene
}

/// What a study finds: means of χ² and of NEES, both 6 if the scatter is known, and per axis the root
/// mean squares of error/σ and of σ.
#[derive(Debug)]
struct Found {
    chi2: f64,
    nees: f64,
    errors: [f64; 6],
    sigmas: [f64; 6],
}

/// Solves for random poses at which all cells are lit; `measure` disturbs what cell `k` delivers at a pose.
fn study(scene: &Scene, measure: impl Fn(&CompiledScene<f64>, usize, &Pose, &mut ChaCha8Rng) -> Pair<f64>) -> Found {
    let solver = Solver::<f64>::new(scene, Tier::Paper).expect("scene");
    let mut rng = generator();
    let mut found = Found { chi2: 0.0, nees: 0.0, errors: [0.0; 6], sigmas: [0.0; 6] };
    for _ in 0..TRIALS {
        let truth = pose_in_box(&mut rng, 2.5, 10.0);
        let pairs = (0..6).map(|cell| {
            let pair = measure(solver.plan(), cell, &truth, &mut rng);
            Pair { i_x1_a: pair.i_x1_a + SOME_A * normal(&mut rng), i_x2_a: pair.i_x2_a + SOME_A * normal(&mut rng) }
        });
        let solution = cold(&solver, &Photocurrents::of_pairs(pairs));
        assert_eq!(solution.outcome, Outcome::Converged, "{truth:?}");
        let estimate = solution.estimate.expect("pose");
        found.chi2 += solution.chi2 / TRIALS as f64;
        found.nees += estimate.nees(&truth).expect("covariance") / TRIALS as f64;
        for (axis, error) in errors_in_sigmas(&estimate, &truth).into_iter().enumerate() {
            let sigma = estimate.sigma()[axis];
            found.errors[axis] += error.powi(2) / TRIALS as f64;
            found.sigmas[axis] += sigma * sigma / TRIALS as f64;
        }
    }
    found.errors = found.errors.map(f64::sqrt);
    found.sigmas = found.sigmas.map(f64::sqrt);
    found
}

/// The means of 2000 χ² of six degrees of freedom, to 4.5 of their σ.
fn assert_known(what: &str, found: &Found) {
    println!("{what}: {found:?}");
    let scatter = 4.5 * (12.0 / TRIALS as f64).sqrt();
    assert!((found.chi2 - 6.0).abs() < scatter && (found.nees - 6.0).abs() < scatter, "{what}: {found:?}");
}

#[test]
fn shot_noise_is_that_of_counted_electrons() {
    let mut scene = quiet();
    let bandwidth_hz = 1e6;
    scene.noise.as_mut().expect("noise").shot_bandwidth_hz = bandwidth_hz;
    // A mean over this time passes as much white noise as an ideal low-pass of that bandwidth.
    let time_s = 0.5 / bandwidth_hz;
    let found = study(&scene, |plan, cell, pose, rng| {
        let pair = plan.photocurrents(cell, pose);
        let electrons = pair.total_a() * time_s / ELECTRON_C;
        // All of them start at one place, and divide alike.
        let share = 1.0 + normal(rng) / electrons.sqrt();
        Pair { i_x1_a: pair.i_x1_a * share, i_x2_a: pair.i_x2_a * share }
    });
    assert_known("light", &found);
}

#[test]
fn dark_current_makes_shot_noise_all_over_the_detector() {
    let mut scene = quiet();
    let (bandwidth_hz, dark_a) = (1e6, 20e-6);
    // Lit and dark sample have it both: the bandwidth that counts both is the other.
    scene.noise.as_mut().expect("noise").johnson_bandwidth_hz = 2.0 * bandwidth_hz;
    scene.cells.iter_mut().for_each(|cell| cell.detector.dark_current_a = dark_a);
    let electrons = dark_a * 0.5 / bandwidth_hz / ELECTRON_C;
    let found = study(&scene, |plan, cell, pose, rng| {
        let mut pair = plan.photocurrents(cell, pose);
        for sign in [1.0, -1.0] {
            // The number of electrons, and where they start: evenly between the electrodes.
            let number = normal(rng) / electrons.sqrt() * dark_a;
            let place = normal(rng) / (12.0 * electrons).sqrt() * dark_a;
            pair.i_x1_a += sign * (0.5 * number - place);
            pair.i_x2_a += sign * (0.5 * number + place);
        }
        pair
    });
    assert_known("dark current", &found);
}

#[test]
fn johnson_noise_is_that_of_the_energy_of_a_capacitor() {
    let mut scene = quiet();
    let (bandwidth_hz, ohm, temperature_k) = (1e6, 50e3, 350.0);
    let noise = scene.noise.as_mut().expect("noise");
    (noise.johnson_bandwidth_hz, noise.temperature_k) = (bandwidth_hz, temperature_k);
    scene.cells.iter_mut().for_each(|cell| cell.detector.interelectrode_ohm = Some(ohm));
    // A resistor and a capacitor pass white noise as an ideal low-pass of 1/(4RC) does; the capacitor
    // holds ½kT on average.
    let farad = 0.25 / (ohm * bandwidth_hz);
    let current_a = (BOLTZMANN_J_PER_K * temperature_k / farad).sqrt() / ohm;
    let found = study(&scene, |plan, cell, pose, rng| {
        let pair = plan.photocurrents(cell, pose);
        let through = current_a * normal(rng);
        Pair { i_x1_a: pair.i_x1_a + through, i_x2_a: pair.i_x2_a - through }
    });
    assert_known("resistance", &found);
}

#[test]
fn a_common_light_level_is_one_more_unknown() {
    let mut scene = quiet();
    scene.noise.as_mut().expect("noise").adc_a = 2e-9;
    let seen_at = |scene: &Scene, level: f64| {
        study(scene, |plan, cell, pose, rng| {
            let Pair { i_x1_a, i_x2_a } = plan.photocurrents(cell, pose);
            Pair { i_x1_a: level * i_x1_a + 2e-9 * normal(rng), i_x2_a: level * i_x2_a + 2e-9 * normal(rng) }
        })
    };
    let known = seen_at(&scene, 1.0);
    let sigma = 0.1;
    scene.uncertainty.light_level_relative = sigma;
    for level in [1.0, 0.995, 0.92, 1.2] {
        let found = seen_at(&scene, level);
        println!("level {level}: {found:?}");
        // Five degrees of freedom, and what is known beforehand of the level: the means of 2000 to 4.5 of their σ.
        let chi2 = 5.0 + ((level - 1.0) / sigma).powi(2);
        let scatter = 4.5 * (12.0 / TRIALS as f64).sqrt();
        assert!((found.chi2 - chi2).abs() < scatter && (found.nees - 6.0).abs() < scatter, "{level}: {found:?}");
        // What positions alone tell of the pose is less, and no more than by a half; less light is more noise.
        for (with, without) in found.sigmas.iter().zip(known.sigmas) {
            let ratio = level * with / without;
            assert!((0.999..1.5).contains(&ratio), "{level}: {found:?} {known:?}");
        }
    }
}

#[test]
fn displaced_parts_are_told_by_covariance() {
    let mut scene = quiet();
    let position_m = 20e-6;
    scene.uncertainty.position_m = position_m;
    let found = study(&scene, |plan, cell, pose, rng| {
        // A detector with its slit that is off one way sees the emitter off the other way.
        let off_m = DVec3::from_array([0; 3].map(|_| position_m * normal(rng)));
        plan.photocurrents(cell, &Pose { translation_m: pose.translation_m - off_m, ..*pose })
    });
    assert_known("parts", &found);
    // Six cells off by 20 µm each, two currents each: the mean of what each says is some 10 µm.
    assert!(found.sigmas[..3].iter().all(|sigma| (9e-6..12e-6).contains(sigma)), "{found:?}");
    assert!(found.errors.iter().all(|error| (0.9..1.1).contains(error)), "{found:?}");
    // Only along one axis, and not told of the others: still no error that is not told.
    for axis in DVec3::AXES {
        let found = study(&scene, |plan, cell, pose, rng| {
            let off_m = axis * (position_m * normal(rng));
            plan.photocurrents(cell, &Pose { translation_m: pose.translation_m - off_m, ..*pose })
        });
        assert!(found.errors.iter().all(|error| *error < 1.25), "{axis}: {found:?}");
    }
}

/// Gains that nobody knows: of each electrode, and of each emitter.
#[test]
fn unknown_gains_are_told_by_covariance() {
    for of_electrodes in [true, false] {
        let mut scene = quiet();
        let unknown = &mut scene.uncertainty;
        *(if of_electrodes { &mut unknown.electrode_gain_relative } else { &mut unknown.emitter_gain_relative }) = 2e-3;
        let found = study(&scene, |plan, cell, pose, rng| {
            let Pair { i_x1_a, i_x2_a } = plan.photocurrents(cell, pose);
            let gains = [0; 2].map(|_| 1.0 + 2e-3 * normal(rng));
            Pair { i_x1_a: gains[0] * i_x1_a, i_x2_a: gains[usize::from(of_electrodes)] * i_x2_a }
        });
        assert!(found.errors.iter().all(|error| (0.85..1.15).contains(error)), "{of_electrodes}: {found:?}");
    }
}

#[test]
fn dark_current_hides_neither_planes_nor_limits() {
    let mut rng = generator();
    for dark_a in [20e-9, 200e-9] {
        let mut scene = wide();
        scene.cells.iter_mut().for_each(|cell| cell.detector.dark_current_a = dark_a);
        for (tier, far_m) in [(Tier::Paper, 1e-9), (Tier::Exact { tolerance: 1e-9 }, 60e-6)] {
            let solver = Solver::<f64>::new(&scene, tier).expect("scene");
            for _ in 0..50 {
                let truth = pose_in_box(&mut rng, 2.0, 8.0);
                let readings = seen(solver.plan(), &truth);
                let off_m = |start| {
                    let pose = solver.solve(&readings, start, &MotionPrior::AT_REST).estimate.expect("pose").pose;
                    (pose.translation_m - truth.translation_m).length()
                };
                // The planes of the exact tier take the middle of a spot for its centroid.
                assert!(off_m(Start::PlanesOnly) < far_m, "{dark_a} {tier:?} {truth:?}: {}", off_m(Start::PlanesOnly));
                assert!(off_m(Start::Cold) < 1e-9, "{dark_a} {tier:?} {truth:?}: {}", off_m(Start::Cold));
            }
            // A detector saturates by all of its current, of which the dark one is no part of a reading.
            let readings = seen(solver.plan(), &Pose::HOME);
            let total_a = solver.plan().photocurrents(2, &Pose::HOME).total_a() + dark_a;
            for (limit_a, used) in [(total_a * 1.001, true), (total_a * 0.999, false)] {
                scene.cells[2].detector.saturation_a = Some(limit_a);
                let solver = Solver::<f64>::new(&scene, tier).expect("scene");
                assert_eq!(cold(&solver, &readings).cells_used.contains(2), used, "{dark_a} {tier:?}");
                assert_eq!(solver.plan().respond(2, &Pose::HOME).flags.saturated, !used, "{dark_a} {tier:?}");
            }
            scene.cells[2].detector.saturation_a = None;
        }
    }
}
