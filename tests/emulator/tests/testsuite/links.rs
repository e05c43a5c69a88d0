//! The board at its links: what a computer sees of it, programs that come and go, hosts that
//! sleep, do not read, or talk rubbish.

use crate::common::is_of_silicon;
use crate::common::listener::{Said, TRANSFER_SCANS};
use crate::common::talk::{FRAME_TICKS, MS, Talk};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use slitpose_emulator::faults::{Fault, Faults};
use slitpose_emulator::machine::Stop;
use slitpose_emulator::memory::UNIQUE_ID;
use slitpose_emulator::peripherals::Ticks;
use slitpose_emulator::rig::request;
use slitpose_emulator::usb_host::Order;
use slitpose_emulator::usb_wire::{Answer, OutPacket};
use slitpose_protocol::{Command, Decoder, MAX_MESSAGE_BYTES, Message, ResetCause};

/// The board goes dark this long after it has lost its host.
const HOST_GONE: Ticks = 500 * MS;

/// The core is polled every millisecond at least, and a frame may be under way.
const POLL: Ticks = MS + FRAME_TICKS;

/// A bus without frames is looked for this often while a control transfer waits for its host, and known at the second look.
const NOTICED: Ticks = 100 * MS;

/// A bus without frames is known to be asleep after this: 3 ms (USB 2.0, 7.1.7.6).
const SUSPENSION: Ticks = 3 * MS;

fn device_id() -> [u8; 12] {
    let words = UNIQUE_ID.map(u32::to_le_bytes);
    std::array::from_fn(|n| words[n / 4][n % 4])
}

#[test]
fn a_computer_finds_a_serial_port_with_a_number_of_its_own() {
    let talk = Talk::at_usb();
    let device = talk.rig.machine.board.usb_host.device().clone();
    // Device of several functions (IAD), or communication device; 0x1209:0x0001.
    assert!([[0xef, 2, 1], [2, 0, 0]].contains(&[device.device[4], device.device[5], device.device[6]]));
    assert_eq!(device.device[8..12], [0x09, 0x12, 0x01, 0x00]);
    let [manufacturer, product, serial] = device.texts;
    assert_eq!([manufacturer, product], ["slitpose", "slitpose board"].map(|text| Some(text.to_owned())));
    let classes: Vec<_> =
        descriptors(&device.configuration).filter(|part| part[1] == 4).map(|part| [part[5], part[6]]).collect();
    assert_eq!(classes, [[2, 2], [10, 0]], "control by the abstract model, and data");
    let bulk: Vec<_> = descriptors(&device.configuration)
        .filter(|part| part[1] == 5 && part[3] & 3 == 2)
        .map(|part| (part[2] & 0x80, u16::from_le_bytes([part[4], part[5]])))
        .collect();
    assert_eq!(bulk.len(), 2);
    assert!(bulk.contains(&(0, 64)) && bulk.contains(&(0x80, 64)), "{bulk:?}");

    let serial = serial.expect("a board has a number");
    let hello = talk.ear.hello().expect("heard").clone();
    assert_eq!(hello.device_id, device_id());
    let digits: String = device_id().iter().map(|byte| format!("{byte:02X}")).collect();
    assert_eq!(serial.to_uppercase(), digits);
    assert_eq!((hello.board.as_str(), hello.reset_cause), ("NUCLEO-G474RE", ResetCause::PowerOn));
    talk.expect_no_faults();
}

/// The descriptors in a configuration, one after another.
fn descriptors(mut bytes: &[u8]) -> impl Iterator<Item = &[u8]> {
    std::iter::from_fn(move || {
        let length = usize::from(*bytes.first()?);
        let (part, rest) = bytes.split_at(length);
        bytes = rest;
        Some(part)
    })
}

