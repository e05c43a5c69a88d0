//! Behaviour of a board, one command sequence a test.

use core::num::NonZeroU32;

use crate::common::{
    Fake, Finished, Heard, Listener, TICK_HZ, board, configuration, identity, request, sequences, turn, without_dark,
    words,
};
use slitpose_firmware::pcb::{QUEUE_BYTES, can_run, default_configuration};
use slitpose_firmware::{Board, HOST_GONE_MS, Identity, Indicator, Link, STATUS_MS, TRANSMIT_BYTES};
use slitpose_protocol::schema::SchemaKeys;
use slitpose_protocol::{
    AdcScaling, BoardKind, BootTarget, Command, Configuration, Decoder, Edge, Edges, EmitterSet, Exposure,
    HardwareFault, Hashes, Hello, Level, MAX_MESSAGE_BYTES, Message, PROTOCOL, Pulse, RawScan, Rejection, Reply,
    ResetCause, ScheduleError, Severity, Status,
};

const MS: u64 = TICK_HZ as u64 / 1_000;

/// A board whose link has just been opened and whose hello has been heard.
fn opened() -> (Board<Fake, [u8; 2_048]>, Listener) {
    let (mut board, mut listener) = (board(Fake::default()), Listener::default());
    let heard = turn(&mut board, &mut listener);
    assert_eq!(heard, [hello(0, configuration())]);
    (board, listener)
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

fn status<const QUEUE: usize>(board: &mut Board<Fake, [u8; QUEUE]>, listener: &mut Listener) -> (Vec<Heard>, Status) {
    board.hardware_mut().now += STATUS_MS * MS;
    let mut heard = turn(board, listener);
    match heard.pop() {
        Some(Heard::Status(status)) => (heard, status),
        other => panic!("no status but {other:?}"),
    }
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
    let (mut board, mut listener) = opened();
    for (supply_v, temperature_k, load) in [(3.1, 305.0, 250), (2.9, 310.0, 400)] {
        board.hardware_mut().health = (supply_v, temperature_k, load);
        let (_, status) = status(&mut board, &mut listener);
        assert_eq!((status.supply_v, status.temperature_k, status.cpu_load_permille), (supply_v, temperature_k, load));
        assert_eq!((status.tick, status.acquiring, status.adc_overruns), (board.hardware_mut().now, false, 0));
    }
    board.receive(&request(1, Command::Start));
    assert!(status(&mut board, &mut listener).1.acquiring);
}

#[test]
fn the_number_of_the_configuration_wraps_after_65535() {
    let (mut board, mut listener) = opened();
    let configure = request(1, Command::Configure(configuration()));
    for _ in 0..=u16::MAX {
        board.receive(&configure);
    }
    board.receive(&request(2, Command::Configure(without_dark())));
    let heard = turn(&mut board, &mut listener);
    let last = [hello(u16::MAX, configuration()), hello(0, configuration()), hello(1, without_dark())];
    let hellos = heard.into_iter().filter(|heard| matches!(heard, Heard::Hello { .. })).collect::<Vec<_>>();
    assert_eq!(hellos[hellos.len() - 3..], last);
}

#[test]
fn scans_at_4_khz_come_in_batches_of_four_and_a_stop_sends_the_rest() {
    let (mut board, mut listener) = opened();
    board.receive(&request(1, Command::Start));
    assert_eq!(turn(&mut board, &mut listener), [accepted(1)]);
    assert_eq!(board.scans_to_poll(), 4);

    board.hardware_mut().sample(3);
    assert_eq!(turn(&mut board, &mut listener), []);
    assert_eq!(board.scans_to_poll(), 1);
    board.hardware_mut().sample(3);
    let heard = turn(&mut board, &mut listener);
    assert_eq!(sequences(&heard), [0, 1, 2, 3]);
    let Heard::Scan { scan, .. } = &heard[2] else { panic!("{heard:?}") };
    assert_eq!(scan.tick, 3 * 250);
    assert_eq!(scan.lit(), &[words(2, 0), words(2, 1)]);
    assert_eq!(scan.levels(), &[Level::NOMINAL; 2]);

    board.hardware_mut().sample(1);
    board.receive(&request(2, Command::Stop));
    let heard = turn(&mut board, &mut listener);
    assert_eq!(sequences(&heard), [4, 5, 6]);
    assert_eq!(heard.last(), Some(&accepted(2)));
    assert!(board.hardware_mut().running.is_none());
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
    let (mut board, mut listener) = opened();
    board.receive(&request(1, Command::Start));
    turn(&mut board, &mut listener);
    board.hardware_mut().sample(2);
    board.hardware_mut().overrun(5);
    assert_eq!(sequences(&turn(&mut board, &mut listener)), [0, 1]);
    board.hardware_mut().sample(1);
    board.hardware_mut().set_level(Level(7));
    board.hardware_mut().sample(1);
    assert_eq!(sequences(&turn(&mut board, &mut listener)), [7]);
    board.hardware_mut().sample(3);
    let heard = turn(&mut board, &mut listener);
    assert_eq!(sequences(&heard), [8, 9, 10, 11]);
    let (_, status) = status(&mut board, &mut listener);
    assert_eq!((status.scans_taken, status.scans_lost, status.adc_overruns), (12, 5, 1));
}

#[test]
fn a_new_configuration_starts_a_new_batch_behind_its_hello() {
    let (mut board, mut listener) = opened();
    board.receive(&request(1, Command::Start));
    board.hardware_mut().sample(2);
    board.receive(&request(2, Command::Configure(without_dark())));
    board.hardware_mut().sample(4);
    board.receive(&request(3, Command::Hello));
    let heard = turn(&mut board, &mut listener);
    let hello = hello(1, without_dark());
    assert_eq!(heard[0], accepted(1));
    assert_eq!(sequences(&heard[1..3]), [0, 1]);
    assert_eq!(heard[3..7], [hello.clone(), accepted(2), hello, accepted(3)]);
    assert_eq!(sequences(&heard[7..]), [2, 3, 4, 5]);
    assert!(matches!(&heard[7], Heard::Scan { configuration: 1, scan } if scan.dark().is_none()));
}

#[test]
fn a_configuration_that_cannot_run_is_rejected_and_changes_nothing() {
    let (mut board, mut listener) = opened();
    board.receive(&request(1, Command::Start));
    turn(&mut board, &mut listener);

    let mut short = configuration();
    short.schedule.slot_ticks = 20;
    let mut other_clock = configuration();
    other_clock.schedule.tick_hz += 1;
    let mut one_level = configuration();
    one_level.levels.pop();
    let mut odd = configuration();
    odd.schedule.oversampling = 3;
    for (number, wrong) in [(2, short), (3, other_clock), (4, one_level), (5, odd)] {
        board.receive(&request(number, Command::Configure(wrong)));
    }
    let too_short = ScheduleError::SlotTooShort { needed_ticks: 21, slot_ticks: 20 };
    assert_eq!(
        turn(&mut board, &mut listener),
        [
            rejected(2, Rejection::Schedule(too_short)),
            rejected(3, Rejection::TickRate { asked_hz: TICK_HZ + 1, board_hz: TICK_HZ }),
            rejected(4, Rejection::Levels { levels: 1, cells: 2 }),
            rejected(5, Rejection::Unsuited(HardwareFault::Oversampling { oversampling: 3 })),
        ]
    );
    assert_eq!(board.hardware_mut().running, Some(configuration()));
    assert_eq!(status(&mut board, &mut listener).1.commands_rejected, 4);
}

#[test]
fn unknown_commands_are_answered_and_damaged_ones_counted() {
    let (mut board, mut listener) = opened();
    // Number 5 is of kind 77; number 6 is a Stop with a byte too many.
    let unknown = [0x07, 0x05, 0x4d, 0x97, 0xdb, 0xc3, 0x34, 0x00];
    let malformed = [0x08, 0x06, 0x02, 0x09, 0x86, 0x7f, 0x26, 0xb0, 0x00];
    let mut damaged = request(9, Command::Start);
    damaged[1] ^= 0x10;
    assert_eq!(board.receive(&[&unknown[..], &malformed[..]].concat()), 2);
    assert_eq!(board.receive(&damaged), 0);
    board.receive(&request(10, Command::Ping { token: 4 }));
    let heard = turn(&mut board, &mut listener);
    assert_eq!(heard[0], rejected(5, Rejection::Unsupported { kind: 77 }));
    assert_eq!(heard[1], rejected(6, Rejection::Malformed { kind: 2 }));
    assert!(matches!(heard[2], Heard::Pong(pong) if pong.token == 4));
    assert_eq!(heard[3..], [accepted(10)]);
    let (_, status) = status(&mut board, &mut listener);
    assert_eq!((status.commands_damaged, status.commands_rejected), (1, 2));
}

#[test]
fn hardware_that_refuses_leaves_the_board_dark() {
    let (mut board, mut listener) = opened();
    for (number, command) in [(1, Command::Start), (3, Command::Configure(without_dark()))] {
        board.hardware_mut().refuse_light = Some(HardwareFault::Timing);
        board.receive(&request(number, command));
        let heard = turn(&mut board, &mut listener);
        assert!(is_event(&heard[0], "the timers"), "{heard:?}");
        assert_eq!(heard[1], rejected(number, Rejection::Hardware(HardwareFault::Timing)));
        assert!(!board.is_acquiring() && board.hardware_mut().running.is_none());
        assert_eq!(board.hardware_mut().indicator, Some(Indicator::Fault));

        board.receive(&request(2, Command::Start));
        assert_eq!(turn(&mut board, &mut listener), [accepted(2)]);
        assert_eq!(board.hardware_mut().running, Some(configuration()), "the old one stays");
        assert_eq!(board.hardware_mut().indicator, Some(Indicator::Acquiring));
    }
}

#[test]
fn a_stop_that_fails_is_tried_until_the_emitters_are_off() {
    let (mut board, mut listener) = opened();
    board.receive(&request(1, Command::Start));
    turn(&mut board, &mut listener);
    board.hardware_mut().refuse_dark = 2;
    board.receive(&request(2, Command::Stop));
    let heard = turn(&mut board, &mut listener);
    assert!(is_event(&heard[0], "may still be lit"), "{heard:?}");
    assert_eq!(heard[1..], [rejected(2, Rejection::Hardware(HardwareFault::Emitters))]);
    assert!(!board.is_acquiring() && board.hardware_mut().running.is_some());
    assert_eq!(board.hardware_mut().indicator, Some(Indicator::Fault));
    assert_eq!(turn(&mut board, &mut listener), [], "told once");
    assert!(board.hardware_mut().running.is_none());
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
        let (mut board, mut listener) = opened();
        board.receive(&request(1, Command::Start));
        turn(&mut board, &mut listener);
        board.hardware_mut().sample(2);
        let mut scan = RawScan::new(2, true);
        (scan.sequence, scan.tick) = (2, 750);
        contradict(&mut scan);
        board.hardware_mut().finished.push_back(Finished::Scan(scan));
        let heard = turn(&mut board, &mut listener);
        assert_eq!(sequences(&heard), [0, 1], "case {case}");
        assert!(is_event(&heard[2], "inconsistent"), "case {case}: {heard:?}");
        assert!(!board.is_acquiring() && board.hardware_mut().running.is_none(), "case {case}");
        let (_, status) = status(&mut board, &mut listener);
        assert_eq!(status.scans_taken, 2 + status.scans_lost, "case {case}");
    }
}

