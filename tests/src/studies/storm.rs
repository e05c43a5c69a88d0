//! Several boards for a long time. In bad weather their link and light fail by schedule, and the daemon is suspended, killed,
//! left without a disk or with one that stands still, and its wall clock is set, in turn: nothing may be lost silently, and
//! the capture of a daemon that was killed holds all but its last second, which ends with a flush. In calm weather nothing
//! is lost. In neither may anything grow.

use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use clap::Args;
use nix::sys::signal::Signal;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde_json::Value;
use slitpose_head::scene_file::WIDE;
use slitpose_model::Tier;

use super::scan_table::{self, Scans};
use super::{Table, Verdicts, check_growth, mib};
use crate::consistency::Sorted;
use crate::daemon::{Daemon, Ended, Subscriber, Usage, WallClock, live_pages, scans};
use crate::process::{Slitpose, name_in, signal};
use crate::terminal::{Board, Terminal};

/// Faults of the boards: each comes again and again, at intervals that have no common multiple in a study.
const FAULTS: [&str; 12] = [
    "flip:rate=1e-7",
    "drop:rate=1e-4",
    "duplicate:rate=1e-4",
    "reorder:rate=1e-4",
    "burst:rate=1e-5,bytes=300",
    "stall:every=7s,from=3s,for=200ms",
    "hangup:every=61s,from=20s,for=300ms",
    "step:every=11s,from=5s,by=5ms",
    "occlude:cell=2,every=5s,from=2s,for=1s",
    "saturate:cell=1,every=13s,from=4s,for=500ms",
    "overrun:scans=8,every=3s,from=1s",
    "reset:every=83s,from=40s",
];

const LOOK_EVERY: Duration = Duration::from_secs(1);

const RECOVERS_WITHIN: Duration = Duration::from_secs(60);

/// No daemon is killed before so many flushes of its capture, which then must hold data on a slow machine, too.
const MIN_FLUSHES: u64 = 3;

/// Most by which the wall clock is off: an hour.
const MAX_AHEAD_NS: i64 = 3_600_000_000_000;

/// What can happen to the daemon.
const BLOWS: [Blow; 5] = [Blow::Suspended, Blow::Killed, Blow::DiskFull, Blow::ClockSet, Blow::DiskStandsStill];

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Blow {
    /// It is stopped for some time, as when a machine sleeps.
    Suspended,
    Killed,
    /// The capture may not grow any more.
    DiskFull,
    /// The disk takes nothing for some time.
    DiskStandsStill,
    /// Its wall clock is set, by up to an hour ahead or back.
    ClockSet,
}

#[derive(Debug, Args)]
pub struct Conditions {
    /// Boards, simulated, each at 4 kHz
    #[arg(long, default_value_t = 4)]
    boards: u8,
    /// Neither faults nor blows, and the boards on pseudo-terminals
    #[arg(long)]
    calm: bool,
    /// Then memory may grow by so many KiB from the second quarter to the last
    #[arg(long, default_value_t = 2048.0)]
    most_growth_kib: f64,
    /// For how long, such as 20m or 24h
    #[arg(long, default_value = "20m", value_parser = humantime::parse_duration)]
    duration: Duration,
    /// And so many blows, however slow the machine is
    #[arg(long, default_value_t = 0)]
    least_blows: usize,
    /// Seed of faults and blows
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Least time between two blows, seconds; at most it is three times that
    #[arg(long, default_value_t = 8.3)]
    pause_s: f64,
    /// Live pages that look at the boards
    #[arg(long, default_value_t = 1)]
    pages: usize,
    /// A mounted file system of its own, for captures; it is frozen now and then, which needs root
    #[arg(long, value_name = "FOLDER")]
    disk: Option<PathBuf>,
    /// Each daemon may take so many MiB of memory
    #[arg(long, default_value_t = 160)]
    most_mib: u32,
}

struct Sample {
    /// The how manieth daemon.
    life: usize,
    usage: Usage,
}

struct Struck {
    blow: Blow,
    /// From its end until all boards sent poses again, seconds; `None` if they did not.
    recovered_s: Option<f64>,
}