#[test]
fn whoever_opens_the_port_hears_a_hello_first_and_nothing_stale() {
    let mut talk = Talk::boot();
    talk.await_port();
    for (n, pause_ms) in [0.0, 0.3, 2.0, 30.0, 700.0].into_iter().enumerate() {
        talk.open();
        assert!(matches!(talk.ear.said[0].1, Said::Hello(_)), "{:?}", talk.ear.said);
        // Half a packet that lay in the port when its host left cannot be recalled: the next one's first byte ends it.
        assert!(talk.ear.damaged() <= u64::from(n > 0), "{} packets damaged", talk.ear.damaged());
        // Left with answers on their way.
        for token in 0..20 {
            talk.rig.send(Command::Ping { token: token + 1_000 * n as u32 });
        }
        talk.run_ms(pause_ms / 10.0);
        talk.close();
        talk.run_ms(pause_ms);
    }
    talk.expect_no_faults();
}

#[test]
fn a_cable_may_be_pulled_and_plugged_in_again() {
    let mut talk = Talk::at_usb();
    // Idle.
    talk.rig.set_cable(false);
    talk.ear.breaks += 1;
    talk.run_ms(50.0);
    talk.rig.set_open(false);
    talk.rig.set_cable(true);
    talk.await_port();
    talk.open();
    assert_eq!(talk.ear.hello().map(|hello| hello.reset_cause), Some(ResetCause::PowerOn), "no reset by it");
    assert_eq!(talk.ask(Command::Start), Ok(()));
    talk.run_ms(30.0);
    // Acquiring, for long.
    talk.record().forget();
    talk.rig.set_cable(false);
    talk.ear.breaks += 1;
    let pulled = talk.rig.now();
    talk.run_ms(600.0);
    let after = talk.dark_since() - pulled;
    println!("dark {:.3} ms after pulling the cable", after as f64 / MS as f64);
    let range = HOST_GONE..=HOST_GONE + SUSPENSION + 2 * POLL;
    assert!(range.contains(&after), "dark after {after} ticks");
    talk.rig.set_cable(true);
    talk.await_port();
    talk.open();
    assert!(!talk.is_acquiring());
    assert_eq!(talk.ear.events().len(), 1, "{:?}", talk.ear.events());
    assert_eq!(talk.ask(Command::Start), Ok(()));
    assert!(talk.is_acquiring());
    // Acquiring, for a moment.
    talk.rig.set_cable(false);
    talk.ear.breaks += 1;
    talk.run_ms(50.0);
    talk.rig.set_cable(true);
    talk.await_port();
    talk.open();
    assert!(talk.is_acquiring());
    assert!(talk.ear.events().is_empty(), "{:?}", talk.ear.events());
    let breaks = talk.ear.breaks;
    let status = talk.settle_account(TRANSFER_SCANS * breaks);
    assert_eq!((status.scans_lost, status.adc_overruns), (0, 0));
    assert_eq!(talk.rig.machine.resets().len(), 1);
    talk.expect_no_faults();
}

#[test]
fn a_cable_pulled_while_the_bus_is_reset_leaves_a_board_that_is_found_again() {
    let mut talk = Talk::boot();
    // Debouncing takes 100 ms, the reset 50.
    talk.run_ms(125.0);
    for pause_ms in [50.0, 0.0] {
        talk.rig.set_cable(false);
        talk.run_ms(pause_ms);
        // Out and in between two looks at the port is a new device all the same.
        talk.rig.set_cable(true);
        talk.run_ms(5.0);
        talk.await_port();
    }
    talk.open();
    talk.expect_no_faults();
}

