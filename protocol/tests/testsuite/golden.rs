//! The bytes of every message and command, pinned: whoever changes one of these breaks
//! every program that speaks this protocol. They were made by an encoder written from
//! the description in the crate's documentation alone.

use core::fmt::Debug;
use core::num::NonZeroU32;

use heapless::Vec;
use serde::Serialize;
use slitpose_protocol::schema::{COMMANDS, MESSAGES, SchemaKeys};
use slitpose_protocol::{
    AdcScaling, Batch, BoardKind, BootTarget, ClockSource, Command, Configuration, Decoder, Edge, Edges, EmitterSet,
    Event, Exposure, HardwareFault, Hashes, HeadPart, Hello, Level, MAX_MESSAGE_BYTES, MAX_REQUEST_BYTES, Message,
    PROTOCOL, Packet, Pong, PoseRecord, PoseStatus, Poses, Pulse, Quantity, Rejection, Reply, Request, ResetCause,
    Schedule, ScheduleError, SettingsSource, Severity, Status, Stream, Truth, encode,
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

fn a_hello<'a>(message_keys: SchemaKeys<'a>, command_keys: SchemaKeys<'a>) -> Hello<'a> {
    Hello {
        protocol: PROTOCOL,
        message_keys,
        command_keys,
        device_id: [0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11],
        kind: BoardKind::Simulated,
        board: "virtual",
        firmware: "0.1.0",
        reset_cause: ResetCause::BrownOut,
        hashes: Hashes { scene: Some(0x0123_4567_89ab_cdef), calibration: Some(7) },
        scaling: AdcScaling { zero_code: 3900.5, amperes_per_code: -2.5e-9, bits: 12, saturation_code: 64 },
        configuration: 3,
        schedule: two_cells(),
    }
}

#[test]
fn hello() {
    assert_message(
        &Message::Hello(a_hello(SchemaKeys(&[1, 2, 3, 4, 5, 6, 7, 8]), SchemaKeys(&[]))),
        "0102020a08010203040506070801280102030405060708090a0b01077669727475616c\
         05302e312e300201ef9bafcdf8acd191010107010101011979ae403a8c30e28e7925be\
         0c400380fd875184cc020301020dac1ba2119401040241bcc13c00",
    );
}

/// The last kind of either table: all before it are compared too.
#[test]
fn both_tables_of_a_hello_are_compared() {
    let changed = |keys: SchemaKeys| {
        let mut bytes = keys.0.to_vec();
        *bytes.last_mut().expect("keys") ^= 1;
        bytes
    };
    let (messages, commands) = (SchemaKeys::messages(), SchemaKeys::commands());
    let differs = |hello: Hello| hello.check_schemas().map_err(|mismatch| mismatch.name);
    assert_eq!(differs(a_hello(messages, commands)), Ok(()));
    assert_eq!(differs(a_hello(SchemaKeys(&changed(messages)), commands)), Err("Edges"));
    assert_eq!(differs(a_hello(messages, SchemaKeys(&changed(commands)))), Err("Pulse"));
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
fn poses() {
    let record = PoseRecord {
        status: PoseStatus::Converged,
        cells_used: 0b11_1111,
        excluded: 0b10,
        ready: 1_000,
        translation_m: [1e-3, -2e-3, 0.5e-3],
        rotation_xyzw: [0.0, 0.0, 0.6, 0.8],
        chi2: 5.25,
    };
    let poses = Poses {
        configuration: 3,
        sequence: 4_000,
        tick: 170_000_000,
        every: 2,
        missed: 300,
        head: 0x89ab_cdef,
        covariance: Some(core::array::from_fn(|i| (i + 1) as f32)),
        records: &record.write(),
    };
    assert_message(
        &Message::Poses(poses),
        "120703a01f80fd875102ac02ef9bafcd08010103803f0101024001034040010380\
         400103a0400103c0400103e0400101024101031041010320410103304101034041\
         010350410103604101037041010380410103884101039041010398410103a04101\
         04a8412801023f02020fe8036f12833a6f1203bb6f12033a01010101010101099a\
         99193fcdcc4c3f0107a840f794359000",
    );
    assert_eq!(poses.iter(42_500).collect::<std::vec::Vec<_>>(), [(4_000, 170_000_000, record)]);
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
            clock: ClockSource::Crystal,
            settings: SettingsSource::PassedOver,
        }),
        "0d02c0fec32801d00f0802050107030433335340010a96437d0102710d729d00",
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
fn edges() {
    let edges = [Edge::new(170_000_000, true), Edge::new(170_001_000, false)];
    assert_eq!((edges[0].tick(), edges[0].is_high(), edges[1].is_high()), (170_000_000, true, false));
    assert_message(
        &Message::Edges(Edges { number: 300, missed: 2, edges: edges.into_iter().collect() }),
        "1408ac02020281fa8fa201d08990a20128265e3c00",
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
    let part = HeadPart { offset: 128, total: 3_000, bytes: Vec::from_slice(&[0, 1, 2]).expect("room") };
    assert_command(10, Command::Head(part), "080a098001b8170307010283e5be6c00");
    assert_command(11, Command::Stream(Stream { scans: 512, poses: 3 }), "0a0b0a80040356a91fc200");
    let full_scale_pa = NonZeroU32::new(9_100_000).expect("not zero");
    assert_command(12, Command::FullScale { full_scale_pa }, "0b0c0be0b5ab04318ca4ee00");
    assert_command(13, Command::Packet { scans: 1 }, "080d0c01db352b2c00");
    assert_command(14, Command::Pulse(Pulse { every: 400, slot: 3 }), "0a0e0d900303282b4fc400");
}

/// By Python's `zlib.crc32(struct.pack("<QQ", …))`.
#[test]
fn numbers_of_heads() {
    let hashes = Hashes { scene: Some(0x0123_4567_89ab_cdef), calibration: None };
    assert_eq!(hashes.number(), 0x118b_aa44);
    assert_ne!(Hashes { scene: None, calibration: hashes.scene }.number(), hashes.number());
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
            "Hello 6dce5c546f7b8755",
            "Batch fc1f7fd1dba5ebc4",
            "Status 116fc829f823a1ef",
            "Event 6a8d39b88aebc5d5",
            "Reply b70fb5cc8ecb3d93",
            "Pong b252f6723e82c8ae",
            "Truth 5399c5b5aa74e6b3",
            "Poses 8baf55d2a8af531c",
            "Edges 0065e910516badef",
            "Hello 922503e07c5a06a3",
            "Start 9b3033813c8d813f",
            "Stop 04b4e713e8cb9e2d",
            "Configure 9b9a752161229cce",
            "Ping d88375e7778d2988",
            "Identify 4dfc5f7f06215ccb",
            "Store 68d6c0e34947d252",
            "Forget fb7e7d17c5c6d5e2",
            "Reboot ef15508edfd220a6",
            "Head e2c6e609d22bd4de",
            "Stream 73b8e4ce7f67049c",
            "FullScale 6b1cd75dd110be9c",
            "Packet bdef264ce40ea2ca",
            "Pulse 6fcba979c711c9d2",
        ]
    );
}

