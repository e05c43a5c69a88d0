//! A board whose cable is pulled, and worse.

use std::sync::{Arc, Mutex, MutexGuard};
use std::time::{Duration, Instant};

use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use slitpose_head::scene_file::WIDE;
use slitpose_model::Tier;
use slitpose_protocol::{Command, Decoder, MAX_REQUEST_BYTES, Request};

use crate::terminal::{Board, Device};

/// How a board goes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Manner {
    /// The port goes in the middle of a packet. The board keeps its power, and goes on counting.
    MidPacket,
    /// The board falls silent, the port goes later.
    Silence(Duration),
    /// Garbage comes, then the port goes.
    Garbage(Duration),
    /// The port goes, and the board starts anew.
    Reboot,
    /// As `MidPacket`; the new port is held by another program at first.
    Held(Duration),
    /// The board starts anew behind a port that stays.
    ResetInPlace,
}

/// What can be told of a board's time behind a terminal.
#[derive(Clone, Copy, Debug, Default)]
pub struct Course {
    /// When it was told to start for the first time.
    pub started: Option<Instant>,
    /// When its first scans went out after that.
    pub scanned: Option<Instant>,
}

/// A board and its cable. Time of the board passes whether it is plugged in or not.
#[derive(Debug)]
pub struct Supplied {
    board: Board,
    born: Instant,
    seed: u64,
    /// The number of the cable it is plugged in with.
    cable: u64,
    course: Course,
    leaving: Option<(Manner, Instant)>,
}

impl Supplied {
    /// A board that has just been switched on.
    pub fn new(seed: u64) -> Arc<Mutex<Self>> {
        let born = Instant::now();
        let (board, course) = (board(seed), Course::default());
        Arc::new(Mutex::new(Self { board, born, seed, cable: 0, course, leaving: None }))
    }

    /// Takes its power and gives it back.
    pub fn reboot(&mut self) {
        self.seed += 1;
        (self.board, self.born) = (board(self.seed), Instant::now());
        self.course = Course::default();
    }

    /// Notices that it is plugged in anew, with the cable of this number: it stopped when it was unplugged.
    pub fn plug_in(&mut self, cable: u64) {
        self.cable = cable;
        self.board.command(Command::Stop);
        (self.course, self.leaving) = (Course::default(), None);
        // What it would have said meanwhile nobody has heard.
        let now_s = self.born.elapsed().as_secs_f64();
        while !self.board.has_reached(now_s) {
            self.board.act(&[], now_s, &mut Vec::new());
        }
    }

    /// Begins to go.
    pub fn leave(&mut self, manner: Manner) {
        self.leaving = Some((manner, Instant::now()));
        self.course = Course::default();
    }

    /// How it went since it was plugged in or rebooted.
    pub fn course(&self) -> Course {
        self.course
    }
}

fn board(seed: u64) -> Board {
    Board::numbered(0, &WIDE.read().expect("shipped"), Tier::Paper, seed)
}

/// `supplied`, locked.
///
/// # Panics
/// If whoever had it before has panicked.
pub fn locked(supplied: &Mutex<Supplied>) -> MutexGuard<'_, Supplied> {
    supplied.lock().expect("no panic")
}

/// The far end of a cable with a number, where `supplied` may be plugged in.
pub fn cable(supplied: Arc<Mutex<Supplied>>, number: u64) -> impl Device {
    let mut rng = ChaCha8Rng::seed_from_u64(number);
    let mut decoder = Decoder::<MAX_REQUEST_BYTES>::new();
    let mut was_cut = false;
    move |received: &[u8], _: f64, sent: &mut Vec<u8>| {
        let mut supplied = locked(&supplied);
        if supplied.cable != number {
            return true;
        }
        let mut rest = received;
        while let Some(request) = decoder.next::<Request>(&mut rest) {
            // The first bytes of a host end half a command of the one before.
            if request.is_ok_and(|request| request.command == Command::Start) {
                supplied.course.started.get_or_insert_with(Instant::now);
            }
        }
        match supplied.leaving {
            Some((Manner::MidPacket | Manner::Held(_) | Manner::Reboot, _)) => {
                if was_cut {
                    return false;
                }
                supplied.act(received, sent);
                sent.truncate(sent.len().saturating_sub(5));
                was_cut = true;
            }
            Some((Manner::Silence(pause), since)) => {
                sent.clear();
                return since.elapsed() < pause;
            }
            Some((Manner::Garbage(pause), since)) => {
                let mut garbage = [0; 64];
                rng.fill_bytes(&mut garbage);
                sent.extend(garbage);
                return since.elapsed() < pause;
            }
            Some((Manner::ResetInPlace, _)) => {
                sent.clear();
                supplied.reboot();
                supplied.leaving = None;
            }
            None => supplied.act(received, sent),
        }
        true
    }
}

impl Supplied {
    fn act(&mut self, received: &[u8], sent: &mut Vec<u8>) {
        self.board.act(received, self.born.elapsed().as_secs_f64(), sent);
        // Besides scans, from then on, there are but a reply and some status.
        if self.course.started.is_some() && sent.len() > 200 {
            self.course.scanned.get_or_insert_with(Instant::now);
        }
    }
}
