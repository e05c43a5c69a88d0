//! The board on a lab's clock: edges at its trigger input, and pulses at its frame output.

use crate::common::talk::{FRAME_TICKS, MS, Talk};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use slitpose_emulator::faults::{Fault, Faults, Kind};
use slitpose_firmware::pcb::default_configuration;
use slitpose_firmware::pcb::frame_plan::FramePlan;
use slitpose_protocol::{Command, HardwareFault, Pulse, Rejection};

/// 0.1 µs, in ticks.
const LATE_TICKS: u64 = 17;

/// A thousand edges at the instants of a seed, 2 to 200 µs apart, while the board samples; and again with all faults of
/// silicon but that of the host, which breaks the link.
#[test]
fn edges_are_timed_to_a_tenth_of_a_microsecond() {
    let faulty = Fault::of(Kind::Silicon).iter().filter(|fault| **fault != Fault::UsbHost);
    for faults in [Faults::default(), faulty.copied().collect()] {
        let mut talk = Talk::on(faults);
        talk.light();
        let (seed, origin) = (11, talk.origin());
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let mut at = talk.rig.now();
        let instants = std::iter::repeat_with(|| {
            at += rng.random_range(340..34_000);
            at
        });
        let edges: Vec<(u64, bool)> = instants.zip([true, false].into_iter().cycle()).take(1_000).collect();
        talk.rig.machine.board.trigger_line.edges = edges.iter().copied().collect();
        talk.rig.machine.board.outside_changed();
        talk.run_ms(120.0);
        assert_eq!((talk.ear.edges.len(), talk.ear.missed_edges, talk.ear.gaps.len()), (1_000, 0, 0), "seed {seed}");
        let heard = || edges.iter().zip(&talk.ear.edges);
        let late: Vec<u64> = heard().map(|((at, _), edge)| edge.tick() + origin - at).collect();
        println!("seed {seed}: {:?} to {:?} ticks late", late.iter().min(), late.iter().max());
        assert!(late.iter().all(|&late| late <= LATE_TICKS));
        assert!(heard().all(|((_, is_high), edge)| edge.is_high() == *is_high));
    }
}

/// Glitches of 30 ns are no edges; a storm of 2 MHz is more than the ring holds, which is told, and the levels of later
/// edges are right.
#[test]
fn glitches_are_no_edges_and_a_storm_is_told() {
    let mut talk = Talk::on(Faults::default());
    talk.light();
    let begin = talk.rig.now() + MS;
    let glitches = (0..50).flat_map(|k| [(begin + 900 * k, true), (begin + 900 * k + 5, false)]);
    talk.rig.machine.board.trigger_line.edges = glitches.collect();
    talk.rig.machine.board.outside_changed();
    talk.run_ms(5.0);
    assert_eq!((talk.ear.edges.len(), talk.ear.missed_edges), (0, 0));

    let begin = talk.rig.now() + MS;
    let storm = (0..20_001).map(|k| (begin + 85 * k, k % 2 == 0));
    let later = (1..9).map(|k| (begin + 20 * MS + k * MS, k % 2 == 0));
    talk.rig.machine.board.trigger_line.edges = storm.chain(later).collect();
    talk.rig.machine.board.outside_changed();
    talk.run_ms(40.0);
    let (count, missed) = (talk.ear.edges.len(), talk.ear.missed_edges);
    println!("{count} edges of a storm of 20 001, {missed} told to be missed");
    assert!(missed > 0 && count > 8, "{count} {missed}");
    let levels: Vec<bool> = talk.ear.edges[count - 8..].iter().map(|edge| edge.is_high()).collect();
    assert_eq!(levels, [false, true].repeat(4));
    assert!(talk.ear.gaps.is_empty(), "no scan is lost");
}

#[test]
fn pulses_mark_the_frames_that_were_asked_for() {
    let mut talk = Talk::on(Faults::default());
    let schedule = default_configuration().schedule;
    let unsuited = Err(Rejection::Unsuited(HardwareFault::Timing));
    assert_eq!(talk.ask(Command::Pulse(Pulse { every: 1, slot: schedule.slots.len() as u8 })), unsuited);
    assert_eq!(talk.ask(Command::Pulse(Pulse { every: u16::MAX, slot: 0 })), unsuited);
    let trigger_ticks = u64::from(FramePlan::new(&default_configuration()).expect("a plan").trigger_ticks);
    let slot_ticks = u64::from(schedule.slot_ticks);
    let mut next = 0;
    for (every, slot) in [(1, 0), (3, 1), (1, 3), (2, 3)] {
        talk.accept(&Command::Pulse(Pulse { every, slot }));
        talk.forget();
        talk.accept(&Command::Start);
        talk.run_ms(5.0);
        talk.accept(&Command::Stop);
        talk.run_ms(2.0);
        let origin = talk.origin();
        let edges = std::mem::take(&mut talk.rig.machine.board.frame_timer.edges);
        let of_frames: Vec<u64> = talk
            .ear
            .scans
            .iter()
            .filter(|scan| scan.sequence % u64::from(every) == 0)
            .map(|scan| origin + scan.tick + u64::from(slot) * slot_ticks + trigger_ticks)
            .collect();
        let rises: Vec<u64> = edges.iter().filter(|edge| edge.1).map(|edge| edge.0).collect();
        // Along the wire they come back.
        let back = std::mem::take(&mut talk.ear.edges);
        assert_eq!(back.iter().filter(|edge| edge.is_high()).count(), rises.len(), "{every} {slot}");
        // The frame that is cut off by the end may have had its pulse.
        assert!(rises.len() - of_frames.len() <= 1 && of_frames.len() > 5, "{every} {slot}: {edges:?}");
        let late: Vec<i64> = rises.iter().zip(&of_frames).map(|(at, of)| *at as i64 - *of as i64).collect();
        // The clock is read just behind the start of the frame timer.
        assert!(late.iter().all(|at| at.abs() < 64 && *at == late[0]), "{every} {slot}: {late:?}");
        let rest = FRAME_TICKS - 3 * slot_ticks;
        let length = if slot == 3 { rest } else { slot_ticks };
        // The last one may be cut off.
        for pulse in edges.chunks_exact(2).take(of_frames.len() - 1) {
            assert_eq!((pulse[0].1, pulse[1].0 - pulse[0].0), (true, length), "{every} {slot}");
        }
        assert!(edges.last().is_none_or(|edge| !edge.1), "low in the end");
        assert!(talk.ear.scans[0].sequence >= next);
        next = talk.ear.scans.last().expect("scans").sequence + 1;
    }
    // Without being asked again it makes none.
    talk.light();
    assert!(talk.rig.machine.board.frame_timer.edges.is_empty());
}
