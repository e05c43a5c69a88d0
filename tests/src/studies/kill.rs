//! What a capture holds of a daemon that was killed: everything but its last second, which ends with a flush.

use std::path::Path;
use std::process::Stdio;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

use clap::Args;
use nix::sys::signal::Signal;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::{Verdicts, scan_table};
use crate::consistency::Sorted;
use crate::daemon::{Daemon, scans};
use crate::process::{Slitpose, name_in};

/// Looks at how far the daemon is.
const LOOK_EVERY: Duration = Duration::from_millis(25);

/// Every second daemon is killed only after this many flushes, so that its capture must hold data on a slow machine, too.
const MIN_FLUSHES: u64 = 3;

/// It does within this, or never.
const STARTS_WITHIN: Duration = Duration::from_secs(60);

#[derive(Debug, Args)]
pub struct Conditions {
    /// Number of daemons that are killed
    #[arg(long, default_value_t = 200)]
    times: usize,
    /// Seed of the times at which the daemons are killed
    #[arg(long, default_value_t = 20_180_718)]
    seed: u64,
    /// Simulated boards of each daemon
    #[arg(long, default_value_t = 3)]
    boards: usize,
    /// Daemons at a time
    #[arg(long, default_value_t = 4)]
    at_once: usize,
    /// Most that was reported and may be missing in the capture, in device time
    #[arg(long, default_value = "1100ms", value_parser = humantime::parse_duration)]
    slack: Duration,
}

/// One death. Scans are those of all boards.
#[derive(Clone, Debug, Default)]
struct Death {
    /// Reported two flushes before.
    owed: u64,
    /// Reported at last.
    reported: u64,
    /// In the capture.
    read: u64,
    faults: Vec<String>,
}

pub fn study(slitpose: Slitpose, conditions: &Conditions) -> Verdicts {
    let Conditions { times, seed, boards, at_once, slack } = *conditions;
    let (next, deaths) = (AtomicUsize::new(0), Mutex::new(Vec::new()));
    std::thread::scope(|scope| {
        for _ in 0..at_once {
            scope.spawn(|| {
                loop {
                    let number = next.fetch_add(1, Ordering::Relaxed);
                    if number >= times {
                        return;
                    }
                    let death = trial(slitpose, conditions, number as u64);
                    deaths.lock().unwrap_or_else(PoisonError::into_inner).push(death);
                }
            });
        }
    });
    let deaths: Vec<Death> = deaths.into_inner().unwrap_or_else(PoisonError::into_inner);
    let rate_hz = 4000.0 * boards as f64;
    let lost_s = Sorted::of(deaths.iter().map(|death| (death.reported as f64 - death.read as f64) / rate_hz));
    let owing = deaths.iter().filter(|death| death.owed > 0).count();
    println!("{times} daemons with {boards} boards killed after 0.1 s to 4 s (seed {seed})");
    println!(
        "  {} scans read; {owing} captures had to hold what was reported two flushes before, {} hold no scan",
        deaths.iter().map(|death| death.read).sum::<u64>(),
        deaths.iter().filter(|death| death.read == 0).count()
    );
    println!(
        "  reported and not in the capture: {:.2} s in the median, {:.2} s at most",
        lost_s.median(),
        lost_s.most()
    );
    let mut verdicts = Verdicts::default();
    let faulty: Vec<&Death> = deaths.iter().filter(|death| !death.faults.is_empty()).collect();
    let first = &faulty[..faulty.len().min(5)];
    verdicts.check(deaths.len() == times, "all were tried");
    verdicts.check(owing > 0, "a daemon lived long enough to owe something; else take another seed");
    verdicts.check(faulty.is_empty(), format!("each capture is as it should be; not so: {} {first:#?}", faulty.len()));
    verdicts.check(
        lost_s.most() <= slack.as_secs_f64(),
        format!("{:.2} s missing at most, {slack:?} allowed", lost_s.most()),
    );
    verdicts
}

fn trial(slitpose: Slitpose, conditions: &Conditions, number: u64) -> Death {
    let mut rng = ChaCha8Rng::seed_from_u64(conditions.seed.wrapping_add(number));
    let lives = Duration::from_secs_f64(rng.random_range(0.1..4.0));
    let folder = tempfile::tempdir().expect("temporary folder");
    let capture = name_in(folder.path(), "killed.mcap");
    let devices = vec!["sim"; conditions.boards].join(",");
    let arguments = ["--device", &devices, "--tier", "paper", "--format", "none", "--record", &capture];
    let begun = Instant::now();
    let daemon = Daemon::start(None, slitpose, folder, arguments, Stdio::null());
    let mut looks = Vec::new();
    let has_to_owe = number % 2 == 1;
    let owes = |looks: &[(u64, u64)]| looks.last().is_some_and(|(flushes, _)| *flushes >= MIN_FLUSHES);
    while begun.elapsed() + LOOK_EVERY < lives || (has_to_owe && !owes(&looks) && begun.elapsed() < STARTS_WITHIN) {
        if let Some(status) = daemon.status() {
            looks.push((status["recorder"]["flushes"].as_u64().unwrap_or(0), scans(&status).iter().sum::<u64>()));
        }
        std::thread::sleep(LOOK_EVERY);
    }
    std::thread::sleep(lives.saturating_sub(begun.elapsed()));
    let _folder = daemon.end_by(Signal::SIGKILL).folder;

    let (flushes, reported) = looks.last().copied().unwrap_or_default();
    // The first flush after a report may have begun before it, the next has not.
    let owed = looks.iter().rfind(|(before, _)| before + 2 <= flushes).map_or(0, |(_, scans)| *scans);
    let mut death = Death { owed, reported, ..Death::default() };
    if !Path::new(&capture).exists() {
        death.expect(owed == 0, || "there is no capture".to_owned());
        return death;
    }
    let (boards, replayed) = scan_table::count(slitpose, &capture, &[]);
    let (read, code, stderr) = (boards.values().map(|scans| scans.count).sum(), replayed.code, replayed.stderr);
    death.read = read;
    death.expect(read >= owed, || format!("{read} scans of at least {owed} are in the capture"));
    // Nothing was flushed yet but who the boards are: such a file says so.
    let is_early = read == 0 && code == 1 && scan_table::is_empty(&stderr);
    death.expect(is_early || code == 3, || format!("replay ends with {code}: {stderr}"));
    death.expect(is_early || stderr.contains("was not ended by its recorder"), || stderr.clone());
    for scans in boards.values() {
        death.expect(scans.first == 0 && scans.jumps == 0, || format!("scans are missing: {scans:?}"));
        death.expect(scans.poses == scans.count, || format!("poses are missing: {scans:?}"));
    }
    death
}

impl Death {
    fn expect(&mut self, good: bool, fault: impl FnOnce() -> String) {
        if !good {
            self.faults.push(fault());
        }
    }
}