#[test]
fn a_link_closed_for_500_ms_ends_acquisition_and_the_next_host_hears_of_it() {
    let (mut board, mut listener) = opened();
    board.receive(&request(1, Command::Start));
    turn(&mut board, &mut listener);
    board.hardware_mut().now += (HOST_GONE_MS - 1) * MS;
    board.poll(Link::Closed);
    assert!(board.is_acquiring());
    board.poll(Link::Open);
    board.hardware_mut().now += (HOST_GONE_MS - 1) * MS;
    board.poll(Link::Closed);
    assert!(board.is_acquiring(), "the time starts anew");
    board.hardware_mut().now += MS;
    board.poll(Link::Closed);
    assert!(!board.is_acquiring() && board.hardware_mut().running.is_none());

    let heard = turn(&mut board, &mut listener);
    assert_eq!(heard[0], hello(0, configuration()));
    assert!(is_event(&heard[1], "closed for 500 ms"), "{heard:?}");
    assert!(matches!(heard[1], Heard::Event { severity: Severity::Warning, .. }));
    assert_eq!(turn(&mut board, &mut listener), [], "told once");
}

#[test]
fn packets_for_one_host_do_not_reach_the_next() {
    let (mut board, mut listener) = opened();
    board.receive(&request(1, Command::Start));
    board.hardware_mut().sample(4);
    board.poll(Link::Open);
    board.receive(&request(2, Command::Ping { token: 1 })[..4]);
    board.poll(Link::Closed);
    board.hardware_mut().sample(4);
    board.poll(Link::Closed);

    board.receive(&request(3, Command::Stop));
    assert_eq!(turn(&mut board, &mut listener), [accepted(3), hello(0, configuration())]);
    let (_, status) = status(&mut board, &mut listener);
    assert_eq!((status.scans_taken, status.scans_dropped, status.batches_dropped), (8, 8, 2));
}

