//! Statistics of a board's scans.

use std::fs;

use slitpose_model::NoTwist;
use slitpose_protocol::{BoardKind, Hello, Severity, Status};

use super::latency::LatencyHistogram;
use super::report::{
    BoardEvent, BoardLosses, BoardReport, DaemonReport, Latencies, LinkLosses, Losses, ProcessReport, Rates,
    RecorderReport, TriggerReport, Vitals,
};
use crate::clock::HostInstant;
use crate::health::HeadHealth;
use crate::link::DeviceId;
use crate::pipeline::{Counts, EdgeRecord, Item, Outcomes, Record};

/// Length of the interval of recent values.
const INTERVAL_NS: u64 = 1_000_000_000;

/// Statistics of one board, from one pipeline, across all reconnections.
#[derive(Clone, Debug, Default)]
pub struct BoardStatistics {
    /// What does not follow from the counts when it is asked for.
    pub report: BoardReport,
    reset_cause: String,
    link_latency: LatencyHistogram,
    host_latency: LatencyHistogram,
    total_latency: LatencyHistogram,
    last_device_s: Option<f64>,
    last_read: Option<HostInstant>,
    /// Number of the trigger input's next edge.
    next_edge: Option<u32>,
    begun: Mark,
}

#[derive(Clone, Copy, Debug, Default)]
struct Mark {
    at: HostInstant,
    scans: u64,
    outcomes: Outcomes,
    link: LinkLosses,
    device_s: Option<f64>,
}

impl BoardStatistics {
    /// Statistics from `now` on, for the board that the user calls `name`.
    pub fn new(name: impl Into<String>, now: HostInstant) -> Self {
        Self {
            report: BoardReport { name: name.into(), ..BoardReport::default() },
            begun: Mark { at: now, ..Mark::default() },
            ..Self::default()
        }
    }

    /// Counts an item of the pipeline. `read_at`: time of the read that completed it; `published_at`: time at which a
    /// pose was published; both `None` if the stream does not run in real time.
    pub fn update(&mut self, item: &Item<'_>, read_at: Option<HostInstant>, published_at: Option<HostInstant>) {
        match item {
            Item::Hello(hello) => self.take_hello(hello),
            Item::Scan(scan) => {
                self.last_device_s = Some(scan.device_time_s);
                self.last_read = read_at;
            }
            Item::Pose(record) => self.take_record(record, read_at, published_at),
            Item::Event { severity, device_time_s, text } if *severity != Severity::Info => {
                self.complain(*severity == Severity::Error, *device_time_s, (*text).to_owned());
            }
            Item::Edge(edge) => self.take_edge(edge),
            Item::Oddity { device_time_s, oddity } => self.complain(false, *device_time_s, oddity.to_string()),
            Item::Event { .. } | Item::Status(_) | Item::Reply(_) => {}
        }
    }

    fn take_edge(&mut self, edge: &EdgeRecord) {
        let EdgeRecord { number, device_time_s: last_device_time_s, is_high, missed, .. } = *edge;
        let (edges, dropped) = self.report.trigger.map_or((1, 0), |before| (before.edges + 1, before.dropped));
        let expected = self.next_edge.replace(number.wrapping_add(1)).unwrap_or(number);
        // A board that has started anew counts from zero.
        let dropped = dropped + u64::from(number.saturating_sub(expected));
        self.report.trigger = Some(TriggerReport { edges, missed, dropped, last_device_time_s, is_high });
    }

    fn complain(&mut self, is_error: bool, time_s: f64, text: String) {
        let device_time_s = Some(time_s).filter(|time_s| time_s.is_finite());
        self.report.complaint = Some(BoardEvent { is_error, device_time_s, text });
    }