#[test]
fn a_computer_may_sleep() {
    let mut talk = Talk::at_usb();
    assert_eq!(talk.ask(Command::Start), Ok(()));
    for (asleep_ms, goes_on) in [(200.0, true), (900.0, false)] {
        talk.run_ms(10.0);
        talk.rig.host(|host, now| host.order(Order::Suspend, now));
        talk.ear.breaks += 1;
        talk.run_ms(asleep_ms);
        assert_eq!(lit_within_a_frame(&mut talk), goes_on, "after {asleep_ms} ms");
        // The port stays open in the program: what comes begins with a hello all the same.
        talk.ear.begin_session();
        talk.rig.host(|host, now| host.order(Order::Resume, now));
        assert!(talk.wait_for(100, |talk| talk.ear.hello().is_some()), "no hello after {asleep_ms} ms");
        assert_eq!(talk.is_acquiring(), goes_on);
        assert_eq!(talk.ear.events().len(), usize::from(!goes_on));
    }
    let status = talk.settle_account(2 * TRANSFER_SCANS);
    assert_eq!((status.scans_lost, status.adc_overruns), (0, 0));
    assert_eq!(talk.rig.machine.resets().len(), 1);
    talk.expect_no_faults();
}

/// The host begins a control transfer, outside the emulated host, and never ends it.
fn begin_transfer(talk: &mut Talk, setup: &[u8]) {
    let board = &mut talk.rig.machine.board;
    let mut port = board.usb.port(&mut board.effects);
    let mut takes = |address| {
        let packet = OutPacket { address, endpoint: 0, setup: true, toggle: false, bytes: setup };
        port.packet_out(packet) == Answer::Ack
    };
    assert!((1..128).any(&mut takes), "the board takes a SETUP");
    board.outside_changed();
}

/// SET_LINE_CODING without its data, SET_CONTROL_LINE_STATE with DTR without its status stage (CDC PSTN 1.2, 6.3).
const UNENDED: [[u8; 8]; 2] = [[0x21, 0x20, 0, 0, 0, 0, 7, 0], [0x21, 0x22, 1, 0, 0, 0, 0, 0]];

#[test]
fn a_host_that_dies_within_a_control_transfer_leaves_no_light_and_the_next_one_is_heard() {
    for setup in UNENDED {
        let mut talk = Talk::at_usb();
        assert_eq!(talk.ask(Command::Start), Ok(()));
        talk.run_ms(10.0);
        talk.rig.set_cable(false);
        begin_transfer(&mut talk, &setup);
        talk.ear.breaks += 1;
        // As long as the board waits for a host, and until it has noticed that this one is gone.
        talk.run_until(talk.rig.now() + HOST_GONE + NOTICED + POLL);
        assert!(!lit_within_a_frame(&mut talk), "lit without a host, {setup:x?}");
        talk.ear.begin_session();
        talk.rig.set_cable(true);
        assert!(talk.wait_for(500, |talk| talk.ear.hello().is_some()), "no hello after {setup:x?}");
        assert!(!talk.is_acquiring());
        assert_eq!(talk.rig.machine.resets().len(), 1);
        talk.expect_no_faults();
    }
}

#[test]
fn of_a_suspension_and_a_reset_within_a_control_transfer_the_last_counts() {
    for (setup, phase) in UNENDED.into_iter().flat_map(|setup| (0..5).map(move |phase| (setup, phase))) {
        let mut talk = Talk::at_usb();
        // Another phase of the board's looks at the bus.
        talk.run_ms(11.0 * f64::from(phase));
        begin_transfer(&mut talk, &setup);
        talk.ear.breaks += 1;
        talk.rig.host(|host, now| host.order(Order::Suspend, now));
        talk.run_ms(5.0);
        talk.ear.begin_session();
        talk.rig.host(|host, now| host.order(Order::Resume, now));
        talk.run_ms(1.0);
        talk.rig.host(|host, now| host.order(Order::Reset, now));
        assert!(talk.wait_for(1_000, |talk| talk.ear.hello().is_some()), "no hello after {setup:x?}, phase {phase}");
        assert_eq!(talk.ask(Command::Start), Ok(()));
        assert!(talk.is_acquiring());
    }
}

