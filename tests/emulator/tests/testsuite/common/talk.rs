//! A program at the board's link, with time: it says commands, and its [`Listener`] keeps everything it hears.

use super::listener::{Introduction, Listener, MANY_BREAKS, Said};
use super::{SEED, head_of, silicon, smooth};
use slitpose_emulator::faults::Faults;
use slitpose_emulator::image::Image;
use slitpose_emulator::machine::Stop;
use slitpose_emulator::peripherals::{TICKS_PER_SECOND, Ticks};
use slitpose_emulator::rig::{Link, Rig, open_image, open_pose_image};
use slitpose_emulator::world::{NoiseSource, Record};
use slitpose_head::scene_file::{SceneFile, WIDE};
use slitpose_head::simulator::Trajectory;
use slitpose_head::table::TableReader;
use slitpose_protocol::{Command, Rejection, ResetCause, Status, Stream};

pub const MS: Ticks = TICKS_PER_SECOND / 1_000;

/// Ticks from one frame to the next in the default configuration.
pub const FRAME_TICKS: u64 = 42_500;

/// From power-on or the plugging in of the cable to a working port: debouncing 100 ms, reset 50 ms,
/// recovery 10 ms, and some twenty requests of a few milliseconds at most.
const ENUMERATION_MS: u64 = 400;

/// Every command but Store and Forget is answered within this; the answer waits behind a transfer
/// of 1 KB at most (1 ms) and up to two frames of USB.
const ANSWER_MS: u64 = 20;

/// An erasure of 22 ms and a record of 24 double words at 85 µs, and as much in hand.
const STORED_MS: u64 = 60;

#[derive(Debug)]
pub struct Talk {
    pub rig: Rig,
    pub ear: Listener,
}

impl Talk {
    /// A board with a tool at rest and no noise, so that all scans are alike; its host has not
    /// found it yet.
    pub fn boot() -> Self {
        Self::boot_with(NoiseSource::Off, silicon())
    }

    /// A board on `silicon`, its port open at USB.
    pub fn on(silicon: Faults) -> Self {
        Self::boot_with(NoiseSource::Off, silicon).opened()
    }

    /// A board with noise from `seed`, its port open at USB.
    pub fn noisy(seed: u64) -> Self {
        Self::boot_with(NoiseSource::Seeded(seed), silicon()).opened()
    }

    fn boot_with(noise: NoiseSource, silicon: Faults) -> Self {
        let image = open_image(None).expect("firmware/build has made an image");
        Self::start(&image, &WIDE.read().expect("shipped"), at_rest(), noise, silicon)
    }

    /// A board with `image`, its clock running, in front of the head of `scene`.
    fn start(image: &Image, scene: &SceneFile, trajectory: Trajectory, noise: NoiseSource, silicon: Faults) -> Self {
        let mut rig = Rig::boot(image, scene, trajectory, noise, silicon).expect("the board fits the scene");
        rig.machine.board.record = Some(Record::default());
        Self { rig, ear: Listener::default() }
    }

    /// A board that solves poses of a moving tool, its port open, and the head of `scene` sent to it.
    pub fn solving(scene: &SceneFile, noise: NoiseSource) -> Self {
        Self::solving_on(scene, noise, silicon())
    }

    /// The same on `silicon`.
    pub fn solving_on(scene: &SceneFile, noise: NoiseSource, silicon: Faults) -> Self {
        println!("seed {SEED}");
        let image = open_pose_image().expect("firmware/build has made an image");
        let mut talk = Self::start(&image, scene, smooth(), noise, silicon);
        talk.ear.breaks = MANY_BREAKS;
        talk.rig.set_open(true);
        while talk.ear.hello().is_none() {
            assert!(talk.rig.now() < TICKS_PER_SECOND, "no hello within a second");
            talk.run_ms(1.0);
        }
        let head = head_of(&talk.ear, scene);
        talk.rig.send_head(&head);
        talk.run_ms(1.0);
        let accepted = talk.ear.accepted();
        assert!(!accepted.is_empty() && accepted.iter().all(|&accepted| accepted), "{accepted:?}");
        talk
    }

