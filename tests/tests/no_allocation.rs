//! On its way from bytes to pose a scan touches no heap: what could grow, or stall, does not exist.

use allocation_counter::AllocationInfo;
use slitpose::clock::{HostInstant, HostTime};
use slitpose::front_end::Stage;
use slitpose::health::Health;
use slitpose::pipeline::{Item, PipelineError};
use slitpose::scene_file::WIDE;
use slitpose::simulator::{Trajectory, TrajectoryKind};
use slitpose::telemetry::BoardStatistics;
use slitpose_model::Tier;
use slitpose_tests::capture::{STREAM, capture, decode, pipeline, solve};

const SCANS: usize = 10_000;

/// What the pipeline allocates while it solves [`SCANS`] scans, and how many poses come out.
fn measure(tier: Tier, kind: TrajectoryKind, spoil: impl Fn(&mut [u8])) -> (AllocationInfo, u64) {
    let file = WIDE.read().expect("shipped");
    // Some hundred scans more to warm up: the hello and the tracker's first frames.
    let mut bytes = capture(&file, Trajectory::of_kind(kind, 51, 10.0), tier, 51, SCANS + 400);
    let start = bytes.len() / 26;
    let (warm_up, measured) = bytes.split_at_mut(start);
    spoil(measured);
    let mut pipeline = pipeline(&file, tier);
    let mut poses = 0;
    let mut count = |item: Item<'_>| {
        if let Item::Pose(record) = item {
            poses += u64::from(record.solution.outcome.has_pose());
        }
        Ok::<_, PipelineError>(())
    };
    pipeline.push(warm_up, &mut count).expect("suits");
    let info = allocation_counter::measure(|| {
        // As a serial port or a file hands them over.
        for chunk in measured.chunks(512) {
            pipeline.push(chunk, &mut count).expect("suits");
        }
    });
    println!("{tier:?}, {kind:?}: {poses} poses, {info:?}");
    (info, poses)
}

#[test]
fn the_counter_counts() {
    let info = allocation_counter::measure(|| drop(std::hint::black_box(vec![0_u8; 100])));
    assert_eq!((info.count_total, info.bytes_total), (1, 100));
}

#[test]
fn ten_thousand_scans_allocate_nothing() {
    for tier in [Tier::Paper, STREAM] {
        let (info, poses) = measure(tier, TrajectoryKind::Smooth, |_| {});
        assert_eq!((info.count_total, poses), (0, SCANS as u64 + 400));
    }
}

#[test]
fn reversals_and_damage_allocate_nothing() {
    let (info, poses) = measure(Tier::Paper, TrajectoryKind::Contact, |bytes| {
        bytes.iter_mut().step_by(10_007).for_each(|byte| *byte ^= 0x55);
    });
    assert_eq!(info.count_total, 0);
    // One packet of at most four scans every 10 007 bytes of some 5 million, or two at a delimiter.
    assert!(poses > SCANS as u64 / 2 && poses < SCANS as u64 + 400, "{poses}");
}

#[test]
fn watching_and_counting_allocate_nothing() {
    let file = WIDE.read().expect("shipped");
    let bytes = capture(&file, Trajectory::of_kind(TrajectoryKind::Smooth, 52, 10.0), STREAM, 52, SCANS);
    let decoded = decode(&bytes);
    let (records, _) = solve(&file, STREAM, &bytes);
    let stage = Stage::new(&file, &decoded.schedule, &decoded.scaling);
    let mut health = Health::new(&file, STREAM, &decoded.schedule, &decoded.scaling).expect("valid");
    let mut statistics = BoardStatistics::new("sim", HostInstant::now());
    let mut watch = |spoil: bool| {
        for (scan, record) in decoded.scans.iter().zip(&records) {
            let mut record = *record;
            if spoil {
                // Nothing fits any more: exchanges are looked for, too.
                record.solution.outcome = slitpose_model::Outcome::Diverged;
            }
            let sampled_ns = (record.device_time_s * 1e9) as u64;
            record.host_time = Some(HostTime { monotonic_ns: sampled_ns, utc_ns: 0, uncertainty_ns: 0 });
            let later = |ns| Some(HostInstant { monotonic_ns: sampled_ns + ns, utc_ns: 0 });
            health.take(scan, &stage.photocurrents(scan), &record.solution);
            statistics.take(&Item::Pose(&record), later(1_000_000), later(1_050_000));
        }
    };
    for spoil in [false, true] {
        let started = std::time::Instant::now();
        let info = allocation_counter::measure(|| watch(spoil));
        let each_ns = started.elapsed().as_nanos() / SCANS as u128;
        println!("watching and counting, nothing fits: {spoil}: {each_ns} ns a scan of six cells, {info:?}");
        assert_eq!(info.count_total, 0);
    }
    assert_eq!(health.report().cells[0].totals.scans, 2 * SCANS as u64);
}
