//! Captures that are damaged, cut off, nonsense or none at all, and results that cannot be written: exit code,
//! message, and no half result under a final name.

use std::path::PathBuf;

use rand::RngExt;
use slitpose_head::scene_file::{SceneFile, WIDE};
use slitpose_head::simulator::{Trajectory, TrajectoryKind};
use slitpose_model::Tier;
use slitpose_protocol::{Batch, Decoder, Event, Hello, Level, MAX_MESSAGE_BYTES, Message, Severity, Truth, encode};
use slitpose_tests::capture::{Packet, capture, packets, pipeline, solve};
use slitpose_tests::poses::generator;
use slitpose_tests::process::{names, text};
use slitpose_tests::slitpose;
use slitpose_tracking::pipeline::PipelineError;

/// 100 batches of four scans.
const SCANS: usize = 400;

struct Capture {
    folder: tempfile::TempDir,
    bytes: Vec<u8>,
    packets: Vec<Packet>,
    /// What replaying it undamaged prints.
    lines: Vec<Vec<u8>>,
}

impl Capture {
    fn new() -> Self {
        let folder = tempfile::tempdir().expect("temporary folder");
        let output = slitpose!().run(["simulate", "--raw", "--output", "-", "--duration", "100ms", "--seed", "41"]);
        let packets = packets(&output.stdout);
        let capture = Self { folder, bytes: output.stdout, packets, lines: Vec::new() };
        let whole = slitpose!().run(["replay", text(&capture.file(&capture.bytes)), "--tier", "paper"]);
        assert_eq!((whole.code, whole.stderr.as_str()), (0, ""));
        let lines: Vec<_> = whole.stdout.split_inclusive(|byte| *byte == b'\n').map(<[u8]>::to_vec).collect();
        assert_eq!(lines.len(), SCANS);
        Self { lines, ..capture }
    }

    fn file(&self, bytes: &[u8]) -> PathBuf {
        let path = self.folder.path().join("damaged.capture");
        std::fs::write(&path, bytes).expect("capture");
        path
    }

    /// Replays `bytes`, from which the scans `lost` are gone, and checks what is printed.
    fn replay(&self, bytes: &[u8], lost: std::ops::Range<usize>, parts: &[&str]) {
        let finished = slitpose!().run(["replay", text(&self.file(bytes)), "--tier", "paper"]);
        finished.assert_said(3, parts);
        let lines: Vec<&[u8]> = finished.stdout.split_inclusive(|byte| *byte == b'\n').collect();
        assert_eq!(lines.len(), SCANS - lost.len());
        // What comes ahead of the damage is what it was; behind it the tracker starts anew.
        assert!(lines[..lost.start].iter().eq(self.lines[..lost.start].iter()));
        let sequences = |lines: &[&[u8]]| -> Vec<Vec<u8>> {
            lines.iter().map(|line| line.split(|byte| *byte == b',').next().expect("seq").to_vec()).collect()
        };
        let expected: Vec<&[u8]> =
            self.lines[..lost.start].iter().chain(&self.lines[lost.end..]).map(Vec::as_slice).collect();
        assert_eq!(sequences(&lines), sequences(&expected));
        assert!(
            slitpose_tests::ndjson::parse(&String::from_utf8(finished.stdout.clone()).expect("UTF-8"))
                .iter()
                .all(|line| line.estimate.is_some())
        );
    }

    fn packet_of(&self, scan: u64) -> &Packet {
        self.packets.iter().find(|packet| packet.scans.contains(&scan)).expect("taken")
    }
}

#[test]
fn damage_is_told_and_ends_with_three() {
    let capture = Capture::new();
    let hit = capture.packet_of(200).clone();
    let lost = hit.scans.start as usize..hit.scans.end as usize;

    let mut flipped = capture.bytes.clone();
    flipped[hit.bytes.start + 50] ^= 0x10;
    capture.replay(&flipped, lost.clone(), &["damaged or lost", "4 scans missing", "1 damaged"]);

    let dropped = [&capture.bytes[..hit.bytes.start], &capture.bytes[hit.bytes.end..]].concat();
    capture.replay(&dropped, lost, &["4 scans missing", "0 damaged"]);

    let garbage = [&capture.bytes[..hit.bytes.start], b"garbage\0", &capture.bytes[hit.bytes.start..]].concat();
    capture.replay(&garbage, 0..0, &["0 scans missing", "1 damaged", "8 bytes skipped"]);

    let cut = &capture.bytes[..hit.bytes.start + 50];
    capture.replay(cut, 200..SCANS, &["0 scans missing", "50 bytes of a packet that was cut off"]);
}

