//! Six cells of the scene `wide`, one thread, `f64`: forward model and solver. Each figure is for 64 poses.

use std::hint::black_box;
use std::time::Duration;

use criterion::{Criterion, criterion_group, criterion_main};
use glam::DVec3;
use slitpose_model::{MotionPrior, Photocurrents, Plan, Pose, Solver, Start, Tier};

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

fn forward(c: &mut Criterion) {
    let scene = wide();
    let poses = poses();
    let mut group = c.benchmark_group("six cells");
    group.measurement_time(Duration::from_secs(3)).throughput(criterion::Throughput::Elements(poses.len() as u64));
    for (name, tier) in [
        ("paper", Tier::Paper),
        ("exact 1e-6", Tier::Exact { tolerance: 1e-6 }),
        ("exact 1e-10", Tier::Exact { tolerance: 1e-10 }),
    ] {
        let plan = Plan::<f64>::compile(&scene, tier).expect("scene");
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
    let scene = wide();
    let poses = poses();
    let mut group = c.benchmark_group("solve");
    group.measurement_time(Duration::from_secs(3)).throughput(criterion::Throughput::Elements(poses.len() as u64));
    for (name, tier) in [("paper", Tier::Paper), ("exact 1e-6", Tier::Exact { tolerance: 1e-6 })] {
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