/// Checks that `variants` are those of the enum that stands in `fields` behind `name(`: each is sent
/// under the number of its place there, and has the fields it has there.
fn assert_variants<T: Serialize + Debug>(fields: &str, name: &str, variants: &[T]) {
    let (_, list) = fields.split_once(&format!("{name}(")).expect("the schema has it");
    let (mut depth, mut listed) = (0, std::vec![String::new()]);
    for letter in list.chars() {
        match letter {
            '(' | '{' => depth += 1,
            ')' if depth == 0 => break,
            ')' | '}' => depth -= 1,
            '|' if depth == 0 => listed.push(String::new()),
            _ => {}
        }
        if letter != '|' || depth > 0 {
            listed.last_mut().expect("one at least").push(letter);
        }
    }
    assert_eq!(listed.len(), variants.len(), "{listed:?}");
    for (number, (listed, variant)) in listed.iter().zip(variants).enumerate() {
        let mut bytes = [0; 32];
        let sent = postcard::to_slice(variant, &mut bytes).expect("room")[0];
        assert_eq!(usize::from(sent), number, "{variant:?}");
        // `A { b: 0, c: 0 }` stands there as `A{b u8,c u32}`, and `A(B)` as `A(B|C)`.
        let debug = format!("{variant:?}").replace(": 0", "").replace(' ', "");
        let listed =
            ["u8", "u16", "u32", "u64"].iter().fold(listed.clone(), |text, kind| text.replace(&format!(" {kind}"), ""));
        let name = |text: &str| text.split('(').next().map(str::to_owned);
        assert_eq!(name(&debug), name(&listed));
    }
}

