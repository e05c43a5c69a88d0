//! Random cells and poses: ordinary ones and awkward ones.
#![allow(dead_code, reason = "benches use a part")]

use glam::{DVec2, DVec3};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use slitpose_model::{
    Cell, CompiledScene, DEFAULT_FAINT_A, Detector, Emitter, Estimate, MotionPrior, Noise, Pair, Photocurrents, Pose,
    Profile, Scalar, Scene, Slit, Solution, Solver, Start, Tier, Uncertainty,
};

/// The tiers in which solvers are tested.
pub const TIERS: [Tier; 2] = [Tier::Paper, Tier::Exact { tolerance: 1e-6 }];

pub const SEED: u64 = 20_180_718;

pub fn generator() -> ChaCha8Rng {
    println!("seed {SEED}");
    ChaCha8Rng::seed_from_u64(SEED)
}

/// Kinds of slit.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Kind {
    Thin,
    Thick,
    Tilted,
    TiltedThick,
    Table,
}

pub const KINDS: [Kind; 5] = [Kind::Thin, Kind::Thick, Kind::Tilted, Kind::TiltedThick, Kind::Table];

pub fn uniform(rng: &mut ChaCha8Rng, low: f64, high: f64) -> f64 {
    rng.random_range(low..high)
}

pub fn vector(rng: &mut ChaCha8Rng, half: f64) -> DVec3 {
    DVec3::from([0; 3].map(|_| uniform(rng, -half, half)))
}

pub fn unit(rng: &mut ChaCha8Rng) -> DVec3 {
    loop {
        let v = vector(rng, 1.0);
        if (0.1..1.0).contains(&v.length()) {
            return v.normalize();
        }
    }
}

/// A single cell of random size somewhere in the base frame; at the home pose its emitter is
/// roughly in front of the slit.
pub fn scene(rng: &mut ChaCha8Rng, kind: Kind) -> Scene {
    let normal = unit(rng);
    let x_axis = normal.cross(unit(rng)).normalize();
    let centre = vector(rng, 0.03);
    let distance = uniform(rng, 4e-3, 9e-3);
    let tilted = matches!(kind, Kind::Tilted | Kind::TiltedThick);
    let thick = matches!(kind, Kind::Thick | Kind::TiltedThick);
    let profile = match kind {
        Kind::Table => Profile::Table(
            (0..=8).map(|i| f64::from(i) * 0.19).map(|g| (g, g.cos().powf(1.3) * (1.0 - 0.05 * g))).collect(),
        ),
        _ => Profile::Cosine { exponent: uniform(rng, 1.0, 3.0) },
    };
    let toward = centre + normal * uniform(rng, 10e-3, 16e-3) + vector(rng, 0.5e-3);
    let mut cell = base().cells[0].clone();
    let Cell { detector, slit, emitter, .. } = &mut cell;
    (detector.centre_base_m, detector.x_axis_base, detector.normal_base) = (centre, x_axis, normal);
    detector.width_m = uniform(rng, 0.8e-3, 2e-3);
    detector.dark_current_a = 5e-9;
    (detector.interelectrode_ohm, detector.saturation_a) = (None, None);
    (slit.distance_m, slit.width_m) = (distance, uniform(rng, 0.3e-3, 1e-3));
    slit.offset_m = DVec2::new(uniform(rng, -0.3e-3, 0.3e-3), uniform(rng, -0.3e-3, 0.3e-3));
    slit.tilt_rad = if tilted { vector(rng, 0.25) } else { DVec3::ZERO };
    slit.thickness_m = if thick { uniform(rng, 0.05e-3, 0.3e-3) } else { 0.0 };
    emitter.position_tool_m = toward;
    emitter.axis_tool = (-normal + vector(rng, 0.3)).normalize();
    emitter.profile = profile;
    Scene { cells: [cell].into_iter().collect(), noise: None, uncertainty: Uncertainty::default() }
}

/// A pose that turns the tool about the emitter, so that light stays on the detector.
pub fn pose(rng: &mut ChaCha8Rng, scene: &Scene, shift_m: f64, turn_rad: f64) -> Pose {
    let emitter = scene.cells[0].emitter.position_tool_m;
    let turned = Pose::from_vectors(DVec3::ZERO, vector(rng, turn_rad));
    Pose { translation_m: emitter - turned.rotation * emitter + vector(rng, shift_m), ..turned }
}

