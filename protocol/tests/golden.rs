//! The bytes of every message and command, pinned: whoever changes one of these breaks
//! every program that speaks this protocol. They were made by an encoder written from
//! the description in the crate's documentation alone.

use heapless::Vec;
use slitpose_protocol::schema::{COMMANDS, MESSAGES, SchemaKeys};
use slitpose_protocol::{
    AdcScaling, Batch, BoardKind, BootTarget, Command, Configuration, Decoder, EmitterSet, Event, Exposure,
    HardwareFault, Hashes, Hello, Level, MAX_MESSAGE_BYTES, MAX_REQUEST_BYTES, Message, PROTOCOL, Packet, Pong,
    Rejection, Reply, Request, ResetCause, Schedule, ScheduleError, Severity, Status, Truth, encode,
};

fn bytes(hex: &str) -> std::vec::Vec<u8> {
    (0..hex.len()).step_by(2).map(|i| u8::from_str_radix(&hex[i..i + 2], 16).expect("hex digits")).collect()
}

fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}

fn assert_encodes<'p>(value: &impl Packet<'p>, golden: &str) {
    let mut buffer = [0; MAX_MESSAGE_BYTES];
    assert_eq!(hex(encode(value, &mut buffer).expect("it fits")), golden);
}

fn assert_message(message: &Message, golden: &str) {
    assert_encodes(message, golden);
    let mut decoder = Decoder::<MAX_MESSAGE_BYTES>::new();
    let decoded = decoder.next(&mut bytes(golden).as_slice());
    assert_eq!(decoded, Some(Ok(message.clone())));
}

fn assert_command(number: u16, command: Command, golden: &str) {
    let request = Request { number, command };
    assert_encodes(&request, golden);
    let mut decoder = Decoder::<MAX_REQUEST_BYTES>::new();
    let decoded = decoder.next(&mut bytes(golden).as_slice());
    assert_eq!(decoded, Some(Ok(request)));
}

fn two_cells() -> Schedule {
    Schedule {
        tick_hz: 170_000_000,
        frame_ticks: 42_500,
        slots: Vec::from_array([EmitterSet::of(&[0]), EmitterSet::of(&[1]), EmitterSet::DARK]),
        slot_ticks: 3_500,
        settling_ticks: 2_210,
        conversion_ticks: 148,
        oversampling: 4,
        cells: 2,
    }
}

fn levels() -> Vec<Level, 16> {
    Vec::from_array([Level::NOMINAL, Level(0x4000)])
}

#[test]
fn hello() {
    assert_message(
        &Message::Hello(Hello {
            protocol: PROTOCOL,
            message_keys: SchemaKeys(&[1, 2, 3, 4, 5, 6, 7, 8]),
            command_keys: SchemaKeys(&[]),
            device_id: [0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11],
            kind: BoardKind::Simulated,
            board: "virtual",
            firmware: "0.1.0",
            reset_cause: ResetCause::BrownOut,
            hashes: Hashes { scene: Some(0x0123_4567_89ab_cdef), calibration: Some(7) },
            scaling: AdcScaling { zero_code: 3900.5, amperes_per_code: -2.5e-9, bits: 12, saturation_code: 64 },
            configuration: 3,
            schedule: two_cells(),
        }),
        "0102020a08010203040506070801280102030405060708090a0b01077669727475616c\
         05302e312e300201ef9bafcdf8acd191010107010101011979ae403a8c30e28e7925be\
         0c400380fd875184cc020301020dac1ba2119401040241bcc13c00",
    );
}

#[test]
fn batch() {
    let samples: std::vec::Vec<u8> = (0x1000..0x1010_u16).flat_map(u16::to_le_bytes).collect();
    let batch = Batch { configuration: 3, sequence: 4_000, tick: 170_000_000, levels: levels(), samples: &samples };
    assert_message(
        &Message::Batch(batch.clone()),
        "110103a01f80fd8751028080028080012024100110021003100410051006100710\
         081009100a100b100c100d100e100f10fdc0075400",
    );
    let scans: std::vec::Vec<_> = batch.scans(&two_cells()).unwrap().collect();
    assert_eq!(scans.len(), 2);
    assert_eq!((scans[1].sequence, scans[1].tick), (4_001, 170_042_500));
    assert_eq!(scans[1].levels(), &levels());
    assert_eq!(scans[1].lit(), &[[0x1008, 0x1009], [0x100a, 0x100b]]);
    let dark = [[0x100c, 0x100d], [0x100e, 0x100f]];
    assert_eq!(scans[1].dark(), Some(dark.as_slice()));
}

#[test]
fn status() {
    assert_message(
        &Message::Status(Status {
            tick: 85_000_000,
            acquiring: true,
            scans_taken: 2_000,
            scans_dropped: 8,
            batches_dropped: 2,
            scans_lost: 5,
            adc_overruns: 1,
            replies_dropped: 0,
            commands_damaged: 3,
            commands_rejected: 4,
            supply_v: 3.3,
            temperature_k: 300.0,
            cpu_load_permille: 125,
        }),
        "0d02c0fec32801d00f0802050107030433335340010896437d8e9ddf1500",
    );
}

