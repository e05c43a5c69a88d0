//! The machine: its clock, permitted priorities, and the disk for recordings.

use std::fs;
use std::io::{self, Write};
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant, UNIX_EPOCH};

use nix::sys::statvfs::statvfs;
use nix::unistd::geteuid;
use slitpose_head::finding::Finding;

use slitpose_tracking::clock::HostInstant;

/// Start of 2026, before the first build: an earlier time is wrong.
const EARLIEST_UTC_NS: u64 = 1_767_225_600_000_000_000;

/// The priority that the shipped service may use.
const PRIORITY: u64 = 50;

pub(super) fn checks() -> [Finding; 3] {
    let limits = fs::read_to_string("/proc/self/limits").ok();
    [of_date(HostInstant::now().utc_ns), of_synchronisation(synchronised().as_deref()), of_priority(limits.as_deref())]
}

fn of_date(utc_ns: u64) -> Finding {
    let date = humantime::format_rfc3339_seconds(UNIX_EPOCH + Duration::from_nanos(utc_ns));
    if utc_ns >= EARLIEST_UTC_NS {
        Finding::ok("date", format!("{date} (UTC)"))
    } else {
        let finding = format!("the clock of this host is wrong: it says {date} (UTC)");
        Finding::warning("date", finding, "set the clock: timedatectl set-ntp true")
    }
}

/// The answer of systemd, if it runs.
fn synchronised() -> Option<String> {
    let asked = Command::new("timedatectl")
        .args(["show", "--property=NTPSynchronized", "--value"])
        .stdin(Stdio::null())
        .stderr(Stdio::null())
        .output()
        .ok()?;
    asked.status.success().then(|| String::from_utf8_lossy(&asked.stdout).trim().to_owned())
}

fn of_synchronisation(said: Option<&str>) -> Finding {
    match said {
        Some("yes") => Finding::ok("clock", "synchronised to UTC"),
        Some("no") => Finding::warning(
            "clock",
            "not synchronised to UTC: dates of poses are as wrong as the clock; intervals are right",
            "timedatectl set-ntp true, or install chrony",
        ),
        _ => Finding::skipped("clock", "without timedatectl it is not known whether the clock is synchronised"),
    }
}

fn of_priority(limits: Option<&str>) -> Finding {
    if geteuid().is_root() {
        return Finding::ok("priority", "root may use real-time priorities");
    }
    let Some(limit) = limits.and_then(real_time_limit) else {
        return Finding::skipped("priority", "/proc/self/limits does not say what is allowed");
    };
    if limit >= PRIORITY {
        Finding::ok("priority", format!("real-time priorities up to {limit} are allowed"))
    } else {
        Finding::warning(
            "priority",
            format!("real-time priorities up to {limit} are allowed, {PRIORITY} is needed: a busy host reads late"),
            "allow them as host/INSTALL.md describes, or run the service",
        )
    }
}

/// The soft limit in `/proc/self/limits`; the maximum if unlimited.
fn real_time_limit(limits: &str) -> Option<u64> {
    let line = limits.lines().find_map(|line| line.strip_prefix("Max realtime priority"))?;
    match line.split_whitespace().next()? {
        "unlimited" => Some(99),
        number => number.parse().ok(),
    }
}

/// Boards that one host records at once.
const BOARDS: f64 = 4.0;

/// Room for less than an hour is little; for less than a minute, none.
const LITTLE_S: f64 = 3600.0;
const NOTHING_S: f64 = 60.0;

/// Factor by which the rate must exceed the need: a disk that other programs use has slow moments.
const MARGIN: f64 = 5.0;

const TRIAL_BYTES: usize = 4 << 20;
const CHUNK_BYTES: usize = 64 << 10;

/// Checks the folder for recordings of boards with `bytes_per_s` each. The findings do not name it because reports are
/// shown to others.
pub(super) fn disk_checks(folder: &Path, bytes_per_s: f64) -> [Finding; 2] {
    let needed = BOARDS * bytes_per_s;
    let room = match statvfs(folder) {
        Ok(disk) => of_room(disk.blocks_available() as f64 * disk.fragment_size() as f64, needed),
        Err(error) => Finding::failed("disk space", error.to_string(), "give a folder that exists with --folder"),
    };
    let rate = match write_rate(folder) {
        Ok(rate) => of_rate(rate, needed),
        Err(error) => {
            Finding::failed("disk rate", error.to_string(), "give a folder that may be written to with --folder")
        }
    };
    [room, rate]
}