#[test]
fn a_full_queue_drops_its_oldest_scans_and_keeps_replies() {
    let (mut board, mut listener) = opened();
    board.receive(&request(1, Command::Start));
    for _ in 0..50 {
        board.hardware_mut().sample(4);
        board.poll(Link::Open);
    }
    board.receive(&request(2, Command::Stop));
    let heard = turn(&mut board, &mut listener);
    assert_eq!((heard.first(), heard.last()), (Some(&accepted(1)), Some(&accepted(2))));
    let sequences = sequences(&heard);
    assert!(sequences.len() > 40);
    assert_eq!(sequences, (200 - sequences.len() as u64..200).collect::<Vec<_>>(), "the newest, whole");
    let (_, status) = status(&mut board, &mut listener);
    assert_eq!(status.scans_dropped, 200 - sequences.len() as u64);
    assert_eq!(u64::from(status.batches_dropped), status.scans_dropped / 4);
    assert_eq!(status.replies_dropped, 0);
}

#[test]
fn a_host_that_never_reads_loses_replies_and_the_status_counts_them() {
    let (mut board, mut listener) = opened();
    for number in 0..1_000 {
        board.receive(&request(number, Command::Start));
    }
    let heard = turn(&mut board, &mut listener);
    assert_eq!(heard.last(), Some(&accepted(999)));
    assert!(heard.len() >= 100);
    let (_, status) = status(&mut board, &mut listener);
    assert_eq!(heard.len() + status.replies_dropped as usize, 1_000);
}

