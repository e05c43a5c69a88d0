//! Behaviour of a board, one command sequence a test.

use core::num::NonZeroU32;

use crate::common::{
    Bench, Fake, Finished, Heard, TICK_HZ, board, configuration, identity, request, sequences, without_dark, words,
};
use slitpose_firmware::pcb::{QUEUE_BYTES, can_run, default_configuration};
use slitpose_firmware::{Board, HOST_GONE_MS, Identity, Indicator, Link, TRANSMIT_BYTES};
use slitpose_protocol::schema::SchemaKeys;
use slitpose_protocol::{
    AdcScaling, BoardKind, BootTarget, Command, Configuration, Decoder, Edge, Edges, EmitterSet, Exposure,
    HardwareFault, Hashes, Hello, Level, MAX_MESSAGE_BYTES, Message, PROTOCOL, Pulse, RawScan, Rejection, Reply,
    ResetCause, ScheduleError, Severity, Stream,
};

const MS: u64 = TICK_HZ as u64 / 1_000;

/// A board whose link has just been opened and whose hello has been heard.
fn opened() -> Bench {
    let mut bench = Bench::default();
    assert_eq!(bench.turn(), [hello(0, configuration())]);
    bench
}

/// The same, and it has been told to start.
fn acquiring() -> Bench {
    let mut bench = opened();
    assert_eq!(bench.ask(1, Command::Start), [accepted(1)]);
    bench
}

fn hello(configuration: u16, new: Configuration) -> Heard {
    Heard::Hello { configuration, schedule: new.schedule, hashes: Hashes::default() }
}

fn accepted(number: u16) -> Heard {
    Heard::Reply(Reply { number, outcome: Ok(()) })
}

fn rejected(number: u16, rejection: Rejection) -> Heard {
    Heard::Reply(Reply { number, outcome: Err(rejection) })
}

fn is_event(heard: &Heard, text: &str) -> bool {
    matches!(heard, Heard::Event { text: found, .. } if found.contains(text))
}

#[test]
fn a_hello_carries_identity_keys_and_schedule() {
    let identity = Identity {
        device_id: *b"twelve bytes",
        kind: BoardKind::Physical,
        board: "of this test",
        reset_cause: ResetCause::Watchdog,
        hashes: Hashes { scene: Some(3), calibration: Some(4) },
        scaling: AdcScaling { zero_code: 4_031.5, amperes_per_code: -2.5e-9, bits: 12, saturation_code: 32 },
        ..identity()
    };
    let mut board = Board::new(Fake::default(), identity, without_dark(), [0; 2_048]).unwrap();
    board.poll(Link::Open);
    let mut buffer = [0; TRANSMIT_BYTES];
    let hello = Message::Hello(Hello {
        protocol: PROTOCOL,
        message_keys: SchemaKeys::messages(),
        command_keys: SchemaKeys::commands(),
        device_id: identity.device_id,
        kind: identity.kind,
        board: identity.board,
        firmware: "0.1.0",
        reset_cause: identity.reset_cause,
        hashes: identity.hashes,
        scaling: identity.scaling,
        configuration: 0,
        schedule: without_dark().schedule,
    });
    let mut decoder = Decoder::<MAX_MESSAGE_BYTES>::new();
    assert_eq!(decoder.next(&mut board.transmit(&mut buffer)), Some(Ok(hello)));
}

#[test]
fn a_status_carries_the_readings_at_its_time() {
    let mut bench = opened();
    for (supply_v, temperature_k, load) in [(3.1, 305.0, 250), (2.9, 310.0, 400)] {
        bench.hardware().health = (supply_v, temperature_k, load);
        let status = bench.status();
        assert_eq!((status.supply_v, status.temperature_k, status.cpu_load_permille), (supply_v, temperature_k, load));
        assert_eq!((status.tick, status.acquiring, status.adc_overruns), (bench.hardware().now, false, 0));
    }
    bench.say(1, Command::Start);
    assert!(bench.status().acquiring);
}

#[test]
fn the_number_of_the_configuration_wraps_after_65535() {
    let mut bench = opened();
    let configure = request(1, Command::Configure(configuration()));
    for _ in 0..=u16::MAX {
        bench.board.receive(&configure);
    }
    let heard = bench.ask(2, Command::Configure(without_dark()));
    let last = [hello(u16::MAX, configuration()), hello(0, configuration()), hello(1, without_dark())];
    let hellos = heard.into_iter().filter(|heard| matches!(heard, Heard::Hello { .. })).collect::<Vec<_>>();
    assert_eq!(hellos[hellos.len() - 3..], last);
}