struct Captured {
    scans: Vec<Scans>,
    code: i32,
    stderr: String,
    /// Scans that the daemon had reported two flushes before it was killed, if it was.
    owed: Option<u64>,
}

/// Flushes of its capture and scans of all boards, by a status.
type Look = (u64, u64);

fn look(status: &Value) -> Look {
    (status["recorder"]["flushes"].as_u64().unwrap_or(0), scans(status).iter().sum())
}

/// Each daemon's capture is counted and removed when it ends, so that a day needs as much disk as the longest life of one.
pub fn study(slitpose: Slitpose, conditions: &Conditions) -> Verdicts {
    let mut rng = ChaCha8Rng::seed_from_u64(conditions.seed);
    let begun = Instant::now();
    let (mut samples, mut struck, mut unanswered) = (Vec::new(), Vec::<Struck>::new(), 0);
    let mut counting: Vec<JoinHandle<Captured>> = Vec::new();
    let (mut life, mut datagrams) = (0, 0);
    let file = WIDE.read().expect("shipped");
    let terminals: Vec<Terminal> = (0..conditions.boards)
        .filter(|_| conditions.calm)
        .map(|n| Terminal::serve_until_pulled(Board::numbered(n, &file, Tier::Paper, 100 + u64::from(n))))
        .collect();
    let clock = WallClock::make();
    let live = (conditions.pages > 0).then(|| live_pages(conditions.pages, 0).to_string());
    let begin = |life: usize| {
        let daemon = start(slitpose, conditions, life, &clock, live.as_deref(), &terminals);
        let client = Subscriber::start(daemon.folder().join("publish"));
        (daemon, client)
    };
    let (mut daemon, mut client) = begin(life);
    let mut looks = Vec::<Look>::new();
    let blows = BLOWS.len() - usize::from(conditions.disk.is_none());
    let pause = |rng: &mut ChaCha8Rng| Duration::from_secs_f64(conditions.pause_s * rng.random_range(1.0..3.0));
    let mut next = pause(&mut rng);
    while begun.elapsed() < conditions.duration || struck.len() < conditions.least_blows {
        samples.push(Sample { life, usage: daemon.usage().expect("the daemon runs") });
        match daemon.status() {
            Some(status) => looks.push(look(&status)),
            None => unanswered += 1,
        }
        if begun.elapsed() >= next && !conditions.calm {
            let blow = BLOWS[struck.len() % blows];
            let lasts = Duration::from_secs_f64(rng.random_range(0.2..3.0));
            match blow {
                Blow::Suspended => {
                    signal(&daemon.child, Signal::SIGSTOP);
                    std::thread::sleep(lasts);
                    signal(&daemon.child, Signal::SIGCONT);
                }
                Blow::Killed => {
                    let (flushes, _) = look(&daemon.status_when(|status| {
                        status["recorder"]["state"] != "recording" || look(status).0 >= MIN_FLUSHES
                    }));
                    // The first flush after a report may have begun before it, the next has not.
                    let owed = looks.iter().rfind(|(before, _)| before + 2 <= flushes).map_or(0, |(_, scans)| *scans);
                    looks.clear();
                    datagrams += client.end();
                    counting.push(count(slitpose, daemon.end_by(Signal::SIGKILL), Some(owed)));
                    life += 1;
                    (daemon, client) = begin(life);
                }
                Blow::DiskFull => {
                    // No file of it may grow beyond 4 KiB, which its capture has passed.
                    let process = daemon.child.id().to_string();
                    let limit = Command::new("prlimit").args(["--pid", &process, "--fsize=4096"]).status();
                    assert!(limit.is_ok_and(|status| status.success()), "prlimit (util-linux) sets a limit");
                }
                Blow::DiskStandsStill => stand_still(conditions.disk.as_deref().expect("a disk"), lasts),
                Blow::ClockSet => clock.set_ahead(rng.random_range(-MAX_AHEAD_NS..MAX_AHEAD_NS)),
            }
            let since = Instant::now();
            let recovered_s = recovers(&daemon).then(|| since.elapsed().as_secs_f64());
            struck.push(Struck { blow, recovered_s });
            next = begun.elapsed() + pause(&mut rng);
        }
        std::thread::sleep(LOOK_EVERY);
    }
    datagrams += client.end();
    let ended = daemon.end_by(Signal::SIGINT);
    let last = (ended.status.code(), ended.stderr.clone());
    counting.push(count(slitpose, ended, None));
    let captured: Vec<Captured> = counting.into_iter().map(|thread| thread.join().expect("counted")).collect();

    let Conditions { boards, duration, seed, .. } = conditions;
    let faults = if conditions.calm { 0 } else { FAULTS.len() };
    println!("{boards} boards at 4 kHz with {faults} faults, for {duration:?}, seed {seed}");
    let mut table = Table::new(&["blow", "times", "back, median s", "most s"]);
    for blow in BLOWS {
        let of_kind = struck.iter().filter(|struck| struck.blow == blow);
        let back = Sorted::of(of_kind.filter_map(|struck| struck.recovered_s));
        let times = [back.median(), back.most()].map(|time_s| format!("{time_s:.2}"));
        table.row([format!("{blow:?}"), back.0.len().to_string()].into_iter().chain(times));
    }
    let sum = |of: fn(&Scans) -> u64| captured.iter().flat_map(|captured| &captured.scans).map(of).sum::<u64>();
    let (scans, missing) = (sum(|scans| scans.count), sum(|scans| scans.missing));
    println!("{table}  {} captures with {scans} scans, {missing} missing; {datagrams} datagrams", captured.len());

    let mut verdicts = Verdicts::default();
    let lost = struck.iter().filter(|struck| struck.recovered_s.is_none()).count();
    verdicts.check(lost == 0, format!("all boards send poses again after each of {} blows", struck.len()));
    verdicts.check(unanswered == 0, "the daemon always answers");
    verdicts.check(matches!(last.0, Some(0 | 3)), format!("the last daemon ends when told to: {last:?}"));
    captured.iter().for_each(|captured| captured.check(conditions.boards.into(), &mut verdicts));
    check_usage(&samples, conditions, &mut verdicts);
    if conditions.calm {
        let [first, .., end] = &samples[..] else { panic!("too short for two looks") };
        let (cpu_s, wall_s) = (end.usage.cpu_s - first.usage.cpu_s, begun.elapsed().as_secs_f64());
        println!("  {:.1} % of one core a board", 100.0 * cpu_s / wall_s / f64::from(conditions.boards));
        // A machine that is busy with other things leaves scans unsolved, which is no loss of data: they are in the capture.
        let code = if last.1.contains("were not solved") { 3 } else { 0 };
        verdicts.check(last.0 == Some(code), format!("it ends with {code}"));
        verdicts.check(missing == 0 && sum(|scans| scans.poses) == scans, "no scan is missing, and each has a pose");
        let resident_bytes: Vec<u64> = samples.iter().map(|sample| sample.usage.resident_bytes).collect();
        check_growth(&mut verdicts, &resident_bytes, conditions.most_growth_kib);
    }
    verdicts
}

