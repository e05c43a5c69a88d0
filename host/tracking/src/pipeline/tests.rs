//! The pipeline with a simulated board.

use slitpose_model::Tier;
use slitpose_protocol::poses::TRIANGLE;
use slitpose_protocol::{
    Command, DELIMITER, Hashes, HeadPart, MAX_MESSAGE_BYTES, Message, PoseRecord, PoseStatus, Poses, Stream, encode,
};

use super::{
    Counts, Item, Oddity, Pipeline, PipelineError, PipelineOptions, PoseFault, PoseSource, Record, SceneMatch,
};
use crate::clock::HostInstant;
use crate::link::{Asked, Segment};
use slitpose_head::scene_file::{SceneFile, WIDE};
use slitpose_head::simulator::{SimulatedBoard, Trajectory, TrajectoryKind};
use slitpose_head::{board_head, front_end};

const TIER: Tier = Tier::Exact { tolerance: 1e-4 };

/// Host time at which the board began to count, nanoseconds.
const START_NS: u64 = 90_000_000_000;

/// Delay of the bytes of a frame on their way to the host.
const DELAY_NS: u64 = 70_000;

/// A simulated board, and a host whose clock is exact.
pub(super) struct SimulatedLink {
    file: SceneFile,
    pub(super) board: SimulatedBoard,
    frame_ns: u64,
    frames: u64,
}

impl SimulatedLink {
    pub(super) fn new() -> Self {
        Self::numbered(0)
    }

    fn numbered(number: u8) -> Self {
        let file = WIDE.read().unwrap();
        let configuration = front_end::configuration(&file).unwrap();
        let frame_ns = (1e9 / configuration.schedule.frame_rate_hz()) as u64;
        let trajectory = Trajectory::of_kind(TrajectoryKind::Smooth, 1, 2.0);
        let mut board = SimulatedBoard::numbered(number, &file, trajectory, TIER, 1).unwrap();
        board.ask(1, Command::Hello);
        board.ask(2, Command::Start);
        Self { file, board, frame_ns, frames: 0 }
    }

    /// Stops the board, configures it anew, and starts it.
    pub(super) fn reconfigure(&mut self) {
        let configuration = front_end::configuration(&self.file).unwrap();
        self.board.ask(3, Command::Stop);
        self.board.ask(4, Command::Configure(configuration));
        self.board.ask(5, Command::Start);
    }

    /// The data delivered by the link in some frames, with a ping in the middle of the first.
    pub(super) fn segment(&mut self, frames: u64, token: u32) -> Segment {
        let mut segment = Segment::default();
        let now_ns = |frames| START_NS + frames * self.frame_ns;
        let asked_ns = now_ns(self.frames) - DELAY_NS;
        segment.asked.push(Asked { token, at: instant(asked_ns) });
        let ends: Vec<u64> = (self.frames + 1..=self.frames + frames).map(now_ns).collect();
        self.board.ask(0, Command::Ping { token });
        let mut bytes = Vec::new();
        for end_ns in ends {
            bytes.clear();
            self.board.step(&mut bytes);
            segment.push(&bytes, Some(instant(end_ns + DELAY_NS)));
        }
        self.frames += frames;
        segment
    }

    pub(super) fn pipeline(&self) -> Pipeline {
        Pipeline::new(self.file.clone(), TIER, SceneMatch::Required)
    }
}

fn instant(monotonic_ns: u64) -> HostInstant {
    HostInstant { monotonic_ns, utc_ns: monotonic_ns + 1_700_000_000_000_000_000 }
}

pub(super) fn feed(pipeline: &mut Pipeline, segment: &Segment) -> (usize, Vec<Record>) {
    let mut records = Vec::new();
    let taken = pipeline.feed(segment, |item| {
        if let Item::Pose(record) = item {
            records.push(*record);
        }
        Ok::<_, PipelineError>(())
    });
    (taken.unwrap(), records)
}

