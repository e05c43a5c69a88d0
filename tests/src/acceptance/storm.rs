//! A soak in bad weather: boards whose link and light fail by schedule, and a daemon that is suspended, killed, left
//! without a disk or with one that stands still, and whose wall clock is set, at random. Nothing may be lost silently, and
//! nothing may grow.

use std::fmt;
use std::ops::Range;
use std::path::PathBuf;
use std::process::{Command, Stdio};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use nix::sys::signal::{Signal, kill};
use nix::unistd::Pid;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde_json::Value;

use super::curves::{Panel, svg};
use super::daemon::{Daemon, Ended, boards, name_in, scans};
use super::scan_table::{self, Scans};
use super::subscriber::Subscriber;
use super::usage::Usage;
use super::wall_clock::WallClock;
use crate::process::Slitpose;
use crate::verdicts::Verdicts;

/// Faults of the boards: each comes again and again, at intervals that have no common multiple in a soak.
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

/// Looks at the daemon.
const LOOK_EVERY: Duration = Duration::from_secs(1);

/// A daemon that has not recovered by then does not.
const RECOVERS_WITHIN: Duration = Duration::from_secs(60);

/// What can happen to the daemon.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Blow {
    /// It is stopped for some time, as when a machine sleeps.
    Suspended,
    /// It is killed, and started again.
    Killed,
    /// The capture may not grow any more.
    DiskFull,
    /// The disk takes nothing for some time.
    DiskStandsStill,
    /// Its wall clock is set, by up to an hour ahead or back.
    ClockSet,
}

impl Blow {
    const ALL: [Self; 5] = [Self::Suspended, Self::Killed, Self::DiskFull, Self::DiskStandsStill, Self::ClockSet];
}

/// Most by which the wall clock is off: an hour.
const MOST_AHEAD_NS: i64 = 3_600_000_000_000;

/// How the soak is made.
#[derive(Clone, Debug)]
pub struct Conditions {
    /// Boards, simulated, at 4 kHz each.
    pub boards: usize,
    /// For so long …
    pub duration: Duration,
    /// … and so many blows, however slow the machine is.
    pub least_blows: usize,
    /// Of the blows and the faults.
    pub seed: u64,
    /// Time between two blows, seconds.
    pub pause_s: Range<f64>,
    /// Address at which live pages look for a daemon.
    pub live: Option<String>,
    /// A file system of its own, which may be frozen (needs root).
    pub disk: Option<PathBuf>,
    /// What memory each daemon may take at most.
    pub most_bytes: u64,
}

/// A look at the daemon.
#[derive(Clone, Copy, Debug)]
pub struct Sample {
    /// From the beginning, seconds.
    pub elapsed_s: f64,
    /// The how manieth daemon.
    pub life: usize,
    /// What it took.
    pub usage: Usage,
    /// From light to pose over the last second, the worst of all boards: median, 99 %, most; seconds.
    pub latency_s: [f64; 3],
    /// Scans that wait to be solved, of all boards.
    pub waiting: u64,
}

/// A blow, and what came of it.
#[derive(Clone, Copy, Debug)]
pub struct Struck {
    /// From the beginning, seconds.
    pub at_s: f64,
    /// What.
    pub blow: Blow,
    /// From its end until all boards sent poses again, seconds; `None` if they did not.
    pub recovered_s: Option<f64>,
}

/// A capture of one daemon.
#[derive(Debug)]
struct Captured {
    scans: Vec<Scans>,
    code: i32,
    stderr: String,
    was_killed: bool,
}

/// What came of it.
#[derive(Debug)]
pub struct Report {
    conditions: Conditions,
    /// Looks at the daemons, one a second.
    pub samples: Vec<Sample>,
    /// All blows.
    pub struck: Vec<Struck>,
    captured: Vec<Captured>,
    datagrams: u64,
    unreadable: usize,
    last: (Option<i32>, String),
}