#[test]
fn a_host_that_suspends_and_resets_the_bus_loses_what_is_counted() {
    let mut talk = Talk::on(Faults::default().with(Fault::UsbHost));
    assert_eq!(talk.ask(Command::Start), Ok(()));
    // At each of them a transfer may be lost.
    talk.ear.breaks = 100;
    talk.run_ms(5_000.0);
    // A bus at rest closes the port for the board: what waits is dropped, and a session begins with a hello.
    talk.ear.status = None;
    assert!(talk.wait_for(2_000, |talk| talk.ear.status.is_some()), "a status in spite of it");
    let status = talk.ear.status.expect("heard");
    println!("{} scans taken, {} dropped", status.scans_taken, status.scans_dropped);
    assert!(talk.ear.hellos() > 5 && status.scans_dropped > 0, "{status:?}");
    assert_eq!((status.scans_lost, status.adc_overruns), (0, 0));
    assert!(status.acquiring && status.scans_dropped < status.scans_taken / 4, "{status:?}");
    // The tool is at rest: a word that is not its own would show.
    let words = talk.ear.scans[0];
    assert!(talk.ear.scans.iter().all(|scan| (scan.lit(), scan.dark()) == (words.lit(), words.dark())));
    assert!(talk.ear.gaps.iter().all(|gap| gap.ticks == (gap.missing + 1) * FRAME_TICKS), "{:?}", talk.ear.gaps);
    talk.record().forget();
    talk.rig.set_open(false);
    talk.run_ms(700.0);
    talk.dark_since();
    talk.expect_no_faults();
}

/// Whether an emitter is lit in the next two frames.
fn lit_within_a_frame(talk: &mut Talk) -> bool {
    talk.record().forget();
    talk.run_until(talk.rig.now() + 2 * FRAME_TICKS);
    talk.record().edges().iter().any(|edge| edge.1 != 0)
}

#[test]
fn what_ends_with_a_full_packet_arrives_at_once() {
    const SEED: u64 = 21;
    println!("seed {SEED}");
    let mut rng = ChaCha8Rng::seed_from_u64(SEED);
    let mut talk = Talk::at_usb();
    let mut number = 0;
    for round in 0..400 {
        let commands = 1 + round % 12;
        let mut burst = Vec::new();
        for _ in 0..commands {
            number += 1;
            let token = rng.random::<u32>() >> (rng.random::<u32>() % 32);
            burst.extend(request(number, Command::Ping { token }));
        }
        talk.ear.said.clear();
        talk.rig.send_bytes(&burst);
        assert_eq!(talk.answer(number, 20), Ok(()));
        let pongs = talk.ear.said.iter().filter(|(_, said)| matches!(said, Said::Pong(_))).count();
        assert_eq!(pongs, commands);
    }
    talk.run_ms(2.0);
    println!("{} empty packets, the longest wait {} ticks", talk.ear.empty_packets, talk.ear.longest_full);
    // One transfer in 64 ends with a full packet: 6 of 400, by chance.
    assert!(talk.ear.empty_packets >= 2);
    // The driver is woken once a packet and the host asks again after 20 µs at the latest; 0.2 ms
    // is several times that, and a frame of USB is 1 ms.
    assert!(talk.ear.longest_full <= MS / 5, "a full packet was left alone for {} ticks", talk.ear.longest_full);
    talk.expect_no_faults();
}

#[test]
fn the_serial_port_carries_the_default_stream_while_it_is_spoken_to() {
    let mut talk = Talk::at_uart();
    assert!(matches!(talk.ear.said[0].1, Said::Hello(_)));
    // Pings keep it open.
    for token in 0..3 {
        talk.run_ms(1_900.0);
        assert_eq!(talk.ask(Command::Ping { token }), Ok(()));
    }
    // One when it was opened, one by command.
    assert_eq!(talk.ear.hellos(), 2, "never closed");
    assert_eq!(talk.ask(Command::Start), Ok(()));
    talk.run_ms(1_000.0);
    assert_eq!(talk.ear.gaps, []);
    assert!((3_980..=4_000).contains(&talk.ear.received), "{} scans", talk.ear.received);
    let status = talk.settle_account(0);
    assert_eq!((status.scans_lost, status.scans_dropped, status.adc_overruns), (0, 0, 0));
    assert_eq!(talk.ear.damaged(), 0);
    // Silence.
    assert_eq!(talk.ask(Command::Start), Ok(()));
    talk.record().forget();
    let begin = talk.rig.now();
    talk.run_ms(2_600.0);
    let after = talk.dark_since() - begin;
    println!("dark {:.3} ms after the last word", after as f64 / MS as f64);
    let silence = 2_000 * MS;
    assert!(after + MS >= silence + HOST_GONE && after <= silence + HOST_GONE + 2 * POLL, "dark after {after} ticks");
    talk.ear.begin_session();
    assert_eq!(talk.ask(Command::Ping { token: 5 }), Ok(()));
    assert!(matches!(talk.ear.said[0].1, Said::Hello(_)));
    assert_eq!(talk.ear.events().len(), 1);
    talk.expect_no_faults();
}

