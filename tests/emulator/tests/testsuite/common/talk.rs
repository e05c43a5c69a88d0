//! A program at the board's link: it says commands and keeps everything it hears.
//!
//! [`Listener`] decodes what comes into messages of its own and checks what must hold of any of
//! them: scans in order, counters that add up. [`Talk`] is a listener at a [`Rig`], with time.

use super::{is_of_silicon, silicon};
use slitpose_emulator::faults::Faults;
use slitpose_emulator::image::Image;
use slitpose_emulator::machine::Stop;
use slitpose_emulator::peripherals::{TICKS_PER_SECOND, Ticks};
use slitpose_emulator::rig::{Link, Rig, open_image, open_pose_image};
use slitpose_emulator::world::{NoiseSource, OpticsWorld, World};
use slitpose_head::scene_file::Shipped;
use slitpose_head::simulator::Trajectory;
use slitpose_protocol::{
    Batch, Command, Decoder, Hashes, MAX_MESSAGE_BYTES, Message, Pong, RawScan, Rejection, Reply, ResetCause, Schedule,
    Severity, Status,
};

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

/// Scans that fit the board: 25 KB of packets of four scans and at least 218 bytes, and a batch
/// under way.
const ON_BOARD_SCANS: u64 = 480;

/// Scans in a transfer of 1 KB, which is lost if the link breaks while it is sent.
pub const TRANSFER_SCANS: u64 = 20;

#[derive(Clone, Debug, PartialEq)]
pub struct Introduction {
    pub device_id: [u8; 12],
    pub board: String,
    pub reset_cause: ResetCause,
    pub hashes: Hashes,
    pub full_scale_a: f64,
    pub configuration: u16,
    pub schedule: Schedule,
}

/// A message, of which scans are kept elsewhere.
#[derive(Clone, Debug, PartialEq)]
pub enum Said {
    Hello(Introduction),
    /// Number of the configuration, first sequence number, scans.
    Batch(u16, u64, u64),
    Status(Status),
    Event(u64, Severity, String),
    Reply(Reply),
    Pong(Pong),
}

/// A place where scans do not follow one another.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Gap {
    /// The last scan before it.
    pub after: u64,
    pub missing: u64,
    /// From the start of the frame before it to that of the one behind it.
    pub ticks: u64,
}

#[derive(Debug, Default)]
pub struct Listener {
    decoder: Decoder<MAX_MESSAGE_BYTES>,
    schedule: Option<(u16, Schedule)>,
    pub said: Vec<(Ticks, Said)>,
    pub scans: Vec<RawScan>,
    pub gaps: Vec<Gap>,
    /// Scans since the board started, also those that were forgotten here.
    pub received: u64,
    last: Option<(u64, u64)>,
    /// How often a link was closed or broken: what was on its way is lost.
    pub breaks: u64,
    pub status: Option<Status>,
    /// Numbers of the heads of all packets of poses.
    pub heads: Vec<u32>,
    /// Empty packets, and the instants of packets that were full and had none behind them.
    pub empty_packets: usize,
    full_since: Option<Ticks>,
    /// The longest that the end of a transfer was waited for behind a full packet.
    pub longest_full: Ticks,
}

impl Listener {
    /// The board starts anew, and its counters with it.
    pub fn forget_board(&mut self) {
        *self = Self::default();
    }

    /// A program opens the port: it has seen nothing yet.
    pub fn begin_session(&mut self) {
        self.decoder = Decoder::new();
        self.schedule = None;
        self.full_since = None;
        self.said.clear();
    }

    /// Forgets scans, gaps and messages, but not the counts.
    pub fn clear(&mut self) {
        self.said.clear();
        self.scans.clear();
        self.gaps.clear();
    }

    /// Frames that were damaged, in this session.
    pub fn damaged(&self) -> u64 {
        let counters = self.decoder.counters();
        counters.overlong + counters.misframed + counters.bad_checksum + counters.unknown + counters.malformed
    }

    /// Takes in a packet that was over at `at`.
    pub fn hear(&mut self, at: Ticks, bytes: &[u8]) {
        if let Some(since) = self.full_since.take() {
            self.longest_full = self.longest_full.max(at - since);
        }
        match bytes.len() {
            0 => self.empty_packets += 1,
            64 => self.full_since = Some(at),
            _ => {}
        }
        let mut decoder = std::mem::take(&mut self.decoder);
        let mut rest = bytes;
        while let Some(result) = decoder.next::<Message>(&mut rest) {
            if let Ok(message) = result {
                self.take(at, message);
            }
        }
        self.decoder = decoder;
    }

    fn take(&mut self, at: Ticks, message: Message<'_>) {
        let said = match message {
            Message::Hello(hello) => {
                assert_eq!(hello.check_schemas(), Ok(()));
                self.schedule = Some((hello.configuration, hello.schedule.clone()));
                Said::Hello(Introduction {
                    device_id: hello.device_id,
                    board: hello.board.to_owned(),
                    reset_cause: hello.reset_cause,
                    hashes: hello.hashes,
                    full_scale_a: hello.scaling.full_scale_a(),
                    configuration: hello.configuration,
                    schedule: hello.schedule,
                })
            }
            Message::Batch(batch) => self.take_batch(&batch),
            Message::Status(status) => {
                self.check_account(&status);
                self.status = Some(status);
                Said::Status(status)
            }
            Message::Event(event) => Said::Event(event.tick, event.severity, event.text.to_owned()),
            Message::Reply(reply) => Said::Reply(reply),
            Message::Pong(pong) => Said::Pong(pong),
            Message::Truth(truth) => panic!("a physical board knows the truth: {truth:?}"),
            Message::Poses(poses) => {
                self.heads.push(poses.head);
                return;
            }
        };
        self.said.push((at, said));
    }