/// Joined by `cat`: what is behind the first capture is not read, and said to be there.
#[test]
fn captures_joined_into_one_file_are_no_series() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let path = |name: &str| text(&folder.path().join(name)).to_owned();
    let simulate = |name| {
        let arguments = ["simulate", "--duration", "50ms", "--tier", "paper", "--output"].map(str::to_owned);
        assert_eq!(slitpose!().run(arguments.into_iter().chain([path(name)])).code, 0);
        std::fs::read(path(name)).expect("a capture")
    };
    let (first, second) = (simulate("a.mcap"), simulate("b.mcap"));
    std::fs::write(path("joined.mcap"), [&first[..], &second].concat()).expect("a file");
    let lines =
        |finished: &slitpose_tests::process::Finished| finished.stdout.iter().filter(|byte| **byte == b'\n').count();
    let joined = slitpose!().run(["replay", &path("joined.mcap")]);
    let parts = [format!("{} bytes behind the end", second.len()), "as a series".to_owned()];
    assert!(joined.code == 3 && parts.iter().all(|part| joined.stderr.contains(part)), "{}", joined.stderr);
    assert!(!joined.stderr.contains("nothing is missing"), "{}", joined.stderr);
    let series = slitpose!().run(["replay", &path("a.mcap"), &path("b.mcap")]);
    assert_eq!((lines(&joined), lines(&series)), (200, 400));
    let first = path("a.mcap");
    slitpose!().run(["replay", &first, &first]).assert_refused(1, &[&first, "given twice"]);
}

#[test]
fn what_holds_no_scan_is_no_capture() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let path = folder.path().join("no.capture");
    for (bytes, what, next_step) in [
        (&b""[..], "no scan: 0 bytes", "--record"),
        (&[0; 100], "no scan: 100 bytes", "--record"),
        (b"id,tx_mm\n1,2\n", "not a capture but a text", "--record"),
        (b"version https://git-lfs.github.com/spec/v1\noid sha256:0\n", "a Git LFS pointer", "git lfs pull"),
        (b"#ROSBAG V2.0\nE\0\0\0", "a ROS 1 bag", "--record"),
        (b"\x1f\x8b\x08\0", "compressed by gzip", "gunzip"),
    ] {
        std::fs::write(&path, bytes).expect("file");
        slitpose!().run(["replay", text(&path)]).assert_refused(1, &[text(&path), what, next_step]);
    }
    let missing = folder.path().join("missing.capture");
    slitpose!().run(["replay", text(&missing)]).assert_refused(1, &[text(&missing), "cannot read", "--record"]);
    slitpose!().run(["replay", text(folder.path())]).assert_refused(1, &[text(folder.path()), "cannot read"]);
}

#[test]
fn a_capture_without_its_hello_cannot_be_read() {
    let capture = Capture::new();
    let path = capture.file(&capture.bytes[capture.packet_of(0).bytes.start..]);
    slitpose!()
        .run(["replay", text(&path)])
        .assert_refused(1, &[text(&path), "100 batches without a hello", "no scan"]);
}

#[test]
fn a_place_that_cannot_be_written_is_refused_before_any_work() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let poses = folder.path().join("poses.csv");
    std::fs::write(&poses, "id,tx_mm,ty_mm,tz_mm,rx_rad,ry_rad,rz_rad\na,0,0,0,0,0,0\n").expect("poses");
    let nowhere = folder.path().join("no/such/folder/result");
    for target in [text(&nowhere), text(folder.path())] {
        let short = ["--duration", "1ms"];
        for command in [
            [&["run", "--device", "sim", "--speed", "max", "--record", target][..], &short].concat(),
            [&["simulate", "--output", target][..], &short].concat(),
            [&["simulate", "--output", "-", "--truth", target][..], &short].concat(),
            vec!["model", "wide", "--poses", text(&poses), "--output", target],
        ] {
            slitpose!().run(&command).assert_refused(1, &["cannot write", target]);
        }
    }
    assert_eq!(names(folder.path()), ["poses.csv"]);
}

/// Scans of a short capture, in memory.
const SHORT: usize = 48;