#[test]
fn scans_at_4_khz_come_in_batches_of_four_and_a_stop_sends_the_rest() {
    let mut bench = acquiring();
    assert_eq!(bench.board.scans_to_poll(), 4);

    bench.hardware().sample(3);
    assert_eq!(bench.turn(), []);
    assert_eq!(bench.board.scans_to_poll(), 1);
    bench.hardware().sample(3);
    let heard = bench.turn();
    assert_eq!(sequences(&heard), [0, 1, 2, 3]);
    let Heard::Scan { scan, .. } = &heard[2] else { panic!("{heard:?}") };
    assert_eq!(scan.tick, 3 * 250);
    assert_eq!(scan.lit(), &[words(2, 0), words(2, 1)]);
    assert_eq!(scan.levels(), &[Level::NOMINAL; 2]);

    bench.hardware().sample(1);
    let heard = bench.ask(2, Command::Stop);
    assert_eq!(sequences(&heard), [4, 5, 6]);
    assert_eq!(heard.last(), Some(&accepted(2)));
    assert!(bench.hardware().running.is_none());

    // It also ends the choice of a stream.
    bench.say(3, Command::Stream(Stream { scans: 0, poses: 0 }));
    bench.say(4, Command::Stop);
    bench.say(5, Command::Start);
    bench.hardware().sample(4);
    assert_eq!(sequences(&bench.turn()), [7, 8, 9, 10]);
}

#[test]
fn emitters_lit_before_the_first_poll_are_switched_off_until_confirmed() {
    let lit = Fake { running: Some(configuration()), refuse_dark: 2, ..Fake::default() };
    let mut board = board(lit);
    board.poll(Link::Closed);
    board.poll(Link::Closed);
    assert!(board.hardware_mut().running.is_some());
    board.poll(Link::Closed);
    assert!(board.hardware_mut().running.is_none());
    board.poll(Link::Closed);
    assert_eq!(board.hardware_mut().asked_dark, 3, "once confirmed, darkness is left alone");
}

#[test]
fn gaps_and_levels_close_a_batch() {
    let mut bench = acquiring();
    bench.hardware().sample(2);
    bench.hardware().overrun(5);
    assert_eq!(sequences(&bench.turn()), [0, 1]);
    bench.hardware().sample(1);
    bench.hardware().set_level(Level(7));
    bench.hardware().sample(1);
    assert_eq!(sequences(&bench.turn()), [7]);
    bench.hardware().sample(3);
    let heard = bench.turn();
    assert_eq!(sequences(&heard), [8, 9, 10, 11]);
    let status = bench.status();
    assert_eq!((status.scans_taken, status.scans_lost, status.adc_overruns), (12, 5, 1));
}

#[test]
fn a_new_configuration_starts_a_new_batch_behind_its_hello() {
    let mut bench = opened();
    bench.say(1, Command::Start);
    bench.hardware().sample(2);
    bench.say(2, Command::Configure(without_dark()));
    bench.hardware().sample(4);
    let heard = bench.ask(3, Command::Hello);
    let hello = hello(1, without_dark());
    assert_eq!(heard[0], accepted(1));
    assert_eq!(sequences(&heard[1..3]), [0, 1]);
    assert_eq!(heard[3..7], [hello.clone(), accepted(2), hello, accepted(3)]);
    assert_eq!(sequences(&heard[7..]), [2, 3, 4, 5]);
    assert!(matches!(&heard[7], Heard::Scan { configuration: 1, scan } if scan.dark().is_none()));
}

