//! On its way from bytes to pose a scan touches no heap: what could grow, or stall, does not exist.

use allocation_counter::AllocationInfo;
use slitpose::datagram::{Address, DatagramServer, Mode, PoseDatagram, Request};
use slitpose::platform::UnixClient;
use slitpose_head::front_end;
use slitpose_head::scene_file::{SceneFile, WIDE};
use slitpose_head::simulator::{SimulatedBoard, Trajectory, TrajectoryKind};
use slitpose_model::{Solver, Tier, Tracker};
use slitpose_protocol::Command;
use slitpose_tests::capture::{STREAM, capture, pipeline};
use slitpose_tests::terminal::request;
use slitpose_tracking::clock::HostInstant;
use slitpose_tracking::link::{Asked, DeviceId, Segment};
use slitpose_tracking::pipeline::{Item, PipelineError};
use slitpose_tracking::telemetry::BoardStatistics;

const SCANS: usize = 10_000;

/// What the pipeline allocates while it solves [`SCANS`] scans of a board with this head, and how many poses come out.
fn measure(board: &SceneFile, tier: Tier, kind: TrajectoryKind, spoil: impl Fn(&mut [u8])) -> (AllocationInfo, u64) {
    let file = WIDE.read().expect("shipped");
    // Some hundred scans more to warm up: the hello and the tracker's first frames.
    let mut bytes = capture(board, Trajectory::of_kind(kind, 51, 10.0), tier, 51, SCANS + 400);
    let start = bytes.len() / 26;
    let (warm_up, measured) = bytes.split_at_mut(start);
    spoil(measured);
    let mut pipeline = pipeline(&file, tier).watched();
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
    let file = WIDE.read().expect("shipped");
    for tier in [Tier::Paper, STREAM] {
        let (info, poses) = measure(&file, tier, TrajectoryKind::Smooth, |_| {});
        assert_eq!((info.count_total, poses), (0, SCANS as u64 + 400));
    }
    // Nothing fits: exchanged cells are looked for, too.
    let mut exchanged = file;
    exchanged.scene.cells.swap(0, 2);
    let (info, _) = measure(&exchanged, STREAM, TrajectoryKind::Smooth, |_| {});
    assert_eq!(info.count_total, 0);
}

#[test]
fn reversals_and_damage_allocate_nothing() {
    let file = WIDE.read().expect("shipped");
    let (info, poses) = measure(&file, Tier::Paper, TrajectoryKind::Contact, |bytes| {
        bytes.iter_mut().step_by(10_007).for_each(|byte| *byte ^= 0x55);
    });
    assert_eq!(info.count_total, 0);
    // One packet of at most four scans every 10 007 bytes of some 5 million, or two at a delimiter.
    assert!(poses > SCANS as u64 / 2 && poses < SCANS as u64 + 400, "{poses}");
}

/// As a pipeline does that is behind, for the newest scan, and a search for exchanged cells.
#[test]
fn copies_of_a_tracker_allocate_nothing() {
    let scene = WIDE.read().expect("shipped").scene;
    for tier in [Tier::Paper, STREAM] {
        let tracker: Tracker<f64> = Tracker::new(Solver::new(&scene, tier).expect("valid"), 250e-6);
        let mut copy = tracker.clone();
        let info = allocation_counter::measure(|| copy.clone_from(std::hint::black_box(&tracker)));
        assert_eq!(info.count_total, 0, "{tier:?}");
    }
}

/// What a board says in `frames` frames, with a ping every half second, in reads of four frames as
/// they come over USB; by a host whose clock starts with the board's.
fn segments(frames: usize) -> Vec<Segment> {
    let file = WIDE.read().expect("shipped");
    let configuration = front_end::configuration(&file).expect("schedule");
    let frame_ns = (configuration.schedule.frame_rate_hz().recip() * 1e9) as u64;
    let trajectory = Trajectory::of_kind(TrajectoryKind::Smooth, 53, 10.0);
    let mut board = SimulatedBoard::new(&file, trajectory, STREAM, 53).expect("can be simulated");
    board.write(&request(1, Command::Configure(configuration)));
    board.write(&request(2, Command::Start));
    let at = |frame: usize| HostInstant { monotonic_ns: frame as u64 * frame_ns, utc_ns: frame as u64 * frame_ns };
    let mut read = |start: usize| {
        let mut segment = Segment { opened: start == 0, ..Segment::default() };
        if start.is_multiple_of(2000) {
            let token = start as u32;
            segment.asked.push(Asked { token, at: at(start) });
            board.write(&request(0, Command::Ping { token }));
        }
        let mut bytes = Vec::new();
        (0..4).for_each(|_| board.step(&mut bytes));
        // A quarter of a millisecond on its way.
        segment.push(&bytes, Some(at(start + 5)));
        segment
    };
    (0..frames).step_by(4).map(&mut read).collect()
}

#[test]
fn following_a_board_live_allocates_nothing() {
    let file = WIDE.read().expect("shipped");
    let segments = segments(SCANS + 4000);
    let mut pipeline = pipeline(&file, STREAM).watched();
    let folder = tempfile::tempdir().expect("temporary folder");
    let path = folder.path().join("pose");
    let memory = Address::Memory(folder.path().join("memory"));
    let server = DatagramServer::bind(&[Address::Unix(path.clone()), memory]).expect("can be had");
    let client = UnixClient::new().expect("socket");
    client.socket.set_nonblocking(true).expect("does not block");
    client.ask(&path, Request::new(Mode::Follow, None)).expect("asks");
    while server.counts().requests == 0 {
        std::thread::yield_now();
    }

    let mut publisher = None;
    let mut statistics = BoardStatistics::new("sim", HostInstant::default());
    let (mut poses, mut timed, mut received) = (0, 0, 0);
    let mut datagram = [0; PoseDatagram::BYTES];
    // As the thread of the daemon does that solves.
    let mut follow = |segment: &Segment| {
        let fed = pipeline.feed(segment, |item| {
            if let Item::Hello(hello) = &item {
                publisher.get_or_insert_with(|| server.publisher(DeviceId(hello.device_id)));
            }
            let Item::Pose(record) = &item else {
                statistics.update(&item, None, None);
                return Ok::<_, PipelineError>(());
            };
            let now = record.arrival.expect("a time");
            publisher.as_mut().expect("hello first").publish(record, now);
            statistics.update(&item, record.arrival, Some(now));
            poses += 1;
            timed += u64::from(record.host_time.is_some());
            while client.socket.recv(&mut datagram).is_ok() {
                received += 1;
            }
            Ok(())
        });
        assert_eq!(fed.expect("suits"), segment.bytes.len());
    };
    // The second ping has been answered by then.
    let (warm_up, measured) = segments.split_at(1000);
    warm_up.iter().for_each(&mut follow);
    let info = allocation_counter::measure(|| measured.iter().for_each(&mut follow));
    println!("{poses} poses, {timed} with time, {received} received: {info:?}");
    assert_eq!(info.count_total, 0);
    assert_eq!((poses, received), (SCANS + 4000, SCANS + 4000));
    assert!(timed >= SCANS as u64, "{timed}");
    assert!(pipeline.health().is_some() && pipeline.drift_ppm().is_some());
}
