//! Damaged bytes cost the scans they held and no others, are counted, and never stop a program.
//!
//! In memory, where every position can be tried; `damaged_files` does the same through processes.

use rand::RngExt;
use slitpose_head::scene_file::{SceneFile, WIDE};
use slitpose_head::simulator::{Trajectory, TrajectoryKind};
use slitpose_model::Tier;
use slitpose_protocol::{Batch, Decoder, Event, Hello, Level, MAX_MESSAGE_BYTES, Message, Severity, Truth, encode};
use slitpose_tests::capture::{Packet, capture, packets, pipeline, solve};
use slitpose_tests::consistency::{error, worst_axis};
use slitpose_tests::poses::generator;
use slitpose_tracking::pipeline::{Counts, PipelineError, Record};

/// Scans of the capture: twelve batches of four.
const SCANS: usize = 48;

struct Whole {
    file: SceneFile,
    bytes: Vec<u8>,
    packets: Vec<Packet>,
}

impl Whole {
    fn new() -> Self {
        let file = WIDE.read().expect("shipped");
        let smooth = Trajectory::of_kind(TrajectoryKind::Smooth, 31, 1.0);
        let bytes = capture(&file, smooth, Tier::Paper, 31, SCANS);
        let packets = packets(&bytes);
        assert_eq!(packets.iter().filter(|packet| !packet.scans.is_empty()).count(), SCANS / 4);
        Self { file, bytes, packets }
    }

    /// The packet that holds the byte at `position`.
    fn at(&self, position: usize) -> usize {
        self.packets.iter().position(|packet| packet.bytes.contains(&position)).expect("inside a packet")
    }

    /// The batches that hold scan 20 to 27, with what stands between them.
    fn middle(&self) -> std::ops::Range<usize> {
        let of = |scan| self.packets.iter().position(|packet| packet.scans.contains(&scan)).expect("taken");
        self.packets[of(20)].bytes.start..self.packets[of(24)].bytes.end
    }

    /// Solves `bytes`, in which the packets numbered in `spoiled` cannot be read, and compares what
    /// came through with what should have.
    fn check(&self, bytes: &[u8], spoiled: &[usize], what: &str) -> Counts {
        let (records, counts) = solve(&self.file, Tier::Paper, bytes);
        let lost: Vec<u64> = spoiled.iter().flat_map(|&i| self.packets[i].scans.clone()).collect();
        let expected: Vec<u64> = (0..SCANS as u64).filter(|scan| !lost.contains(scan)).collect();
        let solved: Vec<u64> = records.iter().map(|record| record.sequence).collect();
        assert_eq!(solved, expected, "{what}");
        records.iter().for_each(|record| assert_near_truth(record, what));
        let (first, last) = (expected[0], expected[expected.len() - 1]);
        let gaps = lost.iter().filter(|scan| (first..last).contains(scan)).count();
        assert_eq!(counts.scans_lost, gaps as u64, "{what}");
        assert_eq!(counts.decoder.packets as usize, self.packets.len() - spoiled.len(), "{what}");
        assert_eq!(counts.decoder.bytes, bytes.len() as u64, "{what}");
        counts
    }
}

/// Every solved scan has a pose; those whose truth came through show that it is right.
fn assert_near_truth(record: &Record, what: &str) {
    let estimate = record.solution.estimate.unwrap_or_else(|| panic!("{what}: scan {} has no pose", record.sequence));
    if let Some(truth) = record.truth {
        let worst = worst_axis(&error(&estimate.pose, &truth), &estimate.covariance);
        // One normal number in 5e8 lies beyond 6 σ, and the same few hundred scans are tried each time.
        assert!(worst < 6.0, "{what}: scan {} is {worst} σ off", record.sequence);
    }
}

#[test]
fn every_flipped_byte_costs_its_packet() {
    let whole = Whole::new();
    for position in whole.middle() {
        let packet = whole.at(position);
        let is_end = position + 1 == whole.packets[packet].bytes.end;
        // One bit, all bits, and whatever makes a delimiter of the byte.
        for mask in [0x01, 0xff, whole.bytes[position]] {
            let mut bytes = whole.bytes.clone();
            bytes[position] ^= mask;
            if bytes[position] == whole.bytes[position] {
                continue;
            }
            // Without its end a packet runs into the next.
            let spoiled = if is_end { vec![packet, packet + 1] } else { vec![packet] };
            let counts = whole.check(&bytes, &spoiled, &format!("byte {position} ^ {mask:#x}"));
            assert!(
                counts.has_loss() && counts.decoder.bytes_skipped > 0,
                "byte {position} ^ {mask:#x} went unnoticed"
            );
        }
    }
}

