//! Random values of everything that crosses the wire.

use proptest::collection::vec;
use proptest::option;
use proptest::prelude::*;
use proptest::sample::select;
use slitpose_protocol::schema::SchemaKeys;
use slitpose_protocol::{
    AdcScaling, Batch, BoardKind, BootTarget, ClockSource, Command, Configuration, EmitterSet, Event, Exposure,
    HardwareFault, Hashes, Hello, Level, Levels, MAX_CELLS, MAX_MESSAGE_BYTES, MAX_SLOTS, Message, PROTOCOL, Packet,
    Pong, Rejection, Reply, Request, ResetCause, Schedule, ScheduleError, SettingsSource, Severity, Status, Truth,
    encode,
};

/// The packet of a value.
pub fn packet<'p>(value: &impl Packet<'p>) -> Vec<u8> {
    let mut buffer = [0; MAX_MESSAGE_BYTES];
    encode(value, &mut buffer).expect("every message fits its limit").to_vec()
}

// Messages borrow their text and samples, and a strategy must own what it makes; a test
// process ends soon enough to leak them.
fn text() -> impl Strategy<Value = &'static str> {
    "\\PC{0,40}".prop_map(|text| &*text.leak())
}

fn bytes(length: usize) -> impl Strategy<Value = &'static [u8]> {
    vec(any::<u8>(), 0..length).prop_map(|bytes| &*bytes.leak())
}

fn levels() -> impl Strategy<Value = Levels> {
    vec(any::<u16>(), 0..=MAX_CELLS).prop_map(|all| all.into_iter().map(Level).collect())
}

fn number() -> impl Strategy<Value = f64> {
    any::<f64>().prop_filter("NaN is not equal to itself", |x| !x.is_nan())
}

/// Schedules of any content, nearly all of them nonsense.
pub fn schedules() -> impl Strategy<Value = Schedule> {
    (any::<(u32, u32, u32, u32, u32, u16, u8)>(), vec(any::<u16>(), 0..=MAX_SLOTS)).prop_map(|(n, slots)| Schedule {
        tick_hz: n.0,
        frame_ticks: n.1,
        slots: slots.into_iter().map(EmitterSet).collect(),
        slot_ticks: n.2,
        settling_ticks: n.3,
        conversion_ticks: n.4,
        oversampling: n.5,
        cells: n.6,
    })
}

fn hello() -> impl Strategy<Value = Message<'static>> {
    let words = (text(), text(), bytes(80), bytes(80));
    let scaling = (number(), number(), any::<u8>(), any::<u16>());
    let rest = (any::<[u8; 12]>(), any::<bool>(), any::<(Option<u64>, Option<u64>)>());
    (words, scaling, rest, any::<u16>(), schedules()).prop_map(|(words, scaling, rest, configuration, schedule)| {
        Message::Hello(Hello {
            protocol: PROTOCOL,
            message_keys: SchemaKeys(words.2),
            command_keys: SchemaKeys(words.3),
            device_id: rest.0,
            kind: if rest.1 { BoardKind::Physical } else { BoardKind::Simulated },
            board: words.0,
            firmware: words.1,
            reset_cause: ResetCause::Watchdog,
            hashes: Hashes { scene: rest.2.0, calibration: rest.2.1 },
            scaling: AdcScaling {
                zero_code: scaling.0,
                amperes_per_code: scaling.1,
                bits: scaling.2,
                saturation_code: scaling.3,
            },
            configuration,
            schedule,
        })
    })
}

fn batch() -> impl Strategy<Value = Message<'static>> {
    (any::<(u16, u64, u64)>(), levels(), bytes(600)).prop_map(|(n, levels, samples)| {
        Message::Batch(Batch { configuration: n.0, sequence: n.1, tick: n.2, levels, samples })
    })
}