    /// The same with USB at work and its port open, and the hello heard.
    pub fn at_usb() -> Self {
        Self::boot().opened()
    }

    fn opened(mut self) -> Self {
        self.await_port();
        self.open();
        self
    }

    pub fn at_uart() -> Self {
        Self::boot().turned_to_uart()
    }

    /// The same, and the board solves poses if it is given a head.
    pub fn solving_at_uart() -> Self {
        let image = open_pose_image().expect("firmware/build has made an image");
        let scene = WIDE.read().expect("shipped");
        Self::start(&image, &scene, at_rest(), NoiseSource::Off, silicon()).turned_to_uart()
    }

    fn turned_to_uart(mut self) -> Self {
        self.rig = self.rig.with_link(Link::Uart);
        self.run_ms(5.0);
        assert_eq!(self.ask(Command::Hello), Ok(()));
        self
    }

    /// A board whose port is open, for tests that let scans be lost.
    pub fn quiet() -> Self {
        let mut talk = Self::boot();
        assert_eq!(talk.connect().reset_cause, ResetCause::PowerOn);
        talk
    }

    /// Lets the host find the board, which has started anew, and open its port; gives its hello.
    pub fn connect(&mut self) -> Introduction {
        self.forget_board();
        self.ear.breaks = MANY_BREAKS;
        // The computer notices that the board was gone.
        self.run_ms(20.0);
        self.await_port();
        // A port that was open is opened again by the host itself.
        self.run_ms(5.0);
        self.rig.set_open(false);
        self.run_ms(5.0);
        self.open();
        self.ear.hello().expect("it has come").clone()
    }

    /// Cuts the supply for a while, at once.
    pub fn cut_supply(&mut self) {
        self.rig.machine.cut_power();
        self.rig.run_for(1e-3);
        self.rig.machine.power_on();
        self.forget_board();
    }

    /// The board has started anew: what it said before is of no use.
    pub fn forget_board(&mut self) {
        self.rig.take_packets();
        self.ear.forget_board();
    }

    pub fn record(&mut self) -> &mut Record {
        self.rig.machine.board.record.as_mut().expect("since the start")
    }

    /// Tick of power at which the board's clock was zero.
    pub fn origin(&mut self) -> Ticks {
        self.rig.machine.device_clock_origin().expect("the program starts its clock")
    }

    /// Forgets what was heard and recorded.
    pub fn forget(&mut self) {
        self.ear.clear();
        self.record().forget();
    }

    pub fn gates(&mut self) -> u8 {
        self.rig.machine.board.gates()
    }

    /// The instant since which all gates have been off.
    pub fn dark_since(&mut self) -> Ticks {
        let edges = self.record().edges();
        let (at, gates) = *edges.last().expect("it was lit");
        assert_eq!(gates, 0, "lit");
        at
    }

    /// Starts, and lets a few frames pass.
    pub fn light(&mut self) {
        self.accept(&Command::Start);
        self.run_ms(5.0);
        assert!(self.record().drives.iter().rev().take(8).any(|drive| drive.gates != 0), "it lights");
    }

    /// Starts, and asks for poses and no scans.
    pub fn start_poses(&mut self) {
        self.rig.send(Command::Stream(Stream { scans: 0, poses: 1 }));
        self.run_ms(1.0);
        self.rig.send(Command::Start);
    }

    /// Lets time pass and listens. The board must live, if it has a supply.
    pub fn run_until(&mut self, end: Ticks) {
        let stop = self.rig.run_until(end);
        assert!(matches!(stop, Stop::Reached | Stop::PoweredOff), "{stop:?}");
        self.listen();
    }

    pub fn run_ms(&mut self, ms: f64) {
        self.run_until(self.rig.now() + (ms * MS as f64) as Ticks);
    }

    pub fn listen(&mut self) {
        for (at, bytes) in self.rig.take_packets() {
            self.ear.hear(at, &bytes);
        }
    }