#[test]
fn a_configuration_that_cannot_run_is_rejected_and_changes_nothing() {
    let mut bench = acquiring();

    let mut short = configuration();
    short.schedule.slot_ticks = 20;
    let mut other_clock = configuration();
    other_clock.schedule.tick_hz += 1;
    let mut one_level = configuration();
    one_level.levels.pop();
    let mut odd = configuration();
    odd.schedule.oversampling = 3;
    for (number, wrong) in [(2, short), (3, other_clock), (4, one_level), (5, odd)] {
        bench.say(number, Command::Configure(wrong));
    }
    let too_short = ScheduleError::SlotTooShort { needed_ticks: 21, slot_ticks: 20 };
    assert_eq!(
        bench.turn(),
        [
            rejected(2, Rejection::Schedule(too_short)),
            rejected(3, Rejection::TickRate { asked_hz: TICK_HZ + 1, board_hz: TICK_HZ }),
            rejected(4, Rejection::Levels { levels: 1, cells: 2 }),
            rejected(5, Rejection::Unsuited(HardwareFault::Oversampling { oversampling: 3 })),
        ]
    );
    assert_eq!(bench.hardware().running, Some(configuration()));
    assert_eq!(bench.status().commands_rejected, 4);
}

#[test]
fn unknown_commands_are_answered_and_damaged_ones_counted() {
    let mut bench = opened();
    // Number 5 is of kind 77; number 6 is a Stop with a byte too many.
    let unknown = [0x07, 0x05, 0x4d, 0x97, 0xdb, 0xc3, 0x34, 0x00];
    let malformed = [0x08, 0x06, 0x02, 0x09, 0x86, 0x7f, 0x26, 0xb0, 0x00];
    let mut damaged = request(9, Command::Start);
    damaged[1] ^= 0x10;
    assert_eq!(bench.board.receive(&[&unknown[..], &malformed[..]].concat()), 2);
    assert_eq!(bench.board.receive(&damaged), 0);
    let heard = bench.ask(10, Command::Ping { token: 4 });
    assert_eq!(heard[0], rejected(5, Rejection::Unsupported { kind: 77 }));
    assert_eq!(heard[1], rejected(6, Rejection::Malformed { kind: 2 }));
    assert!(matches!(heard[2], Heard::Pong(pong) if pong.token == 4));
    assert_eq!(heard[3..], [accepted(10)]);
    let status = bench.status();
    assert_eq!((status.commands_damaged, status.commands_rejected), (1, 2));
}

#[test]
fn hardware_that_refuses_leaves_the_board_dark() {
    let mut bench = opened();
    for (number, command) in [(1, Command::Start), (3, Command::Configure(without_dark()))] {
        bench.hardware().refuse_light = Some(HardwareFault::Timing);
        let heard = bench.ask(number, command);
        assert!(is_event(&heard[0], "the timers"), "{heard:?}");
        assert_eq!(heard[1], rejected(number, Rejection::Hardware(HardwareFault::Timing)));
        assert!(!bench.board.is_acquiring() && bench.hardware().running.is_none());
        assert_eq!(bench.hardware().indicator, Some(Indicator::Fault));

        assert_eq!(bench.ask(2, Command::Start), [accepted(2)]);
        assert_eq!(bench.hardware().running, Some(configuration()), "the old one stays");
        assert_eq!(bench.hardware().indicator, Some(Indicator::Acquiring));
    }
}

#[test]
fn a_stop_that_fails_is_tried_until_the_emitters_are_off() {
    let mut bench = acquiring();
    bench.hardware().refuse_dark = 2;
    let heard = bench.ask(2, Command::Stop);
    assert!(is_event(&heard[0], "may still be lit"), "{heard:?}");
    assert_eq!(heard[1..], [rejected(2, Rejection::Hardware(HardwareFault::Emitters))]);
    assert!(!bench.board.is_acquiring() && bench.hardware().running.is_some());
    assert_eq!(bench.hardware().indicator, Some(Indicator::Fault));
    assert_eq!(bench.turn(), [], "told once");
    assert!(bench.hardware().running.is_none());
}

#[test]
fn counters_that_contradict_themselves_end_acquisition() {
    let wrong_shape = |scan: &mut RawScan| {
        *scan = RawScan::new(3, true);
        (scan.sequence, scan.tick) = (2, 900);
    };
    let contradictions: [&dyn Fn(&mut RawScan); 4] =
        [&|scan| scan.sequence = 1, &|scan| scan.tick = 500, &|scan| scan.sequence = u64::MAX, &wrong_shape];
    for (case, contradict) in contradictions.into_iter().enumerate() {
        let mut bench = acquiring();
        bench.hardware().sample(2);
        let mut scan = RawScan::new(2, true);
        (scan.sequence, scan.tick) = (2, 750);
        contradict(&mut scan);
        bench.hardware().finished.push_back(Finished::Scan(scan));
        let heard = bench.turn();
        assert_eq!(sequences(&heard), [0, 1], "case {case}");
        assert!(is_event(&heard[2], "inconsistent"), "case {case}: {heard:?}");
        assert!(!bench.board.is_acquiring() && bench.hardware().running.is_none(), "case {case}");
        let status = bench.status();
        assert_eq!(status.scans_taken, 2 + status.scans_lost, "case {case}");
    }
}