/// Runs it.
///
/// # Panics
/// If a daemon cannot be started, or ends by itself.
pub fn study(slitpose: Slitpose, conditions: &Conditions) -> Report {
    let mut rng = ChaCha8Rng::seed_from_u64(conditions.seed);
    let begun = Instant::now();
    let mut report = Report {
        conditions: conditions.clone(),
        samples: Vec::new(),
        struck: Vec::new(),
        captured: Vec::new(),
        datagrams: 0,
        unreadable: 0,
        last: (None, String::new()),
    };
    let mut counting: Vec<JoinHandle<Captured>> = Vec::new();
    let mut life = 0;
    let clock = WallClock::make();
    let mut daemon = start(slitpose, conditions, life, &clock);
    let mut client = Subscriber::start(daemon.folder().join("publish"));
    let mut blows = Blow::ALL.to_vec();
    blows.retain(|blow| conditions.disk.is_some() || *blow != Blow::DiskStandsStill);
    let pause = |rng: &mut ChaCha8Rng| Duration::from_secs_f64(rng.random_range(conditions.pause_s.clone()));
    let mut next = pause(&mut rng);
    while begun.elapsed() < conditions.duration || report.struck.len() < conditions.least_blows {
        report.sample(&daemon, begun, life);
        if begun.elapsed() >= next {
            let blow = blows[rng.random_range(0..blows.len())];
            let lasts = Duration::from_secs_f64(rng.random_range(0.2..3.0));
            let at_s = begun.elapsed().as_secs_f64();
            match blow {
                Blow::Suspended => {
                    daemon.signal(Signal::SIGSTOP);
                    std::thread::sleep(lasts);
                    daemon.signal(Signal::SIGCONT);
                }
                Blow::Killed => {
                    report.datagrams += client.end();
                    counting.push(count(slitpose, daemon.end_by(Signal::SIGKILL), true));
                    life += 1;
                    daemon = start(slitpose, conditions, life, &clock);
                    client = Subscriber::start(daemon.folder().join("publish"));
                }
                Blow::DiskFull => daemon.limit_files(),
                Blow::DiskStandsStill => stand_still(conditions, lasts),
                Blow::ClockSet => clock.set_ahead(rng.random_range(-MOST_AHEAD_NS..MOST_AHEAD_NS)),
            }
            let since = Instant::now();
            let recovered_s = recovers(&daemon).then(|| since.elapsed().as_secs_f64());
            report.struck.push(Struck { at_s, blow, recovered_s });
            next = begun.elapsed() + pause(&mut rng);
        }
        std::thread::sleep(LOOK_EVERY);
    }
    report.datagrams += client.end();
    let ended = daemon.end_by(Signal::SIGINT);
    report.last = (ended.status.code(), ended.stderr.clone());
    counting.push(count(slitpose, ended, false));
    report.captured = counting.into_iter().map(|thread| thread.join().expect("counted")).collect();
    report
}

fn start(slitpose: Slitpose, conditions: &Conditions, life: usize, clock: &WallClock) -> Daemon {
    let folder = match &conditions.disk {
        Some(disk) => tempfile::tempdir_in(disk),
        None => tempfile::tempdir(),
    };
    let folder = folder.expect("temporary folder");
    let [capture, publish] = ["storm.mcap", "publish"].map(|name| name_in(folder.path(), name));
    let devices = vec!["sim"; conditions.boards].join(",");
    let mut arguments: Vec<String> =
        ["--device", &devices, "--format", "none", "--patience", "1h", "--record", &capture].map(str::to_owned).into();
    arguments.extend(["--publish".to_owned(), format!("unix:{publish}")]);
    for fault in FAULTS {
        arguments.extend(["--fault".to_owned(), format!("{fault},seed={}", conditions.seed + life as u64)]);
    }
    arguments.extend(conditions.live.iter().flat_map(|live| ["--live".to_owned(), live.clone()]));
    let daemon = Daemon::start_by(Some(clock), slitpose, folder, &arguments, Stdio::null());
    daemon
        .status_when(|status| scans(status).len() == conditions.boards && scans(status).iter().all(|scans| *scans > 0));
    daemon
}

/// Waits until each board has sent poses since now.
fn recovers(daemon: &Daemon) -> bool {
    let since = Instant::now();
    let before = loop {
        match daemon.status() {
            Some(status) => break scans(&status),
            None if since.elapsed() > RECOVERS_WITHIN => return false,
            None => {}
        }
    };
    while since.elapsed() < RECOVERS_WITHIN {
        let now = daemon.status().map(|status| scans(&status)).unwrap_or_default();
        if now.len() == before.len() && now.iter().zip(&before).all(|(now, before)| now > before) {
            return true;
        }
        std::thread::sleep(Duration::from_millis(10));
    }
    false
}

fn stand_still(conditions: &Conditions, lasts: Duration) {
    let Some(disk) = &conditions.disk else { return };
    let freeze = |how: &str| Command::new("fsfreeze").arg(how).arg(disk).status().is_ok_and(|status| status.success());
    assert!(freeze("--freeze"), "{} cannot be frozen: mount a file system of its own there, as root", disk.display());
    std::thread::sleep(lasts);
    assert!(freeze("--unfreeze"), "{} stays frozen", disk.display());
}

