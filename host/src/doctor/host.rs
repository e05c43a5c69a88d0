//! The machine: its clock, and what it lets a program do.

use std::fs;
use std::process::{Command, Stdio};
use std::time::{Duration, UNIX_EPOCH};

use nix::unistd::geteuid;

use super::check::Check;
use crate::clock::HostInstant;

/// Nothing here was built earlier: 2026 begins.
const EARLIEST_UTC_NS: u64 = 1_767_225_600_000_000_000;

/// The priority that the shipped service may use.
const PRIORITY: u64 = 50;

pub(super) fn checks() -> [Check; 3] {
    let limits = fs::read_to_string("/proc/self/limits").ok();
    [of_date(HostInstant::now().utc_ns), of_synchronisation(synchronised().as_deref()), of_priority(limits.as_deref())]
}

fn of_date(utc_ns: u64) -> Check {
    let date = humantime::format_rfc3339_seconds(UNIX_EPOCH + Duration::from_nanos(utc_ns));
    if utc_ns >= EARLIEST_UTC_NS {
        Check::ok("date", format!("{date} (UTC)"))
    } else {
        let finding = format!("the clock of this host is wrong: it says {date} (UTC)");
        Check::warning("date", finding, "set the clock: timedatectl set-ntp true")
    }
}

/// What systemd says, if it is there.
fn synchronised() -> Option<String> {
    let asked = Command::new("timedatectl")
        .args(["show", "--property=NTPSynchronized", "--value"])
        .stdin(Stdio::null())
        .stderr(Stdio::null())
        .output()
        .ok()?;
    asked.status.success().then(|| String::from_utf8_lossy(&asked.stdout).trim().to_owned())
}

fn of_synchronisation(said: Option<&str>) -> Check {
    match said {
        Some("yes") => Check::ok("clock", "synchronised to UTC"),
        Some("no") => Check::warning(
            "clock",
            "not synchronised to UTC: dates of poses are as wrong as the clock; intervals are right",
            "timedatectl set-ntp true, or install chrony",
        ),
        _ => Check::skipped("clock", "no timedatectl here that tells whether it is synchronised"),
    }
}

fn of_priority(limits: Option<&str>) -> Check {
    if geteuid().is_root() {
        return Check::ok("priority", "root may use real-time priorities");
    }
    let Some(limit) = limits.and_then(real_time_limit) else {
        return Check::skipped("priority", "this system does not tell in /proc what is allowed");
    };
    if limit >= PRIORITY {
        Check::ok("priority", format!("real-time priorities up to {limit} are allowed"))
    } else {
        Check::warning(
            "priority",
            format!("real-time priorities up to {limit} are allowed, {PRIORITY} is wanted: a busy host reads late"),
            "allow them as host/INSTALL.md tells, or let the service do the work",
        )
    }
}

/// The soft limit in `/proc/self/limits`; without limit the most there is.
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
    use crate::doctor::Verdict;

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
        assert_eq!(wrong.verdict, Verdict::Warning);
        assert_eq!(wrong.finding, "the clock of this host is wrong: it says 1970-01-01T23:59:59Z (UTC)");
        let right = of_date(EARLIEST_UTC_NS);
        assert_eq!((right.verdict, right.finding.as_str()), (Verdict::Ok, "2026-01-01T00:00:00Z (UTC)"));
        let verdicts = [Some("yes"), Some("no"), Some(""), None].map(|said| of_synchronisation(said).verdict);
        assert_eq!(verdicts, [Verdict::Ok, Verdict::Warning, Verdict::Skipped, Verdict::Skipped]);
    }
}
