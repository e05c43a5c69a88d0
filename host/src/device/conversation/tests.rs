use std::io;

use super::*;
use slitpose_head::front_end;
use slitpose_head::scene_file::WIDE;
use slitpose_head::simulator::{SimulatedBoard, Trajectory, TrajectoryKind};

/// A simulated board over a line that delivers a few bytes at a time; it is acquiring when the host
/// connects.
struct Slow {
    board: SimulatedBoard,
    line: Vec<u8>,
    bytes_at_once: usize,
}

impl Slow {
    fn new(bytes_at_once: usize) -> Self {
        let file = WIDE.read().unwrap();
        let still = Trajectory::of_kind(TrajectoryKind::Still, 1, 1.0);
        let mut board = SimulatedBoard::new(&file, still, slitpose_model::Tier::Paper, 1).unwrap();
        board.ask(1, Command::Start);
        let mut line = Vec::new();
        for _ in 0..20 {
            board.step(&mut line);
        }
        // From the middle of a packet on.
        Self { board, line: line.split_off(50), bytes_at_once }
    }
}

impl Device for Slow {
    fn name(&self) -> &str {
        "slow"
    }

    fn send(&mut self, bytes: &[u8]) -> io::Result<()> {
        self.board.write(bytes);
        Ok(())
    }

    fn receive(&mut self, bytes: &mut Vec<u8>) -> io::Result<bool> {
        if self.line.len() < self.bytes_at_once {
            self.board.step(&mut self.line);
        }
        bytes.extend(self.line.drain(..self.bytes_at_once.min(self.line.len())));
        Ok(true)
    }
}

/// The kinds of the packets in `bytes`, and the configurations of the batches; damage is a failure.
fn kinds(mut bytes: &[u8]) -> (Vec<&'static str>, Vec<u64>) {
    let mut decoder = Decoder::<MAX_MESSAGE_BYTES>::new();
    let (mut kinds, mut configurations) = (Vec::new(), Vec::new());
    while let Some(message) = decoder.next::<Message<'_>>(&mut bytes) {
        kinds.push(match message.unwrap() {
            Message::Hello(_) => "hello",
            Message::Reply(_) => "reply",
            Message::Batch(batch) => {
                configurations.push(batch.configuration.into());
                "batch"
            }
            _ => "other",
        });
    }
    (kinds, configurations)
}

#[test]
fn however_bytes_are_cut_nothing_old_and_nothing_damaged_is_kept() {
    let configuration = front_end::configuration(&WIDE.read().unwrap()).unwrap();
    for bytes_at_once in (1..40).chain([113, 250, 251, 252, 1024]) {
        let mut board = Conversation::open(Box::new(Slow::new(bytes_at_once))).unwrap();
        board.greet(HELLO_WITHIN, |_| Ok::<_, DeviceError>(())).unwrap();
        board.configure(configuration.clone()).unwrap();
        board.start().unwrap();
        let mut kept = board.inbox.clone();
        for _ in 0..3000 / bytes_at_once {
            assert!(board.listen().unwrap());
            kept.extend(&board.inbox);
        }
        board.stop().unwrap();
        kept.extend(&board.inbox);
        let (kinds, configurations) = kinds(&kept);
        assert_eq!(kinds[..2], ["hello", "reply"], "{bytes_at_once} bytes at once");
        assert_eq!(kinds.last(), Some(&"reply"));
        assert!(!configurations.is_empty() && configurations.iter().all(|number| *number == 1));
    }
}

#[test]
fn a_board_of_rare_frames_may_be_quiet_between_them() {
    let mut configuration = front_end::configuration(&WIDE.read().unwrap()).unwrap();
    let mut board = Conversation::open(Box::new(Slow::new(1024))).unwrap();
    board.greet(HELLO_WITHIN, |_| Ok::<_, DeviceError>(())).unwrap();
    board.configure(configuration.clone()).unwrap();
    assert_eq!(board.quiet_limit, QUIET);
    configuration.schedule.frame_ticks = configuration.schedule.tick_hz;
    board.configure(configuration).unwrap();
    assert_eq!(board.quiet_limit, Duration::from_secs(3));
}