fn start(
    slitpose: Slitpose,
    conditions: &Conditions,
    life: usize,
    clock: &WallClock,
    live: Option<&str>,
    terminals: &[Terminal],
) -> Daemon {
    let folder = match &conditions.disk {
        Some(disk) => tempfile::tempdir_in(disk),
        None => tempfile::tempdir(),
    };
    let folder = folder.expect("temporary folder");
    let [capture, publish] = ["storm.mcap", "publish"].map(|name| name_in(folder.path(), name));
    let on_terminals = terminals.iter().map(|terminal| terminal.path.as_str());
    let simulated = (terminals.len()..conditions.boards.into()).map(|_| "sim");
    let devices = on_terminals.chain(simulated).collect::<Vec<_>>().join(",");
    let mut arguments: Vec<String> =
        ["--device", &devices, "--format", "none", "--patience", "1h", "--record", &capture].map(str::to_owned).into();
    arguments.extend(["--publish".to_owned(), format!("unix:{publish}")]);
    for fault in FAULTS.iter().filter(|_| !conditions.calm) {
        arguments.extend(["--fault".to_owned(), format!("{fault},seed={}", conditions.seed + life as u64)]);
    }
    arguments.extend(live.iter().flat_map(|live| ["--live", *live]).map(str::to_owned));
    let daemon = Daemon::start(Some(clock), slitpose, folder, &arguments, Stdio::null());
    let boards = usize::from(conditions.boards);
    daemon.status_when(|status| scans(status).iter().filter(|scans| **scans > 0).count() == boards);
    daemon
}