#[test]
fn variants_are_numbered_as_the_schemas_list_them() {
    use HardwareFault as Fault;
    use Rejection as R;
    use ScheduleError as S;
    let [hello, status, event, reply, configure, reboot] =
        [MESSAGES[0], MESSAGES[2], MESSAGES[3], MESSAGES[4], COMMANDS[3], COMMANDS[8]].map(|schema| schema.fields);
    assert_variants(hello, "kind", &[BoardKind::Physical, BoardKind::Simulated]);
    let causes = {
        use ResetCause::*;
        [Unknown, PowerOn, BrownOut, Pin, Software, Watchdog, Panic, StackOverflow]
    };
    assert_variants(hello, "reset_cause", &causes);
    assert_variants(status, "clock", &ClockSource::ALL);
    assert_variants(status, "settings", &SettingsSource::ALL);
    assert_variants(event, "severity", &[Severity::Info, Severity::Warning, Severity::Error]);
    assert_variants(configure, "exposure", &[Exposure::Fixed, Exposure::Automatic]);
    assert_variants(reboot, "target", &[BootTarget::Firmware, BootTarget::BootLoader]);
    assert_variants(reply, "Zero", &[Quantity::TickRate, Quantity::Frame, Quantity::Slot, Quantity::Conversion]);
    let schedule = [
        S::CellCount { cells: 0 },
        S::Oversampling { oversampling: 0 },
        S::Zero(Quantity::Frame),
        S::DarkTwice { first_slot: 0, second_slot: 0 },
        S::UnknownEmitter { emitter: 0, slot: 0, cells: 0 },
        S::LitTwice { emitter: 0, first_slot: 0, second_slot: 0 },
        S::NeverLit { emitter: 0 },
        S::SlotTooShort { needed_ticks: 0, slot_ticks: 0 },
        S::FrameTooShort { needed_ticks: 0, frame_ticks: 0 },
    ];
    assert_variants(reply, "Schedule", &schedule);
    let faults = [
        Fault::Timing,
        Fault::Conversion { asked_ticks: 0, nearest_ticks: 0 },
        Fault::Settling { asked_ticks: 0, least_ticks: 0 },
        Fault::Oversampling { oversampling: 0 },
        Fault::Channels { cells: 0, channels: 0 },
        Fault::Emitters,
        Fault::SharedLevel { first: 0, second: 0 },
        Fault::Supply,
        Fault::Converters,
        Fault::Counters,
    ];
    assert_variants(reply, "Hardware", &faults);
    assert_variants(reply, "Unsuited", &faults);
    let rejections = [
        R::Unsupported { kind: 0 },
        R::Malformed { kind: 0 },
        R::Schedule(schedule[0]),
        R::Levels { levels: 0, cells: 0 },
        R::TickRate { asked_hz: 0, board_hz: 0 },
        R::Hardware(Fault::Supply),
        R::Unsuited(Fault::Supply),
        R::Storing,
        R::Storage,
    ];
    assert_variants(reply, "Err", &rejections);
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
