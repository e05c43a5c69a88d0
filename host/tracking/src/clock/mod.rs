//! The host's clocks, and a board's clock relative to them.
//!
//! Intervals are measured by the monotonic clock (CLOCK_MONOTONIC, which stops while the host is suspended and is never
//! set; on Windows since the program began), dates by UTC (CLOCK_REALTIME).

mod band;
mod fit;

use slitpose_head::platform;
use web_time::{SystemTime, UNIX_EPOCH};

pub use fit::ClockFit;

/// Both clocks of the host, read at one instant, in nanoseconds.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct HostInstant {
    /// CLOCK_MONOTONIC.
    pub monotonic_ns: u64,
    /// CLOCK_REALTIME: since 1970 began, UTC without leap seconds.
    pub utc_ns: u64,
}

/// Time of an event on a board by the host's clocks, nanoseconds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct HostTime {
    /// CLOCK_MONOTONIC.
    pub monotonic_ns: u64,
    /// CLOCK_REALTIME.
    pub utc_ns: u64,
    /// Greatest error of both times, either way; for UTC that was set back, from when it has caught up.
    pub uncertainty_ns: u64,
}

impl HostInstant {
    /// Reads both clocks. UTC before 1970 is 0.
    pub fn now() -> Self {
        let utc = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
        Self { monotonic_ns: platform::monotonic_ns(), utc_ns: u64::try_from(utc.as_nanos()).unwrap_or(u64::MAX) }
    }
}

/// Least step of UTC that is told, ns: more than clocks are slewed by between two looks.
const MIN_STEP_NS: i64 = 100_000_000;

fn offset_ns(at: HostInstant) -> i64 {
    at.utc_ns.wrapping_sub(at.monotonic_ns).cast_signed()
}

/// Notices steps of UTC: its clock was set, or the host was suspended, while CLOCK_MONOTONIC stands still.
#[derive(Debug, Default)]
pub struct UtcWatch {
    last_ns: Option<i64>,
    /// The lesser of the last two offsets: a delay between the two readings of an instant makes one greater.
    least_ns: Option<i64>,
}

impl UtcWatch {
    /// The step by which UTC has gone ahead (positive) or back since the last looks, seconds, if it is a step.
    pub fn step_s(&mut self, now: HostInstant) -> Option<f64> {
        let now_ns = offset_ns(now);
        let least_ns = now_ns.min(self.last_ns.replace(now_ns)?);
        let step_ns = least_ns - self.least_ns.replace(least_ns)?;
        (step_ns.abs() >= MIN_STEP_NS).then_some(step_ns as f64 * 1e-9)
    }
}

/// Host time over which the least difference is taken.
const BUCKET_NS: u64 = 100_000_000;

/// UTC minus monotonic time: the least difference of the last tenths of a second, because a delay
/// between the two readings of an instant only makes the difference greater.
#[derive(Clone, Copy, Debug, Default)]
struct UtcOffset {
    bucket: u64,
    least_ns: i64,
    least_before_ns: i64,
}

impl UtcOffset {
    fn note(&mut self, at: HostInstant) {
        let offset_ns = offset_ns(at);
        let bucket = at.monotonic_ns / BUCKET_NS + 1;
        if bucket == self.bucket {
            self.least_ns = self.least_ns.min(offset_ns);
            return;
        }
        self.least_before_ns = if bucket == self.bucket + 1 { self.least_ns } else { offset_ns };
        self.least_ns = offset_ns;
        self.bucket = bucket;
    }

    /// UTC at a monotonic time close to the last readings.
    fn utc_ns(&self, monotonic_ns: u64) -> u64 {
        monotonic_ns.wrapping_add_signed(self.least_ns.min(self.least_before_ns))
    }
}

#[cfg(test)]
mod tests;
