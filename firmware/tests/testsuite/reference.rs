//! Random steps of a board, compared with a reference.
//!
//! The reference knows neither queues nor batches: only whether emitters are lit, whether
//! a host listens, which replies are owed, and that every scan is delivered, dropped or lost.

use crate::common::{Bench, Heard, TICK_HZ, configuration, request, sequences, without_dark, words};
use proptest::collection::vec;
use proptest::prelude::*;
use slitpose_firmware::{HOST_GONE_MS, Link, STATUS_MS};
use slitpose_protocol::{BootTarget, Command, Configuration, HardwareFault, Hashes, Level, Rejection, Status};

const MS: u64 = TICK_HZ as u64 / 1_000;

#[derive(Debug, Clone)]
enum Step {
    Order(Command),
    Noise(Vec<u8>),
    Sample(u64),
    Overrun(u64),
    Level(u16),
    RefuseLight,
    Wait(u64),
    Link(bool),
    Listen,
}

fn impossible() -> Configuration {
    let mut configuration = configuration();
    configuration.schedule.frame_ticks = 100;
    configuration
}

fn step() -> impl Strategy<Value = Step> {
    let command = prop_oneof![
        2 => Just(Command::Start),
        1 => Just(Command::Stop),
        1 => Just(Command::Hello),
        1 => Just(Command::Configure(configuration())),
        1 => Just(Command::Configure(without_dark())),
        1 => Just(Command::Configure(impossible())),
        1 => any::<u32>().prop_map(|token| Command::Ping { token }),
        1 => any::<u8>().prop_map(|seconds| Command::Identify { seconds }),
        1 => any::<Option<u64>>().prop_map(|scene| Command::Store(Hashes { scene, calibration: None })),
        1 => Just(Command::Forget),
        1 => Just(Command::Reboot(BootTarget::Firmware)),
    ];
    prop_oneof![
        6 => command.prop_map(Step::Order),
        1 => vec(any::<u8>(), 1..40).prop_map(Step::Noise),
        12 => (1..40_u64).prop_map(Step::Sample),
        2 => (1..9_u64).prop_map(Step::Overrun),
        1 => any::<u16>().prop_map(Step::Level),
        1 => Just(Step::RefuseLight),
        2 => (1..400_u64).prop_map(Step::Wait),
        3 => prop::bool::weighted(0.7).prop_map(Step::Link),
        4 => Just(Step::Listen),
    ]
}

#[derive(Default)]
struct Reference {
    acquiring: bool,
    open: bool,
    light_refused: bool,
    heard_from_host: u64,
    /// Commands without an answer heard, and whether they ought to be accepted.
    owed: Vec<(u16, bool)>,
    rejected: u32,
    hashes: Hashes,
}

impl Reference {
    /// Carries out `command`. Whether it ought to be accepted.
    fn order(&mut self, command: &Command, now: u64) -> bool {
        self.heard_from_host = now;
        let lights = match command {
            Command::Start => !self.acquiring,
            Command::Configure(configuration) if *configuration == impossible() => return false,
            Command::Configure(_) => self.acquiring,
            _ => false,
        };
        if matches!(command, Command::Stop | Command::Reboot(_)) {
            self.acquiring = false;
        }
        if let Command::Store(hashes) = command {
            self.hashes = *hashes;
        }
        if *command == Command::Forget {
            self.hashes = Hashes::default();
        }
        if !lights {
            return true;
        }
        self.acquiring = !std::mem::take(&mut self.light_refused);
        self.acquiring
    }

    fn poll(&mut self, now: u64) {
        if self.open {
            self.heard_from_host = now;
        } else if now - self.heard_from_host >= HOST_GONE_MS * MS {
            self.acquiring = false;
        }
    }
}

/// A board, its host, and the reference beside it.
#[derive(Default)]
struct Life {
    bench: Bench,
    reference: Reference,
    next_number: u16,
    delivered: u64,
    last_sequence: Option<u64>,
    last_status: Option<Status>,
}

impl Life {
    fn order(&mut self, command: Command) {
        let now = self.bench.hardware().now;
        let accepted = self.reference.order(&command, now);
        // The zero in front ends any noise, as a host does when it opens a link.
        let mut bytes = vec![0];
        bytes.extend(request(self.next_number, command));
        self.bench.board.receive(&bytes);
        self.reference.owed.push((self.next_number, accepted));
        self.reference.rejected += u32::from(!accepted);
        self.next_number += 1;
        // Scripted memory stores at once, and the answer comes with the next poll.
        self.poll();
    }

