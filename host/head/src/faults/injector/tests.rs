//! Bytes of a simulated board with faults.

use rand::SeedableRng;
use slitpose_model::Tier;
use slitpose_protocol::Command;

use super::*;
use crate::faults::KINDS;
use crate::scene_file::WIDE;
use crate::simulator::{SimulatedBoard, Trajectory, TrajectoryKind};

const SCANS: usize = 400;

fn faults(texts: &[&str]) -> Faults {
    Faults::new(texts.iter().map(|text| text.parse().unwrap()).collect(), 6).unwrap()
}

/// What a board sends that has these faults in head and board, ahead of the injector.
fn sent(faults: &Faults) -> Vec<u8> {
    let file = WIDE.read().unwrap();
    let motion = Trajectory::of_kind(TrajectoryKind::Smooth, 3, 1.0);
    let board = SimulatedBoard::new(&file, motion, Tier::Paper, 3).unwrap();
    let mut board = board.with_faults(faults, &file, Tier::Paper).unwrap();
    let mut bytes = Vec::new();
    board.ask(1, Command::Start);
    (0..SCANS).for_each(|_| board.step(&mut bytes));
    bytes
}

fn injected(injector: Option<Injector>, bytes: &[u8], cut: usize) -> Vec<u8> {
    let mut injector = injector.expect("there are faults");
    let mut out = Vec::new();
    for part in bytes.chunks(cut) {
        assert_eq!(injector.push(part, &mut out), Link::Open);
    }
    injector.finish(&mut out);
    out
}

/// The numbers of the scans that can be read, in the order in which they come, and the texts of events.
fn read(mut bytes: &[u8]) -> (Vec<u64>, Vec<String>, Vec<u64>) {
    let mut decoder = Decoder::<MAX_MESSAGE_BYTES>::new();
    let (mut scans, mut events, mut ticks) = (Vec::new(), Vec::new(), Vec::new());
    while let Some(message) = decoder.next::<Message<'_>>(&mut bytes) {
        match message {
            Ok(Message::Batch(batch)) => {
                scans.extend((batch.sequence..).take(batch.samples.len() / 48));
                ticks.push(batch.tick);
            }
            Ok(Message::Event(event)) => events.push(event.text.to_owned()),
            _ => {}
        }
    }
    (scans, events, ticks)
}

#[test]
fn the_same_faults_give_the_same_bytes_however_they_are_cut() {
    let sound = sent(&faults(&[]));
    for kind in KINDS.iter().filter(|kind| kind.not_in_recordings().is_none()) {
        let name = kind.example.split(':').next().unwrap_or_default();
        let cell = if kind.layer == Layer::Words { "cell=2," } else { "" };
        let with = if name == "swap-cells" { "with=3," } else { "" };
        let faults = faults(&[&format!("{name}:{cell}{with}from=20ms,seed=9")]);
        let whole = injected(Injector::of_recording(&faults), &sound, sound.len());
        for cut in [1, 7, 1000] {
            assert_eq!(injected(Injector::of_recording(&faults), &sound, cut), whole, "{name} cut by {cut}");
        }
        // A simulated board with the fault sends what comes of the bytes of a sound one.
        let live = injected(Injector::of_link(&faults), &sent(&faults), 100);
        assert_eq!(live, whole, "{name}");
        assert_ne!(whole, sound, "{name}");
        // The first 20 ms, and not the 21st.
        let same = whole.iter().zip(&sound).take_while(|(faulty, sound)| faulty == sound).count();
        assert_eq!(read(&sound[..same]).0.last(), Some(&79), "{name}");
    }
}

#[test]
fn a_fault_is_announced_when_it_begins_and_then_more_and_more_rarely() {
    let faults = faults(&["occlude:cell=1,from=5ms", "stall:for=1ms,every=10ms"]);
    let (scans, events, _) = read(&injected(Injector::of_recording(&faults), &sent(&faults), 100));
    assert_eq!(scans.len(), SCANS);
    let stall = |number| format!("injected fault: stall:for=1ms,every=10ms (number {number})");
    let first = [stall(1), "injected fault: occlude:cell=1,from=5ms".to_owned()];
    assert_eq!(events, [&first[..], &[2, 4, 8].map(stall)].concat());
}