#[test]
fn a_queue_without_room_for_a_batch_keeps_none_and_counts() {
    let mut board = Board::new(Fake::default(), identity(), configuration(), [0; 16]).unwrap();
    let mut listener = Listener::default();
    turn(&mut board, &mut listener);
    board.receive(&request(1, Command::Start));
    board.hardware_mut().sample(8);
    assert_eq!(turn(&mut board, &mut listener), [accepted(1)]);
    let (_, status) = status(&mut board, &mut listener);
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
    let mut board = Board::new(fake, identity(), default_configuration(), [0; QUEUE_BYTES]).unwrap();
    board.poll(Link::Open);
    board.receive(&request(1, Command::Start));
    board.receive(&request(2, Command::Hello));
    for _ in 0..100 {
        board.hardware_mut().sample(4);
        board.poll(Link::Open);
    }
    let heard = Listener::default().listen(&mut board);
    assert_eq!(sequences(&heard).len(), 400);
}

#[test]
fn edges_are_numbered_from_the_start_and_those_of_a_closed_link_leave_a_gap() {
    let mut board = board(Fake::default());
    let mut listener = Listener::default();
    let mut pass = |link: Link, ticks: core::ops::Range<u64>| {
        board.hardware_mut().edges.extend(ticks.map(|tick| Edge::new(tick, tick % 2 == 0)));
        board.poll(link);
        listener
            .listen(&mut board)
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
        let (mut board, _) = opened();
        board.receive(&request(1, Command::Pulse(pulse)));
        assert_eq!(board.hardware_mut().pulse, Some(pulse));
        // There is no slot of this number.
        board.receive(&request(9, Command::Pulse(Pulse { every: 3, slot: 4 })));
        assert_eq!(board.hardware_mut().pulse, Some(pulse));
        board.receive(&request(2, command));
        assert_eq!(board.hardware_mut().pulse, Some(Pulse::NONE));
    }
}