fn status() -> impl Strategy<Value = Message<'static>> {
    let counts = any::<(u64, u64, u64, u64, u32, u32, u32, u32, u32)>();
    let sources = (select(&ClockSource::ALL), select(&SettingsSource::ALL));
    (counts, any::<bool>(), 0.0_f32..5.0, any::<u16>(), sources).prop_map(|(n, acquiring, supply_v, load, sources)| {
        Message::Status(Status {
            tick: n.0,
            acquiring,
            scans_taken: n.1,
            scans_dropped: n.2,
            batches_dropped: n.4,
            scans_lost: n.3,
            adc_overruns: n.5,
            replies_dropped: n.6,
            commands_damaged: n.7,
            commands_rejected: n.8,
            supply_v,
            temperature_k: 100.0 * supply_v,
            cpu_load_permille: load,
            clock: sources.0,
            settings: sources.1,
        })
    })
}

fn rejection() -> impl Strategy<Value = Rejection> {
    let n = any::<(u8, u8, u8, u32, u64)>();
    (0..12, n).prop_map(|(variant, n)| match variant {
        0 => Rejection::Unsupported { kind: n.3 },
        1 => Rejection::Malformed { kind: n.3 },
        2 => Rejection::Schedule(ScheduleError::LitTwice { emitter: n.0, first_slot: n.1, second_slot: n.2 }),
        3 => Rejection::Schedule(ScheduleError::FrameTooShort { needed_ticks: n.4, frame_ticks: n.3 }),
        4 => Rejection::Levels { levels: n.0, cells: n.1 },
        5 => Rejection::TickRate { asked_hz: n.3, board_hz: !n.3 },
        6 => Rejection::Storage,
        7 => Rejection::Storing,
        10 => Rejection::Unsuited(HardwareFault::Emitters),
        8 => Rejection::Hardware(HardwareFault::Settling { asked_ticks: n.3, least_ticks: !n.3 }),
        9 => Rejection::Hardware(HardwareFault::Channels { cells: n.0, channels: n.1 }),
        _ => Rejection::Hardware(HardwareFault::Counters),
    })
}

/// Messages of every kind.
pub fn messages() -> impl Strategy<Value = Message<'static>> {
    let outcome = option::of(rejection()).prop_map(|rejection| rejection.map_or(Ok(()), Err));
    prop_oneof![
        hello(),
        batch(),
        status(),
        (any::<u64>(), text()).prop_map(|(tick, text)| Message::Event(Event { tick, severity: Severity::Error, text })),
        (any::<u16>(), outcome).prop_map(|(number, outcome)| Message::Reply(Reply { number, outcome })),
        any::<(u32, u64)>().prop_map(|(token, tick)| Message::Pong(Pong { token, tick })),
        (any::<u64>(), [(); 3].map(|()| number()), [(); 4].map(|()| number())).prop_map(
            |(sequence, translation_m, rotation_xyzw)| Message::Truth(Truth { sequence, translation_m, rotation_xyzw })
        ),
    ]
}

/// Requests with every kind of command.
pub fn requests() -> impl Strategy<Value = Request> {
    let command = prop_oneof![
        Just(Command::Hello),
        Just(Command::Start),
        Just(Command::Stop),
        (schedules(), levels(), any::<bool>()).prop_map(|(schedule, levels, automatic)| {
            let exposure = if automatic { Exposure::Automatic } else { Exposure::Fixed };
            Command::Configure(Configuration { schedule, levels, exposure })
        }),
        any::<(Option<u64>, Option<u64>)>()
            .prop_map(|(scene, calibration)| Command::Store(Hashes { scene, calibration })),
        Just(Command::Forget),
        Just(Command::Reboot(BootTarget::Firmware)),
        Just(Command::Reboot(BootTarget::BootLoader)),
        any::<u32>().prop_map(|token| Command::Ping { token }),
        any::<u8>().prop_map(|seconds| Command::Identify { seconds }),
    ];
    (any::<u16>(), command).prop_map(|(number, command)| Request { number, command })
}
