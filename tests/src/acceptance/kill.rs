//! What a capture holds of a daemon that was killed: everything but its last second, which ends with a flush.

use std::fmt;
use std::path::Path;
use std::process::Stdio;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

use nix::sys::signal::Signal;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::daemon::{Daemon, name_in, scans};
use super::scan_table::{self, Scans};
use crate::process::Slitpose;
use crate::verdicts::Verdicts;

/// Looks at how far the daemon is.
const LOOK_EVERY: Duration = Duration::from_millis(25);

/// Each other daemon lives until it has flushed so often, however slow the machine is: then it owes something.
const LEAST_FLUSHES: u64 = 3;

/// It does within this, or never.
const STARTS_WITHIN: Duration = Duration::from_secs(60);

/// How daemons are killed.
#[derive(Clone, Copy, Debug)]
pub struct Conditions {
    /// Times.
    pub times: usize,
    /// Of the moments.
    pub seed: u64,
    /// Boards of each daemon, simulated.
    pub boards: usize,
    /// Daemons at a time.
    pub at_once: usize,
}

/// One death.
#[derive(Clone, Debug)]
pub struct Death {
    /// After its start.
    pub after_s: f64,
    /// Scans it had reported two flushes before, those of all boards.
    pub owed: u64,
    /// Scans it had reported at last.
    pub reported: u64,
    /// Scans in the capture.
    pub read: u64,
    /// What is wrong.
    pub faults: Vec<String>,
}

/// What came of it.
#[derive(Debug)]
pub struct Report {
    conditions: Conditions,
    /// In the order of their seeds.
    pub deaths: Vec<Death>,
}

/// Runs it.
///
/// # Panics
/// If a daemon cannot be started, or ends before it is killed.
pub fn study(slitpose: Slitpose, conditions: &Conditions) -> Report {
    let (next, deaths) = (AtomicUsize::new(0), Mutex::new(Vec::new()));
    std::thread::scope(|scope| {
        for _ in 0..conditions.at_once {
            scope.spawn(|| {
                loop {
                    let number = next.fetch_add(1, Ordering::Relaxed);
                    if number >= conditions.times {
                        return;
                    }
                    let death = trial(slitpose, conditions, number as u64);
                    deaths.lock().unwrap_or_else(PoisonError::into_inner).push((number, death));
                }
            });
        }
    });
    let mut deaths = deaths.into_inner().unwrap_or_else(PoisonError::into_inner);
    deaths.sort_by_key(|(number, _)| *number);
    Report { conditions: *conditions, deaths: deaths.into_iter().map(|(_, death)| death).collect() }
}

fn trial(slitpose: Slitpose, conditions: &Conditions, number: u64) -> Death {
    let mut rng = ChaCha8Rng::seed_from_u64(conditions.seed.wrapping_add(number));
    let lives = Duration::from_secs_f64(rng.random_range(0.1..4.0));
    let folder = tempfile::tempdir().expect("temporary folder");
    let capture = name_in(folder.path(), "killed.mcap");
    let devices = vec!["sim"; conditions.boards].join(",");
    let arguments = ["--device", &devices, "--tier", "paper", "--format", "none", "--record", &capture];
    let begun = Instant::now();
    let daemon = Daemon::start(slitpose, folder, arguments, Stdio::null());
    let mut looks = Vec::new();
    let has_to_owe = number % 2 == 1;
    let owes = |looks: &[(u64, u64)]| looks.last().is_some_and(|(flushes, _)| *flushes >= LEAST_FLUSHES);
    while begun.elapsed() + LOOK_EVERY < lives || (has_to_owe && !owes(&looks) && begun.elapsed() < STARTS_WITHIN) {
        if let Some(status) = daemon.status() {
            looks.push((status["recorder"]["flushes"].as_u64().unwrap_or(0), scans(&status).iter().sum::<u64>()));
        }
        std::thread::sleep(LOOK_EVERY);
    }
    std::thread::sleep(lives.saturating_sub(begun.elapsed()));
    let died = begun.elapsed();
    let ended = daemon.end_by(Signal::SIGKILL);

    let reported = looks.last().map_or(0, |(_, scans)| *scans);
    // The first flush after a report may have begun before it, the next has not.
    let flushes = looks.last().map_or(0, |(flushes, _)| *flushes);
    let owed = looks.iter().rfind(|(before, _)| before + 2 <= flushes).map_or(0, |(_, scans)| *scans);
    let mut death = Death { after_s: died.as_secs_f64(), owed, reported, read: 0, faults: Vec::new() };
    if !Path::new(&capture).exists() {
        death.expect(owed == 0, || "there is no capture".to_owned());
        return death;
    }
    let (boards, replayed) = scan_table::count(slitpose, &capture, &[]);
    death.judge(&boards.into_values().collect::<Vec<_>>(), replayed.code, &replayed.stderr);
    drop(ended);
    death
}