#[test]
fn scans_have_the_time_at_which_they_were_taken() {
    let mut link = SimulatedLink::new();
    let mut pipeline = link.pipeline();
    for token in 0..8 {
        let segment = link.segment(400, token);
        let (taken, records) = feed(&mut pipeline, &segment);
        assert_eq!(taken, segment.bytes.len());
        // The pong comes with the first scans.
        for record in &records[usize::from(token == 0) * 10..] {
            let time = record.host_time.unwrap();
            let truth_ns = START_NS + (record.device_time_s * 1e9) as u64;
            assert!(time.monotonic_ns.abs_diff(truth_ns) <= time.uncertainty_ns, "{time:?}, {truth_ns}");
            let arrival = record.arrival.unwrap();
            assert!(time.monotonic_ns <= arrival.monotonic_ns && segment.reads.iter().any(|r| r.at == Some(arrival)));
            // Between a ping and its pong lie a frame and twice the delay.
            assert!(token < 6 || time.uncertainty_ns < link.frame_ns + 2 * DELAY_NS, "{time:?}");
        }
    }
}

/// Wherever reads end: what follows the end is neither damage nor part of what is kept, and what is kept ends with a packet.
#[test]
fn what_comes_after_the_end_is_no_damage() {
    let mut link = SimulatedLink::new();
    let bytes = link.segment(40, 0).bytes;
    let push = |pipeline: &mut Pipeline, bytes: &[u8]| pipeline.push(bytes, |_| Ok::<_, PipelineError>(())).unwrap();
    let until = || link.pipeline().until(Some(20.0 * link.frame_ns as f64 * 1e-9));
    let mut whole = until();
    let kept = push(&mut whole, &bytes);
    assert!(whole.is_complete() && kept < bytes.len() && bytes[kept - 1] == DELIMITER);
    for cut in kept - 200..kept + 200 {
        let mut pipeline = until();
        let taken: usize = [&bytes[..cut], &bytes[cut..]].map(|part| push(&mut pipeline, part)).iter().sum();
        assert_eq!((pipeline.counts().decoder.damaged(), pipeline.counts().scans), (0, whole.counts().scans), "{cut}");
        assert!(taken <= kept && (cut < kept || taken == kept), "{cut}: {taken} of {kept}");
    }
}

#[test]
fn without_instants_there_are_no_times_and_the_poses_are_the_same() {
    let mut link = SimulatedLink::new();
    let segment = link.segment(50, 0);
    let (_, timed) = feed(&mut link.pipeline(), &segment);
    let mut timeless = Segment::default();
    timeless.push(&segment.bytes, None);
    let (taken, pushed) = feed(&mut link.pipeline(), &timeless);
    assert_eq!(taken, segment.bytes.len());
    assert_eq!(timed.len(), pushed.len());
    for (timed, pushed) in timed.iter().zip(&pushed) {
        assert!(pushed.host_time.is_none() && pushed.arrival.is_none());
        assert_eq!(timed.solution.estimate, pushed.solution.estimate);
    }
    assert!(timed.iter().any(|record| record.host_time.is_some()));
}

#[test]
fn a_reopened_link_begins_with_a_whole_packet_and_a_new_clock() {
    let mut link = SimulatedLink::new();
    let mut pipeline = link.pipeline();
    let mut segment = link.segment(50, 0);
    segment.truncate(segment.bytes.len() - 1);
    let (_, records) = feed(&mut pipeline, &segment);
    let pending = pipeline.counts().pending_bytes;
    assert!(pending > 0 && records.iter().any(|record| record.host_time.is_some()));
    let mut segment = link.segment(50, 1);
    segment.opened = true;
    // Asked before the link was lost, answered behind it.
    let asked = std::mem::take(&mut segment.asked);
    feed(&mut pipeline, &Segment { asked, ..Segment::default() });
    let (_, records) = feed(&mut pipeline, &segment);
    // Without a ping no time is known; an answer to an earlier ping is ignored.
    assert!(!records.is_empty() && records.iter().all(|record| record.host_time.is_none()));
    assert_eq!(pipeline.counts().decoder.bytes_skipped, pending);
}

#[test]
fn a_batch_has_come_after_its_last_sample() {
    let mut link = SimulatedLink::new();
    let mut pipeline = link.pipeline();
    feed(&mut pipeline, &link.segment(20, 0));
    let session = pipeline.flow.session.unwrap();
    // Ticks at 170 MHz: 42 500 per frame; a slot has 2210 of settling and 48 conversions of 148. The last
    // sample is the 48th conversion of the third slot, the dark one.
    let last_sample = 2 * (2_210 + 48 * 148) + 2_210 + 47 * 148;
    assert_eq!(session.last_tick(1_000, 1), 1_000 + last_sample);
    assert_eq!(session.last_tick(1_000, 4), 1_000 + 3 * 42_500 + last_sample);
    assert_eq!(session.last_tick(u64::MAX, 1), last_sample - 1, "the counter wraps");
}

