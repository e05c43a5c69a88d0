//! Percentiles of durations.

use hdrhistogram::Histogram;
use schemars::JsonSchema;
use serde::Serialize;

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
    use super::*;

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
