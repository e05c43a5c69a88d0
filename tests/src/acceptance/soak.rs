//! Several boards for a long time, everything switched on: nothing is lost anywhere, and nothing grows.

use std::fmt;
use std::process::Stdio;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

use nix::sys::signal::Signal;
use serde_json::Value;
use slitpose_head::scene_file::WIDE;
use slitpose_model::Tier;

use super::daemon::{Daemon, Ended, boards, name_in, scans};
use super::metered::{Meter, Metered};
use super::scan_table::{self, Scans};
use super::subscriber::Subscriber;
use super::usage::{Usage, resident_in_quarters};
use crate::process::Slitpose;
use crate::terminal::{Board, Terminal};
use crate::verdicts::Verdicts;

/// An account is renewed each 200 ms, also when nothing comes; boards that are silent for longer than 450 ms
/// are missed.
const BREATH_HELD: Duration = Duration::from_millis(400);

/// How often the boards hold their breath until the account is found to be complete.
const BREATHS: usize = 5;

/// How a soak is made.
#[derive(Clone, Copy, Debug)]
pub struct Conditions {
    /// Boards, at 4 kHz each.
    pub boards: u8,
    /// For so long.
    pub duration: Duration,
    /// Looks at the process this far apart.
    pub every: Duration,
    /// What memory may grow by, from the mean of the second quarter to that of the last.
    pub most_growth_bytes: f64,
}

/// A look at the process.
#[derive(Clone, Copy, Debug)]
pub struct Sample {
    /// When, from the beginning.
    pub elapsed_s: f64,
    /// What it took.
    pub usage: Usage,
    /// Scans of all boards, by its own account.
    pub scans: u64,
}

/// What came of it.
#[derive(Debug)]
pub struct Report {
    conditions: Conditions,
    /// Looks at the process.
    pub samples: Vec<Sample>,
    /// Scans that each board has sent.
    pub sent: Vec<u64>,
    /// Scans that the daemon reports, and those sent by then.
    pub reported: Vec<(u64, u64)>,
    /// Scans that each board has in the capture.
    pub captured: Vec<Scans>,
    /// Datagrams that a client was sent.
    pub datagrams: u64,
    status: Value,
    capture_bytes: u64,
    ended: (Option<i32>, String),
    replayed: (i32, String),
}

/// Runs it.
///
/// # Panics
/// If the daemon ends before it is told to, or does not tell how it goes.
pub fn study(slitpose: Slitpose, conditions: &Conditions) -> Report {
    let file = WIDE.read().expect("shipped");
    let meters: Vec<Arc<Meter>> = (0..conditions.boards).map(|_| Arc::default()).collect();
    let terminals: Vec<Terminal> = (0..conditions.boards)
        .zip(&meters)
        .map(|(number, meter)| {
            let board = Board::numbered(number, &file, Tier::Paper, 100 + u64::from(number));
            Terminal::serve_until_pulled(Metered::new(board, Arc::clone(meter)))
        })
        .collect();
    let folder = tempfile::tempdir().expect("temporary folder");
    let [capture, publish] = ["soak.mcap", "publish"].map(|name| name_in(folder.path(), name));
    let mut arguments = vec!["--format".to_owned(), "none".to_owned(), "--record".to_owned(), capture.clone()];
    arguments.extend(["--publish".to_owned(), format!("unix:{publish}")]);
    arguments.extend(terminals.iter().flat_map(|terminal| ["--device".to_owned(), terminal.path.clone()]));
    let daemon = Daemon::start(slitpose, folder, &arguments, Stdio::null());
    let subscriber = Subscriber::start(publish.into());
    daemon.status_when(|status| scans(status).len() == meters.len() && scans(status).iter().all(|scans| *scans > 0));

    let (samples, status) = watch(&daemon, conditions);
    let reported = hold_breath(&daemon, &meters);
    let Ended { status: exit, stderr, folder } = daemon.end_by(Signal::SIGINT);
    meters.iter().for_each(|meter| meter.is_unplugged.store(true, Ordering::Relaxed));
    terminals.into_iter().for_each(|terminal| drop(terminal.closed()));
    let datagrams = subscriber.end();

    let capture_bytes = std::fs::metadata(&capture).map_or(0, |metadata| metadata.len());
    let (captured, replayed) = scan_table::count(slitpose, &capture, &["--tier", "paper"]);
    drop(folder);
    Report {
        conditions: *conditions,
        samples,
        sent: meters.iter().map(|meter| meter.scans.load(Ordering::Relaxed)).collect(),
        reported,
        captured: captured.into_values().collect(),
        datagrams,
        status,
        capture_bytes,
        ended: (exit.code(), stderr),
        replayed: (replayed.code, replayed.stderr),
    }
}