#[test]
fn scans_missing_beyond_the_end_are_not_lost() {
    let mut counts = Counts::default();
    counts.count_scan(9, 0);
    counts.count_lost_before_end(30, 5);
    assert_eq!((counts.scans, counts.scans_lost), (1, 5));
}

#[test]
fn another_board_counts_its_own_scans() {
    let (mut first, mut second) = (SimulatedLink::new(), SimulatedLink::numbered(1));
    let mut pipeline = first.pipeline();
    let (_, before) = feed(&mut pipeline, &first.segment(50, 0));
    let mut segment = second.segment(50, 1);
    segment.opened = true;
    let (_, after) = feed(&mut pipeline, &segment);
    assert!(before[0].device != after[0].device && after[0].sequence < before[before.len() - 1].sequence);
    let counts = pipeline.counts();
    let scans = (before.len() + after.len()) as u64;
    assert_eq!((counts.scans, counts.scans_lost, counts.restarts), (scans, 0, 0));
}

#[test]
fn a_status_sets_the_bounds_of_the_clock() {
    for (permille, contradicts) in [(1000, false), (1010, true), (990, true)] {
        let mut link = SimulatedLink::new();
        link.frame_ns = link.frame_ns * permille / 1000;
        let mut pipeline = link.pipeline();
        let mut statuses = 0;
        // Pings come twice a second, as statuses do.
        for token in 0..6 {
            let count = |item: Item<'_>| {
                statuses += usize::from(matches!(item, Item::Status(_)));
                Ok::<_, PipelineError>(())
            };
            pipeline.receive(&link.segment(2000, token), count).unwrap();
            pipeline.skip(usize::MAX);
        }
        assert!(statuses >= 4, "{statuses}");
        assert_eq!(pipeline.contradicts_crystal(), contradicts, "{permille}");
    }
}

/// A pipeline that takes the poses of a board with the head of a scene whose hash is that of `wide`, or another; and what
/// came of some hundred frames.
fn of_board(source: PoseSource, change: u64) -> (Pipeline, Vec<Record>, Vec<Oddity>) {
    of_stream(if source == PoseSource::Board { Stream::POSES } else { Stream::BOTH }, source, change, 3)
}

/// The same of a board that is told to send `stream`, for some hundred frames times `segments`.
fn of_stream(stream: Stream, source: PoseSource, change: u64, segments: u32) -> (Pipeline, Vec<Record>, Vec<Oddity>) {
    let mut link = SimulatedLink::new();
    let (mut pipeline, mut said) = (link.pipeline(), None);
    let heard = pipeline.push(&link.segment(1, 0).bytes, |item| {
        if let Item::Hello(hello) = item {
            said = Some((hello.schedule.clone(), hello.scaling));
        }
        Ok::<_, PipelineError>(())
    });
    heard.unwrap();
    let (schedule, scaling) = said.unwrap();
    let hashes = Hashes { scene: Some(link.file.hash ^ change), calibration: None };
    let head = board_head::encode(&link.file, &schedule, &scaling, hashes).unwrap();
    for (number, part) in (10..).zip(HeadPart::all(&head)) {
        link.board.ask(number, Command::Head(part));
    }
    link.board.ask(9, Command::Stream(stream));
    pipeline = link.pipeline().following(PipelineOptions { source, ..PipelineOptions::default() });
    // The session began without it.
    link.board.ask(8, Command::Hello);
    let (mut records, mut oddities) = (Vec::new(), Vec::new());
    for token in 0..segments {
        let segment = link.segment(400, token);
        let taken = pipeline.feed(&segment, |item| {
            match item {
                Item::Pose(record) => records.push(*record),
                Item::Oddity { oddity, .. } => oddities.push(oddity),
                _ => {}
            }
            Ok::<_, PipelineError>(())
        });
        taken.unwrap();
    }
    (pipeline, records, oddities)
}

