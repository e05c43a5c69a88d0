//! UTC from the monotonic clock.

use super::HostInstant;

/// Host time over which the least difference is taken.
const BUCKET_NS: u64 = 100_000_000;

/// UTC minus monotonic time: the least difference of the last tenths of a second, because a delay
/// between the two readings of an instant only makes the difference greater.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct UtcOffset {
    bucket: u64,
    least_ns: i64,
    least_before_ns: i64,
}

impl UtcOffset {
    /// Adds a reading.
    pub(super) fn note(&mut self, at: HostInstant) {
        let offset_ns = at.utc_ns.wrapping_sub(at.monotonic_ns).cast_signed();
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
    pub(super) fn utc_ns(&self, monotonic_ns: u64) -> u64 {
        monotonic_ns.wrapping_add_signed(self.least_ns.min(self.least_before_ns))
    }
}