fn short() -> (SceneFile, Vec<u8>) {
    let file = WIDE.read().expect("shipped");
    let bytes = capture(&file, Trajectory::of_kind(TrajectoryKind::Smooth, 31, 1.0), Tier::Paper, 31, SHORT);
    (file, bytes)
}

#[test]
fn undamaged_nonsense_gives_no_nonsense() {
    let (file, whole) = short();
    let mut rng = generator(34);
    for round in 0..2000 {
        let mut any = || rng.random_range(0..=u16::MAX);
        let levels = (0..6).map(|_| Level([0, 1, 0x8000, any()][usize::from(any() % 4)])).collect();
        let words: Vec<u8> = (0..24).flat_map(|_| [0, u16::MAX, any()][usize::from(any() % 3)].to_le_bytes()).collect();
        let sequence = [100, u64::MAX - 1, u64::from(any())][usize::from(any() % 3)];
        let truth = [f64::NAN, 1e300, 0.0][usize::from(any() % 3)];
        let messages = [
            Message::Truth(Truth { sequence, translation_m: [truth; 3], rotation_xyzw: [truth; 4] }),
            Message::Batch(Batch { configuration: 1, sequence, tick: 42, levels, samples: &words }),
            Message::Batch(Batch {
                configuration: 1,
                sequence: u64::MAX,
                tick: u64::MAX,
                levels: [Level::NOMINAL; 6].into_iter().collect(),
                samples: &words,
            }),
            Message::Event(Event { tick: u64::MAX, severity: Severity::Error, text: "\u{1b}[2J" }),
        ];
        let mut bytes = whole.clone();
        for message in &messages {
            let mut buffer = [0; MAX_MESSAGE_BYTES];
            bytes.extend_from_slice(encode(message, &mut buffer).expect("room"));
        }
        let (records, counts) = solve(&file, Tier::Paper, &bytes);
        // A number that has come already is left out.
        let repeated = usize::from(sequence < SHORT as u64);
        assert_eq!((records.len(), counts.batches_unreadable), (SHORT + 1 - repeated, 1), "round {round}");
        assert_eq!(counts.scans_repeated, repeated as u64, "round {round}");
        let last = records[records.len() - 1];
        assert!(last.truth.is_none_or(|truth| truth.is_finite()), "round {round}: {last:?}");
        assert_eq!(last.solution.estimate.is_some(), last.solution.outcome.has_pose(), "round {round}");
        if let Some(estimate) = last.solution.estimate {
            let variances = (0..6).map(|i| estimate.covariance[i][i]);
            assert!(estimate.pose.is_finite() && variances.into_iter().all(|v| v > 0.0), "round {round}: {last:?}");
        }
    }
}

type Change = fn(&mut Hello<'_>);

#[test]
fn a_hello_that_contradicts_itself_is_refused() {
    let (file, whole) = short();
    let changes: [(&str, Change); 9] = [
        ("no slots", |hello| hello.schedule.slots.clear()),
        ("no time", |hello| hello.schedule.tick_hz = 0),
        ("no frame", |hello| hello.schedule.frame_ticks = 0),
        ("no conversions", |hello| hello.schedule.oversampling = 0),
        ("more cells than any board", |hello| hello.schedule.cells = u8::MAX),
        ("fewer cells than the scene", |hello| hello.schedule.cells = 5),
        ("no scale", |hello| hello.scaling.amperes_per_code = f64::NAN),
        ("no zero", |hello| hello.scaling.zero_code = f64::INFINITY),
        ("wider than a word", |hello| hello.scaling.bits = 40),
    ];
    for (what, change) in changes {
        let mut decoder = Decoder::<MAX_MESSAGE_BYTES>::new();
        let mut rest = whole.as_slice();
        let mut hello = loop {
            if let Message::Hello(hello) = decoder.next(&mut rest).expect("a hello").expect("undamaged") {
                break hello;
            }
        };
        change(&mut hello);
        let mut buffer = [0; MAX_MESSAGE_BYTES];
        let bytes = encode(&Message::Hello(hello), &mut buffer).expect("room");
        let refused = pipeline(&file, Tier::Paper).push::<PipelineError>(bytes, |_| Ok(()));
        let message = refused.expect_err(what).to_string();
        assert!(message.contains("simulated"), "{what}: the board is not named in: {message}");
    }
}