/// Counts what a daemon has recorded, beside the soak, and removes it.
fn count(slitpose: Slitpose, ended: Ended, was_killed: bool) -> JoinHandle<Captured> {
    std::thread::spawn(move || {
        let capture = name_in(ended.folder.path(), "storm.mcap");
        let (scans, replayed) = scan_table::count(slitpose, &capture, &["--tier", "paper"]);
        Captured { scans: scans.into_values().collect(), code: replayed.code, stderr: replayed.stderr, was_killed }
    })
}

impl Daemon {
    fn signal(&self, signal: Signal) {
        kill(Pid::from_raw(self.id() as i32), signal).expect("running");
    }

    /// No file of it may grow beyond 4 KiB, which its capture has passed: the disk is full.
    fn limit_files(&self) {
        let limit = Command::new("prlimit").args(["--pid", &self.id().to_string(), "--fsize=4096"]).status();
        assert!(limit.is_ok_and(|status| status.success()), "prlimit (util-linux) sets a limit");
    }
}

impl Report {
    fn sample(&mut self, daemon: &Daemon, begun: Instant, life: usize) {
        let usage = daemon.usage().expect("the daemon runs");
        let Some(status) = daemon.status() else {
            self.unreadable += 1;
            return;
        };
        let most = |of: &dyn Fn(&Value) -> Option<f64>| boards(&status).filter_map(of).fold(f64::NAN, f64::max);
        let recent = |quantile: &'static str| {
            let last =
                |board: &Value| Some(board["latencies"]["total"]["recent"].clone()).filter(|it| it["count"] != 0);
            most(&move |board: &Value| last(board)?[quantile].as_f64())
        };
        let waiting = boards(&status).filter_map(|board| board["lag"]["waiting_scans"].as_u64()).sum();
        let latency_s = ["p50_s", "p99_s", "max_s"].map(recent);
        self.samples.push(Sample { elapsed_s: begun.elapsed().as_secs_f64(), life, usage, latency_s, waiting });
    }

    /// Says which bounds were kept.
    ///
    /// # Panics
    /// If there are no samples.
    pub fn check(&self, verdicts: &mut Verdicts) {
        let lost = self.struck.iter().filter(|struck| struck.recovered_s.is_none()).count();
        verdicts.check(lost == 0, &format!("all boards send poses again after each of {} blows", self.struck.len()));
        verdicts.check(self.unreadable == 0, "the daemon always answers");
        verdicts
            .check(matches!(self.last.0, Some(0 | 3)), &format!("the last daemon ends when told to: {:?}", self.last));
        for Captured { scans, code, stderr, was_killed } in &self.captured {
            // Nothing was flushed yet but who the boards are: such a file says so.
            let is_early =
                *was_killed && scans.is_empty() && (stderr.contains("holds no scan") || stderr.contains("empty"));
            if is_early {
                continue;
            }
            let count: u64 = scans.iter().map(|scans| scans.count).sum();
            let missing: u64 = scans.iter().map(|scans| scans.missing).sum();
            let told: u64 = stderr.lines().filter_map(told_missing).sum();
            let text = format!("of a capture with {count} scans {missing} are missing, and {told} are told");
            verdicts.check(told == missing && scans.len() == self.conditions.boards, &text);
            let is_told = stderr.contains("was not ended by its recorder");
            let is_lossy = missing > 0 || *was_killed;
            let text = format!("its exit code is {code}");
            verdicts.check(*code == 3 || (*code == 0 && !is_lossy), &text);
            verdicts.check(is_told || !was_killed, "that of a killed daemon says so");
        }
        let most_bytes = self.samples.iter().map(|sample| sample.usage.peak_bytes).max().unwrap_or(0);
        let bound = self.conditions.most_bytes;
        let text = format!("a daemon takes {} MiB at most, {} allowed", most_bytes >> 20, bound >> 20);
        verdicts.check(most_bytes <= bound, &text);
        // Of each daemon the most, so that one that is just starting counts for nothing.
        let most = |of: fn(&Usage) -> u64| {
            let lives = (0..=self.samples.last().map_or(0, |sample| sample.life)).map(|life| {
                let of_life = self.samples.iter().filter(|sample| sample.life == life);
                of_life.map(|sample| of(&sample.usage)).max().unwrap_or(0)
            });
            let lives: Vec<u64> = lives.filter(|most| *most > 0).collect();
            (lives.iter().copied().min().unwrap_or(0), lives.iter().copied().max().unwrap_or(0))
        };
        let [threads, descriptors] = [most(|usage| usage.threads), most(|usage| usage.descriptors)];
        // A board that is lost has one thread and one descriptor less for a while.
        let is_close = |(least, most): (u64, u64)| most - least <= 2 * self.conditions.boards as u64;
        verdicts.check(is_close(threads), &format!("all daemons have about as many threads: {threads:?}"));
        verdicts.check(is_close(descriptors), &format!("and descriptors: {descriptors:?}"));
    }

    /// Memory, threads and descriptors, latency of the worst board, and what waits, over time, with a letter for each blow:
    /// suspended, killed, disk full (F), disk that stands still, clock set.
    pub fn picture(&self) -> String {
        let curve = |name: &str, of: fn(&Sample) -> f64| {
            (name.to_owned(), self.samples.iter().map(|sample| [sample.elapsed_s, of(sample)]).collect())
        };
        let panel = |label: &str, is_logarithmic, curves| Panel { label: label.to_owned(), is_logarithmic, curves };
        let panels = [
            panel(
                "memory (MiB)",
                false,
                vec![curve("resident", |it| it.usage.resident_bytes as f64 / f64::from(1 << 20))],
            ),
            panel(
                "number",
                false,
                vec![
                    curve("threads", |it| it.usage.threads as f64),
                    curve("descriptors", |it| it.usage.descriptors as f64),
                ],
            ),
            panel(
                "light to pose (ms)",
                true,
                vec![
                    curve("median", |it| it.latency_s[0] * 1e3),
                    curve("99 %", |it| it.latency_s[1] * 1e3),
                    curve("most", |it| it.latency_s[2] * 1e3),
                ],
            ),
            panel("waiting scans", false, vec![curve("all boards", |it| it.waiting as f64)]),
        ];
        let marks: Vec<(f64, String)> = self
            .struck
            .iter()
            .map(|struck| {
                let word = match struck.blow {
                    Blow::Suspended => "S",
                    Blow::Killed => "K",
                    Blow::DiskFull => "F",
                    Blow::DiskStandsStill => "D",
                    Blow::ClockSet => "C",
                };
                (struck.at_s, word.to_owned())
            })
            .collect();
        svg("A daemon in a storm", &panels, &marks)
    }

    /// The samples as CSV.
    pub fn csv(&self) -> String {
        let mut text =
            "elapsed_s,life,resident_mib,threads,descriptors,p50_ms,p99_ms,max_ms,waiting_scans\n".to_owned();
        for Sample { elapsed_s, life, usage, latency_s: [p50, p99, max], waiting } in &self.samples {
            let mib = usage.resident_bytes as f64 / f64::from(1 << 20);
            text += &format!(
                "{elapsed_s:.1},{life},{mib:.2},{},{},{:.3},{:.3},{:.3},{waiting}\n",
                usage.threads,
                usage.descriptors,
                p50 * 1e3,
                p99 * 1e3,
                max * 1e3
            );
        }
        text
    }
}

