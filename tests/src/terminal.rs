//! Boards on pseudo-terminals, as `run --device PATH` meets them.

use std::sync::{Arc, OnceLock};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use nix::fcntl::OFlag;
use nix::pty::{PtyMaster, posix_openpt};
use slitpose_emulator::terminal::Terminal as Line;
use slitpose_head::scene_file::{SceneFile, WIDE};
use slitpose_head::simulator::{SimulatedBoard, Trajectory, TrajectoryKind};
use slitpose_model::Tier;
use slitpose_protocol::{
    Command, Decoder, Hello, MAX_MESSAGE_BYTES, MAX_REQUEST_BYTES, Message, Reply, Request, encode,
};

use crate::capture::STREAM;

/// Frames a second of the default scene.
pub const FRAME_RATE_HZ: f64 = 4000.0;

/// What is on the other side of a terminal.
pub trait Device: Send + 'static {
    /// Takes what the host has sent, appends to `sent` what goes to the host, `now_s` after the host
    /// has opened the terminal; called every millisecond. `false` pulls the plug.
    fn act(&mut self, received: &[u8], now_s: f64, sent: &mut Vec<u8>) -> bool;
}

impl<F: FnMut(&[u8], f64, &mut Vec<u8>) -> bool + Send + 'static> Device for F {
    fn act(&mut self, received: &[u8], now_s: f64, sent: &mut Vec<u8>) -> bool {
        self(received, now_s, sent)
    }
}

/// A terminal that is served until its host closes it, or the device pulls the plug.
#[derive(Debug)]
pub struct Terminal {
    /// Where the host finds it.
    pub path: String,
    opened: Arc<OnceLock<Instant>>,
    thread: JoinHandle<Log>,
}

/// Takes so many terminals, as long as they are kept. Numbers of terminals are given again, and whoever looks
/// for a board that was at such a number would take the next one there for it: behind these numbers nobody
/// looks.
pub fn occupy(count: usize) -> Vec<PtyMaster> {
    let flags = OFlag::O_RDWR | OFlag::O_NOCTTY | OFlag::O_CLOEXEC;
    (0..count).map(|_| posix_openpt(flags).expect("pseudo-terminal")).collect()
}

/// What went over a terminal.
#[derive(Clone, Debug, Default)]
pub struct Log {
    pub received: Vec<u8>,
    /// To the host, as far as it took it.
    pub sent: Vec<u8>,
}

impl Log {
    pub fn commands(&self) -> Vec<Command> {
        let mut decoder = Decoder::<MAX_REQUEST_BYTES>::new();
        let mut bytes = &self.received[..];
        let mut commands = Vec::new();
        while let Some(request) = decoder.next::<Request>(&mut bytes) {
            commands.push(request.expect("undamaged").command);
        }
        commands
    }
}

impl Terminal {
    /// A new terminal with `device` behind it.
    pub fn serve(device: impl Device) -> Self {
        Self::start(device, true)
    }

    /// The same, but it stays when the host closes it, which may open it again: only the device can pull the
    /// plug. Its log is empty.
    pub fn serve_until_pulled(device: impl Device) -> Self {
        Self::start(device, false)
    }

    fn start(device: impl Device, ends_with_host: bool) -> Self {
        let line = Line::open().expect("pseudo-terminal");
        let path = line.path().to_str().expect("UTF-8").to_owned();
        let opened = Arc::new(OnceLock::new());
        let clock = Arc::clone(&opened);
        let thread = std::thread::spawn(move || serve(&line, device, &clock, ends_with_host));
        Self { path, opened, thread }
    }

    /// When the host opened it: the start of the device's time.
    pub fn opened(&self) -> Option<Instant> {
        self.opened.get().copied()
    }

    /// Waits until it is closed from either side.
    pub fn closed(self) -> Log {
        self.thread.join().expect("device")
    }
}

fn serve(line: &Line, mut device: impl Device, opened: &OnceLock<Instant>, ends_with_host: bool) -> Log {
    let mut log = Log::default();
    let (mut chunk, mut pending) = ([0; 4096], Vec::new());
    let mut due = Instant::now();
    loop {
        // What the device takes to act is not on top; what it takes beyond is not made up for.
        due = (due + Duration::from_millis(1)).max(Instant::now());
        std::thread::sleep(due.saturating_duration_since(Instant::now()));
        // In this order: what a host has written before it closed the terminal is read.
        let is_open = line.is_open().expect("poll");
        let received = line.read(&mut chunk).expect("read");
        if received.is_empty() && !is_open {
            std::thread::sleep(Duration::from_millis(1));
            if ends_with_host {
                if opened.get().is_some() {
                    return log;
                }
                continue;
            }
            // Nobody hears it.
            pending.clear();
        }
        let now_s = opened.get_or_init(Instant::now).elapsed().as_secs_f64();
        let plugged = device.act(received, now_s, &mut pending);
        if ends_with_host {
            log.received.extend_from_slice(received);
        }
        if !plugged {
            return log;
        }
        let written = pending.drain(..line.write(&pending).expect("write"));
        if ends_with_host {
            log.sent.extend(written);
        }
    }
}

