//! From bytes to poses with covariance, one thread: shipped scenes in smooth motion, `wide` at up to
//! 0.5 m/s and 5 rad/s, four scans a packet, truths included as a simulated board sends them.
//!
//! ```text
//! cargo bench -p slitpose-tests --bench pipeline
//! ```
//!
//! `thrpt` is scans a second; a board sends 4000.

use std::hint::black_box;
use std::time::Duration;

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use slitpose_head::scene_file::{MAGLEV, SPACEMOUSE, WIDE};
use slitpose_head::simulator::{Trajectory, TrajectoryKind};
use slitpose_model::Tier;
use slitpose_protocol::{Decoder, MAX_MESSAGE_BYTES, Message};
use slitpose_tests::capture::{STREAM, capture, pipeline};
use slitpose_tracking::pipeline::{Item, PipelineError};

/// A quarter of a second.
const SCANS: usize = 1000;

fn bytes_to_poses(c: &mut Criterion) {
    let mut group = c.benchmark_group("bytes to poses");
    group.throughput(Throughput::Elements(SCANS as u64)).measurement_time(Duration::from_secs(5));
    for (shipped, tier) in [(WIDE, Tier::Paper), (WIDE, STREAM), (SPACEMOUSE, STREAM), (MAGLEV, STREAM)] {
        let file = shipped.read().expect("shipped");
        let name = format!("{}, {}", shipped.name, if tier == STREAM { "exact 1e-6" } else { "paper" });
        let bytes = capture(&file, Trajectory::of_kind(TrajectoryKind::Smooth, 1, 1.0), tier, 1, SCANS);
        group.bench_function(name, |b| {
            b.iter(|| {
                let mut pipeline = pipeline(&file, tier);
                let take = |item: Item<'_>| {
                    if let Item::Pose(record) = item {
                        black_box(record.solution.estimate);
                    }
                    Ok::<_, PipelineError>(())
                };
                pipeline.push(black_box(&bytes), take).expect("suits");
                assert_eq!(pipeline.counts().poses(), SCANS as u64);
            });
        });
    }
    group.finish();
}

fn bytes_to_messages(c: &mut Criterion) {
    let file = WIDE.read().expect("shipped");
    let bytes = capture(&file, Trajectory::of_kind(TrajectoryKind::Smooth, 1, 1.0), Tier::Paper, 1, SCANS);
    let mut group = c.benchmark_group("bytes to messages");
    group.throughput(Throughput::Elements(SCANS as u64));
    group.bench_function("decoder only", |b| {
        b.iter(|| {
            let mut decoder = Decoder::<MAX_MESSAGE_BYTES>::new();
            let mut rest = black_box(bytes.as_slice());
            while let Some(message) = decoder.next::<Message<'_>>(&mut rest) {
                black_box(message.is_ok());
            }
            assert_eq!(decoder.counters().bytes_skipped, 0);
        });
    });
    group.finish();
}

criterion_group!(benches, bytes_to_poses, bytes_to_messages);
criterion_main!(benches);
