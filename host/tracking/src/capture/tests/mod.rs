//! Captures as a whole: written, cut, damaged, split, and read again.

mod damage;
mod series;

use std::collections::BTreeMap;
use std::io::{self, Write};
use std::path::Path;
use std::sync::{Arc, Mutex};
use std::time::Duration;

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use slitpose_model::Tier;
use slitpose_protocol::{Command, DELIMITER, Decoder, MAX_MESSAGE_BYTES, Message, RawScan, Schedule};

use super::file::{CaptureFile, Channels};
use super::*;
use crate::clock::{HostInstant, HostTime};
use crate::link::{Asked, DeviceId, Segment};
use crate::pipeline::{Item, Pipeline, PipelineError, PipelineOptions, Record, SceneMatch};
use crate::telemetry::report_schema;
use slitpose_head::scene_file::{BENCH, SceneFile, WIDE};
use slitpose_head::simulator::{SimulatedBoard, Trajectory, TrajectoryKind};
use slitpose_head::threads::lock;

const FIRST: DeviceId = DeviceId(*b"first board.");
const SECOND: DeviceId = DeviceId(*b"second board");

/// Some time in 2025.
const BEGIN: HostInstant = HostInstant { monotonic_ns: 5_000_000_000, utc_ns: 1_750_000_000_000_000_000 };

const MS: u64 = 1_000_000;

fn later(at: HostInstant, ns: u64) -> HostInstant {
    HostInstant { monotonic_ns: at.monotonic_ns + ns, utc_ns: at.utc_ns + ns }
}

fn settings() -> Settings {
    Settings {
        tier: Tier::Exact { tolerance: 1e-6 },
        following: PipelineOptions { without_clipped: true, ..PipelineOptions::default() },
    }
}

fn setup(device: DeviceId) -> Setup {
    Setup::new(device, &WIDE.read().unwrap().into(), settings())
}

/// A capture of one file, which must not be there.
fn begun(path: &Path) -> CaptureSeries {
    CaptureSeries::create(path, Limits::default(), Existing::Kept).unwrap()
}

/// What a simulated board with the head of `file` sends in each of `scans` frames, with or without
/// the true poses that only simulators know.
fn stream(file: &SceneFile, scans: usize, truths: bool) -> Vec<Vec<u8>> {
    let trajectory = Trajectory::of_kind(TrajectoryKind::Smooth, 1, 10.0);
    let mut board = SimulatedBoard::new(file, trajectory, Tier::Paper, 1).unwrap();
    board.ask(1, Command::Start);
    let mut frame = || {
        let mut bytes = Vec::new();
        board.step(&mut bytes);
        if !truths {
            let packets = bytes.split_inclusive(|&byte| byte == DELIMITER);
            bytes = packets.filter(|packet| !is_truth(packet)).flatten().copied().collect();
        }
        bytes
    };
    (0..scans).map(|_| frame()).collect()
}