impl Death {
    fn expect(&mut self, good: bool, fault: impl FnOnce() -> String) {
        if !good {
            self.faults.push(fault());
        }
    }

    fn judge(&mut self, boards: &[Scans], code: i32, stderr: &str) {
        self.read = boards.iter().map(|scans| scans.count).sum();
        let (owed, read) = (self.owed, self.read);
        self.expect(read >= owed, || format!("{read} scans of at least {owed} are in the capture"));
        // Nothing was flushed yet but who the boards are: such a file says so.
        let is_early = read == 0 && code == 1 && (stderr.contains("holds no scan") || stderr.contains("empty"));
        self.expect(is_early || code == 3, || format!("replay ends with {code}: {stderr}"));
        self.expect(is_early || stderr.contains("was not ended by its recorder"), || stderr.to_owned());
        for scans in boards {
            self.expect(scans.first == 0 && scans.jumps == 0, || format!("scans are missing: {scans:?}"));
            self.expect(scans.poses == scans.count, || format!("poses are missing: {scans:?}"));
        }
    }
}

impl Report {
    /// Says which bounds were kept.
    pub fn check(&self, verdicts: &mut Verdicts) {
        let faulty: Vec<&Death> = self.deaths.iter().filter(|death| !death.faults.is_empty()).collect();
        let first = &faulty[..faulty.len().min(5)];
        verdicts.check(self.deaths.len() == self.conditions.times, "all were tried");
        verdicts
            .check(faulty.is_empty(), &format!("each capture is as it should be; not so: {} {first:#?}", faulty.len()));
    }

    /// What each daemon had reported and its capture does not hold, in seconds of device time, ascending.
    pub fn lost_s(&self) -> Vec<f64> {
        let rate_hz = 4000.0 * self.conditions.boards as f64;
        let lost_s = self.deaths.iter().map(|death| (death.reported as f64 - death.read as f64) / rate_hz);
        let mut lost_s: Vec<f64> = lost_s.collect();
        lost_s.sort_by(f64::total_cmp);
        lost_s
    }

    /// Deaths after which something had to be in the capture.
    pub fn owing(&self) -> usize {
        self.deaths.iter().filter(|death| death.owed > 0).count()
    }
}

impl fmt::Display for Report {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Conditions { times, seed, boards, .. } = self.conditions;
        let lost_s = self.lost_s();
        let read: u64 = self.deaths.iter().map(|death| death.read).sum();
        let empty = self.deaths.iter().filter(|death| death.read == 0).count();
        writeln!(f, "{times} daemons with {boards} boards killed after 0.1 s to 4 s (seed {seed})")?;
        writeln!(
            f,
            "  {read} scans read; {} captures had to hold what was reported two flushes before, {empty} hold no scan",
            self.owing()
        )?;
        if let (Some(most), Some(median)) = (lost_s.last(), lost_s.get(lost_s.len() / 2)) {
            writeln!(f, "  reported and not in the capture: {median:.2} s in the median, {most:.2} s at most")?;
        }
        Ok(())
    }
}