fn watch(daemon: &Daemon, conditions: &Conditions) -> (Vec<Sample>, Value) {
    let begun = Instant::now();
    let mut samples = Vec::new();
    let mut status = Value::Null;
    while begun.elapsed() < conditions.duration {
        // First, or the connection of whoever asks for the status would be counted, or not.
        let usage = daemon.usage().expect("the daemon runs");
        status = daemon.status().expect("the daemon tells how it goes");
        samples.push(Sample { elapsed_s: begun.elapsed().as_secs_f64(), usage, scans: scans(&status).iter().sum() });
        let next = conditions.every * samples.len() as u32;
        std::thread::sleep(next.saturating_sub(begun.elapsed()));
    }
    (samples, status)
}

/// Lets no board take scans until the daemon has accounted for all it was sent.
fn hold_breath(daemon: &Daemon, meters: &[Arc<Meter>]) -> Vec<(u64, u64)> {
    let mut both = Vec::new();
    for _ in 0..BREATHS {
        meters.iter().for_each(|meter| meter.holds_breath.store(true, Ordering::Relaxed));
        let since = Instant::now();
        while since.elapsed() < BREATH_HELD {
            let reported = daemon.status().map(|status| scans(&status)).unwrap_or_default();
            let sent = meters.iter().map(|meter| meter.scans.load(Ordering::Relaxed));
            both = reported.into_iter().zip(sent).collect();
            if !both.is_empty() && both.iter().all(|(reported, sent)| reported == sent) {
                break;
            }
            std::thread::sleep(Duration::from_millis(10));
        }
        meters.iter().for_each(|meter| meter.holds_breath.store(false, Ordering::Relaxed));
        if both.iter().all(|(reported, sent)| reported == sent) {
            break;
        }
        std::thread::sleep(Duration::from_secs(1));
    }
    both
}

impl Report {
    /// The mean of memory over the second quarter of the time, and over the last, bytes.
    pub fn resident_bytes(&self) -> [f64; 2] {
        resident_in_quarters(&self.samples.iter().map(|sample| sample.usage).collect::<Vec<_>>())
    }

    /// Says which bounds were kept.
    ///
    /// # Panics
    /// If there are no samples.
    pub fn check(&self, verdicts: &mut Verdicts) {
        let all = |count: fn(&Scans) -> u64| self.captured.iter().map(count).collect::<Vec<_>>();
        verdicts.check(self.ended.0 == Some(0), &format!("the daemon ends with 0: {:?}", self.ended));
        let is_reported = self.reported.iter().all(|(reported, sent)| reported == sent);
        verdicts.check(is_reported, &format!("the daemon reports what was sent: {:?}", self.reported));
        let captured = all(|scans| scans.count);
        verdicts.check(captured == self.sent, &format!("captured {captured:?} of {:?} scans", self.sent));
        verdicts.check(all(|scans| scans.jumps).iter().all(|jumps| *jumps == 0), "scans follow each other");
        verdicts.check(all(|scans| scans.poses) == captured, "each scan has a pose");
        verdicts.check(self.replayed.0 == 0, &format!("the capture is whole: {:?}", self.replayed));
        for board in boards(&self.status) {
            verdicts.check(
                board["link"]["reconnects"] == 0 && is_zero(&without_unsent(board)),
                &format!("nothing lost, never reconnected: {} {}", board["losses"], board["link"]["reconnects"]),
            );
        }
        let [before, after] = self.resident_bytes();
        let bound = self.conditions.most_growth_bytes;
        verdicts.check(
            after - before <= bound,
            &format!("memory grows by {:.0} KiB, {:.0} allowed", (after - before) / 1024.0, bound / 1024.0),
        );
        // Within the first quarter all has begun, and a client been admitted.
        let settled = self.samples[self.samples.len() / 4].usage;
        let is_constant = |of: fn(&Usage) -> u64| {
            self.samples[self.samples.len() / 4..].iter().all(|sample| of(&sample.usage) == of(&settled))
        };
        verdicts.check(is_constant(|usage| usage.threads), "the number of threads is constant");
        verdicts.check(is_constant(|usage| usage.descriptors), "the number of descriptors is constant");
    }
}

