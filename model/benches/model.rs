//! Six cells of the scene `wide`, one thread, `f64`: forward model and solver. Each figure is for 64 poses.

use std::hint::black_box;
use std::time::Duration;

use criterion::{Criterion, criterion_group, criterion_main};
use glam::DVec3;
use slitpose_model::{
    CompiledScene, Converters, MotionPrior, Photocurrents, Pose, Profile, ProfileShape, Scene, Solver, Start, Stray,
    Tier, Window,
};

#[path = "../tests/testsuite/common/mod.rs"]
mod common;

use common::wide;

fn poses() -> Vec<Pose> {
    // A fixed set inside ±3 mm, ±0.2 rad, so that all six cells are lit.
    (0..64)
        .map(|i| {
            let s = |m: f64| (f64::from(i) * m).sin();
            Pose::from_vectors(DVec3::new(s(1.0), s(2.3), s(3.7)) * 3e-3, DVec3::new(s(0.7), s(1.9), s(2.9)) * 0.2)
        })
        .collect()
}

/// A profile like that of the CQY36N: every 5°, three decimals.
fn tabulated() -> Scene {
    let mut scene = wide();
    let relative = |gamma: f64| {
        let (c, z) = (gamma.cos(), 1.0 - gamma.cos());
        (c.powf(1.247) * (1.0 + 0.1 * z - 0.15 * z * z) * 1e3).round() * 1e-3
    };
    let knots = (0..18).map(|i| f64::from(5 * i).to_radians());
    for cell in &mut scene.cells {
        cell.emitter.profile = Profile::Table(knots.clone().map(|gamma| (gamma, relative(gamma))).collect());
    }
    scene
}

/// Every effect that a calibration knows.
fn calibrated() -> Scene {
    let mut scene = wide();
    for cell in &mut scene.cells {
        cell.slit.thickness_m = 0.15e-3;
        cell.slit.tilt_rad = DVec3::new(0.01, -0.005, 0.02);
        let effects = &mut cell.effects;
        effects.window = Some(Window { thickness_m: 0.7e-3, refractive_index: 1.52 });
        effects.nonlinearity_m = (0..12).map(|k| 5e-6 * f64::from(k).sin()).collect();
        effects.profile = ProfileShape { radial: [0.1, -0.2, 0.1, 0.05], azimuthal: [0.02, -0.01, 0.03, 0.02] };
        effects.stray = Some(Stray {
            linear_a_per_m: [[3e-6, -5e-6, 2e-6], [1e-6, 4e-6, -6e-6]],
            quadratic_a_per_m2: [[1e-3; 6]; 2],
            ..Stray::at(100e-9, 1e-3, cell.detector.length_m)
        });
        effects.electrode_gain = [1.01, 0.98];
        let curve = |sign: f64| (0..10).map(|k| sign * 1e-10 * f64::from(k)).collect();
        effects.converters = Some(Converters { full_scale_a: 10e-6, curves_a: [curve(1.0), curve(-1.0)] });
    }
    scene
}

fn thick() -> Scene {
    let mut scene = wide();
    scene.cells.iter_mut().for_each(|cell| cell.slit.thickness_m = 0.15e-3);
    scene
}

const EXACT: Tier = Tier::Exact { tolerance: 1e-6 };

fn cases() -> [(&'static str, Scene, Tier); 6] {
    [
        ("paper", wide(), Tier::Paper),
        ("exact 1e-6", wide(), EXACT),
        ("exact 1e-10", wide(), Tier::Exact { tolerance: 1e-10 }),
        ("thick mask", thick(), EXACT),
        ("tabulated profile", tabulated(), EXACT),
        ("all effects", calibrated(), EXACT),
    ]
}

fn forward(c: &mut Criterion) {
    let poses = poses();
    let mut group = c.benchmark_group("six cells");
    group.measurement_time(Duration::from_secs(3)).throughput(criterion::Throughput::Elements(poses.len() as u64));
    for (name, scene, tier) in cases() {
        let plan = CompiledScene::<f64>::compile(&scene, tier).expect("scene");
        group.bench_function(format!("{name}, currents"), |b| {
            b.iter(|| {
                for pose in &poses {
                    for cell in 0..plan.cell_count() {
                        black_box(plan.photocurrents(cell, black_box(pose)));
                    }
                }
            });
        });
        group.bench_function(format!("{name}, currents and derivatives"), |b| {
            b.iter(|| {
                for pose in &poses {
                    for cell in 0..plan.cell_count() {
                        black_box(plan.linearise(cell, black_box(pose)));
                    }
                }
            });
        });
    }
    group.finish();
}

fn solve(c: &mut Criterion) {
    let poses = poses();
    let mut group = c.benchmark_group("solve");
    group.measurement_time(Duration::from_secs(3)).throughput(criterion::Throughput::Elements(poses.len() as u64));
    for (name, scene, tier) in cases() {
        let solver = Solver::<f64>::new(&scene, tier).expect("scene");
        let readings: Vec<Photocurrents> = poses
            .iter()
            .map(|pose| Photocurrents::of_pairs((0..6).map(|cell| solver.plan().photocurrents(cell, pose))))
            .collect();
        group.bench_function(format!("{name}, cold"), |b| {
            b.iter(|| {
                for reading in &readings {
                    black_box(solver.solve(black_box(reading), Start::Cold, &MotionPrior::AT_REST));
                }
            });
        });
        // A prior 3 µm and 0.3 mrad off on each axis, as from the frame before.
        let priors: Vec<Pose> =
            poses.iter().map(|pose| pose.perturbed(DVec3::splat(3e-6), DVec3::splat(3e-4))).collect();
        group.bench_function(format!("{name}, warm"), |b| {
            b.iter(|| {
                for (reading, prior) in readings.iter().zip(&priors) {
                    black_box(solver.solve(black_box(reading), Start::Near(prior), &MotionPrior::AT_REST));
                }
            });
        });
    }
    group.finish();
}

criterion_group!(benches, forward, solve);
criterion_main!(benches);
