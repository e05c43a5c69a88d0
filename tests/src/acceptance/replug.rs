//! A board that goes in all manners and comes back at another port: how soon its poses are there again, and
//! whether the daemon keeps anything of the ports before.

use std::fmt;
use std::fs;
use std::io::{BufRead, BufReader};
use std::os::unix::fs::symlink;
use std::path::Path;
use std::process::{ChildStdout, Stdio};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, Sender, channel};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use nix::sys::signal::Signal;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use slitpose::device::SerialDevice;

use super::daemon::{Daemon, boards, name_in};
use super::unplugging::{Manner, Supplied, cable, locked};
use super::usage::{Usage, resident_in_quarters};
use crate::process::Slitpose;
use crate::terminal::{Terminal, occupy};
use crate::verdicts::Verdicts;

/// Whatever is not there after this will not come.
const GIVEN_UP: Duration = Duration::from_secs(20);

/// A board that resets behind a port that stays is missed when its next status says so, or nothing comes.
const NOTICED_WITHIN: Duration = Duration::from_millis(500);

/// After so many cycles everything has been opened that ever will.
const WARM_UP: usize = 20;

/// How boards are unplugged.
#[derive(Clone, Copy, Debug)]
pub struct Conditions {
    /// Times.
    pub cycles: usize,
    /// Of manners and pauses.
    pub seed: u64,
    /// Poses must be there again within this.
    pub within: Duration,
    /// What memory may grow by, from the mean of the second quarter of the cycles to that of the last.
    pub most_growth_bytes: f64,
}

/// One return of the board.
#[derive(Clone, Copy, Debug)]
pub struct Return {
    /// How it had gone.
    pub manner: Manner,
    /// From the port being there, and free, until the board was told to start; `None`: never.
    pub start_s: Option<f64>,
    /// Until a pose was on standard output.
    pub pose_s: Option<f64>,
}

/// What came of it.
#[derive(Debug)]
pub struct Report {
    conditions: Conditions,
    /// In order.
    pub returns: Vec<Return>,
    /// What the daemon took before each cycle and at the end, with the board running.
    pub usages: Vec<Usage>,
    reconnects: u64,
    link: String,
    exit: (Option<i32>, Vec<String>),
}

/// Runs it.
///
/// # Panics
/// If the daemon ends before it is told to.
pub fn study(slitpose: Slitpose, conditions: &Conditions) -> Report {
    let mut rng = ChaCha8Rng::seed_from_u64(conditions.seed);
    let folder = tempfile::tempdir().expect("temporary folder");
    let link = name_in(folder.path(), "board");
    // Other tests look for their boards, too; two of this one do not share numbers.
    let _others = occupy(32 + std::process::id() as usize % 64);
    let board = Supplied::new(conditions.seed);
    let mut port = Port::new(&board, 0);
    locked(&board).plug_in(0);
    point(&link, &port.terminal.path);
    let arguments = ["--device", &link, "--format", "ndjson"];
    let mut daemon = Daemon::start(slitpose, folder, arguments, Stdio::piped());
    let poses = Poses::watch(daemon.take_stdout());
    poses.next(&board).expect("the first pose");

    let mut report = Report {
        conditions: *conditions,
        returns: Vec::new(),
        usages: Vec::new(),
        reconnects: 0,
        link: String::new(),
        exit: (None, Vec::new()),
    };
    for cycle in 0..conditions.cycles {
        std::thread::sleep(Duration::from_millis(rng.random_range(20..100)));
        report.usages.extend(daemon.usage());
        let manner = manner(cycle, &mut rng);
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
        let started = locked(&board).course().started;
        let after = |at: Option<Instant>| at.map(|at| at.saturating_duration_since(came).as_secs_f64());
        report.returns.push(Return { manner, start_s: after(started), pose_s: after(pose) });
        if pose.is_none() {
            break;
        }
    }
    std::thread::sleep(Duration::from_millis(100));
    report.usages.extend(daemon.usage());
    let status = daemon.status().expect("the daemon tells how it goes");
    report.link = boards(&status).map(|board| board["link"].to_string()).collect();
    report.reconnects = boards(&status).filter_map(|board| board["link"]["reconnects"].as_u64()).sum();
    let ended = daemon.end_by(Signal::SIGINT);
    report.exit = (ended.status.code(), ended.stderr.lines().map(str::to_owned).collect());
    locked(&board).leave(Manner::MidPacket);
    drop(port.terminal.closed());
    report
}

/// Where the board is plugged in.
struct Port {
    number: u64,
    terminal: Terminal,
}

impl Port {
    fn new(board: &Arc<Mutex<Supplied>>, number: u64) -> Self {
        Self { number, terminal: Terminal::serve_until_pulled(cable(Arc::clone(board), number)) }
    }
}