/// A device that delivers scripted bytes, one piece per receive.
struct Scripted(std::collections::VecDeque<Vec<u8>>);

impl Scripted {
    fn saying(pieces: &[&[Vec<u8>]]) -> Conversation {
        Conversation::open(Box::new(Self(pieces.iter().map(|packets| packets.concat()).collect()))).unwrap()
    }
}

impl Device for Scripted {
    fn name(&self) -> &str {
        "script"
    }

    fn send(&mut self, _: &[u8]) -> io::Result<()> {
        Ok(())
    }

    fn receive(&mut self, bytes: &mut Vec<u8>) -> io::Result<bool> {
        bytes.extend(self.0.pop_front().unwrap_or_default());
        Ok(!self.0.is_empty())
    }
}

fn packet(message: &Message<'_>) -> Vec<u8> {
    encode(message, &mut [0; MAX_MESSAGE_BYTES]).unwrap().to_vec()
}

fn reply(number: u16, outcome: Result<(), Rejection>) -> Vec<u8> {
    packet(&Message::Reply(slitpose_protocol::Reply { number, outcome }))
}

#[test]
fn only_the_reply_to_the_command_itself_answers_it() {
    // The first command has the number 1. Replies of an earlier host, from both sides of it.
    for other in [0, 2, u16::MAX] {
        let mut board = Scripted::saying(&[&[reply(other, Ok(()))], &[reply(1, Err(Rejection::Storing))], &[]]);
        let refused = board.ask(Command::Stop, REPLY_WITHIN);
        assert!(matches!(refused, Err(DeviceError::Refused { .. })), "{other}: {refused:?}");
        let mut board = Scripted::saying(&[&[reply(other, Err(Rejection::Storing))], &[reply(1, Ok(()))], &[]]);
        assert!(board.ask(Command::Stop, REPLY_WITHIN).is_ok(), "{other}");
        // No other reply follows: no answer.
        let mut board = Scripted::saying(&[&[reply(other, Ok(()))], &[]]);
        let silent = board.ask(Command::Stop, REPLY_WITHIN);
        assert!(matches!(silent, Err(DeviceError::NoReply { .. })), "{other}: {silent:?}");
    }
}

#[test]
fn a_greeting_is_over_with_the_reply_to_it_and_not_before() {
    const DEVICES: [[u8; 12]; 2] = [*b"an older one", *b"the one here"];
    let mut line = Vec::new();
    let mut board = Slow::new(1).board;
    board.ask(1, Command::Hello);
    board.step(&mut line);
    let (mut decoder, mut bytes, mut hellos) = (Decoder::<MAX_MESSAGE_BYTES>::new(), &line[..], Vec::new());
    while let Some(message) = decoder.next::<Message<'_>>(&mut bytes) {
        if let Message::Hello(hello) = message.unwrap() {
            hellos = DEVICES.map(|device_id| packet(&Message::Hello(Hello { device_id, ..hello.clone() }))).to_vec();
        }
    }
    for other in [0, 2, u16::MAX] {
        // What an earlier host was told, then the answer.
        let before: &[_] = &[hellos[0].clone(), reply(other, Ok(()))];
        let after: &[_] = &[hellos[1].clone(), reply(1, Ok(()))];
        let mut seen = Vec::new();
        let mut board = Scripted::saying(&[before, after, &[]]);
        let greeted = board.greet(HELLO_WITHIN, |hello| {
            seen.push(hello.device_id);
            Ok::<_, DeviceError>(())
        });
        assert!(greeted.is_ok(), "{other}: {greeted:?}");
        assert_eq!(seen, DEVICES, "{other}");
        // Without the answer there is no board.
        let mut board = Scripted::saying(&[before, &[]]);
        assert!(board.greet(HELLO_WITHIN, |_| Ok::<_, DeviceError>(())).is_err(), "{other}");
    }
}