    fn take_batch(&mut self, batch: &Batch<'_>) -> Said {
        let (number, schedule) = self.schedule.as_ref().expect("a hello comes before the first batch");
        assert_eq!(batch.configuration, *number, "the last hello announces the configuration of a batch");
        let frame_ticks = u64::from(schedule.frame_ticks);
        let scans = batch.scans(schedule).expect("a batch agrees with the schedule of its hello");
        let count = scans.len() as u64;
        for scan in scans {
            if let Some((sequence, tick)) = self.last {
                assert!(
                    scan.sequence > sequence && scan.tick > tick,
                    "scan {} at {} behind scan {sequence} at {tick}",
                    scan.sequence,
                    scan.tick
                );
                let (missing, ticks) = (scan.sequence - sequence - 1, scan.tick - tick);
                if (missing, ticks) != (0, frame_ticks) {
                    self.gaps.push(Gap { after: sequence, missing, ticks });
                }
            }
            self.last = Some((scan.sequence, scan.tick));
            self.received += 1;
            self.scans.push(scan);
        }
        Said::Batch(batch.configuration, batch.sequence, count)
    }

    /// Scans on the board by what a status and this end have counted.
    fn unaccounted(&self, status: &Status) -> u64 {
        let known = self.received + status.scans_dropped + status.scans_lost;
        status
            .scans_taken
            .checked_sub(known)
            .unwrap_or_else(|| panic!("{} received, more than {status:?}", self.received))
    }

    fn check_account(&self, status: &Status) {
        let most = ON_BOARD_SCANS + self.breaks * TRANSFER_SCANS;
        let unaccounted = self.unaccounted(status);
        assert!(unaccounted <= most, "{unaccounted} scans unaccounted for, {} received: {status:?}", self.received);
    }

    pub fn replies(&self, number: u16) -> Vec<Result<(), Rejection>> {
        let reply = |said: &(Ticks, Said)| match said.1 {
            Said::Reply(reply) if reply.number == number => Some(reply.outcome),
            _ => None,
        };
        self.said.iter().filter_map(reply).collect()
    }

    pub fn hello(&self) -> Option<&Introduction> {
        self.said.iter().rev().find_map(|(_, said)| if let Said::Hello(hello) = said { Some(hello) } else { None })
    }

    pub fn hellos(&self) -> usize {
        self.said.iter().filter(|(_, said)| matches!(said, Said::Hello(_))).count()
    }

    pub fn events(&self) -> Vec<&str> {
        self.all_events().into_iter().filter(|text| !is_of_silicon(text)).collect()
    }

    /// The same with those that faults of the silicon make for.
    pub fn all_events(&self) -> Vec<&str> {
        self.said
            .iter()
            .filter_map(|(_, said)| if let Said::Event(_, _, text) = said { Some(&text[..]) } else { None })
            .collect()
    }

    pub fn missing(&self) -> u64 {
        self.gaps.iter().map(|gap| gap.missing).sum()
    }
}

#[derive(Debug)]
pub struct Talk<W = OpticsWorld> {
    pub rig: Rig<W>,
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
        Self::boot_image(&open_image(None).expect("firmware/build has made an image"), noise, silicon)
    }

    fn boot_image(image: &Image, noise: NoiseSource, silicon: Faults) -> Self {
        let scene = Shipped::named("wide").expect("a shipped scene").read().expect("shipped scenes are valid");
        let rig = Rig::boot(image, &scene, at_rest(), noise, silicon).expect("the board fits the scene");
        Self { rig, ear: Listener::default() }
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
        Self::boot_image(&image, NoiseSource::Off, silicon()).turned_to_uart()
    }

    fn turned_to_uart(mut self) -> Self {
        self.rig = self.rig.with_link(Link::Uart);
        self.run_ms(5.0);
        assert_eq!(self.ask(Command::Hello), Ok(()));
        self
    }
}

impl<W: World> Talk<W> {
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
        let configured = self.wait_for(ENUMERATION_MS, |talk| talk.rig.machine().board.usb_host.is_configured());
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
        assert!(self.wait_for(ANSWER_MS, |talk| !talk.rig.machine().board.usb_host.dtr()));
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
}

/// A tool at rest where every electrode has another current.
pub fn at_rest() -> Trajectory {
    let path = std::env::temp_dir().join(format!("at-rest-{}.csv", std::process::id()));
    std::fs::write(&path, AT_REST).expect("there is room for a line");
    let trajectory = Trajectory::from_table(path.to_str().expect("a path of letters"));
    std::fs::remove_file(&path).expect("it was written");
    trajectory.expect("one pose")
}

const AT_REST: &str = "\
time_s,tx_mm,ty_mm,tz_mm,rx_rad,ry_rad,rz_rad
0,0.31,-0.23,0.17,0.011,-0.007,0.019
";
