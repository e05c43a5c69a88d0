//! Memory and threads of the daemon, from the operating system.

use std::fs;

use super::report::{BoardReport, DaemonReport, ProcessReport, RecorderReport};
use crate::clock::HostInstant;

impl DaemonReport {
    /// The report of this program now, `started` at that time.
    pub(crate) fn of_now(started: HostInstant, boards: Vec<BoardReport>, recorder: RecorderReport) -> Self {
        let running_ns = HostInstant::now().monotonic_ns.saturating_sub(started.monotonic_ns);
        Self {
            program: env!("CARGO_PKG_NAME"),
            version: env!("CARGO_PKG_VERSION"),
            started_utc_ns: started.utc_ns,
            uptime_s: running_ns as f64 * 1e-9,
            process: fs::read_to_string("/proc/self/status").ok().as_deref().and_then(parse),
            boards,
            recorder,
            datagrams: None,
        }
    }
}

/// From Linux's `/proc/self/status`: lines of a key, a colon, and a value, memory in KiB.
fn parse(status: &str) -> Option<ProcessReport> {
    let number = |key: &str| {
        let line = status.lines().find_map(|line| line.strip_prefix(key)?.strip_prefix(':'))?;
        line.split_whitespace().next()?.parse::<u64>().ok()
    };
    Some(ProcessReport { resident_bytes: number("VmRSS")?.checked_mul(1024)?, threads: number("Threads")? })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn memory_and_threads_are_read() {
        let status = "Name:\tslitpose\nVmRSSx:\t1 kB\nVmRSS:\t   5124 kB\nThreads:\t3\n";
        assert_eq!(parse(status), Some(ProcessReport { resident_bytes: 5124 * 1024, threads: 3 }));
        for nonsense in ["", "VmRSS:\nThreads:\n", "VmRSS: 99999999999999999999 kB\nThreads: 1\n", "VmRSS: 1 kB\n"] {
            assert_eq!(parse(nonsense), None, "{nonsense}");
        }
    }

    #[test]
    #[cfg(target_os = "linux")]
    fn this_process_has_memory_and_a_thread() {
        let report = DaemonReport::of_now(HostInstant::now(), Vec::new(), RecorderReport::default());
        let process = report.process.expect("Linux tells");
        assert!(process.resident_bytes > 100_000 && process.threads >= 1, "{process:?}");
    }
}
