//! Figures of the default image in `firmware/README.md`: what it takes of the chip, how soon it starts, and how late its scans
//! are. They are printed with `--nocapture`.

use crate::common::listener::{Listener, Said};
use crate::common::talk::Talk;
use crate::common::{scene, us};
use slitpose_emulator::memory::RAM_BYTES;
use slitpose_emulator::peripherals::{TICKS_PER_SECOND, Ticks};
use slitpose_emulator::rig::{Link, open_image};
use slitpose_firmware::pcb::default_configuration;
use slitpose_head::front_end;
use slitpose_protocol::{Command, Configuration, Exposure, Hashes};

/// Bytes of RAM that are kept for the stack.
const STACK_BYTES: u32 = 31_928;

/// Every command, new levels, damaged bytes, a closed port.
#[test]
fn image_and_stack_fit_the_chip() {
    let mut talk = Talk::quiet();
    let mut fast = default_configuration();
    fast.schedule.frame_ticks = 23_200;
    let automatic = Configuration { exposure: Exposure::Automatic, ..default_configuration() };
    for command in [
        Command::Hello,
        Command::Start,
        Command::Ping { token: 1 },
        Command::Identify { seconds: 1 },
        Command::Configure(fast),
        Command::Configure(automatic),
        Command::Store(Hashes { scene: Some(1), calibration: Some(2) }),
        Command::Forget,
        Command::Stop,
        Command::Start,
    ] {
        talk.accept(&command);
        talk.run_ms(100.0);
    }
    talk.rig.send_bytes(&[0x55; 300]);
    talk.run_ms(10.0);
    talk.close();
    talk.run_ms(700.0);
    talk.open();
    talk.accept(&Command::Start);
    talk.run_ms(1_000.0);
    let (image, stack) = (open_image(None).expect("firmware/build makes it"), talk.rig.stack_bytes());
    println!("{} bytes of flash, {} of static RAM, {stack} of stack", image.flash_bytes(), image.static_ram_bytes);
    assert!(stack <= STACK_BYTES && image.static_ram_bytes + STACK_BYTES as usize <= RAM_BYTES, "{stack}");
}

/// When the first hello has come, by power.
fn first_hello(ear: &Listener) -> Ticks {
    ear.said.iter().find(|(_, said)| matches!(said, Said::Hello(_))).expect("a hello").0
}

#[test]
fn the_board_is_there_within_a_fifth_of_a_second() {
    let Talk { rig, ear } = Talk::boot();
    let mut talk = Talk { rig: rig.with_link(Link::Uart), ear };
    println!("clock after {:.0} µs", us(talk.origin()));
    while talk.ear.hello().is_none() {
        talk.rig.send(Command::Hello);
        talk.run_ms(1.0);
    }
    let at_serial_port = first_hello(&talk.ear);
    let mut talk = Talk::boot();
    // Before the computer has found it.
    talk.rig.set_open(true);
    assert!(talk.wait_for(1_000, |talk| talk.ear.hello().is_some()), "no hello");
    let at_usb = first_hello(&talk.ear);
    println!("hello after {:.0} µs at the serial port, {:.0} µs at USB", us(at_serial_port), us(at_usb));
    assert!(us(at_serial_port) < 10e3 && us(at_usb) < 200e3);
}

/// Frames a second, scans in a packet, and how late they are at most: in the median, and 99 % of them, microseconds.
const LATENESS_US: [(f64, u8, [f64; 2]); 5] = [
    (4e3, 4, [1e3, 1.4e3]),
    (4e3, 1, [300.0, 350.0]),
    (8e3, 4, [800.0, 1e3]),
    (8e3, 2, [700.0, 1e3]),
    (1e4, 4, [1.2e3, 1.5e3]),
];

#[test]
fn scans_come_soon_after_their_light_at_every_rate_and_none_is_lost() {
    for (rate_hz, scans, most_us) in LATENESS_US {
        let file = front_end::at_rate(&scene(), rate_hz).expect("a rate that fits");
        let configuration = front_end::configuration(&file).expect("a schedule");
        let at = lateness_us(&configuration, scans);
        println!("{rate_hz} frames/s, {scans} in a packet: {at:.0?} µs in the median, for 99 %, at most");
        assert!(at.iter().zip(most_us).all(|(at, most)| *at < most), "{rate_hz} {scans}: {at:?}");
    }
}

/// Between the last conversion of light and the end of the packet: median, 99 %, most, of a second.
fn lateness_us(configuration: &Configuration, scans: u8) -> [f64; 3] {
    let mut talk = Talk::quiet();
    talk.accept(&Command::Configure(configuration.clone()));
    talk.accept(&Command::Packet { scans });
    talk.forget();
    talk.rig.send(Command::Start);
    talk.run_ms(1_000.0);
    // Each scan with the end of the packet that completes its batch.
    let batches = talk.ear.said.iter().filter_map(|(at, said)| match said {
        Said::Batch(_, _, count) => Some(std::iter::repeat_n(*at, *count as usize)),
        _ => None,
    });
    let over: Vec<Ticks> = batches.flatten().collect();
    let origin = talk.origin();
    let schedule = &configuration.schedule;
    let conversions = u64::from(schedule.oversampling - 1) * u64::from(schedule.conversion_ticks);
    let first = (0..usize::from(schedule.cells))
        .filter_map(|cell| schedule.first_sample_ticks(schedule.lit_slot(cell)?, cell))
        .max()
        .expect("lit");
    let scans = over.iter().zip(&talk.ear.scans);
    let mut late: Vec<_> = scans.map(|(over, scan)| over - (origin + scan.tick + first + conversions)).collect();
    late.sort_unstable();
    assert_eq!((over.len(), talk.ear.gaps.len()), (talk.ear.scans.len(), 0));
    assert!(over.len() as u64 > TICKS_PER_SECOND / u64::from(schedule.frame_ticks) - 40, "{}", over.len());
    [0.5, 0.99, 1.0].map(|share| us(late[((late.len() - 1) as f64 * share) as usize]))
}