#[test]
fn identify_lasts_as_long_as_asked() {
    let (mut board, mut listener) = opened();
    board.receive(&request(1, Command::Identify { seconds: 2 }));
    turn(&mut board, &mut listener);
    assert_eq!(board.hardware_mut().indicator, Some(Indicator::Identify));
    board.hardware_mut().now += 1_999 * MS;
    turn(&mut board, &mut listener);
    assert_eq!(board.hardware_mut().indicator, Some(Indicator::Identify));
    board.hardware_mut().now += MS;
    turn(&mut board, &mut listener);
    assert_eq!(board.hardware_mut().indicator, Some(Indicator::Idle));
}

#[test]
fn a_status_comes_twice_a_second_while_the_link_is_open() {
    let (mut board, mut listener) = opened();
    let mut statuses = 0;
    for _ in 0..=10_000 {
        statuses += turn(&mut board, &mut listener).len();
        board.hardware_mut().now += MS;
    }
    assert_eq!(statuses, 20);
    for _ in 0..10_000 {
        board.poll(Link::Closed);
        assert_eq!(listener.listen(&mut board), []);
        board.hardware_mut().now += MS;
    }
}

#[test]
fn a_store_is_answered_once_its_settings_are_kept() {
    let (mut board, mut listener) = opened();
    let hashes = Hashes { scene: Some(7), calibration: Some(8) };
    board.hardware_mut().storing_polls = 2;
    board.receive(&request(1, Command::Configure(without_dark())));
    board.receive(&request(2, Command::Start));
    board.receive(&request(3, Command::Store(hashes)));
    board.receive(&request(4, Command::Forget));
    let heard = turn(&mut board, &mut listener);
    assert_eq!(heard[3..], [rejected(4, Rejection::Storing)], "one at a time");
    board.hardware_mut().sample(4);
    assert_eq!(sequences(&turn(&mut board, &mut listener)), [0, 1, 2, 3], "sampling goes on");
    let heard = turn(&mut board, &mut listener);
    let Heard::Hello { hashes: told, .. } = heard[0] else { panic!("{heard:?}") };
    assert_eq!((told, &heard[1..]), (hashes, &[accepted(3)][..]));
    let kept = board.hardware_mut().kept.clone().expect("kept");
    assert_eq!((kept.configuration, kept.hashes), (without_dark(), hashes));

    board.hardware_mut().refuse_store = true;
    board.receive(&request(5, Command::Forget));
    assert_eq!(turn(&mut board, &mut listener), [rejected(5, Rejection::Storage)]);
    board.receive(&request(6, Command::Forget));
    let heard = turn(&mut board, &mut listener);
    assert!(matches!(heard[0], Heard::Hello { hashes: Hashes { scene: None, calibration: None }, .. }));
    assert_eq!(board.hardware_mut().kept, None);
}

#[test]
fn a_full_scale_is_told_with_the_next_configuration_and_kept() {
    let (mut board, mut listener) = opened();
    board.receive(&request(1, Command::Start));
    turn(&mut board, &mut listener);
    let full_scale_pa = NonZeroU32::new(6_600_000).expect("not zero");
    board.receive(&request(2, Command::FullScale { full_scale_pa }));
    let mut sent = [0; TRANSMIT_BYTES];
    board.poll(Link::Open);
    let mut bytes = board.transmit(&mut sent);
    let mut decoder = Decoder::<MAX_MESSAGE_BYTES>::new();
    let Some(Ok(Message::Hello(hello))) = decoder.next::<Message>(&mut bytes) else { panic!("no hello") };
    assert_eq!((hello.configuration, hello.scaling), (1, identity().scaling.with_full_scale(full_scale_pa)));
    assert!((hello.scaling.full_scale_a() / 6.6e-6 - 1.0).abs() < 1e-6);
    assert!(board.is_acquiring());
    // Number 3, zero picoamperes.
    board.receive(&[0x03, 0x03, 0x0b, 0x05, 0x80, 0xbe, 0xf3, 0x1e, 0x00]);
    assert_eq!(turn(&mut board, &mut listener), [rejected(3, Rejection::Malformed { kind: 11 })]);
    board.receive(&request(4, Command::Store(Hashes::default())));
    turn(&mut board, &mut listener);
    assert_eq!(board.hardware_mut().kept.as_ref().and_then(|kept| kept.full_scale_pa), Some(full_scale_pa));
    // One that does not come into force is not told.
    board.hardware_mut().refuse_light = Some(HardwareFault::Converters);
    board.receive(&request(5, Command::FullScale { full_scale_pa: NonZeroU32::MIN }));
    turn(&mut board, &mut listener);
    board.receive(&request(6, Command::Store(Hashes::default())));
    turn(&mut board, &mut listener);
    assert_eq!(board.hardware_mut().kept.as_ref().and_then(|kept| kept.full_scale_pa), Some(full_scale_pa));
}