/// A board that has fallen behind catches up with so many frames a millisecond, not at one go: it
/// would be silent meanwhile.
const FRAMES_AT_ONCE: u64 = 20;

/// As many before it hears a command, so that its clock is right then: some hundredths of a second of a
/// slow machine. One that is further behind is no clock.
const FRAMES_BEFORE_COMMAND: u64 = 200;

/// A board does not sample while so much waits for its host: it loses nothing, and replies are not late.
const BACKLOG_BYTES: usize = 4096;

/// The simulated board in real time, or slower if machine or host are.
#[derive(Debug)]
pub struct Board {
    board: SimulatedBoard,
    frame_s: f64,
    frames: u64,
    /// What it says when the frame under way is over.
    said: Vec<u8>,
}

impl Board {
    /// One with the head of the default scene and a smoothly moved tool.
    pub fn wide(seed: u64) -> Self {
        Self::of(&WIDE.read().expect("shipped"), seed)
    }

    pub fn of(file: &SceneFile, seed: u64) -> Self {
        Self::numbered(0, file, STREAM, seed)
    }

    /// One of several, with optics of `tier`.
    pub fn numbered(number: u8, file: &SceneFile, tier: Tier, seed: u64) -> Self {
        let trajectory = Trajectory::of_kind(TrajectoryKind::Smooth, seed, 10.0);
        let board = SimulatedBoard::numbered(number, file, trajectory, tier, seed).expect("can be simulated");
        let schedule = slitpose_head::front_end::configuration(file).expect("has a schedule").schedule;
        Self { board, frame_s: schedule.frame_rate_hz().recip(), frames: 0, said: Vec::new() }
    }

    /// Whether it has caught up with the time `now_s`.
    pub fn has_reached(&self, now_s: f64) -> bool {
        self.frames >= (now_s / self.frame_s) as u64
    }

    /// Does what `command` says, whoever gives it.
    pub fn command(&mut self, command: Command) {
        self.board.write(&request(u16::MAX, command));
    }
}

/// Its clock is one: whatever it is sent reaches it later by its ticks, too, and nothing it says
/// comes earlier than its ticks say.
impl Device for Board {
    fn act(&mut self, received: &[u8], now_s: f64, sent: &mut Vec<u8>) -> bool {
        // Frames that are over by now, and the one under way if there is something to be heard in it.
        let over = (now_s / self.frame_s) as u64;
        let wanted = match received {
            [] => over.min(self.frames + FRAMES_AT_ONCE),
            _ => (over + 1).min(self.frames + FRAMES_BEFORE_COMMAND),
        };
        while self.frames < wanted && sent.len() <= BACKLOG_BYTES {
            self.board.step(&mut self.said);
            self.frames += 1;
        }
        self.board.write(received);
        self.board.transmit(&mut self.said);
        if self.frames <= over {
            sent.append(&mut self.said);
        }
        true
    }
}

/// `board` with each message changed by `edit`; `None` leaves it out.
pub fn edited(
    board: impl Device,
    mut edit: impl FnMut(Message<'_>) -> Option<Message<'_>> + Send + 'static,
) -> impl Device {
    rewritten(board, move |message, sent| sent.extend(edit(message).iter().flat_map(packet)))
}

/// `board` with what `write` sends instead of each message.
pub fn rewritten(
    mut board: impl Device,
    mut write: impl FnMut(Message<'_>, &mut Vec<u8>) + Send + 'static,
) -> impl Device {
    let mut decoder = Decoder::<MAX_MESSAGE_BYTES>::new();
    move |received: &[u8], now_s: f64, sent: &mut Vec<u8>| {
        let mut own = Vec::new();
        let plugged = board.act(received, now_s, &mut own);
        let mut bytes = &own[..];
        while let Some(message) = decoder.next::<Message<'_>>(&mut bytes) {
            write(message.expect("undamaged"), sent);
        }
        plugged
    }
}

pub fn greeting(board: impl Device, mut edit: impl FnMut(&mut Hello<'_>) + Send + 'static) -> impl Device {
    edited(board, move |mut message| {
        if let Message::Hello(hello) = &mut message {
            edit(hello);
        }
        Some(message)
    })
}

/// A message as it goes over the wire.
pub fn packet(message: &Message<'_>) -> Vec<u8> {
    encode(message, &mut [0; MAX_MESSAGE_BYTES]).expect("room").to_vec()
}

/// A command as it goes over the wire.
pub fn request(number: u16, command: Command) -> Vec<u8> {
    encode(&Request { number, command }, &mut [0; MAX_REQUEST_BYTES]).expect("room").to_vec()
}

pub fn reply(number: u16, outcome: Result<(), slitpose_protocol::Rejection>) -> Message<'static> {
    Message::Reply(Reply { number, outcome })
}