#[test]
fn a_link_closed_for_500_ms_ends_acquisition_and_the_next_host_hears_of_it() {
    let mut bench = acquiring();
    bench.hardware().now += (HOST_GONE_MS - 1) * MS;
    bench.board.poll(Link::Closed);
    assert!(bench.board.is_acquiring());
    bench.board.poll(Link::Open);
    bench.hardware().now += (HOST_GONE_MS - 1) * MS;
    bench.board.poll(Link::Closed);
    assert!(bench.board.is_acquiring(), "the time starts anew");
    bench.hardware().now += MS;
    bench.board.poll(Link::Closed);
    assert!(!bench.board.is_acquiring() && bench.hardware().running.is_none());

    let heard = bench.turn();
    assert_eq!(heard[0], hello(0, configuration()));
    assert!(is_event(&heard[1], "closed for 500 ms"), "{heard:?}");
    assert!(matches!(heard[1], Heard::Event { severity: Severity::Warning, .. }));
    assert_eq!(bench.turn(), [], "told once");
}

#[test]
fn packets_for_one_host_do_not_reach_the_next() {
    let mut bench = opened();
    bench.say(1, Command::Start);
    bench.hardware().sample(4);
    bench.board.poll(Link::Open);
    bench.board.receive(&request(2, Command::Ping { token: 1 })[..4]);
    bench.board.poll(Link::Closed);
    bench.hardware().sample(4);
    bench.board.poll(Link::Closed);

    assert_eq!(bench.ask(3, Command::Stop), [accepted(3), hello(0, configuration())]);
    let status = bench.status();
    assert_eq!((status.scans_taken, status.scans_dropped, status.batches_dropped), (8, 8, 2));
}

#[test]
fn a_full_queue_drops_its_oldest_scans_and_keeps_replies() {
    let mut bench = opened();
    bench.say(1, Command::Start);
    for _ in 0..50 {
        bench.hardware().sample(4);
        bench.board.poll(Link::Open);
    }
    let heard = bench.ask(2, Command::Stop);
    assert_eq!((heard.first(), heard.last()), (Some(&accepted(1)), Some(&accepted(2))));
    let sequences = sequences(&heard);
    assert!(sequences.len() > 40);
    assert_eq!(sequences, (200 - sequences.len() as u64..200).collect::<Vec<_>>(), "the newest, whole");
    let status = bench.status();
    assert_eq!(status.scans_dropped, 200 - sequences.len() as u64);
    assert_eq!(u64::from(status.batches_dropped), status.scans_dropped / 4);
    assert_eq!(status.replies_dropped, 0);
}

#[test]
fn a_host_that_never_reads_loses_replies_and_the_status_counts_them() {
    let mut bench = opened();
    for number in 0..1_000 {
        bench.say(number, Command::Start);
    }
    let heard = bench.turn();
    assert_eq!(heard.last(), Some(&accepted(999)));
    assert!(heard.len() >= 100);
    let status = bench.status();
    assert_eq!(heard.len() + status.replies_dropped as usize, 1_000);
}

#[test]
fn a_queue_without_room_for_a_batch_keeps_none_and_counts() {
    let mut bench = Bench::of(Board::new(Fake::default(), identity(), configuration(), [0; 16]).unwrap());
    bench.turn();
    bench.say(1, Command::Start);
    bench.hardware().sample(8);
    assert_eq!(bench.turn(), [accepted(1)]);
    let status = bench.status();
    assert_eq!((status.scans_taken, status.scans_dropped, status.batches_dropped), (8, 8, 2));
}

#[test]
fn the_pcb_can_run_its_default_and_nothing_beyond_its_parts() {
    let changed = |change: fn(&mut Configuration)| {
        let mut configuration = default_configuration();
        change(&mut configuration);
        can_run(&configuration)
    };
    assert!(changed(|_| {}));
    assert!(!changed(|c| c.schedule.conversion_ticks -= 1), "no time of the converters");
    assert!(!changed(|c| c.schedule.tick_hz -= 1), "another clock");
    assert!(!changed(|c| c.levels.truncate(5)), "a level too few");
}