#[test]
fn a_reboot_waits_for_its_reply_for_200_ms_at_most() {
    let (mut board, mut listener) = opened();
    board.receive(&request(1, Command::Start));
    board.hardware_mut().sample(1);
    board.receive(&request(2, Command::Reboot(BootTarget::BootLoader)));
    board.poll(Link::Open);
    assert!(!board.is_acquiring());
    assert_eq!(board.hardware_mut().rebooted, None);
    let heard = turn(&mut board, &mut listener);
    assert_eq!((sequences(&heard).len(), heard.last()), (1, Some(&accepted(2))));
    // The link has it, but may still be sending it.
    board.poll(Link::Open);
    assert_eq!(board.hardware_mut().rebooted, None);
    board.hardware_mut().now += 10 * MS;
    board.poll(Link::Open);
    assert_eq!(board.hardware_mut().rebooted.take(), Some(BootTarget::BootLoader));

    board.receive(&request(3, Command::Reboot(BootTarget::Firmware)));
    board.poll(Link::Open);
    assert_eq!(board.hardware_mut().rebooted, None);
    // No host reads the reply; acquisition that was started meanwhile is stopped.
    board.receive(&request(4, Command::Start));
    board.hardware_mut().now += 200 * MS;
    board.poll(Link::Open);
    assert_eq!(board.hardware_mut().rebooted.take(), Some(BootTarget::Firmware));
    assert!(!board.is_acquiring());

    // Hardware that does not go dark does not hold a reset up.
    board.receive(&request(5, Command::Start));
    board.hardware_mut().refuse_dark = u32::MAX;
    board.receive(&request(6, Command::Reboot(BootTarget::Firmware)));
    board.hardware_mut().running = None;
    board.hardware_mut().now += 200 * MS;
    board.poll(Link::Open);
    assert_eq!(board.hardware_mut().rebooted, Some(BootTarget::Firmware));
}

#[test]
fn a_reboot_waits_until_settings_are_kept_and_its_reply_is_read() {
    // The reply has been read, the settings are not safe yet; and the other way round.
    for storing in [true, false] {
        let (mut board, mut listener) = opened();
        board.hardware_mut().storing_polls = if storing { 1_000 } else { 0 };
        if storing {
            board.receive(&request(1, Command::Store(Hashes::default())));
        }
        board.receive(&request(2, Command::Reboot(BootTarget::Firmware)));
        let mut rest = |board: &mut Board<Fake, _>, reads: bool| {
            board.poll(Link::Open);
            if reads {
                listener.listen(board);
            }
            board.hardware_mut().now += 20 * MS;
            board.poll(Link::Open);
            board.hardware_mut().rebooted.is_some()
        };
        assert!((0..3).all(|_| !rest(&mut board, storing)), "storing: {storing}");
        board.hardware_mut().storing_polls = 0;
        assert!((0..2).any(|_| rest(&mut board, true)), "storing: {storing}");
    }
}

#[test]
fn a_hardware_fault_ends_acquisition_with_an_event() {
    let (mut board, mut listener) = opened();
    board.receive(&request(1, Command::Start));
    board.hardware_mut().sample(2);
    board.hardware_mut().finished.push_back(Finished::Fault(HardwareFault::Supply));
    let heard = turn(&mut board, &mut listener);
    assert_eq!(sequences(&heard), [0, 1]);
    assert!(is_event(&heard[3], "supply is too low"), "{heard:?}");
    assert!(board.hardware_mut().running.is_none());
}