    /// Lets time pass until something has happened, `most_ms` at most; gives whether it has.
    pub fn wait_for(&mut self, most_ms: u64, mut happened: impl FnMut(&mut Self) -> bool) -> bool {
        let end = self.rig.now() + most_ms * MS;
        while !happened(self) {
            if self.rig.now() >= end {
                return false;
            }
            self.run_until(self.rig.now() + MS / 10);
        }
        true
    }

    /// Waits until the host has configured the board.
    pub fn await_port(&mut self) {
        let configured = self.wait_for(ENUMERATION_MS, |talk| talk.rig.machine.board.usb_host.is_configured());
        assert!(configured, "not enumerated in time: {:?}", self.rig.faults());
    }

    /// Opens the port as a new program and waits for the hello.
    pub fn open(&mut self) {
        self.ear.begin_session();
        self.rig.set_open(true);
        assert!(self.wait_for(ANSWER_MS, |talk| talk.ear.hello().is_some()), "no hello");
    }

    /// Closes the port and waits until the board has been told.
    pub fn close(&mut self) {
        self.rig.set_open(false);
        self.ear.breaks += 1;
        assert!(self.wait_for(ANSWER_MS, |talk| !talk.rig.machine.board.usb_host.dtr()));
    }

    /// Says a command and gives the outcome of its only reply.
    pub fn ask(&mut self, command: Command) -> Result<(), Rejection> {
        let patience = match command {
            Command::Store(_) | Command::Forget => STORED_MS,
            _ => ANSWER_MS,
        };
        let number = self.rig.send(command);
        self.answer(number, patience)
    }

    /// Waits for the only reply to command `number`.
    pub fn answer(&mut self, number: u16, patience_ms: u64) -> Result<(), Rejection> {
        assert!(
            self.wait_for(patience_ms, |talk| !talk.ear.replies(number).is_empty()),
            "no reply in {patience_ms} ms"
        );
        let replies = self.ear.replies(number);
        assert_eq!(replies.len(), 1, "one reply each");
        replies[0]
    }

    /// Says a command that is accepted, even if the board has its hands full; gives when its reply was over.
    pub fn accept(&mut self, command: &Command) -> Ticks {
        let number = self.rig.send(command.clone());
        assert_eq!(self.answer(number, 100), Ok(()), "{command:?}");
        self.ear.said.iter().rfind(|(_, said)| matches!(said, Said::Reply(_))).expect("a reply").0
    }

    pub fn next_status(&mut self) -> Status {
        self.ear.status = None;
        assert!(self.wait_for(520, |talk| talk.ear.status.is_some()), "no status in 520 ms");
        self.ear.status.expect("it was waited for")
    }

    pub fn is_acquiring(&mut self) -> bool {
        let before = self.ear.received;
        self.run_ms(4.0);
        self.ear.received > before
    }

    /// Stops, and checks that every scan is accounted for to the last but `on_the_wire` at most.
    pub fn settle_account(&mut self, on_the_wire: u64) -> Status {
        assert_eq!(self.ask(Command::Stop), Ok(()));
        let status = self.next_status();
        assert!(!status.acquiring);
        let unaccounted = self.ear.unaccounted(&status);
        assert!(unaccounted <= on_the_wire, "{unaccounted} scans unaccounted for: {status:?}");
        status
    }

    pub fn expect_no_faults(&self) {
        assert_eq!(self.rig.faults(), Vec::<String>::new());
    }

    /// The same, and the line is clean.
    pub fn expect_neither_faults_nor_damage(&self) {
        self.expect_no_faults();
        assert_eq!(self.ear.damaged(), 0, "the line is clean");
    }
}

/// A tool at rest where every electrode has another current.
pub fn at_rest() -> Trajectory {
    let table = TableReader::new("at rest", AT_REST.as_bytes()).expect("a table");
    Trajectory::through_rows(table).expect("one pose")
}

const AT_REST: &str = "\
time_s,tx_mm,ty_mm,tz_mm,rx_rad,ry_rad,rz_rad
0,0.31,-0.23,0.17,0.011,-0.007,0.019
";