#[test]
fn the_default_queue_holds_a_tenth_of_a_second() {
    let fake = Fake { sampled: 1 << 40, now: 1 << 60, ..Fake::default() };
    let mut bench = Bench::of(Board::new(fake, identity(), default_configuration(), [0; QUEUE_BYTES]).unwrap());
    bench.board.poll(Link::Open);
    bench.say(1, Command::Start);
    bench.say(2, Command::Hello);
    for _ in 0..100 {
        bench.hardware().sample(4);
        bench.board.poll(Link::Open);
    }
    assert_eq!(sequences(&bench.listen()).len(), 400);
}

#[test]
fn edges_are_numbered_from_the_start_and_those_of_a_closed_link_leave_a_gap() {
    let mut bench = Bench::default();
    let mut pass = |link: Link, ticks: core::ops::Range<u64>| {
        bench.hardware().edges.extend(ticks.map(|tick| Edge::new(tick, tick % 2 == 0)));
        bench.board.poll(link);
        bench
            .listen()
            .into_iter()
            .filter_map(|heard| match heard {
                Heard::Edges(Edges { number, edges, .. }) => Some((number, edges[0].tick(), edges.len())),
                _ => None,
            })
            .collect::<Vec<_>>()
    };
    assert_eq!(pass(Link::Closed, 0..3), []);
    assert_eq!(pass(Link::Open, 3..14), [(3, 3, 8), (11, 11, 3)]);
    // More than a poll takes are sent by the next.
    assert_eq!(pass(Link::Open, 14..50).len(), 4);
    assert_eq!(pass(Link::Open, 0..0), [(46, 46, 4)]);
}

#[test]
fn pulses_end_with_a_stop_or_a_configuration() {
    let pulse = Pulse { every: 3, slot: 1 };
    for command in [Command::Stop, Command::Configure(without_dark())] {
        let mut bench = opened();
        bench.say(1, Command::Pulse(pulse));
        assert_eq!(bench.hardware().pulse, Some(pulse));
        // There is no slot of this number.
        bench.say(9, Command::Pulse(Pulse { every: 3, slot: 4 }));
        assert_eq!(bench.hardware().pulse, Some(pulse));
        bench.say(2, command);
        assert_eq!(bench.hardware().pulse, Some(Pulse::NONE));
    }
}

#[test]
fn identify_lasts_as_long_as_asked() {
    let mut bench = opened();
    bench.ask(1, Command::Identify { seconds: 2 });
    assert_eq!(bench.hardware().indicator, Some(Indicator::Identify));
    bench.hardware().now += 1_999 * MS;
    bench.turn();
    assert_eq!(bench.hardware().indicator, Some(Indicator::Identify));
    bench.hardware().now += MS;
    bench.turn();
    assert_eq!(bench.hardware().indicator, Some(Indicator::Idle));
}

#[test]
fn a_status_comes_twice_a_second_while_the_link_is_open() {
    let mut bench = opened();
    let mut statuses = 0;
    for _ in 0..=10_000 {
        statuses += bench.turn().len();
        bench.hardware().now += MS;
    }
    assert_eq!(statuses, 20);
    for _ in 0..10_000 {
        bench.board.poll(Link::Closed);
        assert_eq!(bench.listen(), []);
        bench.hardware().now += MS;
    }
}

#[test]
fn a_store_is_answered_once_its_settings_are_kept() {
    let mut bench = opened();
    let hashes = Hashes { scene: Some(7), calibration: Some(8) };
    bench.hardware().storing_polls = 2;
    bench.say(1, Command::Configure(without_dark()));
    bench.say(2, Command::Start);
    bench.say(3, Command::Store(hashes));
    let heard = bench.ask(4, Command::Forget);
    assert_eq!(heard[3..], [rejected(4, Rejection::Storing)], "one at a time");
    bench.hardware().sample(4);
    assert_eq!(sequences(&bench.turn()), [0, 1, 2, 3], "sampling goes on");
    let heard = bench.turn();
    let Heard::Hello { hashes: told, .. } = heard[0] else { panic!("{heard:?}") };
    assert_eq!((told, &heard[1..]), (hashes, &[accepted(3)][..]));
    let kept = bench.hardware().kept.clone().expect("kept");
    assert_eq!((kept.configuration, kept.hashes), (without_dark(), hashes));

    bench.hardware().refuse_store = true;
    assert_eq!(bench.ask(5, Command::Forget), [rejected(5, Rejection::Storage)]);
    let heard = bench.ask(6, Command::Forget);
    assert!(matches!(heard[0], Heard::Hello { hashes: Hashes { scene: None, calibration: None }, .. }));
    assert_eq!(bench.hardware().kept, None);
}

