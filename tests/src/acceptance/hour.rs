//! How fast long captures are made and solved on one core, and in how much memory.

use std::fmt;
use std::process::Stdio;
use std::time::{Duration, Instant};

use super::daemon::name_in;
use super::usage::Usage;
use crate::process::Slitpose;
use crate::verdicts::Verdicts;

/// Looks at the process this often: what it took in between and at its very end is not seen.
const LOOK_EVERY: Duration = Duration::from_millis(10);

/// The tiers to replay in, and how many times as fast as real time each has to be.
const REQUIRED: [(&str, &[&str], f64); 2] =
    [("paper", &["--tier", "paper"], 40.0), ("exact 1e-6", &["--tier", "exact", "--tolerance", "1e-6"], 20.0)];

/// How the study is made.
#[derive(Clone, Debug)]
pub struct Conditions {
    /// Device time of the capture.
    pub duration: Duration,
    /// What a replay may take at most.
    pub most_bytes: u64,
    /// What to run the command by, such as `taskset -c 0`; may be empty.
    pub wrapper: Vec<String>,
}

/// One command.
#[derive(Clone, Debug)]
pub struct Run {
    /// What it does.
    pub name: String,
    /// How long it took.
    pub wall_s: f64,
    /// How much processor time.
    pub cpu_s: f64,
    /// The most memory it held.
    pub peak_bytes: u64,
    /// How it ended, and what it said.
    pub ended: (Option<i32>, String),
    required: f64,
}

/// What came of it.
#[derive(Debug)]
pub struct Report {
    conditions: Conditions,
    capture_bytes: u64,
    /// The making of the capture, and its replays.
    pub runs: Vec<Run>,
}

/// Runs it.
///
/// # Panics
/// If a command cannot be started.
pub fn study(slitpose: Slitpose, conditions: &Conditions) -> Report {
    let folder = tempfile::tempdir().expect("temporary folder");
    let capture = name_in(folder.path(), "long.mcap");
    let duration = format!("{}us", conditions.duration.as_micros());
    let simulate = ["simulate", "--tier", "paper", "--duration", &duration, "--output", &capture];
    let mut runs = vec![run(slitpose, conditions, "simulate paper", &simulate, 0.0)];
    for (tier, options, required) in REQUIRED {
        let arguments = [&["replay", &capture, "--format", "none"], options].concat();
        runs.push(run(slitpose, conditions, &format!("replay {tier}"), &arguments, required));
    }
    let capture_bytes = std::fs::metadata(&capture).map_or(0, |metadata| metadata.len());
    Report { conditions: conditions.clone(), capture_bytes, runs }
}

fn run(slitpose: Slitpose, conditions: &Conditions, name: &str, arguments: &[&str], required: f64) -> Run {
    let mut words =
        conditions.wrapper.iter().map(String::as_str).chain([slitpose.path()]).chain(arguments.iter().copied());
    let mut command = std::process::Command::new(words.next().expect("at least the command itself"));
    command.args(words).stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::piped());
    let begun = Instant::now();
    let mut child = command.spawn().unwrap_or_else(|error| panic!("{command:?}: {error}"));
    let mut last = Usage::default();
    while child.try_wait().expect("runs").is_none() {
        // An ended process that was not waited for has no memory any more.
        last = Usage::of(child.id()).unwrap_or(last);
        std::thread::sleep(LOOK_EVERY);
    }
    let wall_s = begun.elapsed().as_secs_f64();
    let output = child.wait_with_output().expect("ended");
    let ended = (output.status.code(), String::from_utf8_lossy(&output.stderr).into_owned());
    Run { name: name.to_owned(), wall_s, cpu_s: last.cpu_s, peak_bytes: last.peak_bytes, ended, required }
}

impl Report {
    /// Says which bounds were kept. Speed is of processor time, so that other programs do not count.
    pub fn check(&self, verdicts: &mut Verdicts) {
        for run in &self.runs {
            let speed = self.speed(run);
            verdicts.check(speed >= run.required, &format!("{}: at least {} x real time", run.name, run.required));
        }
        self.check_memory(verdicts);
    }

    /// The same but for speed.
    pub fn check_memory(&self, verdicts: &mut Verdicts) {
        for run in &self.runs {
            verdicts
                .check(run.ended == (Some(0), String::new()), &format!("{} ends with 0: {:?}", run.name, run.ended));
            let most = self.conditions.most_bytes;
            verdicts.check(run.peak_bytes <= most, &format!("{}: at most {} MiB", run.name, most >> 20));
        }
    }

    fn speed(&self, run: &Run) -> f64 {
        self.conditions.duration.as_secs_f64() / run.cpu_s
    }
}

impl fmt::Display for Report {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Conditions { duration, wrapper, .. } = &self.conditions;
        let scans = duration.as_secs_f64() * 4000.0;
        writeln!(
            f,
            "{duration:?} of one board at 4 kHz, {scans:.0} scans, {} bytes ({:.1} a scan); run by `{}`",
            self.capture_bytes,
            self.capture_bytes as f64 / scans,
            wrapper.join(" ")
        )?;
        writeln!(
            f,
            "  {:<20}{:>10}{:>14}{:>12}{:>14}{:>16}",
            "", "wall, s", "processor, s", "us a scan", "x real time", "peak memory, MiB"
        )?;
        for run in &self.runs {
            writeln!(
                f,
                "  {:<20}{:>10.1}{:>14.1}{:>12.2}{:>14.1}{:>16.1}",
                run.name,
                run.wall_s,
                run.cpu_s,
                1e6 * run.cpu_s / scans,
                self.speed(run),
                run.peak_bytes as f64 / f64::from(1 << 20)
            )?;
        }
        Ok(())
    }
}
