//! A board that goes in all manners and comes back at another port: how soon its poses are there again, and
//! whether the daemon keeps anything of the ports before.

use std::fs;
use std::io::{BufRead, BufReader};
use std::os::unix::fs::symlink;
use std::path::Path;
use std::process::{ChildStdout, Stdio};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, Sender, channel};
use std::sync::{Arc, Mutex, MutexGuard};
use std::time::{Duration, Instant};

use clap::Args;
use nix::sys::signal::Signal;
use rand::{Rng, RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use slitpose::device::SerialDevice;
use slitpose_head::scene_file::WIDE;
use slitpose_model::Tier;
use slitpose_protocol::{Command, Decoder, MAX_REQUEST_BYTES, Request};

use super::{Table, Verdicts, check_growth};
use crate::consistency::Sorted;
use crate::daemon::{Daemon, Usage, boards};
use crate::process::{Slitpose, name_in};
use crate::terminal::{Board, Device, Terminal, occupy};

/// Whatever is not there after this will not come.
const GIVEN_UP: Duration = Duration::from_secs(20);

/// A board that resets behind a port that stays is missed when its next status says so, or nothing comes.
const NOTICED_WITHIN: Duration = Duration::from_millis(500);

/// After so many cycles everything has been opened that ever will.
const WARM_UP: usize = 20;

#[derive(Debug, Args)]
pub struct Conditions {
    /// Times
    #[arg(long, default_value_t = 1000)]
    cycles: usize,
    /// Of manners and pauses
    #[arg(long, default_value_t = 20_180_718)]
    seed: u64,
    /// Poses must be there again within this
    #[arg(long, default_value = "1s", value_parser = humantime::parse_duration)]
    within: Duration,
    /// Memory may grow by so many KiB from the second quarter to the last
    #[arg(long, default_value_t = 1024.0)]
    most_growth_kib: f64,
}

#[derive(Clone, Copy, Debug)]
struct Return {
    manner: Manner,
    /// From the port being there, and free, until the board was told to start; `None`: never.
    start_s: Option<f64>,
    /// Until a pose was on standard output.
    pose_s: Option<f64>,
}

pub fn study(slitpose: Slitpose, conditions: &Conditions) -> Verdicts {
    let &Conditions { cycles, seed, within, most_growth_kib } = conditions;
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let folder = tempfile::tempdir().expect("temporary folder");
    let link = name_in(folder.path(), "board");
    // Other tests look for their boards, too; two of this one do not share numbers.
    let _others = occupy(32 + std::process::id() as usize % 64);
    let board = Supplied::new(seed);
    let mut port = Port::new(&board, 0);
    locked(&board).plug_in(0);
    point(&link, &port.terminal.path);
    let arguments = ["--device", &link, "--format", "ndjson"];
    let mut daemon = Daemon::start(None, slitpose, folder, arguments, Stdio::piped());
    let poses = Poses::watch(daemon.child.stdout.take().expect("piped"));
    poses.next(&board).expect("the first pose");

    let (mut returns, mut usages) = (Vec::<Return>::new(), Vec::<Usage>::new());
    for cycle in 0..cycles {
        std::thread::sleep(Duration::from_millis(rng.random_range(20..100)));
        usages.extend(daemon.usage());
        let manner = Manner::of(cycle, &mut rng);
        let came = if manner == Manner::ResetInPlace {
            let since = Instant::now();
            locked(&board).leave(manner);
            since
        } else {
            // Made while the old one is there, the new one has another name.
            let next = Port::new(&board, 1 + cycle as u64);
            unplug(&link, manner, &board, port);
            std::thread::sleep(Duration::from_millis(rng.random_range(0..150)));
            port = next;
            plug_in(&link, manner, &board, &port)
        };
        let pose = poses.next(&board);
        let started = locked(&board).course.started;
        let after = |at: Option<Instant>| at.map(|at| at.saturating_duration_since(came).as_secs_f64());
        returns.push(Return { manner, start_s: after(started), pose_s: after(pose) });
        if pose.is_none() {
            break;
        }
    }
    std::thread::sleep(Duration::from_millis(100));
    usages.extend(daemon.usage());
    let status = daemon.status().expect("the daemon tells how it goes");
    let reconnects: u64 = boards(&status).filter_map(|board| board["link"]["reconnects"].as_u64()).sum();
    let ended = daemon.end_by(Signal::SIGINT);
    locked(&board).leave(Manner::MidPacket);
    drop(port.terminal.closed());

    println!(
        "{cycles} times unplugged and plugged in again (seed {seed}), {} lines of talk",
        ended.stderr.lines().count()
    );
    print!("{}", table(&returns));
    let mut verdicts = Verdicts::default();
    let back = returns.iter().filter(|it| it.pose_s.is_some()).count();
    verdicts.check(back == cycles, format!("{back} of {cycles} times the poses come again"));
    if back < cycles {
        println!("{status}\n{}", ended.stderr);
    }
    let bound = |it: &Return| within + if it.manner == Manner::ResetInPlace { NOTICED_WITHIN } else { Duration::ZERO };
    let is_late = |it: &&Return| it.pose_s.is_none_or(|pose_s| pose_s > bound(it).as_secs_f64());
    let late: Vec<&Return> = returns.iter().filter(is_late).collect();
    let worst = &late[..late.len().min(5)];
    verdicts.check(
        late.is_empty(),
        format!("within {within:?}, {NOTICED_WITHIN:?} more if reset in place; later: {} {worst:?}", late.len()),
    );
    verdicts.check(reconnects == cycles as u64, format!("{reconnects} reconnections reported in {cycles} cycles"));
    let (before, after) = (&usages[WARM_UP.min(cycles / 2)], &usages[usages.len() - 1]);
    for (what, before, after) in
        [("threads", before.threads, after.threads), ("descriptors", before.descriptors, after.descriptors)]
    {
        verdicts.check(before == after, format!("{after} {what}, {before} before"));
    }
    check_growth(&mut verdicts, &usages.iter().map(|usage| usage.resident_bytes).collect::<Vec<_>>(), most_growth_kib);
    // Garbage, and packets that were cut off, are damage.
    verdicts.check(ended.status.code() == Some(3), format!("it ends with 3: {}", ended.status));
    verdicts
}

fn table(returns: &[Return]) -> Table {
    let mut table = Table::new(&["gone by", "times", "port to start, ms: median/99 %/most", "port to pose, ms"]);
    for name in ["MidPacket", "Silence", "Garbage", "Reboot", "Held", "ResetInPlace", ""] {
        let some = || returns.iter().filter(|it| format!("{:?}", it.manner).starts_with(name));
        let times = |times: Sorted| {
            format!("{:.0} / {:.0} / {:.0}", times.median() * 1e3, times.at(0.99) * 1e3, times.most() * 1e3)
        };
        let start = times(Sorted::of(some().filter_map(|it| it.start_s)));
        let pose = times(Sorted::of(some().filter_map(|it| it.pose_s)));
        let name = if name.is_empty() { "all" } else { name };
        table.row([name.to_owned(), some().count().to_string(), start, pose]);
    }
    table
}

struct Port {
    number: u64,
    terminal: Terminal,
}

impl Port {
    fn new(board: &Arc<Mutex<Supplied>>, number: u64) -> Self {
        Self { number, terminal: Terminal::serve_until_pulled(cable(Arc::clone(board), number)) }
    }
}

/// Lets the board go: with its port goes the port's name.
fn unplug(link: &str, manner: Manner, board: &Mutex<Supplied>, port: Port) {
    locked(board).leave(manner);
    drop(port.terminal.closed());
    fs::remove_file(link).expect("removable");
    if manner == Manner::Reboot {
        locked(board).reboot();
    }
}

/// Brings the board back; since when it could be used.
fn plug_in(link: &str, manner: Manner, board: &Mutex<Supplied>, port: &Port) -> Instant {
    locked(board).plug_in(port.number);
    let path = &port.terminal.path;
    if let Manner::Held(pause) = manner {
        let holder = SerialDevice::open(path).expect("is free");
        point(link, path);
        std::thread::sleep(pause);
        drop(holder);
        Instant::now()
    } else {
        let came = Instant::now();
        point(link, path);
        came
    }
}

fn point(link: &str, port: &str) {
    let new = Path::new(link).with_extension("new");
    symlink(port, &new).expect("link");
    fs::rename(new, link).expect("renamed");
}

/// Looks for poses on the daemon's standard output.
struct Poses {
    wanted: Arc<AtomicBool>,
    came: Receiver<Instant>,
}

impl Poses {
    fn watch(stdout: ChildStdout) -> Self {
        let wanted = Arc::new(AtomicBool::new(false));
        let (tell, came) = channel();
        let asked = Arc::clone(&wanted);
        std::thread::spawn(move || read_poses(stdout, &asked, &tell));
        Self { wanted, came }
    }

    /// When the first pose was printed after the board has sent scans; `None`: never.
    fn next(&self, board: &Mutex<Supplied>) -> Option<Instant> {
        let since = Instant::now();
        while locked(board).course.scanned.is_none() {
            if since.elapsed() > GIVEN_UP {
                return None;
            }
            std::thread::sleep(Duration::from_micros(200));
        }
        self.wanted.store(true, Ordering::Relaxed);
        self.came.recv_timeout(GIVEN_UP).ok()
    }
}

fn read_poses(stdout: ChildStdout, wanted: &AtomicBool, tell: &Sender<Instant>) {
    let mut lines = BufReader::with_capacity(1 << 16, stdout);
    let mut line = Vec::new();
    while lines.read_until(b'\n', &mut line).is_ok_and(|count| count > 0) {
        let is_pose = line.starts_with(b"{\"seq\"");
        if is_pose && wanted.swap(false, Ordering::Relaxed) && tell.send(Instant::now()).is_err() {
            return;
        }
        line.clear();
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Manner {
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

impl Manner {
    /// All manners in turn, with pauses by chance.
    fn of(cycle: usize, rng: &mut ChaCha8Rng) -> Self {
        let mut pause = |most_ms| Duration::from_millis(rng.random_range(50..most_ms));
        match cycle % 6 {
            0 => Self::MidPacket,
            1 => Self::Silence(pause(1500)),
            2 => Self::Garbage(pause(300)),
            3 => Self::Reboot,
            4 => Self::Held(pause(700)),
            _ => Self::ResetInPlace,
        }
    }
}

/// What can be told of a board's time behind a terminal, since it was plugged in or rebooted.
#[derive(Clone, Copy, Debug, Default)]
struct Course {
    /// When it was told to start for the first time.
    started: Option<Instant>,
    /// When its first scans went out after that.
    scanned: Option<Instant>,
}

/// A board and its cable. Time of the board passes whether it is plugged in or not.
struct Supplied {
    board: Board,
    born: Instant,
    seed: u64,
    /// The number of the cable it is plugged in with.
    cable: u64,
    course: Course,
    leaving: Option<(Manner, Instant)>,
}

fn locked(supplied: &Mutex<Supplied>) -> MutexGuard<'_, Supplied> {
    supplied.lock().expect("no panic")
}

impl Supplied {
    /// A board that has just been switched on.
    fn new(seed: u64) -> Arc<Mutex<Self>> {
        let (board, born) = (Self::board(seed), Instant::now());
        Arc::new(Mutex::new(Self { board, born, seed, cable: 0, course: Course::default(), leaving: None }))
    }

    fn board(seed: u64) -> Board {
        Board::numbered(0, &WIDE.read().expect("shipped"), Tier::Paper, seed)
    }

    /// Takes its power and gives it back.
    fn reboot(&mut self) {
        self.seed += 1;
        (self.board, self.born) = (Self::board(self.seed), Instant::now());
        self.course = Course::default();
    }

    /// Notices that it is plugged in anew, with the cable of this number: it stopped when it was unplugged.
    fn plug_in(&mut self, cable: u64) {
        self.cable = cable;
        self.board.command(Command::Stop);
        (self.course, self.leaving) = (Course::default(), None);
        // What it would have said meanwhile nobody has heard.
        let now_s = self.born.elapsed().as_secs_f64();
        while !self.board.has_reached(now_s) {
            self.board.act(&[], now_s, &mut Vec::new());
        }
    }

    fn leave(&mut self, manner: Manner) {
        self.leaving = Some((manner, Instant::now()));
        self.course = Course::default();
    }

    fn act(&mut self, received: &[u8], sent: &mut Vec<u8>) {
        self.board.act(received, self.born.elapsed().as_secs_f64(), sent);
        // Besides scans, from then on, there are but a reply and some status.
        if self.course.started.is_some() && sent.len() > 200 {
            self.course.scanned.get_or_insert_with(Instant::now);
        }
    }
}

/// The far end of a cable with a number, where `supplied` may be plugged in.
fn cable(supplied: Arc<Mutex<Supplied>>, number: u64) -> impl Device {
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