#[test]
fn every_dropped_packet_is_a_gap() {
    let whole = Whole::new();
    let hello = whole.packets.iter().position(|packet| !packet.scans.is_empty()).expect("batches");
    for (i, packet) in whole.packets.iter().enumerate().skip(hello) {
        let bytes = [&whole.bytes[..packet.bytes.start], &whole.bytes[packet.bytes.end..]].concat();
        let counts = whole.check(&bytes, &[i], &format!("without packet {i}"));
        assert_eq!(counts.decoder.bytes_skipped, 0);
        // The first and the last batch leave no gap between scans that came.
        assert_eq!(counts.has_loss(), counts.scans_lost > 0, "without packet {i}");
    }
}

#[test]
fn garbage_is_passed_over() {
    let whole = Whole::new();
    let mut rng = generator(32);
    for i in 0..whole.packets.len() {
        let start = whole.packets[i].bytes.start;
        // Up to three times what any packet has.
        let length = rng.random_range(1..3 * MAX_MESSAGE_BYTES);
        let mut garbage: Vec<u8> = (0..length).map(|_| rng.random_range(1..=u8::MAX)).collect();
        let insert = |garbage: &[u8]| [&whole.bytes[..start], garbage, &whole.bytes[start..]].concat();
        let what = format!("{length} bytes ahead of packet {i}");

        // Unless the packet holds the schedule, the rest does without it.
        if whole.packets[i..].iter().any(|packet| !packet.scans.is_empty()) && !is_hello(&whole, i) {
            let counts = whole.check(&insert(&garbage), &[i], &what);
            assert!(counts.decoder.bytes_skipped > length as u64, "{what}");
        }
        garbage.push(0);
        let counts = whole.check(&insert(&garbage), &[], &format!("{what}, ended"));
        assert_eq!(counts.decoder.bytes_skipped, length as u64 + 1, "{what}");
        assert!(counts.has_loss(), "{what}");
        // Delimiters alone mean nothing.
        let counts = whole.check(&insert(&[0; 7]), &[], &format!("delimiters ahead of packet {i}"));
        assert!(!counts.has_loss(), "delimiters ahead of packet {i}");
    }
}

fn is_hello(whole: &Whole, i: usize) -> bool {
    whole.packets[..=i].iter().all(|packet| packet.scans.is_empty())
}

#[test]
fn many_faults_at_once_cost_only_what_they_hit() {
    let whole = Whole::new();
    let mut rng = generator(33);
    let schedule_end = whole.packets.iter().find(|packet| !packet.scans.is_empty()).expect("batches").bytes.start;
    for round in 0..300 {
        let mut bytes = whole.bytes.clone();
        let mut hit = Vec::new();
        for _ in 0..rng.random_range(1..20) {
            let position = rng.random_range(schedule_end..bytes.len());
            bytes[position] ^= rng.random_range(1..=u8::MAX);
            let packet = whole.at(position);
            hit.extend([packet, packet + usize::from(position + 1 == whole.packets[packet].bytes.end)]);
        }
        let (records, counts) = solve(&whole.file, Tier::Paper, &bytes);
        let spared = whole.packets.iter().enumerate().filter(|(i, _)| !hit.contains(i));
        let spared: Vec<u64> = spared.flat_map(|(_, packet)| packet.scans.clone()).collect();
        let solved: Vec<u64> = records.iter().map(|record| record.sequence).collect();
        // A second flip may undo the first.
        assert!(spared.iter().all(|scan| solved.contains(scan)), "round {round}: {solved:?} of {spared:?}");
        assert!(solved.is_sorted_by(|a, b| a < b), "round {round}: {solved:?}");
        records.iter().for_each(|record| assert_near_truth(record, &format!("round {round}")));
        assert!(counts.has_loss() || bytes == whole.bytes, "round {round}");
    }
}

#[test]
fn undamaged_nonsense_gives_no_nonsense() {
    let whole = Whole::new();
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
        let mut bytes = whole.bytes.clone();
        for message in &messages {
            let mut buffer = [0; MAX_MESSAGE_BYTES];
            bytes.extend_from_slice(encode(message, &mut buffer).expect("room"));
        }
        let (records, counts) = solve(&whole.file, Tier::Paper, &bytes);
        // A number that has come already is left out.
        let repeated = usize::from(sequence < SCANS as u64);
        assert_eq!((records.len(), counts.batches_unreadable), (SCANS + 1 - repeated, 1), "round {round}");
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
    let whole = Whole::new();
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
        let mut rest = whole.bytes.as_slice();
        let mut hello = loop {
            if let Message::Hello(hello) = decoder.next(&mut rest).expect("a hello").expect("undamaged") {
                break hello;
            }
        };
        change(&mut hello);
        let mut buffer = [0; MAX_MESSAGE_BYTES];
        let bytes = encode(&Message::Hello(hello), &mut buffer).expect("room");
        let refused = pipeline(&whole.file, Tier::Paper).push::<PipelineError>(bytes, |_| Ok(()));
        let message = refused.expect_err(what).to_string();
        assert!(message.contains("simulated"), "{what}: the board is not named in: {message}");
    }
}