fn is_truth(mut packet: &[u8]) -> bool {
    let mut decoder = Decoder::<MAX_MESSAGE_BYTES>::new();
    matches!(decoder.next::<Message<'_>>(&mut packet), Some(Ok(Message::Truth(_))))
}

#[derive(Debug, Default, PartialEq)]
struct Content {
    setups: Vec<Setup>,
    hellos: Vec<(DeviceId, Vec<u8>)>,
    links: Vec<(Option<DeviceId>, u64, Segment)>,
    notes: Vec<(u64, String)>,
}

impl Content {
    /// Each byte of a board with the time of its read.
    fn bytes(&self, device: DeviceId) -> Vec<(u8, Option<HostInstant>)> {
        let of_board = self.links.iter().filter(|(of, ..)| *of == Some(device));
        of_board.flat_map(|(.., segment)| bytes(segment)).collect()
    }
}

fn bytes(segment: &Segment) -> Vec<(u8, Option<HostInstant>)> {
    segment.chunks().flat_map(|(bytes, at)| bytes.iter().map(move |byte| (*byte, at))).collect()
}

fn read_all<R: io::Read + io::Seek>(mut reader: CaptureReader<R>) -> (Content, End) {
    let (mut content, mut segment) = (Content::default(), Segment::default());
    while let Some(entry) = reader.next(&mut segment).unwrap() {
        match entry {
            Entry::Setup(setup) => content.setups.push(*setup),
            Entry::Hello { device, .. } => content.hellos.push((device, segment.bytes.clone())),
            Entry::Link { device, log_ns } => content.links.push((device, log_ns, segment.clone())),
            Entry::Note { stamp_ns, text, .. } => content.notes.push((stamp_ns, text)),
        }
    }
    (content, reader.end())
}

fn read_file(path: &Path) -> (Content, End) {
    read_all(CaptureReader::open(path).unwrap())
}

fn read(bytes: &[u8]) -> (Content, End) {
    read_all(CaptureReader::new(Path::new("memory"), io::Cursor::new(bytes)).unwrap())
}

fn segments(content: Content) -> Vec<Segment> {
    content.links.into_iter().map(|(.., segment)| segment).collect()
}

fn joined(content: Content) -> Vec<u8> {
    segments(content).into_iter().flat_map(|segment| segment.bytes).collect()
}

/// A disk of so many bytes, and what is on it.
#[derive(Clone)]
struct Disk {
    bytes: Arc<Mutex<Vec<u8>>>,
    room: usize,
}

impl Disk {
    fn of(room: usize) -> Self {
        Self { bytes: Arc::default(), room }
    }

    fn begin(&self) -> CaptureFile {
        CaptureFile::create(Box::new(self.clone()), "").unwrap()
    }

    fn bytes(&self) -> Vec<u8> {
        lock(&self.bytes).clone()
    }
}

impl Write for Disk {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let mut written = lock(&self.bytes);
        let taken = bytes.len().min(self.room - written.len());
        written.extend_from_slice(&bytes[..taken]);
        if taken == 0 { Err(io::ErrorKind::StorageFull.into()) } else { Ok(taken) }
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

impl Medium for Disk {
    fn sync(&mut self) -> io::Result<()> {
        Ok(())
    }

    fn truncate(&mut self, length: u64) -> io::Result<()> {
        lock(&self.bytes).truncate(length as usize);
        Ok(())
    }
}

/// Records the frames of two boards as links deliver them, cut anywhere, and gives what was delivered.
fn record_two(series: &mut CaptureSeries, frames: &[Vec<u8>]) -> Content {
    let mut random = ChaCha8Rng::seed_from_u64(15);
    let mut delivered = Content::default();
    let all = frames.concat();
    let mut taken = [0; 2];
    for device in [FIRST, SECOND] {
        series.add_device(setup(device), None, 0).unwrap();
        delivered.setups.push(setup(device));
    }
    let mut at = BEGIN;
    while taken != [all.len(); 2] {
        for (taken, device) in taken.iter_mut().zip([FIRST, SECOND]) {
            let mut segment = Segment { opened: *taken == 0, ..Segment::default() };
            for _ in 0..random.random_range(0..20) {
                at = later(at, random.random_range(1..2 * MS));
                let length = random.random_range(1..300).min(all.len() - *taken);
                segment.push(&all[*taken..*taken + length], Some(at));
                *taken += length;
            }
            if random.random_bool(0.1) {
                segment.asked.push(Asked { token: random.random(), at });
            }
            series.segment(device, &segment, at.utc_ns).unwrap();
            delivered.links.push((Some(device), at.utc_ns, segment));
        }
    }
    delivered
}

fn solve(bytes: &[u8]) -> (Vec<Record>, Pipeline) {
    let mut pipeline = Pipeline::new(WIDE.read().unwrap(), Tier::Paper, SceneMatch::Required);
    let mut records = Vec::new();
    let pushed = pipeline.push(bytes, |item| {
        if let Item::Pose(record) = item {
            records.push(*record);
        }
        Ok::<_, PipelineError>(())
    });
    pushed.unwrap();
    (records, pipeline)
}

#[test]
fn what_is_skipped_leaves_its_hello() {
    let frames = stream(&WIDE.read().unwrap(), 400, true);
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("one.mcap");
    let mut series = begun(&path);
    let delivered = record_two(&mut series, &frames);
    series.finish().unwrap();
    let middle = delivered.links[delivered.links.len() / 2].1;
    let (content, end) = read_all(CaptureReader::open(&path).unwrap().starting_at(middle));
    assert!(!end.has_loss());
    assert_eq!(content.setups.len(), 2);
    assert!(content.links.iter().all(|(_, log_ns, _)| *log_ns >= middle));
    for device in [FIRST, SECOND] {
        let (all, kept) = (delivered.bytes(device), content.bytes(device));
        assert!(kept.len() < all.len() && all.ends_with(&kept), "{} of {}", kept.len(), all.len());
    }
    let mut packets = content.hellos[0].1.clone();
    packets.extend(content.bytes(content.hellos[0].0).iter().map(|(byte, _)| byte));
    let (records, pipeline) = solve(&packets);
    assert_eq!(records.last().unwrap().sequence, 399);
    assert!(records[0].sequence > 0 && !pipeline.counts().has_loss());
}

#[test]
fn poses_and_reports_are_there_for_other_programs() {
    let frames = stream(&WIDE.read().unwrap(), 40, true);
    let (records, _) = solve(&frames.concat());
    let mut record = Record { device: FIRST, ..records[20] };
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("poses.mcap");
    let mut series = begun(&path);
    series.add_device(setup(FIRST), None, 1).unwrap();
    series.pose(&record, 2).unwrap();
    let at = HostTime { monotonic_ns: 7, utc_ns: BEGIN.utc_ns, uncertainty_ns: 8 };
    record.host_time = Some(at);
    series.pose(&record, 3).unwrap();
    series.report(Some(FIRST), &BTreeMap::from([("well", true)]), 4).unwrap();
    series.report(None, &BTreeMap::from([("well", false)]), 5).unwrap();
    series.note(BEGIN.utc_ns, "contact", 6).unwrap();
    assert_eq!(contents(&path).unwrap(), None, "not ended");
    series.finish().unwrap();
    let known = contents(&path).unwrap().unwrap();
    assert_eq!((known.boards.len(), known.notes), (0, 1), "no bytes of a board: {known:?}");
    assert!((known.length_s - 4e-9).abs() < 1e-12, "{known:?}");
    assert_eq!(read_file(&path).0.notes, [(BEGIN.utc_ns, "contact".to_owned())]);

    let bytes = std::fs::read(&path).unwrap();
    let messages: Vec<_> = mcap::MessageStream::new(&bytes).unwrap().map(|message| message.unwrap()).collect();
    let told: Vec<_> = messages
        .iter()
        .map(|message| {
            let schema = message.channel.schema.as_ref().unwrap();
            let topic = message.channel.topic.replace(&FIRST.to_string(), "ID");
            (topic, schema.name.as_str(), message.channel.message_encoding.as_str(), message.log_time)
        })
        .collect();
    let of_pose = |log_ns| {
        [
            ("/slitpose/board_ID/pose", "geometry_msgs/msg/PoseWithCovarianceStamped"),
            ("/slitpose/board_ID/pose_stamped", "geometry_msgs/msg/PoseStamped"),
            ("/tf", "tf2_msgs/msg/TFMessage"),
            ("/slitpose/board_ID/twist", "geometry_msgs/msg/TwistWithCovarianceStamped"),
        ]
        .map(|(topic, schema)| (topic.to_owned(), schema, "cdr", log_ns))
    };
    let report = |topic: &str, log_ns| (topic.to_owned(), "std_msgs/msg/String", "cdr", log_ns);
    let reports = [report("/slitpose/board_ID/report", 4), report("/slitpose/report", 5)];
    let head = ("/slitpose/board_ID/head".to_owned(), "visualization_msgs/msg/MarkerArray", "cdr", 2);
    let note = ("/slitpose/notes".to_owned(), "rcl_interfaces/msg/Log", "cdr", 6);
    assert_eq!(told, [&[head], &of_pose(2)[..], &of_pose(3), &reports, &[note]].concat());
    let messages = &messages[1..];
    assert_eq!(messages[0].sequence, 20);
    assert_eq!((messages[0].publish_time, messages[4].publish_time), (2, BEGIN.utc_ns));
    // Stamps: device time while the host's is not known.
    let stamp_s =
        |message: &mcap::Message<'_>, at: usize| u32::from_le_bytes(message.data[at..at + 4].try_into().unwrap());
    for index in 0..4 {
        // A list of transforms begins with their number.
        let at = if index == 2 { 8 } else { 4 };
        let stamps = (stamp_s(&messages[index], at), stamp_s(&messages[index + 4], at));
        assert_eq!(stamps, (0, 1_750_000_000), "message {index}");
    }
    assert_eq!(*messages[8].data, *b"\x00\x01\x00\x00\x0e\x00\x00\x00{\"well\":true}\x00");
    let schema = mcap::read::Summary::read(&bytes).unwrap().unwrap().attachment_indexes;
    let schema = schema.iter().find(|attachment| attachment.name == "report.schema.json").unwrap();
    let schema = mcap::read::attachment(&bytes, schema).unwrap();
    let schema_of_reports = report_schema().as_value().to_string();
    assert_eq!((&*schema.data, &*schema.media_type), (schema_of_reports.as_bytes(), "application/schema+json"));
}