#[test]
fn event() {
    assert_message(
        &Message::Event(Event { tick: 1_000, severity: Severity::Warning, text: "link was closed" }),
        "1903e807010f6c696e6b2077617320636c6f7365644c6ac1b900",
    );
}

#[test]
fn replies() {
    assert_message(&Message::Reply(Reply { number: 513, outcome: Ok(()) }), "0404810405f8fcbd2a00");
    assert_message(
        &Message::Reply(Reply {
            number: 7,
            outcome: Err(Rejection::Schedule(ScheduleError::SlotTooShort { needed_ticks: 5_762, slot_ticks: 3_500 })),
        }),
        "0e0407010207822dac1b1eabad1700",
    );
    let fault = HardwareFault::Conversion { asked_ticks: 150, nearest_ticks: 148 };
    assert_message(
        &Message::Reply(Reply { number: 8, outcome: Err(Rejection::Hardware(fault)) }),
        "0e0408010501960194016746195800",
    );
}

#[test]
fn pong() {
    assert_message(&Message::Pong(Pong { token: 7, tick: 170_000_000 }), "0b050780fd875156d5c46b00");
}

#[test]
fn truth() {
    assert_message(
        &Message::Truth(Truth {
            sequence: 4_000,
            translation_m: [0.001, -0.002, 0.0005],
            rotation_xyzw: [0.0, 0.0, 0.0, 1.0],
        }),
        "1c06a01ffca9f1d24d62503ffca9f1d24d6260bffca9f1d24d62403f0101010101010101\
         01010101010101010101010101010101010101010107f03f2cd0dd5400",
    );
}

#[test]
fn commands() {
    assert_command(1, Command::Hello, "020105be23c25800");
    assert_command(2, Command::Start, "070201eb40e80400");
    assert_command(3, Command::Stop, "0703021020fa8400");
    assert_command(
        300,
        Command::Configure(Configuration { schedule: two_cells(), levels: levels(), exposure: Exposure::Automatic }),
        "0eac020380fd875184cc0203010215ac1ba21194010402028080028080010101f2a8d400",
    );
    assert_command(5, Command::Ping { token: 7 }, "080504075e4b820300");
    assert_command(6, Command::Identify { seconds: 10 }, "0806050afbb86e6600");
    let hashes = Hashes { scene: Some(0x0123_4567_89ab_cdef), calibration: None };
    assert_command(7, Command::Store(hashes), "0d070601ef9bafcdf8acd1910105176f0e3b00");
    assert_command(8, Command::Forget, "070807540d641700");
    assert_command(9, Command::Reboot(BootTarget::BootLoader), "0809080103584e4f00");
}

/// The table and its hashes: a field list that changes without a new key, or a key that
/// changes without a reason, shows here.
#[test]
fn schema_keys() {
    let keys: std::vec::Vec<_> =
        MESSAGES.iter().chain(&COMMANDS).map(|schema| format!("{} {:016x}", schema.name, schema.key)).collect();
    assert_eq!(
        keys,
        [
            "Hello 8f0816ddceb320f3",
            "Batch fc1f7fd1dba5ebc4",
            "Status d264e884698222ef",
            "Event 6a8d39b88aebc5d5",
            "Reply b70fb5cc8ecb3d93",
            "Pong b252f6723e82c8ae",
            "Truth 5399c5b5aa74e6b3",
            "Hello 922503e07c5a06a3",
            "Start 9b3033813c8d813f",
            "Stop 04b4e713e8cb9e2d",
            "Configure 9b9a752161229cce",
            "Ping d88375e7778d2988",
            "Identify 4dfc5f7f06215ccb",
            "Store 68d6c0e34947d252",
            "Forget fb7e7d17c5c6d5e2",
            "Reboot ef15508edfd220a6",
        ]
    );
}

/// Sixteen cells in seventeen slots, every number at its longest.
#[test]
fn the_largest_configure_fits_its_limit() {
    let request = Request {
        number: u16::MAX,
        command: Command::Configure(Configuration {
            schedule: Schedule {
                tick_hz: u32::MAX,
                frame_ticks: u32::MAX,
                slots: (0..17).map(|_| EmitterSet(u16::MAX)).collect(),
                slot_ticks: u32::MAX,
                settling_ticks: u32::MAX,
                conversion_ticks: u32::MAX,
                oversampling: u16::MAX,
                cells: u8::MAX,
            },
            levels: (0..16).map(|_| Level(u16::MAX)).collect(),
            exposure: Exposure::Automatic,
        }),
    };
    let mut buffer = [0; MAX_REQUEST_BYTES];
    assert_eq!(encode(&request, &mut buffer).unwrap().len(), 141);
}

/// As many scans as the limit of a message promises room for, every number at its
/// longest.
#[test]
fn the_largest_batches_fit_their_limit() {
    for (cells, scans) in [(6, 20), (16, 7)] {
        let samples = std::vec![0xff; scans * cells * 8];
        let message = Message::Batch(Batch {
            configuration: u16::MAX,
            sequence: u64::MAX,
            tick: u64::MAX,
            levels: (0..cells).map(|_| Level(u16::MAX)).collect(),
            samples: &samples,
        });
        let mut buffer = [0; MAX_MESSAGE_BYTES];
        assert!(encode(&message, &mut buffer).is_ok(), "{cells} cells");
    }
}