/// All manners in turn, with pauses by chance.
fn manner(cycle: usize, rng: &mut ChaCha8Rng) -> Manner {
    let mut pause = |most_ms| Duration::from_millis(rng.random_range(50..most_ms));
    match cycle % 6 {
        0 => Manner::MidPacket,
        1 => Manner::Silence(pause(1500)),
        2 => Manner::Garbage(pause(300)),
        3 => Manner::Reboot,
        4 => Manner::Held(pause(700)),
        _ => Manner::ResetInPlace,
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
        while locked(board).course().scanned.is_none() {
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

impl Report {
    /// Says which bounds were kept.
    pub fn check(&self, verdicts: &mut Verdicts) {
        let Conditions { cycles, within, most_growth_bytes, .. } = self.conditions;
        let bound =
            |it: &Return| within + if it.manner == Manner::ResetInPlace { NOTICED_WITHIN } else { Duration::ZERO };
        let is_late = |it: &Return| it.pose_s.is_none_or(|pose_s| pose_s > bound(it).as_secs_f64());
        let late: Vec<&Return> = self.returns.iter().filter(|it| is_late(it)).collect();
        let back = self.returns.iter().filter(|it| it.pose_s.is_some()).count();
        let last_words = &self.exit.1[self.exit.1.len().saturating_sub(if back == cycles { 0 } else { 6 })..];
        verdicts.check(
            back == cycles,
            &format!("{back} of {cycles} times the poses come again {last_words:?} {}", self.link),
        );
        let worst = &late[..late.len().min(5)];
        verdicts.check(
            late.is_empty(),
            &format!("within {within:?}, {NOTICED_WITHIN:?} more if reset in place; later: {} {worst:?}", late.len()),
        );
        verdicts.check(
            self.reconnects == cycles as u64,
            &format!("{} reconnections reported in {cycles} cycles", self.reconnects),
        );
        if let (Some(before), Some(after)) = (self.usages.get(WARM_UP.min(cycles / 2)), self.usages.last()) {
            let (threads, descriptors) = (after.threads, after.descriptors);
            verdicts.check(threads == before.threads, &format!("{threads} threads, {} before", before.threads));
            verdicts.check(
                descriptors == before.descriptors,
                &format!("{descriptors} descriptors, {} before", before.descriptors),
            );
        }
        let [before, after] = resident_in_quarters(&self.usages);
        verdicts.check(
            after - before <= most_growth_bytes,
            &format!("memory grows by {:.0} KiB, {:.0} allowed", (after - before) / 1024.0, most_growth_bytes / 1024.0),
        );
        // Garbage, and packets that were cut off, are damage.
        verdicts.check(self.exit.0 == Some(3), &format!("it ends with 3: {:?}", self.exit.0));
    }
}

impl fmt::Display for Report {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Conditions { cycles, seed, .. } = self.conditions;
        writeln!(
            f,
            "{cycles} times unplugged and plugged in again (seed {seed}), {} lines of talk",
            self.exit.1.len()
        )?;
        writeln!(f, "  {:<16}{:>6}{:>36}{:>36}", "gone by", "times", "port to start, ms", "port to pose, ms")?;
        writeln!(f, "  {:<22}{:>36}{:>36}", "", "median / 99 % / most", "median / 99 % / most")?;
        let names = ["MidPacket", "Silence", "Garbage", "Reboot", "Held", "ResetInPlace"];
        for name in names.iter().chain(&["all"]) {
            let some =
                || self.returns.iter().filter(|it| *name == "all" || format!("{:?}", it.manner).starts_with(name));
            let start = distribution(some().filter_map(|it| it.start_s));
            let pose = distribution(some().filter_map(|it| it.pose_s));
            writeln!(f, "  {name:<16}{:>6}{start:>36}{pose:>36}", some().count())?;
        }
        let [before, after] = resident_in_quarters(&self.usages).map(|bytes| bytes / f64::from(1 << 20));
        let mib =
            |usage: Option<&Usage>| usage.map_or(f64::NAN, |usage| usage.resident_bytes as f64 / f64::from(1 << 20));
        writeln!(
            f,
            "  memory: {:.2} MiB after {WARM_UP} cycles, {before:.2} MiB in the second quarter, {after:.2} MiB in the last, {:.2} MiB at the end",
            mib(self.usages.get(WARM_UP)),
            mib(self.usages.last())
        )
    }
}

fn distribution(seconds: impl Iterator<Item = f64>) -> String {
    let mut values: Vec<f64> = seconds.map(|value| value * 1e3).collect();
    values.sort_by(f64::total_cmp);
    let Some(most) = values.last() else { return "-".to_owned() };
    let at = |share: usize| values[(values.len() * share / 100).min(values.len() - 1)];
    format!("{:.0} / {:.0} / {most:.0}", at(50), at(99))
}
