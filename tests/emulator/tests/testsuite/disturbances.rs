//! What goes wrong between converters, transfers and clock, and how the board gets over it.

use crate::common::channel_of;
use crate::common::dma_ticks;
use crate::common::talk::{FRAME_TICKS, MS, Talk};
use slitpose_emulator::faults::{Fault, Faults};
use slitpose_emulator::peripherals::Ticks;
use slitpose_emulator::rig::{Rig, open_image, open_pose_image};
use slitpose_emulator::world::NoiseSource;
use slitpose_firmware::pcb::default_configuration;
use slitpose_head::scene_file::WIDE;
use slitpose_head::simulator::{Trajectory, TrajectoryKind};
use slitpose_protocol::{Command, Configuration, Level, RawScan};

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Disturbance {
    /// The DMA request of a word of converter 1 or 2 (index 0 or 1) is not seen.
    SwallowedRequest(usize),
    /// A converter says that it has lost a word.
    Overrun(usize),
    /// A transfer for this request (firmware/README.md, "A frame") meets a bus error. The channel that serves it is looked up
    /// on the board.
    Transfer(&'static str),
}

impl Disturbance {
    fn happen(self, talk: &mut Talk) {
        let board = &mut talk.rig.machine.board;
        match self {
            Self::SwallowedRequest(converter) => board.adc12.adcs[converter].swallow_request(),
            Self::Overrun(converter) => board.adc12.adcs[converter].force_overrun(),
            Self::Transfer(request) => {
                let channel = channel_of(board, request);
                board.dma.fail_next(channel);
            }
        }
    }
}

/// Within a frame: in the settling time, between words, before and after the last word, in the
/// idle rest.
const PHASES: [Ticks; 6] = [500, 3_700, 9_000, 15_000, 22_700, 30_000];

/// Frames from a disturbance until it is found out at the latest: the batch under way is waited
/// for, unless polling every millisecond comes earlier; then what has been lost may show only in
/// the next frame.
const FOUND_FRAMES: u64 = 6;

/// The lit gates that follow one another from the start of `scan` on, with their distance from it.
fn gates_of(talk: &mut Talk, scan: &RawScan) -> Vec<(i64, u8)> {
    let start = talk.origin().wrapping_add(scan.tick) as i64;
    let within = talk.record().edges().into_iter().map(|(at, gates)| (at as i64 - start, gates));
    within.filter(|(after, _)| (-100..FRAME_TICKS as i64 - 100).contains(after)).collect()
}

/// Runs `configuration` with `disturbance` in each phase, and checks the account and what follows.
fn disturb(configuration: &Configuration, disturbance: Disturbance) {
    let mut talk = Talk::at_usb();
    assert_eq!(talk.ask(Command::Configure(configuration.clone())), Ok(()));
    assert_eq!(talk.ask(Command::Start), Ok(()));
    talk.run_ms(20.0);
    let pattern = *talk.ear.scans.last().expect("scans come");
    let words: Vec<u16> = pattern.lit().iter().flatten().copied().collect();
    let distinct: std::collections::BTreeSet<_> = words.iter().collect();
    assert!(distinct.len() >= words.len() - 2, "words that could be told from each other: {words:?}");
    let before = talk.ear.scans[talk.ear.scans.len() - 8];
    let gates = gates_of(&mut talk, &before);
    assert!(gates.len() >= 3, "{gates:?}");

    let (mut overruns, mut lost) = (0, 0);
    for (round, phase) in PHASES.into_iter().enumerate() {
        // Into a frame, and into the batch by as many frames as there were rounds.
        let last = talk.origin() + talk.ear.scans.last().expect("scans come").tick;
        let frames = (talk.rig.now() - last) / FRAME_TICKS + 2 + round as u64;
        talk.run_until(last + frames * FRAME_TICKS + phase);
        talk.ear.clear();
        let title = format!("{disturbance:?} at {phase}");
        disturbance.happen(&mut talk);
        talk.run_ms(20.0);
        talk.record().forget();
        talk.run_ms(5.0);
        let [gap] = talk.ear.gaps[..] else { panic!("{title}: one gap, not {:?}", talk.ear.gaps) };
        assert!((1..=FOUND_FRAMES).contains(&gap.missing), "{title}: {gap:?}");
        // The frame that is interrupted when it is found out has no number, unless it is the only
        // one that is lost; the first one behind begins at once.
        let least = (gap.missing - 1) * FRAME_TICKS;
        assert!((least..least + 3 * FRAME_TICKS).contains(&gap.ticks), "{title}: {gap:?}");
        overruns += 1;
        lost += gap.missing;
        for scan in &talk.ear.scans {
            assert_eq!((scan.lit(), scan.dark()), (pattern.lit(), pattern.dark()), "{title}: {}", scan.sequence);
        }
        let after = talk.ear.scans[talk.ear.scans.len() - 6];
        let gates_now = gates_of(&mut talk, &after);
        assert_eq!(gates_now.len(), gates.len(), "{title}: {gates_now:?}");
        for (now, then) in gates_now.iter().zip(&gates) {
            // Between the start of the timer and the look at the clock lie some instructions,
            // whose number does not change, but which may wait for the bus or the flash.
            assert!(
                now.1 == then.1 && (now.0 - then.0).unsigned_abs() <= 32 + dma_ticks(),
                "{title}: {gates_now:?}, before {gates:?}"
            );
        }
    }
    let status = talk.settle_account(0);
    println!("{disturbance:?}: {overruns} overruns, {lost} scans lost");
    assert_eq!((status.adc_overruns, status.scans_lost, status.scans_dropped), (overruns, lost, 0), "{disturbance:?}");
    talk.expect_no_faults();
}

#[test]
fn a_lost_word_or_a_failed_transfer_costs_a_few_scans() {
    let default = default_configuration();
    for lost in [0, 1].map(|of| [Disturbance::SwallowedRequest(of), Disturbance::Overrun(of)]).into_iter().flatten() {
        disturb(&default, lost);
    }
    let mut without_dark = default.clone();
    without_dark.schedule.slots.pop();
    let mut of_levels = default.clone();
    of_levels.levels = [0x8000, 0x7000, 0x6000, 0x8000, 0x7800, 0x7000].map(Level).into_iter().collect();
    for (configuration, request) in [
        (&default, "ADC1"),
        (&default, "ADC2"),
        // Gates, darkness behind the last slot, periods, and both lines of levels.
        (&default, "TIM2_UP"),
        (&without_dark, "TIM2_CH4"),
        (&default, "TIM2_CH2"),
        (&of_levels, "TIM2_CH1"),
        (&of_levels, "TIM2_CH3"),
    ] {
        disturb(configuration, Disturbance::Transfer(request));
    }
}

#[test]
fn no_scan_holds_a_word_of_another_frame() {
    // With noise no two scans are alike; what comes before the gap must be as without it.
    let run = |swallow_at: Option<(usize, Ticks)>| {
        let mut talk = Talk::noisy(5);
        assert_eq!(talk.ask(Command::Start), Ok(()));
        // Longer than a ring, so that it holds words of earlier frames.
        talk.run_ms(30.0);
        let first = talk.origin() + talk.ear.scans[0].tick;
        let frames = (talk.rig.now() - first) / FRAME_TICKS + 2;
        let (converter, phase) = swallow_at.unwrap_or_default();
        talk.run_until(first + frames * FRAME_TICKS + phase);
        if swallow_at.is_some() {
            Disturbance::SwallowedRequest(converter).happen(&mut talk);
        }
        talk.run_ms(10.0);
        (std::mem::take(&mut talk.ear.scans), std::mem::take(&mut talk.ear.gaps))
    };
    let (undisturbed, none) = run(None);
    assert_eq!(none, []);
    for converter in [0, 1] {
        for batch_frame in 0..4 {
            // Between the last word but one and the last.
            let (scans, gaps) = run(Some((converter, batch_frame * FRAME_TICKS + 22_800)));
            assert_eq!(gaps.len(), 1);
            for scan in scans.iter().take_while(|scan| scan.sequence <= gaps[0].after) {
                let twin = undisturbed.iter().find(|twin| twin.sequence == scan.sequence).expect("the longer run");
                assert_eq!(scan, twin, "converter {converter}, frame {batch_frame}");
            }
        }
    }
}

#[test]
fn the_device_clock_may_wrap_while_the_board_is_idle() {
    let mut talk = Talk::boot();
    // 50 ms before.
    talk.rig.machine.preset_device_clock((1_u64 << 32).wrapping_sub(50 * MS) as u32);
    talk.await_port();
    talk.open();
    assert_eq!(talk.ask(Command::Start), Ok(()));
    talk.run_ms(50.0);
    let first = talk.ear.scans[0].tick;
    assert!(first > 1 << 32 && first < (1 << 32) + TICKS_OF_A_START, "{first}");
    assert_eq!(talk.ear.gaps, []);
    let status = talk.settle_account(0);
    assert_eq!((status.scans_lost, status.adc_overruns), (0, 0));
    talk.expect_no_faults();
}

/// Enumeration, opening and a Start take less than this.
const TICKS_OF_A_START: u64 = 500 * MS;

#[test]
fn the_device_clock_may_wrap_while_the_board_acquires() {
    let mut talk = Talk::at_usb();
    talk.rig.machine.preset_device_clock((1_u64 << 32).wrapping_sub(100 * MS) as u32);
    talk.run_ms(5.0);
    assert_eq!(talk.ask(Command::Start), Ok(()));
    talk.run_ms(200.0);
    assert!(talk.ear.scans[0].tick < 1 << 32);
    assert!(talk.ear.scans.last().expect("scans come").tick > 1 << 32);
    assert_eq!(talk.ear.gaps, [], "ticks go on by a frame each");
    assert!(talk.ear.received >= 4 * 195, "{} scans", talk.ear.received);
    let status = talk.settle_account(0);
    assert!(status.tick > 1 << 32);
    assert_eq!((status.scans_lost, status.scans_dropped, status.adc_overruns), (0, 0, 0));
    talk.expect_no_faults();
}

/// Both are there from the first instruction on.
#[test]
fn images_start_where_first_writes_are_lost_and_sleep_with_a_barrier_behind_it() {
    let (wide, still) = (WIDE.read().expect("shipped"), Trajectory::of_kind(TrajectoryKind::Still, 1, 10.0));
    for image in [open_image(None), open_pose_image()] {
        let image = image.expect("firmware/build makes it");
        for fault in [Fault::SramFirstWrite, Fault::SleepFetch] {
            let mut rig = Rig::boot(&image, &wide, still.clone(), NoiseSource::Off, Faults::default().with(fault))
                .expect("it fits");
            rig.run_for(0.05);
            assert_eq!(rig.faults(), [""; 0], "{fault:?}");
            let machine = rig.machine;
            assert_eq!((machine.cpu.last_fault(), machine.resets().len()), (None, 1), "{fault:?}");
        }
    }
}