/// The losses of a board, but for poses that a subscriber did not take in time: it is not the daemon's fault
/// when the machine has no time for the subscriber.
fn without_unsent(board: &Value) -> Value {
    let mut losses = board["losses"].clone();
    losses["host"]["poses_unsent"] = 0.into();
    losses
}

/// Whether all counters in `value` are zero.
fn is_zero(value: &Value) -> bool {
    match value {
        Value::Object(object) => object.values().all(is_zero),
        value => value == 0,
    }
}

impl fmt::Display for Report {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Conditions { boards: count, duration, .. } = self.conditions;
        writeln!(f, "{count} boards at 4 kHz, exact 1e-6, recorded and published, for {duration:?}")?;
        let (Some(first), Some(last)) = (self.samples.first(), self.samples.last()) else { return Ok(()) };
        let cpu_s = last.usage.cpu_s - first.usage.cpu_s;
        let percent = 100.0 * cpu_s / (last.elapsed_s - first.elapsed_s);
        let scans = last.scans - first.scans;
        writeln!(
            f,
            "  processor: {percent:.1} % of one core, {:.1} % a board, {:.1} us a scan ({scans} scans)",
            percent / f64::from(count),
            1e6 * cpu_s / scans as f64
        )?;
        let [before, after] = self.resident_bytes();
        let mib = |bytes: f64| bytes / f64::from(1 << 20);
        writeln!(
            f,
            "  memory: {:.2} MiB in the second quarter, {:.2} MiB in the last, {:.2} MiB at most; {} threads, {} descriptors",
            mib(before),
            mib(after),
            mib(last.usage.peak_bytes as f64),
            last.usage.threads,
            last.usage.descriptors
        )?;
        let captured: u64 = self.captured.iter().map(|scans| scans.count).sum();
        writeln!(
            f,
            "  capture: {} bytes, {:.1} a scan; {} datagrams of {} poses",
            self.capture_bytes,
            self.capture_bytes as f64 / captured as f64,
            self.datagrams,
            captured
        )?;
        writeln!(
            f,
            "  {:<6}{:>10}{:>10}{:>12}{:>30}{:>30}",
            "board", "sent", "captured", "degraded", "light to pose, ms", "read to pose, us"
        )?;
        writeln!(f, "  {:<38}{:>30}{:>30}", "", "50/99/99.9 %, most", "50/99/99.9 %, most")?;
        for (number, board) in boards(&self.status).enumerate() {
            let at = |of: &str, unit: f64| {
                let part =
                    |quantile: &str| board["latencies"][of]["total"][quantile].as_f64().unwrap_or(f64::NAN) * unit;
                let [p50, p99, p999, max] = ["p50_s", "p99_s", "p999_s", "max_s"].map(part);
                format!("{p50:.2}/{p99:.2}/{p999:.2}, {max:.1}")
            };
            let captured = self.captured.get(number).map_or(0, |scans| scans.count);
            writeln!(
                f,
                "  {number:<6}{:>10}{captured:>10}{:>12}{:>30}{:>30}",
                self.sent[number],
                board["outcomes"]["degraded"].to_string(),
                at("total", 1e3),
                at("host", 1e6)
            )?;
        }
        Ok(())
    }
}