    /// The report at `now`, without the link's state; `counts` and `head` are those of the pipeline. To be called a
    /// few times per second: an interval ends once per second.
    pub fn report(&mut self, counts: &Counts, head: Option<HeadHealth>, now: HostInstant) -> BoardReport {
        if now.monotonic_ns.saturating_sub(self.begun.at.monotonic_ns) >= INTERVAL_NS {
            self.end_interval(counts, now);
        }
        let age_s = |then: HostInstant| now.monotonic_ns.saturating_sub(then.monotonic_ns) as f64 * 1e-9;
        BoardReport {
            made_monotonic_ns: now.monotonic_ns,
            made_utc_ns: now.utc_ns,
            scans: counts.scans,
            last_scan_age_s: self.last_read.map(age_s),
            losses: Losses { board: board_losses(counts), link: link_losses(counts), host: self.report.losses.host },
            outcomes: counts.outcomes,
            latencies: Latencies {
                link: self.link_latency.latency(),
                host: self.host_latency.latency(),
                total: self.total_latency.latency(),
            },
            vitals: counts.board_status.as_ref().map(|status| self.vitals(status)),
            head,
            ..self.report.clone()
        }
    }

    fn take_hello(&mut self, hello: &Hello<'_>) {
        let report = &mut self.report;
        report.device = Some(DeviceId(hello.device_id));
        hello.board.clone_into(&mut report.board);
        hello.firmware.clone_into(&mut report.firmware);
        self.reset_cause = format!("{:?}", hello.reset_cause);
        report.simulated = hello.kind == BoardKind::Simulated;
    }

    fn take_record(&mut self, record: &Record, read_at: Option<HostInstant>, published_at: Option<HostInstant>) {
        self.report.clock.uncertainty_s = record.host_time.map(|time| time.uncertainty_ns as f64 * 1e-9);
        self.report.light_level = record.light_level.or(self.report.light_level);
        let withheld = &mut self.report.velocities_withheld;
        match record.twist {
            Ok(_) | Err(NoTwist::NoPose) => {}
            Err(NoTwist::Start) => withheld.start += 1,
            Err(NoTwist::Jump) => withheld.jump += 1,
        }
        let sampled_ns = record.host_time.map(|time| time.monotonic_ns);
        let [read_ns, published_ns] = [read_at, published_at].map(|at| at.map(|at| at.monotonic_ns));
        let record_ns = |histogram: &mut LatencyHistogram, from_ns: Option<u64>, to_ns: Option<u64>| {
            if let (Some(from_ns), Some(to_ns)) = (from_ns, to_ns) {
                // A scan may seem to arrive before its instant, within the uncertainty of the clock.
                histogram.record_ns(to_ns.saturating_sub(from_ns));
            }
        };
        record_ns(&mut self.link_latency, sampled_ns, read_ns);
        record_ns(&mut self.host_latency, read_ns, published_ns);
        record_ns(&mut self.total_latency, sampled_ns, published_ns);
    }

    fn end_interval(&mut self, counts: &Counts, now: HostInstant) {
        let before = self.begun;
        let interval_s = (now.monotonic_ns - before.at.monotonic_ns) as f64 * 1e-9;
        let scans = counts.scans.saturating_sub(before.scans);
        let span_s = match (before.device_s, self.last_device_s) {
            (Some(from_s), Some(to_s)) => Some(to_s - from_s),
            _ => None,
        };
        self.report.rates = Rates {
            // After a reset of the board the span is negative.
            device_hz: span_s.filter(|&span_s| span_s > 0.0).map(|span_s| scans as f64 / span_s),
            host_hz: scans as f64 / interval_s,
            interval_s,
        };
        self.report.recent_outcomes = counts.outcomes.since(&before.outcomes);
        let link = link_losses(counts);
        self.report.recent_link_losses = link.since(&before.link);
        for histogram in [&mut self.link_latency, &mut self.host_latency, &mut self.total_latency] {
            histogram.end_interval();
        }
        self.begun =
            Mark { at: now, scans: counts.scans, outcomes: counts.outcomes, link, device_s: self.last_device_s };
    }

