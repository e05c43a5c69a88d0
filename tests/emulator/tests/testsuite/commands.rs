//! Every command in every state of the board.

use crate::common::talk::{FRAME_TICKS, Introduction, Said, Talk};
use slitpose_firmware::pcb::default_configuration;
use slitpose_protocol::{
    Command, Configuration, DELIMITER, EmitterSet, HardwareFault, Hashes, Level, Rejection, Schedule,
};

/// What the board is doing when a command comes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum State {
    Idle,
    Acquiring,
    StoringIdle,
    StoringWhileAcquiring,
    JustOpened,
    /// The supply has fallen and come back.
    Faulty,
}

const STATES: [State; 6] =
    [State::Idle, State::Acquiring, State::StoringIdle, State::StoringWhileAcquiring, State::JustOpened, State::Faulty];

impl State {
    fn is_acquiring(self) -> bool {
        matches!(self, Self::Acquiring | Self::StoringWhileAcquiring)
    }

    fn is_storing(self) -> bool {
        matches!(self, Self::StoringIdle | Self::StoringWhileAcquiring)
    }

    /// Brings the board there; gives the number of the Store under way.
    fn enter(self, talk: &mut Talk) -> Option<u16> {
        let first = if self.is_acquiring() || self == Self::Faulty { Command::Start } else { Command::Stop };
        assert_eq!(talk.ask(first), Ok(()));
        // The first scans tell how the board has paused.
        talk.run_ms(3.0);
        talk.ear.gaps.clear();
        match self {
            Self::StoringIdle | Self::StoringWhileAcquiring => {
                return Some(talk.rig.send(Command::Store(Hashes::default())));
            }
            Self::JustOpened => {
                talk.close();
                talk.ear.begin_session();
                talk.rig.set_open(true);
            }
            Self::Faulty => {
                talk.rig.machine().set_supply_v(2.5);
                let told = |talk: &mut Talk| talk.ear.events().iter().any(|text| text.contains("supply"));
                assert!(talk.wait_for(5, told), "{:?}", talk.ear.events());
                talk.rig.machine().set_supply_v(3.3);
                talk.run_ms(0.2);
            }
            Self::Idle | Self::Acquiring => {}
        }
        None
    }
}

/// A command, and what becomes of it.
struct Case {
    name: &'static str,
    packet: Vec<u8>,
    outcome: Result<(), Rejection>,
    /// The outcome while a Store is under way.
    while_storing: Result<(), Rejection>,
    /// Whether the board acquires behind it; `None`: as before.
    acquires: Option<bool>,
    hellos: usize,
    pongs: usize,
    /// The configuration is another.
    configures: bool,
}

impl Case {
    fn of(name: &'static str, command: Command) -> Self {
        let bytes = slitpose_emulator::rig::request(NUMBER, command);
        Self {
            name,
            packet: bytes,
            outcome: Ok(()),
            while_storing: Ok(()),
            acquires: None,
            hellos: 0,
            pongs: 0,
            configures: false,
        }
    }

    fn refused(mut self, rejection: Rejection) -> Self {
        (self.outcome, self.while_storing) = (Err(rejection), Err(rejection));
        self
    }

    fn raw(name: &'static str, payload: &[u8], rejection: Rejection) -> Self {
        Self { packet: packet(payload), ..Self::of(name, Command::Hello) }.refused(rejection)
    }
}

/// Number of the commands under test; the rig's own are smaller.
const NUMBER: u16 = 60_000;

/// A packet of any payload, behind a delimiter.
fn packet(payload: &[u8]) -> Vec<u8> {
    let checksum = crc::Crc::<u32>::new(&crc::CRC_32_ISO_HDLC).checksum(payload);
    let plain = [payload, &checksum.to_le_bytes()].concat();
    let mut stuffed = vec![0; plain.len() + 3];
    let length = cobs::encode(&plain, &mut stuffed);
    [&[DELIMITER], &stuffed[..length], &[DELIMITER]].concat()
}

/// A payload that begins with the number and `kind`, in postcard's variable-length integers.
fn payload(kind: u8, rest: &[u8]) -> Vec<u8> {
    let [low, middle, high] = [NUMBER as u8 | 0x80, (NUMBER >> 7) as u8 | 0x80, (NUMBER >> 14) as u8];
    [&[low, middle, high, kind], rest].concat()
}

fn changed(change: impl FnOnce(&mut Configuration)) -> Configuration {
    let mut configuration = default_configuration();
    change(&mut configuration);
    configuration
}

