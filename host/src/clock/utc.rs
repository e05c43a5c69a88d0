//! UTC from the monotonic clock.

use super::HostInstant;

/// Least step of UTC that is told, ns: more than clocks are slewed by between two looks.
const LEAST_STEP_NS: i64 = 100_000_000;

/// UTC minus monotonic time.
fn offset_ns(at: HostInstant) -> i64 {
    at.utc_ns.wrapping_sub(at.monotonic_ns).cast_signed()
}

/// Notices steps of UTC: its clock was set, or the host was suspended, while CLOCK_MONOTONIC stands still.
#[derive(Debug, Default)]
pub(crate) struct UtcWatch {
    last_ns: Option<i64>,
    /// The lesser of the last two offsets: a delay between the two readings of an instant makes one greater.
    least_ns: Option<i64>,
}

impl UtcWatch {
    /// The step by which UTC has gone ahead (positive) or back since the last looks, seconds, if it is a step.
    pub(crate) fn step_s(&mut self, now: HostInstant) -> Option<f64> {
        let now_ns = offset_ns(now);
        let least_ns = now_ns.min(self.last_ns.replace(now_ns)?);
        let step_ns = least_ns - self.least_ns.replace(least_ns)?;
        (step_ns.abs() >= LEAST_STEP_NS).then_some(step_ns as f64 * 1e-9)
    }
}

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
    pub(super) fn utc_ns(&self, monotonic_ns: u64) -> u64 {
        monotonic_ns.wrapping_add_signed(self.least_ns.min(self.least_before_ns))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// What a watch says at looks 20 ms apart, of which each knows UTC's step and the delay between its readings, ms.
    fn steps(looks: &[(i64, u64)]) -> Vec<Option<f64>> {
        let mut watch = UtcWatch::default();
        let at = |(look, &(step_ms, delay_ms)): (usize, &(i64, u64))| {
            let monotonic_ns = 5_000_000_000 + 20_000_000 * look as u64;
            let utc_ns = (1_700_000_000_000_000_000 + monotonic_ns).wrapping_add_signed(step_ms * 1_000_000);
            HostInstant { monotonic_ns, utc_ns: utc_ns + delay_ms * 1_000_000 }
        };
        looks.iter().enumerate().map(at).map(|now| watch.step_s(now)).collect()
    }

    #[test]
    fn a_step_of_utc_is_told_once_with_its_sign_and_a_delay_between_two_readings_is_none() {
        let back = [(0, 0), (0, 0), (-3_600_000, 0), (-3_600_000, 0), (-3_600_000, 0)];
        assert_eq!(steps(&back), [None, None, Some(-3600.0), None, None]);
        // Only the next look tells a step ahead from a delay.
        let ahead = [(0, 0), (0, 0), (250, 0), (250, 0), (250, 0)];
        assert_eq!(steps(&ahead), [None, None, None, Some(0.25), None]);
        assert_eq!(steps(&[(0, 0), (0, 0), (0, 9_000), (0, 0), (0, 0)]), [None; 5]);
        assert_eq!(steps(&[(0, 9_000), (0, 0), (0, 0), (0, 0)]), [None; 4]);
        // A second in two minutes is slewing.
        let slewed: Vec<_> = (0..6000).map(|look| (look / 6, 0)).collect();
        assert!(steps(&slewed).iter().all(Option::is_none));
    }
}
