//! The places where missing scans were lost, and percentiles of durations.
//!
//! Gaps in the numbering show missing scans. Twice per second the board reports how many it has lost itself since its
//! reset. The rest was lost on the link.

use hdrhistogram::Histogram;
use schemars::JsonSchema;
use serde::Serialize;
use slitpose_protocol::Status;

use super::report::BoardLosses;

/// Scans dropped and lost, and overruns.
type Counters = [u64; 3];

/// Follows the board's counters across its resets.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct LossBook {
    /// Losses while followed, before the last reset.
    carried: Counters,
    /// The counters when following began, or zero after a reset.
    base: Counters,
    last: Option<(u64, Counters)>,
    next_sequence: Option<u64>,
    /// Scans missing in the numbering so far.
    missed: u64,
    /// Of these, lost between board and host.
    pub(super) link_scans: u64,
}

impl LossBook {
    pub(super) fn begin_numbering(&mut self) {
        self.next_sequence = None;
    }

    /// Adds the number of the next scan, and how many of those missing before it were not lost. A number that goes back
    /// shows that the board was reset.
    pub(super) fn scan(&mut self, sequence: u64, not_lost: u64) {
        let missing = self.next_sequence.map_or(0, |expected| sequence.saturating_sub(expected));
        self.missed += missing.saturating_sub(not_lost);
        self.next_sequence = Some(sequence.wrapping_add(1));
    }

    /// Adds a status that came after the scans so far.
    pub(super) fn status(&mut self, status: &Status) {
        let now = [status.scans_dropped, status.scans_lost, status.adc_overruns.into()];
        match self.last {
            Some((tick, _)) if status.tick < tick => (self.carried, self.base) = (self.counters(), Counters::default()),
            Some(_) => {}
            // Losses before the first scan do not count; scans missing in the numbering since then do.
            None => {
                let dropped = now[0].min(self.missed);
                let lost = now[1].min(self.missed - dropped);
                self.base = [now[0] - dropped, now[1] - lost, now[2]];
            }
        }
        self.last = Some((status.tick, now));
        // The board reports a loss before the numbering shows it: only the largest difference counts.
        let [dropped, lost, _] = self.counters();
        self.link_scans = self.link_scans.max(self.missed.saturating_sub(dropped + lost));
    }

    fn counters(&self) -> Counters {
        let last = self.last.map_or(self.base, |(_, last)| last);
        std::array::from_fn(|k| self.carried[k] + last[k].saturating_sub(self.base[k]))
    }

    pub(super) fn board(&self) -> BoardLosses {
        let [scans_dropped, scans_lost, adc_overruns] = self.counters();
        BoardLosses { scans_dropped, scans_lost, adc_overruns }
    }
}

/// Range of the histogram: 1 µs to 100 s with 1 % resolution, in some 30 KiB.
const MIN_NS: u64 = 1_000;
const MAX_NS: u64 = 100_000_000_000;
const DIGITS: u8 = 2;

const QUANTILES: [f64; 4] = [0.5, 0.9, 0.99, 0.999];

/// Percentiles of durations, seconds; zeros if there are no durations.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, JsonSchema)]
pub struct Percentiles {
    /// Median.
    pub p50_s: f64,
    /// 90th percentile.
    pub p90_s: f64,
    /// 99th percentile.
    pub p99_s: f64,
    /// 99.9th percentile.
    pub p999_s: f64,
    /// Maximum.
    pub max_s: f64,
    /// Sum.
    pub sum_s: f64,
    /// Number of durations.
    pub count: u64,
}

impl Percentiles {
    /// Each quantile, 0 to 1, with its duration in seconds.
    pub fn quantiles(&self) -> [(f64, f64); 4] {
        let values = [self.p50_s, self.p90_s, self.p99_s, self.p999_s];
        std::array::from_fn(|i| (QUANTILES[i], values[i]))
    }
}

/// Percentiles of durations since the start, and of the last interval.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, JsonSchema)]
pub struct Latency {
    /// Durations since the start.
    pub total: Percentiles,
    /// Durations of the last full interval: see [`Rates::interval_s`](super::report::Rates::interval_s).
    pub recent: Percentiles,
}

#[derive(Clone, Debug)]
pub struct LatencyHistogram {
    total: Sums,
    interval: Sums,
    recent: Percentiles,
}

#[derive(Clone, Debug)]
struct Sums {
    histogram: Histogram<u64>,
    sum_ns: u64,
    max_ns: u64,
}

impl Sums {
    fn new() -> Self {
        let histogram = Histogram::new_with_bounds(MIN_NS, MAX_NS, DIGITS).expect("bounds that are in order");
        Self { histogram, sum_ns: 0, max_ns: 0 }
    }

    fn record(&mut self, duration_ns: u64) {
        // Within its bounds a histogram accepts every value without more memory.
        let _ = self.histogram.record(duration_ns.min(MAX_NS));
        self.sum_ns = self.sum_ns.saturating_add(duration_ns);
        self.max_ns = self.max_ns.max(duration_ns);
    }