/// Configurations the board cannot run, and what is wrong with them.
fn unfit() -> Vec<(&'static str, Configuration, Rejection)> {
    let of_schedule = |change: &dyn Fn(&mut Schedule)| changed(|configuration| change(&mut configuration.schedule));
    let contradiction = |configuration: &Configuration| {
        Rejection::Schedule(configuration.schedule.validate().expect_err("a schedule that contradicts itself"))
    };
    let short = of_schedule(&|schedule| schedule.slot_ticks = 5_761);
    let never_lit = of_schedule(&|schedule| schedule.slots[0] = EmitterSet::of(&[0]));
    let (short_error, never_lit_error) = (contradiction(&short), contradiction(&never_lit));
    let together = changed(|configuration| {
        configuration.schedule.slots = [EmitterSet::of(&[0, 1, 2, 3, 4, 5]), EmitterSet::DARK].into_iter().collect();
        configuration.levels[1] = Level(0x4000);
    });
    let bright_for_long = changed(|configuration| {
        // 101 µs.
        configuration.schedule.slot_ticks = 17_170;
        configuration.schedule.frame_ticks = 4 * 17_170;
        configuration.levels[0] = Level(0x8001);
    });
    let seven_cells = changed(|configuration| {
        configuration.schedule.cells = 7;
        configuration.schedule.slots[0] = EmitterSet::of(&[0, 3, 6]);
        configuration.schedule.slot_ticks = 6_400;
        configuration.levels.push(Level::NOMINAL).expect("room for seven");
    });
    vec![
        ("a slot too short", short, short_error),
        ("an emitter never lit", never_lit, never_lit_error),
        (
            "five levels",
            changed(|configuration| configuration.levels.truncate(5)),
            Rejection::Levels { levels: 5, cells: 6 },
        ),
        (
            "other ticks",
            of_schedule(&|schedule| schedule.tick_hz = 168_000_000),
            Rejection::TickRate { asked_hz: 168_000_000, board_hz: 170_000_000 },
        ),
        (
            "conversions between two times",
            of_schedule(&|schedule| schedule.conversion_ticks = 147),
            Rejection::Unsuited(HardwareFault::Conversion { asked_ticks: 147, nearest_ticks: 148 }),
        ),
        (
            "three conversions a word",
            of_schedule(&|schedule| schedule.oversampling = 3),
            Rejection::Unsuited(HardwareFault::Oversampling { oversampling: 3 }),
        ),
        (
            "settling too short",
            of_schedule(&|schedule| schedule.settling_ticks = 106),
            Rejection::Unsuited(HardwareFault::Settling { asked_ticks: 106, least_ticks: 107 }),
        ),
        ("seven cells", seven_cells, Rejection::Unsuited(HardwareFault::Channels { cells: 7, channels: 6 })),
        ("two levels on one line", together, Rejection::Unsuited(HardwareFault::SharedLevel { first: 0, second: 1 })),
        ("bright for long", bright_for_long, Rejection::Unsuited(HardwareFault::Emitters)),
    ]
}

fn cases() -> Vec<Case> {
    let brighter = changed(|configuration| configuration.levels.fill(Level(0x9000)));
    let storing = Err(Rejection::Storing);
    let hashes = Hashes { scene: Some(1), calibration: Some(2) };
    let mut cases = vec![
        Case { hellos: 1, ..Case::of("Hello", Command::Hello) },
        Case { acquires: Some(true), ..Case::of("Start", Command::Start) },
        Case { acquires: Some(false), ..Case::of("Stop", Command::Stop) },
        Case { hellos: 1, configures: true, ..Case::of("Configure", Command::Configure(brighter)) },
        Case { pongs: 1, ..Case::of("Ping", Command::Ping { token: 77 }) },
        Case::of("Identify", Command::Identify { seconds: 0 }),
        Case { hellos: 1, while_storing: storing, ..Case::of("Store", Command::Store(hashes)) },
        Case { hellos: 1, while_storing: storing, ..Case::of("Forget", Command::Forget) },
        Case::raw("unknown kind", &payload(12, &[]), Rejection::Unsupported { kind: 12 }),
        Case::raw(
            "a head, to a board that solves no poses",
            &payload(9, &[0, 0, 0]),
            Rejection::Unsupported { kind: 9 },
        ),
        Case::raw("Start with more behind", &payload(1, &[0]), Rejection::Malformed { kind: 1 }),
        Case::raw("Ping without its token", &payload(4, &[]), Rejection::Malformed { kind: 4 }),
        Case::raw("Reboot to nowhere", &payload(8, &[7]), Rejection::Malformed { kind: 8 }),
    ];
    let unfit = unfit().into_iter();
    cases.extend(unfit.map(|(name, wrong, why)| Case::of(name, Command::Configure(wrong)).refused(why)));
    cases
}