#[test]
fn a_full_scale_is_told_with_the_next_configuration_and_kept() {
    let mut bench = acquiring();
    let full_scale_pa = NonZeroU32::new(6_600_000).expect("not zero");
    bench.say(2, Command::FullScale { full_scale_pa });
    let mut sent = [0; TRANSMIT_BYTES];
    bench.board.poll(Link::Open);
    let mut bytes = bench.board.transmit(&mut sent);
    let mut decoder = Decoder::<MAX_MESSAGE_BYTES>::new();
    let Some(Ok(Message::Hello(hello))) = decoder.next::<Message>(&mut bytes) else { panic!("no hello") };
    assert_eq!((hello.configuration, hello.scaling), (1, identity().scaling.with_full_scale(full_scale_pa)));
    assert!((hello.scaling.full_scale_a() / 6.6e-6 - 1.0).abs() < 1e-6);
    assert!(bench.board.is_acquiring());
    // Number 3, zero picoamperes.
    bench.board.receive(&[0x03, 0x03, 0x0b, 0x05, 0x80, 0xbe, 0xf3, 0x1e, 0x00]);
    assert_eq!(bench.turn(), [rejected(3, Rejection::Malformed { kind: 11 })]);
    bench.ask(4, Command::Store(Hashes::default()));
    assert_eq!(bench.hardware().kept.as_ref().and_then(|kept| kept.full_scale_pa), Some(full_scale_pa));
    // One that does not come into force is not told.
    bench.hardware().refuse_light = Some(HardwareFault::Converters);
    bench.ask(5, Command::FullScale { full_scale_pa: NonZeroU32::MIN });
    bench.ask(6, Command::Store(Hashes::default()));
    assert_eq!(bench.hardware().kept.as_ref().and_then(|kept| kept.full_scale_pa), Some(full_scale_pa));
}

#[test]
fn a_reboot_waits_for_its_reply_for_200_ms_at_most() {
    let mut bench = opened();
    bench.say(1, Command::Start);
    bench.hardware().sample(1);
    bench.say(2, Command::Reboot(BootTarget::BootLoader));
    bench.board.poll(Link::Open);
    assert!(!bench.board.is_acquiring());
    assert_eq!(bench.hardware().rebooted, None);
    let heard = bench.turn();
    assert_eq!((sequences(&heard).len(), heard.last()), (1, Some(&accepted(2))));
    // The link has it, but may still be sending it.
    bench.board.poll(Link::Open);
    assert_eq!(bench.hardware().rebooted, None);
    bench.hardware().now += 10 * MS;
    bench.board.poll(Link::Open);
    assert_eq!(bench.hardware().rebooted.take(), Some(BootTarget::BootLoader));

    bench.say(3, Command::Reboot(BootTarget::Firmware));
    bench.board.poll(Link::Open);
    assert_eq!(bench.hardware().rebooted, None);
    // No host reads the reply; acquisition that was started meanwhile is stopped.
    bench.say(4, Command::Start);
    bench.hardware().now += 200 * MS;
    bench.board.poll(Link::Open);
    assert_eq!(bench.hardware().rebooted.take(), Some(BootTarget::Firmware));
    assert!(!bench.board.is_acquiring());

    // Hardware that does not go dark does not hold a reset up.
    bench.say(5, Command::Start);
    bench.hardware().refuse_dark = u32::MAX;
    bench.say(6, Command::Reboot(BootTarget::Firmware));
    bench.hardware().running = None;
    bench.hardware().now += 200 * MS;
    bench.board.poll(Link::Open);
    assert_eq!(bench.hardware().rebooted, Some(BootTarget::Firmware));
}