    fn percentiles(&self) -> Percentiles {
        let seconds = |duration_ns: u64| duration_ns as f64 * 1e-9;
        // The upper end of a bin may exceed the maximum.
        let at = |quantile: f64| seconds(self.histogram.value_at_quantile(quantile).min(self.max_ns));
        let [p50_s, p90_s, p99_s, p999_s] = QUANTILES.map(at);
        let (max_s, sum_s) = (seconds(self.max_ns), seconds(self.sum_ns));
        Percentiles { p50_s, p90_s, p99_s, p999_s, max_s, sum_s, count: self.histogram.len() }
    }
}

impl Default for LatencyHistogram {
    fn default() -> Self {
        Self { total: Sums::new(), interval: Sums::new(), recent: Percentiles::default() }
    }
}

impl LatencyHistogram {
    pub fn record_ns(&mut self, duration_ns: u64) {
        self.total.record(duration_ns);
        self.interval.record(duration_ns);
    }

    pub fn end_interval(&mut self) {
        self.recent = self.interval.percentiles();
        self.interval.histogram.reset();
        (self.interval.sum_ns, self.interval.max_ns) = (0, 0);
    }

    pub fn latency(&self) -> Latency {
        Latency { total: self.total.percentiles(), recent: self.recent }
    }
}

#[cfg(test)]
mod tests {
    use slitpose_protocol::{ClockSource, SettingsSource};

    use super::*;

    fn status(tick: u64, scans_dropped: u64, scans_lost: u64) -> Status {
        Status {
            tick,
            acquiring: true,
            scans_taken: 0,
            scans_dropped,
            batches_dropped: 0,
            scans_lost,
            adc_overruns: 0,
            replies_dropped: 0,
            commands_damaged: 0,
            commands_rejected: 0,
            supply_v: 3.3,
            temperature_k: 300.0,
            cpu_load_permille: 0,
            clock: ClockSource::Crystal,
            settings: SettingsSource::Defaults,
        }
    }

    fn shares(book: &LossBook) -> (u64, u64, u64) {
        let board = book.board();
        (board.scans_dropped, board.scans_lost, book.link_scans)
    }

    #[test]
    fn scans_that_a_board_says_not_to_have_solved_are_not_lost() {
        let mut book = LossBook::default();
        book.scan(0, 0);
        book.scan(8, 5);
        book.status(&status(1, 0, 0));
        assert_eq!(shares(&book), (0, 0, 2));
    }

    #[test]
    fn each_missing_scan_has_one_place() {
        let mut book = LossBook::default();
        // 1000 scans dropped before the link was opened, 4 lost since then in the first half second.
        [0, 1, 6].iter().for_each(|&sequence| book.scan(sequence, 0));
        book.status(&status(1, 1004, 7));
        assert_eq!(shares(&book), (4, 0, 0));
        // The board has dropped 10 more; the numbering shows 6 of them so far.
        book.scan(13, 0);
        book.status(&status(2, 1014, 7));
        assert_eq!(shares(&book), (14, 0, 0));
        // Those, and 3 that the board does not report.
        book.scan(21, 0);
        book.status(&status(3, 1014, 7));
        assert_eq!(shares(&book), (14, 0, 3));
        // Another drop, not in the numbering yet, does not reduce the losses of the link.
        book.status(&status(4, 1016, 8));
        assert_eq!(shares(&book), (16, 1, 3));
    }

    #[test]
    fn no_scan_is_missing_between_two_boards() {
        let mut book = LossBook::default();
        [5, 6].iter().for_each(|&sequence| book.scan(sequence, 0));
        book.begin_numbering();
        [900, 901].iter().for_each(|&sequence| book.scan(sequence, 0));
        book.status(&status(1, 0, 0));
        assert_eq!(shares(&book), (0, 0, 0));
    }

    #[test]
    fn a_reset_of_the_board_takes_nothing_back() {
        let mut book = LossBook::default();
        book.scan(0, 0);
        book.status(&status(100, 50, 0));
        book.scan(6, 0);
        book.status(&status(200, 55, 0));
        [0, 4].iter().for_each(|&sequence| book.scan(sequence, 0));
        book.status(&status(10, 2, 1));
        assert_eq!(shares(&book), (7, 1, 0));
    }

    #[test]
    fn an_interval_begins_with_nothing() {
        let mut histogram = LatencyHistogram::default();
        assert_eq!(histogram.latency(), Latency::default());
        histogram.record_ns(0);
        histogram.record_ns(u64::MAX);
        assert_eq!(histogram.latency().recent.count, 0, "the interval has not ended");
        histogram.end_interval();
        let latency = histogram.latency();
        assert_eq!((latency.recent.count, latency.recent.max_s), (2, u64::MAX as f64 * 1e-9));
        assert!(latency.recent.p50_s < 2e-6 && latency.recent.p999_s >= 100.0, "{latency:?}");
        histogram.end_interval();
        assert_eq!(histogram.latency().recent, Percentiles::default());
        assert_eq!(histogram.latency().total.count, 2);
    }
}