#[test]
fn packets_come_late_or_twice_and_none_is_lost() {
    let whole: Vec<u64> = (0..SCANS as u64).collect();
    for (text, is_ordered) in
        [("stall:from=10ms,for=20ms", true), ("reorder:rate=0.2", false), ("duplicate:rate=0.2", false)]
    {
        let faults = faults(&[text]);
        let (mut scans, ..) = read(&injected(Injector::of_recording(&faults), &sent(&faults), 100));
        assert_eq!(scans.is_sorted_by(|a, b| a < b), is_ordered, "{text}");
        scans.sort_unstable();
        scans.dedup();
        assert_eq!(scans, whole, "{text}");
    }
}

#[test]
fn the_clock_drifts_and_is_set() {
    let sound = sent(&faults(&[]));
    let (.., before) = read(&sound);
    let ahead = |text: &str| -> Vec<i64> {
        let (.., after) = read(&injected(Injector::of_recording(&faults(&[text])), &sound, 100));
        before.iter().zip(&after).map(|(before, after)| *after as i64 - *before as i64).collect()
    };
    // 20 ms, every 10 ms from 40 ms on; at 170 MHz and 1 ms a batch.
    let steps = ahead("step:by=20ms,from=40ms,every=10ms");
    assert_eq!([0, 39, 40, 49, 50, 99].map(|batch| steps[batch] / 3_400_000), [0, 0, 1, 1, 2, 6]);
    let drift = ahead("drift:ppm=-1000ppm,from=50ms,for=20ms");
    assert_eq!([0, 50, 60, 99].map(|batch| drift[batch]), [0, -170, -1870, -3400]);
}

#[test]
fn a_link_that_hangs_up_loses_what_was_under_way() {
    let faults = faults(&["hangup:from=20ms,for=300ms"]);
    let mut injector = Injector::of_link(&faults).unwrap();
    let mut out = Vec::new();
    let bytes = sent(&faults);
    assert_eq!(injector.push(&bytes, &mut out), Link::HungUp { for_s: 0.3 });
    assert_eq!(read(&out).0.last(), Some(&79));
    // It is open again.
    assert_eq!(injector.push(&bytes, &mut out), Link::Open);
}

fn act(text: &str, packets: usize, length: usize) -> Vec<Passage> {
    let mut fault = WireFault::new(text.parse().unwrap(), ChaCha8Rng::seed_from_u64(5));
    let pass = |_| {
        let mut packet = Passage { bytes: vec![0; length], ..Passage::default() };
        fault.act(0.0, &mut packet);
        packet
    };
    (0..packets).map(pass).collect()
}

#[test]
fn bits_are_inverted_as_often_as_asked_for() {
    for (rate, packets) in [(1e-4, 10_000), (0.01, 1_000), (1.0, 3)] {
        let flipped = act(&format!("flip:rate={rate}"), packets, 25);
        let ones: u32 = flipped.iter().flat_map(|packet| &packet.bytes).map(|byte| byte.count_ones()).sum();
        let expected = rate * (packets * 200) as f64;
        // Six standard deviations of a binomial number.
        let most = 6.0 * (expected * (1.0 - rate)).sqrt() + 1e-9;
        assert!((f64::from(ones) - expected).abs() <= most, "seed 5, rate {rate}: {ones} of {expected}");
    }
}

#[test]
fn packets_are_hit_as_often_as_asked_for() {
    let share = |text: &str, is_hit: fn(&Passage) -> bool| {
        let hits = act(text, 10_000, 25).iter().filter(|packet| is_hit(packet)).count();
        // Six standard deviations of a binomial number.
        assert!((hits as f64 - 1000.0).abs() < 6.0 * 900.0_f64.sqrt(), "seed 5, {text}: {hits}");
    };
    share("drop:rate=0.1", |packet| packet.bytes.is_empty());
    share("duplicate:rate=0.1", |packet| packet.is_double);
    share("reorder:rate=0.1", |packet| packet.is_late);
    share("truncate:rate=0.1", |packet| packet.bytes.len() < 25);
    assert!(act("stall", 3, 25).iter().all(|packet| packet.is_held));
}

#[test]
fn a_burst_goes_on_into_later_packets() {
    let packets = act("burst:rate=1,bytes=60,for=1ms", 3, 25);
    // Of 60 random bytes few are as they were.
    let hit: Vec<usize> = packets.iter().map(|packet| packet.bytes.iter().filter(|byte| **byte != 0).count()).collect();
    assert!(hit[0] > 20 && hit[1] > 20 && hit[2] > 5, "seed 5: {hit:?}");
}