fn of_room(free: f64, needed: f64) -> Finding {
    let seconds = free / needed;
    let finding = format!("{:.1} GB free for recordings: {:.1} hours of four boards", free / 1e9, seconds / 3600.0);
    if seconds >= LITTLE_S {
        Finding::ok("disk space", finding)
    } else if seconds >= NOTHING_S {
        Finding::warning("disk space", finding, "make room, or record elsewhere")
    } else {
        Finding::failed("disk space", finding, "make room, or record elsewhere")
    }
}

fn of_rate(rate: f64, needed: f64) -> Finding {
    let finding = format!("{:.1} MB/s written, four boards need {:.2} MB/s", rate / 1e6, needed / 1e6);
    if rate >= MARGIN * needed {
        Finding::ok("disk rate", finding)
    } else if rate >= needed {
        Finding::warning("disk rate", finding, "record to a faster disk, or fewer boards")
    } else {
        Finding::failed("disk rate", finding, "record to a faster disk, or fewer boards")
    }
}

/// Write rate of the disk, bytes per second.
fn write_rate(folder: &Path) -> io::Result<f64> {
    let mut file = tempfile::tempfile_in(folder)?;
    // Zeros could be written as a hole.
    let chunk = [0xa5; CHUNK_BYTES];
    let begun = Instant::now();
    for _ in 0..TRIAL_BYTES / CHUNK_BYTES {
        file.write_all(&chunk)?;
    }
    file.sync_all()?;
    Ok(TRIAL_BYTES as f64 / begun.elapsed().as_secs_f64())
}

#[cfg(test)]
mod tests {
    use slitpose_head::finding::Grade::{self, Failed, Ok, Warning};

    use super::*;

    #[test]
    fn the_limit_is_read() {
        let limits = "Limit                     Soft Limit           Hard Limit           Units     \n\
                      Max nice priority         0                    0                    \n\
                      Max realtime priority     12                   95                   \n\
                      Max realtime timeout      unlimited            unlimited            us        \n";
        assert_eq!(real_time_limit(limits), Some(12));
        assert_eq!(real_time_limit(&limits.replace("12 ", "unlimited ")), Some(99));
        assert_eq!(real_time_limit("Max nice priority 0 0"), None);
    }

    #[test]
    fn a_clock_that_starts_in_1970_is_not_believed() {
        let wrong = of_date(86_399_000_000_000);
        assert_eq!(wrong.grade, Warning);
        assert_eq!(wrong.text, "the clock of this host is wrong: it says 1970-01-01T23:59:59Z (UTC)");
        let right = of_date(EARLIEST_UTC_NS);
        assert_eq!((right.grade, right.text.as_str()), (Ok, "2026-01-01T00:00:00Z (UTC)"));
        let verdicts = [Some("yes"), Some("no"), Some(""), None].map(|said| of_synchronisation(said).grade);
        assert_eq!(verdicts, [Ok, Warning, Grade::Skipped, Grade::Skipped]);
    }

    #[test]
    fn room_and_rate_are_compared_with_the_need_of_four_boards() {
        let needed = 1e6;
        assert_eq!([3.7e9, 3.5e9, 59e6].map(|free| of_room(free, needed).grade), [Ok, Warning, Failed]);
        assert_eq!([5.1e6, 4.9e6, 0.9e6].map(|rate| of_rate(rate, needed).grade), [Ok, Warning, Failed]);
    }

    #[test]
    fn a_folder_that_is_not_there_takes_nothing() {
        let folder = tempfile::tempdir().unwrap();
        let [room, _] = disk_checks(folder.path(), 1.0);
        assert_eq!(room.grade, Ok, "{room}");
        assert!(write_rate(folder.path()).unwrap() > 0.0);
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 0, "left behind");
        let gone = folder.path().join("gone");
        assert_eq!(disk_checks(&gone, 1.0).map(|check| check.grade), [Failed, Failed]);
    }
}