/// Does `case` in `state`; gives whether it was rejected.
fn try_case(talk: &mut Talk, state: State, case: &Case) -> bool {
    let title = format!("{} while {state:?}", case.name);
    talk.ear.clear();
    let store = state.enter(talk);
    if state != State::JustOpened {
        talk.ear.said.clear();
    }
    let before = talk.rig.machine().board.gates();
    talk.rig.send_bytes(&case.packet);
    talk.answer(NUMBER, 60).ok();
    // Whatever comes beside it.
    if let Some(store) = store {
        assert_eq!(talk.answer(store, 60), Ok(()), "{title}: the first Store");
    }
    let acquires = talk.is_acquiring();
    let outcome = if state.is_storing() { case.while_storing } else { case.outcome };
    assert_eq!(talk.ear.replies(NUMBER), [outcome], "{title}");
    assert_eq!(acquires, case.acquires.unwrap_or(state.is_acquiring()), "{title}: acquires, gates {before:#x}");
    let pongs = talk.ear.said.iter().filter(|(_, said)| matches!(said, Said::Pong(_))).count();
    assert_eq!(pongs, case.pongs, "{title}: pongs");
    // A Store yields a hello, and so does an open port.
    let others = usize::from(state.is_storing()) + usize::from(state == State::JustOpened);
    let own = if outcome.is_ok() { case.hellos } else { 0 };
    assert_eq!(talk.ear.hellos(), own + others, "{title}: hellos");
    if state == State::JustOpened {
        assert!(matches!(talk.ear.said[0].1, Said::Hello(_)), "{title}: hello first");
    }
    if state.is_acquiring() && !case.configures {
        assert_eq!(talk.ear.gaps, [], "{title}: sampling goes on");
    }
    let reply =
        talk.ear.said.iter().rposition(|(_, said)| matches!(said, Said::Reply(reply) if reply.number == NUMBER));
    let yielded = talk.ear.said.iter().rposition(|(_, said)| matches!(said, Said::Hello(_) | Said::Pong(_)));
    if own + case.pongs > 0 && !state.is_storing() {
        assert!(yielded < reply, "{title}: the reply comes last");
    }
    outcome.is_err()
}

fn introduction(talk: &mut Talk) -> Introduction {
    assert_eq!(talk.ask(Command::Hello), Ok(()));
    talk.ear.hello().expect("asked for").clone()
}

#[test]
fn every_command_in_every_state_gets_one_reply() {
    let mut talk = Talk::at_usb();
    let (mut rejected, mut configured) = (0, 0);
    for state in STATES {
        for case in &cases() {
            let known = introduction(&mut talk);
            rejected += u32::from(try_case(&mut talk, state, case));
            configured += u16::from(case.configures);
            let now = introduction(&mut talk);
            assert_eq!(now.configuration, configured, "{} while {state:?}", case.name);
            assert_eq!(now.schedule, known.schedule, "{} while {state:?}", case.name);
        }
    }
    let breaks = talk.ear.breaks;
    let status = talk.settle_account(breaks);
    println!("{rejected} rejections in {} cases", STATES.len() * cases().len());
    assert_eq!(status.commands_rejected, rejected);
    assert_eq!((status.commands_damaged, status.replies_dropped, status.adc_overruns), (0, 0, 0));
    talk.expect_no_faults();
}

#[test]
fn a_supply_that_stays_low_refuses_light() {
    let mut talk = Talk::at_usb();
    assert_eq!(talk.ask(Command::Start), Ok(()));
    talk.run_ms(5.0);
    talk.rig.machine().set_supply_v(2.5);
    talk.run_ms(0.2);
    assert_eq!(talk.rig.machine().board.gates(), 0, "dark at once");
    // The core finds out at its next poll.
    talk.run_ms(2.0);
    let refused = Err(Rejection::Hardware(HardwareFault::Supply));
    assert_eq!(talk.ask(Command::Start), refused);
    assert!(!talk.is_acquiring());
    assert_eq!(talk.ask(Command::Ping { token: 1 }), Ok(()));
    assert_eq!(talk.ask(Command::Configure(default_configuration())), Ok(()));
    assert_eq!(talk.ask(Command::Stop), Ok(()));
    let status = talk.next_status();
    assert!((status.supply_v - 2.5).abs() < 0.01, "{status:?}");
    talk.rig.machine().set_supply_v(3.3);
    talk.run_ms(1.0);
    assert_eq!(talk.ask(Command::Start), Ok(()));
    assert!(talk.is_acquiring());
    talk.settle_account(0);
    talk.expect_no_faults();
}

#[test]
fn a_configuration_comes_into_force_between_two_frames() {
    let mut talk = Talk::at_usb();
    assert_eq!(talk.ask(Command::Start), Ok(()));
    for (round, frame_ticks) in [85_000_u32, 42_500, 34_000, 42_500].into_iter().enumerate() {
        talk.run_ms(10.0);
        let new = changed(|configuration| {
            configuration.schedule.frame_ticks = frame_ticks;
            configuration.levels.fill(Level(0x7000 + round as u16));
        });
        talk.ear.clear();
        assert_eq!(talk.ask(Command::Configure(new.clone())), Ok(()));
        talk.run_ms(10.0);
        let behind: Vec<_> = talk.ear.scans.iter().filter(|scan| scan.levels() == &new.levels[..]).collect();
        assert!(behind.len() > 15, "{} scans of {frame_ticks} ticks", behind.len());
        let [gap] = talk.ear.gaps[..] else { panic!("one change, {:?}", talk.ear.gaps) };
        // The frame it interrupts is not finished and has no number; one that was finished and
        // not yet collected may be lost.
        assert!(gap.missing <= 1 && gap.ticks < 4 * FRAME_TICKS, "{gap:?}");
    }
    let status = talk.settle_account(0);
    assert_eq!(status.adc_overruns, 0);
    talk.expect_no_faults();
}