#[test]
fn a_reboot_waits_until_settings_are_kept_and_its_reply_is_read() {
    // The reply has been read, the settings are not safe yet; and the other way round.
    for storing in [true, false] {
        let mut bench = opened();
        bench.hardware().storing_polls = if storing { 1_000 } else { 0 };
        if storing {
            bench.say(1, Command::Store(Hashes::default()));
        }
        bench.say(2, Command::Reboot(BootTarget::Firmware));
        let rest = |bench: &mut Bench, reads: bool| {
            bench.board.poll(Link::Open);
            if reads {
                bench.listen();
            }
            bench.hardware().now += 20 * MS;
            bench.board.poll(Link::Open);
            bench.hardware().rebooted.is_some()
        };
        assert!((0..3).all(|_| !rest(&mut bench, storing)), "storing: {storing}");
        bench.hardware().storing_polls = 0;
        assert!((0..2).any(|_| rest(&mut bench, true)), "storing: {storing}");
    }
}

#[test]
fn a_hardware_fault_ends_acquisition_with_an_event() {
    let mut bench = opened();
    bench.say(1, Command::Start);
    bench.hardware().sample(2);
    bench.hardware().finished.push_back(Finished::Fault(HardwareFault::Supply));
    let heard = bench.turn();
    assert_eq!(sequences(&heard), [0, 1]);
    assert!(is_event(&heard[3], "supply is too low"), "{heard:?}");
    assert!(bench.hardware().running.is_none());
}

/// Both emitters lit together, under automatic exposure.
fn automatic() -> Configuration {
    let mut automatic = configuration();
    automatic.exposure = Exposure::Automatic;
    automatic.schedule.frame_ticks = 1_000;
    automatic.schedule.slots = [EmitterSet::of(&[0, 1]), EmitterSet::DARK].into_iter().collect();
    automatic
}

const HALVED: [Level; 2] = [Level(Level::NOMINAL.0 / 2); 2];

#[test]
fn fixed_exposure_keeps_the_levels_of_saturated_cells() {
    let mut dim = automatic();
    dim.exposure = Exposure::Fixed;
    dim.levels.fill(Level(0x3000));
    let mut bench = opened();
    bench.say(1, Command::Configure(dim.clone()));
    bench.say(2, Command::Start);
    // Saturated or not, for a tenth of a second.
    for _ in 0..100 {
        bench.hardware().sample(1);
        bench.turn();
    }
    assert_eq!(bench.hardware().running, Some(dim));
}

#[test]
fn exposure_begins_anew_with_a_configuration_and_with_a_start() {
    for commands in [&[Command::Configure(automatic())][..], &[Command::Stop, Command::Start]] {
        let mut bench = opened();
        bench.say(1, Command::Configure(automatic()));
        bench.say(2, Command::Start);
        // Saturated, and collected by the command, so that nothing has been decided by it yet.
        bench.hardware().sample(1);
        for command in commands {
            bench.say(3, command.clone());
        }
        bench.turn();
        let levels = |bench: &mut Bench| bench.hardware().running.clone().expect("lit").levels;
        assert_eq!(levels(&mut bench)[..], [Level::NOMINAL; 2], "{commands:?}");
        // The next one counts.
        bench.hardware().sample(1);
        bench.turn();
        assert_eq!(levels(&mut bench)[..], HALVED, "{commands:?}");
    }
}

#[test]
fn a_host_that_has_gone_gets_no_reply_through_the_next_one() {
    let mut bench = opened();
    bench.hardware().storing_polls = 3;
    bench.say(1, Command::Store(Hashes { scene: Some(7), calibration: None }));
    bench.board.poll(Link::Closed);
    let heard = bench.turn();
    assert!(matches!(heard[..], [Heard::Hello { .. }]), "{heard:?}");
    let heard: Vec<_> = (0..3).flat_map(|_| bench.turn()).collect();
    assert!(matches!(heard[..], [Heard::Hello { hashes: Hashes { scene: Some(7), .. }, .. }]), "{heard:?}");
}

#[test]
fn converters_that_do_not_stop_are_reported_and_the_emitters_count_as_off() {
    let mut bench = opened();
    bench.say(1, Command::Start);
    bench.hardware().deaf_converters = true;
    let heard = bench.ask(2, Command::Stop);
    assert!(is_event(&heard[1], "sampling may not have stopped"), "{heard:?}");
    assert_eq!(heard[2..], [rejected(2, Rejection::Hardware(HardwareFault::Converters))]);
    let asked = bench.hardware().asked_dark;
    bench.board.poll(Link::Open);
    assert_eq!(bench.hardware().asked_dark, asked, "it is dark");
}
