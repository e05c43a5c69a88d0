//! The machine: its clock, and permitted priorities.

use std::fs;
use std::process::{Command, Stdio};
use std::time::{Duration, UNIX_EPOCH};

use nix::unistd::geteuid;

use crate::clock::HostInstant;
use slitpose_head::finding::Finding;

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

#[cfg(test)]
mod tests {
    use super::*;
    use slitpose_head::finding::Grade;

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
        assert_eq!(wrong.grade, Grade::Warning);
        assert_eq!(wrong.text, "the clock of this host is wrong: it says 1970-01-01T23:59:59Z (UTC)");
        let right = of_date(EARLIEST_UTC_NS);
        assert_eq!((right.grade, right.text.as_str()), (Grade::Ok, "2026-01-01T00:00:00Z (UTC)"));
        let verdicts = [Some("yes"), Some("no"), Some(""), None].map(|said| of_synchronisation(said).grade);
        assert_eq!(verdicts, [Grade::Ok, Grade::Warning, Grade::Skipped, Grade::Skipped]);
    }
}