/// Six cells every 60°, emitters on a circle of 10 mm, detectors on one of 25 mm, slits of
/// `width_mm` at `distance_mm`, rolled by `rolls_deg` in turn, with 10 kHz noise.
pub fn six_cells(distance_mm: f64, width_mm: f64, rolls_deg: [f64; 2]) -> Scene {
    let cells = (0..6).map(|k| {
        let (sine, cosine) = (f64::from(k) * core::f64::consts::FRAC_PI_3).sin_cos();
        let outward = DVec3::new(cosine, sine, 0.0);
        let roll = rolls_deg[k as usize % 2].to_radians();
        Cell {
            detector: Detector {
                centre_base_m: outward * 25e-3,
                x_axis_base: DVec3::Z.cross(outward) * roll.cos() + DVec3::Z * roll.sin(),
                normal_base: -outward,
                length_m: 12e-3,
                width_m: 1e-3,
                responsivity_a_per_w: 0.54,
                dark_current_a: 0.0,
                interelectrode_ohm: Some(50e3),
                saturation_a: Some(100e-6),
                faint_a: DEFAULT_FAINT_A,
            },
            slit: Slit {
                distance_m: distance_mm * 1e-3,
                width_m: width_mm * 1e-3,
                length_m: 10e-3,
                offset_m: DVec2::ZERO,
                tilt_rad: DVec3::ZERO,
                thickness_m: 0.0,
            },
            emitter: Emitter {
                position_tool_m: outward * 10e-3,
                axis_tool: outward,
                radiant_intensity_w_per_sr: 3.16e-3,
                profile: Profile::from_half_angle(55_f64.to_radians()),
            },
            effects: slitpose_model::Effects::default(),
        }
    });
    let noise = Noise { shot_bandwidth_hz: 10e3, johnson_bandwidth_hz: 10e3, temperature_k: 300.0, adc_a: 0.6e-9 };
    Scene { cells: cells.collect(), noise: Some(noise), uncertainty: Uncertainty::default() }
}

/// The geometry of the shipped scene `wide`.
pub fn wide() -> Scene {
    six_cells(5.0, 0.6, [45.0, -45.0])
}

/// The geometry of the shipped scene `base`.
pub fn base() -> Scene {
    six_cells(7.5, 0.4, [0.0, 90.0])
}

/// A pose uniformly in a box.
pub fn pose_in_box(rng: &mut ChaCha8Rng, half_mm: f64, half_deg: f64) -> Pose {
    Pose::from_vectors(vector(rng, half_mm * 1e-3), vector(rng, half_deg.to_radians()))
}

pub fn normal(rng: &mut ChaCha8Rng) -> f64 {
    StandardNormal.sample(rng)
}

/// What each cell delivers with the tool at `pose`.
pub fn pairs(plan: &CompiledScene<f64>, pose: &Pose) -> Vec<Pair<f64>> {
    (0..plan.cell_count()).map(|cell| plan.photocurrents(cell, pose)).collect()
}

pub fn seen(plan: &CompiledScene<f64>, pose: &Pose) -> Photocurrents {
    Photocurrents::of_pairs(pairs(plan, pose))
}

/// With the noise of converters alone, which outweighs the rest.
pub fn noisy(pairs: &[Pair<f64>], sigma_a: f64, rng: &mut ChaCha8Rng) -> Photocurrents {
    Photocurrents::of_pairs(
        pairs.iter().map(|pair| Pair {
            i_x1_a: pair.i_x1_a + sigma_a * normal(rng),
            i_x2_a: pair.i_x2_a + sigma_a * normal(rng),
        }),
    )
}

pub fn cold<S: Scalar>(solver: &Solver<S>, readings: &Photocurrents<S>) -> Solution<S> {
    solver.solve(readings, Start::Cold, &MotionPrior::AT_REST)
}

pub fn near<S: Scalar>(solver: &Solver<S>, readings: &Photocurrents<S>, expected: &Pose) -> Solution<S> {
    solver.solve(readings, Start::Near(expected), &MotionPrior::AT_REST)
}

/// The errors of an estimate along all axes, in σ.
pub fn errors_in_sigmas(estimate: &Estimate, truth: &Pose) -> [f64; 6] {
    let (dt, dr) = estimate.pose.displacement_from(truth);
    let (errors, sigma) = ([dt.x, dt.y, dt.z, dr.x, dr.y, dr.z], estimate.sigma());
    core::array::from_fn(|axis| errors[axis].abs() / sigma[axis])
}