#[test]
fn poses_of_the_board_are_passed_on_and_checked_by_a_sample_of_its_scans() {
    let (pipeline, records, oddities) = of_board(PoseSource::Board, 0);
    assert!(oddities.is_empty(), "{oddities:?}");
    let counts = pipeline.counts();
    assert_eq!((counts.scans, counts.scans_lost, counts.scans_skipped), (records.len() as u64, 0, 0));
    assert!(records.windows(2).all(|pair| pair[1].sequence == pair[0].sequence + 1));
    assert!(records.len() > 1190, "{}", records.len());
    for record in &records[20..] {
        let (found, truth) = (record.solution.estimate.unwrap(), record.truth.unwrap());
        let (dt, dr) = found.pose.displacement_from(&truth);
        let off = [dt.x, dt.y, dt.z, dr.x, dr.y, dr.z];
        // Of 7,000 normal numbers 4e-3 lie beyond 5 σ.
        assert!(off.iter().zip(found.sigma()).all(|(off, sigma)| off.abs() < 5.0 * sigma), "{off:?}");
        assert!(record.host_time.is_some() && record.arrival.is_some());
    }
    // Two samples of 32 scans, the first of which lacks some, and 16 of each show how the tool moves.
    let agreement = pipeline.agreement().unwrap();
    assert!((25..32).contains(&agreement.compared), "{agreement:?}");
    assert_eq!((agreement.one_sided, agreement.missed), (0, 0));
    // Optics to 1e-4 of currents of some microamperes are 0.1 nA, of some nanoamperes of noise.
    assert!(agreement.worst_sigmas < 0.5 && agreement.recent_rms_sigmas > 1e-6, "{agreement:?}");
}

#[test]
fn where_all_scans_come_the_poses_are_found_here_and_all_are_compared() {
    let (pipeline, records, _) = of_board(PoseSource::Host, 0);
    let mut alone = SimulatedLink::new();
    let mut host = alone.pipeline();
    alone.segment(1, 0);
    alone.board.ask(9, Command::Stream(Stream::SCANS));
    alone.board.ask(8, Command::Hello);
    for (token, records) in (0..).zip(records.chunks(400)) {
        let (_, expected) = feed(&mut host, &alone.segment(400, token));
        for (record, expected) in records.iter().zip(&expected) {
            assert_eq!(record.sequence, expected.sequence);
            assert_eq!(record.solution.estimate, expected.solution.estimate);
        }
    }
    let agreement = pipeline.agreement().unwrap();
    assert!(agreement.compared > 1170 && agreement.worst_sigmas < 0.5, "{agreement:?}");
}

#[test]
fn poses_by_another_head_are_left_out_and_told_once() {
    let (pipeline, records, oddities) = of_board(PoseSource::Board, 1);
    assert_eq!((records.len(), oddities), (0, vec![Oddity::OtherHead]));
    assert_eq!(pipeline.agreement(), None);
    let (pipeline, records, oddities) = of_board(PoseSource::Host, 1);
    assert!(records.len() > 1190 && oddities.is_empty() && pipeline.agreement().is_none());
}

#[test]
fn poses_without_scans_to_check_them_by_are_unchecked_within_two_seconds() {
    for (stream, is_unchecked) in [(Stream { scans: 0, ..Stream::POSES }, true), (Stream::POSES, false)] {
        // 1.4 s and 1.8 s at 4 kHz, and no check lies more than a quarter of a second before the end.
        for (segments, is_late) in [(14, false), (18, true)] {
            let (pipeline, records, _) = of_stream(stream, PoseSource::Board, 0, segments);
            assert!(records.len() > 390 * segments as usize);
            let agreement = pipeline.agreement().unwrap();
            assert_eq!(agreement.is_unchecked, is_unchecked && is_late, "{stream:?} {segments}: {agreement:?}");
        }
    }
}