/// Waits until each board has sent poses since now.
fn recovers(daemon: &Daemon) -> bool {
    let since = Instant::now();
    let mut before = None;
    while since.elapsed() < RECOVERS_WITHIN {
        if let Some(now) = daemon.status().map(|status| scans(&status)) {
            let before = before.get_or_insert_with(|| now.clone());
            if now.len() == before.len() && now.iter().zip(before).all(|(now, before)| now > before) {
                return true;
            }
        }
        std::thread::sleep(Duration::from_millis(10));
    }
    false
}

fn stand_still(disk: &Path, lasts: Duration) {
    let freeze = |how: &str| Command::new("fsfreeze").arg(how).arg(disk).status().is_ok_and(|status| status.success());
    assert!(freeze("--freeze"), "{} cannot be frozen: mount a file system of its own there, as root", disk.display());
    std::thread::sleep(lasts);
    assert!(freeze("--unfreeze"), "{} stays frozen", disk.display());
}

/// Counts what a daemon has recorded, beside the study, and removes it.
fn count(slitpose: Slitpose, ended: Ended, owed: Option<u64>) -> JoinHandle<Captured> {
    std::thread::spawn(move || {
        let capture = name_in(ended.folder.path(), "storm.mcap");
        let (scans, replayed) = scan_table::count(slitpose, &capture, &["--tier", "paper"]);
        let scans = scans.into_values().collect();
        Captured { scans, code: replayed.code, stderr: replayed.stderr, owed }
    })
}

impl Captured {
    fn check(&self, boards: usize, verdicts: &mut Verdicts) {
        let Self { scans, code, stderr, owed } = self;
        let was_killed = owed.is_some();
        if was_killed && scans.is_empty() && scan_table::is_empty(stderr) {
            return;
        }
        let count: u64 = scans.iter().map(|scans| scans.count).sum();
        let missing: u64 = scans.iter().map(|scans| scans.missing).sum();
        let number_before = |line: &str| line.split_once(" scans missing")?.0.rsplit(' ').next()?.parse::<u64>().ok();
        let told: u64 = stderr.lines().filter_map(number_before).sum();
        let text = format!("of a capture with {count} scans {missing} are missing, and {told} are told");
        verdicts.check(told == missing && scans.len() == boards, text);
        let owed = owed.unwrap_or(0);
        verdicts.check(count >= owed, format!("{count} scans, at least {owed} of them reported two flushes before"));
        let is_lossy = missing > 0 || was_killed;
        verdicts.check(*code == 3 || (*code == 0 && !is_lossy), format!("its exit code is {code}"));
        let is_told = stderr.contains("was not ended by its recorder");
        verdicts.check(is_told || !was_killed, "that of a killed daemon says so");
    }
}

fn check_usage(samples: &[Sample], conditions: &Conditions, verdicts: &mut Verdicts) {
    let most_mib = samples.iter().map(|sample| mib(sample.usage.peak_bytes)).fold(0.0, f64::max);
    let bound = conditions.most_mib;
    verdicts.check(most_mib <= f64::from(bound), format!("a daemon takes {most_mib:.0} MiB at most, {bound} allowed"));
    // Of each daemon the most, so that one that is just starting counts for nothing.
    for (what, of) in
        [("threads", (|usage| usage.threads) as fn(&Usage) -> u64), ("descriptors", |usage| usage.descriptors)]
    {
        let lives: Vec<u64> = samples
            .chunk_by(|before, after| before.life == after.life)
            .filter_map(|life| life.iter().map(|sample| of(&sample.usage)).max())
            .collect();
        let (least, most) = (lives.iter().copied().min().unwrap_or(0), lives.iter().copied().max().unwrap_or(0));
        // A board that is lost has one thread and one descriptor less for a while.
        let is_close = most - least <= 2 * u64::from(conditions.boards);
        verdicts.check(is_close, format!("all daemons have about as many {what}: {least} to {most}"));
    }
}