    fn vitals(&self, status: &Status) -> Vitals {
        Vitals {
            reset_cause: self.reset_cause.clone(),
            clock_source: status.clock,
            settings: status.settings,
            acquiring: status.acquiring,
            supply_v: status.supply_v,
            temperature_k: status.temperature_k,
            cpu_load: f64::from(status.cpu_load_permille) * 1e-3,
            replies_dropped: status.replies_dropped,
            commands_damaged: status.commands_damaged,
            commands_rejected: status.commands_rejected,
        }
    }
}

fn board_losses(counts: &Counts) -> BoardLosses {
    let [scans_dropped, scans_lost, adc_overruns] = counts.lost_on_board();
    BoardLosses { scans_dropped, scans_lost, adc_overruns }
}

fn link_losses(counts: &Counts) -> LinkLosses {
    let decoder = &counts.decoder;
    LinkLosses {
        scans: counts.scans_lost_on_link,
        scans_repeated: counts.scans_repeated,
        bad_checksum: decoder.bad_checksum,
        misframed: decoder.misframed,
        overlong: decoder.overlong,
        unreadable: decoder.unknown + decoder.malformed + counts.batches_unreadable + counts.batches_without_hello,
        poses_refused: counts.poses_refused,
        bytes_skipped: decoder.bytes_skipped,
    }
}

impl DaemonReport {
    /// The report of this program `now`, `started` at that time.
    pub fn of(started: HostInstant, now: HostInstant, boards: Vec<BoardReport>, recorder: RecorderReport) -> Self {
        let running_ns = now.monotonic_ns.saturating_sub(started.monotonic_ns);
        Self {
            program: "slitpose",
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

    const fn at(monotonic_ns: u64) -> HostInstant {
        HostInstant { monotonic_ns, utc_ns: 1_700_000_000_000_000_000 + monotonic_ns }
    }

    #[test]
    fn rates_are_those_of_the_last_second() {
        let mut statistics = BoardStatistics::new("port", at(0));
        let mut counts = Counts::default();
        let mut report = |scans: u64, device_s: f64, now_ns: u64| {
            counts.scans = scans;
            counts.outcomes.converged = scans;
            statistics.last_device_s = Some(device_s);
            statistics.report(&counts, None, at(now_ns))
        };
        // Device time has any origin: the first interval has no rate by the board's clock.
        let first = report(1000, 7.0, 1_000_000_000);
        assert_eq!((first.rates.device_hz, first.rates.host_hz), (None, 1000.0));
        // Too early for another interval.
        assert_eq!(report(1500, 7.4, 1_900_000_000).rates, first.rates);
        // The board's clock is slow: 1 s by the host's is 0.8 s.
        let second = report(5000, 7.8, 2_000_000_000);
        assert_eq!((second.rates.host_hz, second.recent_outcomes.converged), (4000.0, 4000));
        assert!((second.rates.device_hz.unwrap() - 5000.0).abs() < 1e-6);
        // It was reset.
        assert_eq!(report(6000, 0.2, 3_000_000_000).rates.device_hz, None);
        // Nothing comes any more.
        let last = report(6000, 0.2, 5_000_000_000);
        assert_eq!((last.rates.device_hz, last.rates.host_hz, last.rates.interval_s), (None, 0.0, 2.0));
        assert_eq!((last.outcomes.converged, last.recent_outcomes), (6000, Outcomes::default()));
    }

    #[test]
    fn memory_and_threads_are_read() {
        let status = "Name:\tslitpose\nVmRSSx:\t1 kB\nVmRSS:\t   5124 kB\nThreads:\t3\n";
        assert_eq!(parse(status), Some(ProcessReport { resident_bytes: 5124 * 1024, threads: 3 }));
        for nonsense in ["", "VmRSS:\nThreads:\n", "VmRSS: 99999999999999999999 kB\nThreads: 1\n", "VmRSS: 1 kB\n"] {
            assert_eq!(parse(nonsense), None, "{nonsense}");
        }
    }
}