#[test]
fn poses_that_cannot_be_right_are_left_out_named_and_counted() {
    use PoseFault::{Cells, Covariance, NoCovariance, Number, Rotation, Unseen};
    type Change = fn(&mut PoseRecord, &mut [f32; TRIANGLE]);
    let sound = PoseRecord {
        status: PoseStatus::Converged,
        cells_used: 0x3f,
        excluded: 0,
        ready: 0,
        translation_m: [1e-3, 0.0, 0.0],
        rotation_xyzw: [0.0, 0.0, 0.0, 1.0],
        chi2: 6.0,
    };
    let cases: &[(Option<PoseFault>, Change)] = &[
        (None, |_, _| {}),
        (None, |record, _| record.rotation_xyzw = [0.0, 0.0, 0.0, -1.000_01]),
        (None, |record, _| (record.cells_used, record.excluded) = (0x1f, 0x20)),
        // Without a pose its numbers mean nothing.
        (None, |record, _| (record.status, record.translation_m) = (PoseStatus::TooDark, [f32::NAN; 3])),
        (Some(Number), |record, _| record.translation_m[1] = f32::NAN),
        (Some(Number), |record, _| record.translation_m[2] = f32::NEG_INFINITY),
        (Some(Number), |record, _| record.rotation_xyzw[0] = f32::NAN),
        (Some(Number), |record, _| record.chi2 = f32::NAN),
        (Some(Number), |record, _| record.chi2 = f32::INFINITY),
        (Some(Number), |record, _| record.chi2 = -1.0),
        (Some(Number), |_, covariance| covariance[1] = f32::NAN),
        (Some(Number), |_, covariance| covariance[20] = f32::INFINITY),
        (Some(Rotation), |record, _| record.rotation_xyzw = [0.0; 4]),
        (Some(Rotation), |record, _| record.rotation_xyzw = [0.0, 0.0, 0.0, 2.0]),
        (Some(Rotation), |record, _| record.rotation_xyzw = [f32::MAX; 4]),
        (Some(NoCovariance), |_, covariance| *covariance = [0.0; TRIANGLE]),
        (Some(Covariance), |_, covariance| covariance[0] = -1e-12),
        (Some(Covariance), |_, covariance| covariance[5] = 0.0),
        (Some(Covariance), |_, covariance| covariance[1] = 1.1e-12),
        (Some(Cells), |record, _| record.cells_used = 0),
        (Some(Cells), |record, _| record.cells_used = 0x21),
        (Some(Cells), |record, _| record.cells_used = 0x7f),
        (Some(Cells), |record, _| record.excluded = 0x8000),
        (Some(Unseen), |record, _| record.translation_m[0] = 1000.0),
        (Some(Unseen), |record, _| record.translation_m = [f32::MAX; 3]),
        (Some(Unseen), |record, _| record.translation_m[0] = 0.3),
    ];
    for (number, (fault, change)) in cases.iter().enumerate() {
        let mut link = SimulatedLink::new();
        let mut pipeline =
            link.pipeline().following(PipelineOptions { source: PoseSource::Board, ..PipelineOptions::default() });
        let (mut record, mut covariance) = (sound, [0.0; TRIANGLE]);
        (0..6).for_each(|i| covariance[i * (i + 3) / 2] = 1e-12);
        change(&mut record, &mut covariance);
        let (mut configuration, mut found, mut named) = (0, Vec::new(), Vec::new());
        let mut push = |bytes: &[u8], configuration: &mut u16| {
            let taken = pipeline.push(bytes, |item| {
                match item {
                    Item::Hello(hello) => *configuration = hello.configuration,
                    Item::Pose(record) => found.push(*record),
                    Item::Oddity { oddity, .. } => named.push(oddity),
                    _ => {}
                }
                Ok::<_, PipelineError>(())
            });
            taken.unwrap();
        };
        push(&link.segment(1, 0).bytes, &mut configuration);
        let head = Hashes { scene: Some(link.file.hash), calibration: None }.number();
        let covariance = Some(covariance).filter(|covariance| *covariance != [0.0; TRIANGLE]);
        for sequence in [1000, 1001] {
            let records = &record.write();
            let tick = sequence * 42_500;
            let poses = Poses { configuration, sequence, tick, every: 1, missed: 0, head, covariance, records };
            push(encode(&Message::Poses(poses), &mut [0; MAX_MESSAGE_BYTES]).unwrap(), &mut configuration);
        }
        assert_eq!(found.len(), 2, "{number}: each is a record");
        let is_pose = fault.is_none() && record.status.has_pose();
        assert!(found.iter().all(|found| found.solution.estimate.is_some() == is_pose), "{number}");
        let named: Vec<_> = named.iter().map(|oddity| (*oddity, oddity.to_string())).collect();
        let counts = pipeline.counts();
        let refused = if fault.is_some() { 2 } else { 0 };
        assert_eq!((counts.poses_refused, counts.outcomes.diverged), (refused, refused), "{number}");
        assert_eq!((counts.has_loss(), pipeline.agreement().unwrap().refused), (refused > 0, refused), "{number}");
        let expected = |count| fault.map(|fault| Oddity::Pose { sequence: 999 + count, fault, count });
        let expected: Vec<_> = [1, 2].into_iter().filter_map(expected).collect();
        assert_eq!(named.iter().map(|(oddity, _)| *oddity).collect::<Vec<_>>(), expected, "{number}: {named:?}");
    }
}