/// Messages among the bytes that the serial port has sent since the last call.
fn at_serial_port(talk: &mut Talk) -> Vec<String> {
    let bytes: Vec<u8> = talk.rig.machine.board.lpuart.take_sent().iter().map(|sent| sent.byte).collect();
    let (mut decoder, mut rest, mut said) = (Decoder::<MAX_MESSAGE_BYTES>::new(), &bytes[..], Vec::new());
    while let Some(message) = decoder.next::<Message<'_>>(&mut rest) {
        let message = format!("{:?}", message.expect("whole packets"));
        if is_of_silicon(&message) {
            continue;
        }
        said.push(message.split(['(', ' ']).next().unwrap_or_default().to_owned());
    }
    said
}

fn say_at_serial_port(talk: &mut Talk, number: u16, command: Command) {
    let board = &mut talk.rig.machine.board;
    board.lpuart.send(&request(number, command), &board.effects);
    board.outside_changed();
    talk.run_ms(10.0);
}

#[test]
fn who_comes_first_has_the_board_until_the_link_is_closed() {
    let mut talk = Talk::at_usb();
    say_at_serial_port(&mut talk, 1, Command::Start);
    assert!(!talk.is_acquiring(), "not heard");
    assert_eq!(at_serial_port(&mut talk), Vec::<String>::new());
    talk.ear.said.clear();
    talk.run_ms(5.0);
    assert_eq!(talk.ear.said, [], "nor answered elsewhere");
    assert_eq!(talk.ask(Command::Ping { token: 1 }), Ok(()));

    talk.close();
    say_at_serial_port(&mut talk, 2, Command::Ping { token: 2 });
    assert_eq!(at_serial_port(&mut talk), ["Hello", "Pong", "Reply"]);

    // USB comes second and waits, until the other has been silent for two seconds.
    talk.ear.begin_session();
    talk.rig.set_open(true);
    talk.run_ms(20.0);
    let number = talk.rig.send(Command::Ping { token: 3 });
    talk.run_ms(20.0);
    assert_eq!(talk.ear.said, [], "not heard");
    say_at_serial_port(&mut talk, 3, Command::Ping { token: 4 });
    assert_eq!(at_serial_port(&mut talk), ["Pong", "Reply"]);
    assert!(talk.wait_for(2_100, |talk| talk.ear.hello().is_some()), "it is its turn now");
    assert_eq!(talk.ear.replies(number), [], "what was said before was not heard");
    assert_eq!(talk.ask(Command::Ping { token: 5 }), Ok(()));
    talk.expect_no_faults();
}

#[test]
fn reboot_to_the_boot_loader_answers_first() {
    let mut talk = Talk::at_usb();
    assert_eq!(talk.ask(Command::Start), Ok(()));
    let number = talk.rig.send(Command::Reboot(slitpose_protocol::BootTarget::BootLoader));
    assert_eq!(talk.rig.run_for(0.1), Stop::BootLoader);
    talk.listen();
    assert_eq!(talk.ear.replies(number), [Ok(())]);
    assert_eq!(talk.rig.machine.board.gates(), 0);
    talk.expect_no_faults();
}
