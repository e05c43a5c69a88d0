//! How fast long captures are made and solved on one core, and in how much memory.

use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use clap::Args;

use super::{Table, Verdicts, mib};
use crate::daemon::Usage;
use crate::process::{Slitpose, name_in};

/// Looks at the process this often: what it took in between and at its very end is not seen.
const LOOK_EVERY: Duration = Duration::from_millis(10);

/// The tiers to replay in, and how many times as fast as real time each has to be.
const REQUIRED: [(&str, &[&str], f64); 2] =
    [("paper", &["--tier", "paper"], 40.0), ("exact 1e-6", &["--tier", "exact", "--tolerance", "1e-6"], 20.0)];

#[derive(Debug, Args)]
pub struct Conditions {
    /// Device time of the capture, such as 1h
    #[arg(long, default_value = "10m", value_parser = humantime::parse_duration)]
    duration: Duration,
    /// Each command may take so many MiB
    #[arg(long, default_value_t = 64)]
    most_mib: u32,
    /// What to run the command by
    #[arg(long, default_value = "taskset -c 0")]
    by: String,
    /// Without a verdict on speed, which other programs on this machine share in
    #[arg(long)]
    untimed: bool,
}

pub fn study(slitpose: Slitpose, conditions: &Conditions) -> Verdicts {
    let folder = tempfile::tempdir().expect("temporary folder");
    let capture = name_in(folder.path(), "long.mcap");
    let duration = format!("{}us", conditions.duration.as_micros());
    let simulate = ["simulate", "--tier", "paper", "--duration", &duration, "--output", &capture];
    let mut commands = vec![("simulate paper".to_owned(), simulate.to_vec(), 0.0)];
    for (tier, options, required) in REQUIRED {
        commands.push((
            format!("replay {tier}"),
            [&["replay", &capture, "--format", "none"], options].concat(),
            required,
        ));
    }
    let seconds = conditions.duration.as_secs_f64();
    let scans = seconds * 4000.0;
    let mut verdicts = Verdicts::default();
    let mut table = Table::new(&["", "wall s", "processor s", "us a scan", "x real time", "peak MiB"]);
    for (name, arguments, required) in commands {
        let mut words = conditions.by.split_whitespace().chain([slitpose.path()]).chain(arguments);
        let mut command = Command::new(words.next().expect("at least the command itself"));
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
        let peak_mib = mib(last.peak_bytes);
        // Speed is of processor time, so that other programs do not count.
        let speed = seconds / last.cpu_s;
        let numbers = [wall_s, last.cpu_s, 1e6 * last.cpu_s / scans, speed, peak_mib].map(|it| format!("{it:.2}"));
        table.row([name.clone()].into_iter().chain(numbers));
        let ended = (output.status.code(), String::from_utf8_lossy(&output.stderr).into_owned());
        verdicts.check(ended == (Some(0), String::new()), format!("{name} ends with 0: {ended:?}"));
        let most = conditions.most_mib;
        verdicts.check(peak_mib <= f64::from(most), format!("{name}: at most {most} MiB"));
        if !conditions.untimed {
            verdicts.check(speed >= required, format!("{name}: at least {required} x real time"));
        }
    }
    let bytes = std::fs::metadata(&capture).map_or(0, |metadata| metadata.len());
    println!(
        "{:?} of one board at 4 kHz, {scans:.0} scans, {bytes} bytes ({:.1} a scan); run by `{}`",
        conditions.duration,
        bytes as f64 / scans,
        conditions.by
    );
    print!("{table}");
    verdicts
}