    fn poll(&mut self) {
        let now = self.bench.hardware().now;
        self.bench.board.poll(if self.reference.open { Link::Open } else { Link::Closed });
        self.reference.poll(now);
        if self.bench.hardware().rebooted.take().is_some() {
            // Acquisition may have been started between the command and the reboot.
            self.reference.acquiring = false;
        }
        assert_eq!(self.bench.board.is_acquiring(), self.reference.acquiring);
        let lit = self.bench.hardware().running.is_some();
        assert_eq!(lit, self.reference.acquiring, "light only while acquiring");
    }

    fn link(&mut self, open: bool) {
        if self.reference.open && !open {
            self.reference.owed.clear();
        }
        self.reference.open = open;
        self.poll();
    }

    fn step(&mut self, step: Step) {
        match step {
            Step::Order(command) => self.order(command),
            Step::Noise(bytes) => {
                self.bench.board.receive(&bytes);
            }
            Step::Sample(count) => self.bench.hardware().sample(count),
            Step::Overrun(count) => self.bench.hardware().overrun(count),
            Step::Level(level) => self.bench.hardware().set_level(Level(level)),
            Step::RefuseLight => {
                self.reference.light_refused = true;
                self.bench.hardware().refuse_light = Some(HardwareFault::Emitters);
            }
            Step::Wait(milliseconds) => self.bench.hardware().now += milliseconds * MS,
            Step::Link(open) => self.link(open),
            Step::Listen if self.reference.open => self.listen(),
            Step::Listen => {}
        }
        self.poll();
        // The board keeps answers for a few commands, not for a host that never reads.
        if self.reference.owed.len() >= 5 {
            self.link(true);
            self.listen();
        }
    }

    fn listen(&mut self) {
        for heard in self.bench.listen() {
            match heard {
                Heard::Scan { scan, .. } => {
                    assert!(self.last_sequence.is_none_or(|last| last < scan.sequence), "order kept");
                    self.last_sequence = Some(scan.sequence);
                    self.delivered += 1;
                    for (cell, pair) in scan.lit().iter().enumerate() {
                        assert_eq!(*pair, words(scan.sequence, cell));
                    }
                }
                Heard::Reply(reply) => {
                    let (number, accepted) = self.reference.owed.remove(0);
                    assert_eq!((reply.number, reply.outcome.is_ok()), (number, accepted));
                    let hardware = matches!(reply.outcome, Err(Rejection::Hardware(_)));
                    assert!(!hardware || reply.outcome == Err(Rejection::Hardware(HardwareFault::Emitters)));
                }
                Heard::Status(status) => self.last_status = Some(status),
                Heard::Hello { .. } | Heard::Event { .. } | Heard::Pong(_) | Heard::Edges(_) => {}
            }
        }
        assert_eq!(self.reference.owed, [], "every command answered");
    }

    /// Takes one last scan, so that every loss shows in a sequence number, and listens to
    /// all packets left.
    fn account(&mut self) -> Status {
        self.bench.hardware().refuse_light = None;
        self.reference.light_refused = false;
        self.link(true);
        self.order(Command::Start);
        self.bench.hardware().sample(1);
        self.order(Command::Stop);
        self.bench.hardware().now += STATUS_MS * MS;
        self.poll();
        self.listen();
        self.last_status.take().expect("half a second has passed")
    }
}

proptest! {
    #[test]
    fn a_board_agrees_with_the_reference_over_random_steps(steps in vec(step(), 1..120)) {
        let mut life = Life::default();
        for step in steps {
            life.step(step);
        }
        let status = life.account();
        prop_assert_eq!(status.scans_taken, life.bench.hardware().sampled);
        prop_assert_eq!(status.scans_taken, life.delivered + status.scans_dropped + status.scans_lost);
        prop_assert_eq!(status.commands_rejected, life.reference.rejected);
        prop_assert_eq!(status.replies_dropped, 0);
        prop_assert!(!status.acquiring);
        let kept = life.bench.hardware().kept.as_ref().map(|settings| settings.hashes);
        prop_assert_eq!(kept.unwrap_or_default(), life.reference.hashes);
    }

    #[test]
    fn a_board_does_not_panic_at_random_bytes_and_scans(
        bytes in vec(any::<u8>(), 0..400),
        scans in vec(any::<(u64, u64, u8, bool)>(), 0..20),
    ) {
        let mut life = Life::default();
        life.order(Command::Start);
        for (sequence, tick, cells, has_dark) in scans {
            let mut scan = slitpose_protocol::RawScan::new(cells.into(), has_dark);
            (scan.sequence, scan.tick) = (sequence, tick);
            life.bench.hardware().finished.push_back(crate::common::Finished::Scan(scan));
            life.bench.board.poll(Link::Open);
            life.bench.board.receive(&bytes);
        }
        prop_assert!(sequences(&life.bench.listen()).is_sorted());
    }
}