/// The number of missing scans in a line that tells losses.
fn told_missing(line: &str) -> Option<u64> {
    let (before, _) = line.split_once(" scans missing")?;
    before.rsplit(' ').next()?.parse().ok()
}

impl fmt::Display for Report {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Conditions { boards, duration, seed, .. } = &self.conditions;
        writeln!(f, "{boards} boards at 4 kHz with {} faults, for {duration:?}, seed {seed}", FAULTS.len())?;
        writeln!(f, "  {:<18}{:>8}{:>16}{:>12}", "blow", "times", "back, median s", "most s")?;
        for blow in Blow::ALL {
            let mut back: Vec<f64> =
                self.struck.iter().filter(|struck| struck.blow == blow).filter_map(|it| it.recovered_s).collect();
            back.sort_by(f64::total_cmp);
            let (median, most) = back.last().map_or((f64::NAN, f64::NAN), |last| (back[back.len() / 2], *last));
            writeln!(f, "  {:<18}{:>8}{median:>16.2}{most:>12.2}", format!("{blow:?}"), back.len())?;
        }
        let scans: u64 = self.captured.iter().flat_map(|captured| &captured.scans).map(|scans| scans.count).sum();
        let missing: u64 = self.captured.iter().flat_map(|captured| &captured.scans).map(|scans| scans.missing).sum();
        writeln!(
            f,
            "  {} captures with {scans} scans, {missing} missing and told; {} datagrams",
            self.captured.len(),
            self.datagrams
        )
    }
}