/// Both emitters lit together, under automatic exposure.
fn automatic() -> Configuration {
    let mut automatic = configuration();
    automatic.exposure = Exposure::Automatic;
    automatic.schedule.frame_ticks = 1_000;
    automatic.schedule.slots = [EmitterSet::of(&[0, 1]), EmitterSet::DARK].into_iter().collect();
    automatic
}

/// The scripted board's words are a quarter of this one's range.
fn faint() -> Identity {
    Identity { scaling: AdcScaling { saturation_code: u16::MAX, ..identity().scaling }, ..identity() }
}

const HALVED: [Level; 2] = [Level(Level::NOMINAL.0 / 2); 2];

#[test]
fn exposure_ends_at_the_highest_level_of_the_hardware() {
    let highest = Level(0x9000);
    let mut board =
        Board::new(Fake { highest: Some(highest), ..Fake::default() }, faint(), automatic(), [0; 2_048]).unwrap();
    let mut listener = Listener::default();
    turn(&mut board, &mut listener);
    board.receive(&request(1, Command::Start));
    // Faint light waits for its decision, 20 ms.
    for _ in 0..=20 {
        board.hardware_mut().sample(1);
        turn(&mut board, &mut listener);
    }
    let running = board.hardware_mut().running.clone().expect("still lit");
    assert_eq!(running.levels[..], [highest; 2]);
}

#[test]
fn fixed_exposure_keeps_the_levels_of_saturated_cells() {
    let mut dim = automatic();
    dim.exposure = Exposure::Fixed;
    dim.levels.fill(Level(0x3000));
    let (mut board, mut listener) = opened();
    board.receive(&request(1, Command::Configure(dim.clone())));
    board.receive(&request(2, Command::Start));
    // Saturated or not, for a tenth of a second.
    for _ in 0..100 {
        board.hardware_mut().sample(1);
        turn(&mut board, &mut listener);
    }
    assert_eq!(board.hardware_mut().running, Some(dim));
}

#[test]
fn exposure_begins_anew_with_a_configuration_and_with_a_start() {
    for commands in [&[Command::Configure(automatic())][..], &[Command::Stop, Command::Start]] {
        let (mut board, mut listener) = opened();
        board.receive(&request(1, Command::Configure(automatic())));
        board.receive(&request(2, Command::Start));
        // Saturated, and collected by the command, so that nothing has been decided by it yet.
        board.hardware_mut().sample(1);
        for command in commands {
            board.receive(&request(3, command.clone()));
        }
        turn(&mut board, &mut listener);
        let levels = |board: &mut Board<Fake, _>| board.hardware_mut().running.clone().expect("lit").levels;
        assert_eq!(levels(&mut board)[..], [Level::NOMINAL; 2], "{commands:?}");
        // The next one counts.
        board.hardware_mut().sample(1);
        turn(&mut board, &mut listener);
        assert_eq!(levels(&mut board)[..], HALVED, "{commands:?}");
    }
}

#[test]
fn a_host_that_has_gone_gets_no_reply_through_the_next_one() {
    let (mut board, mut listener) = opened();
    board.hardware_mut().storing_polls = 3;
    board.receive(&request(1, Command::Store(Hashes { scene: Some(7), calibration: None })));
    board.poll(Link::Closed);
    let heard = turn(&mut board, &mut listener);
    assert!(matches!(heard[..], [Heard::Hello { .. }]), "{heard:?}");
    let heard: Vec<_> = (0..3).flat_map(|_| turn(&mut board, &mut listener)).collect();
    assert!(matches!(heard[..], [Heard::Hello { hashes: Hashes { scene: Some(7), .. }, .. }]), "{heard:?}");
}

#[test]
fn converters_that_do_not_stop_are_reported_and_the_emitters_count_as_off() {
    let (mut board, mut listener) = opened();
    board.receive(&request(1, Command::Start));
    board.hardware_mut().deaf_converters = true;
    board.receive(&request(2, Command::Stop));
    let heard = turn(&mut board, &mut listener);
    assert!(is_event(&heard[1], "sampling may not have stopped"), "{heard:?}");
    assert_eq!(heard[2..], [rejected(2, Rejection::Hardware(HardwareFault::Converters))]);
    let asked = board.hardware_mut().asked_dark;
    board.poll(Link::Open);
    assert_eq!(board.hardware_mut().asked_dark, asked, "it is dark");
}
