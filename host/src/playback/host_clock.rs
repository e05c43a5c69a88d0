//! The clock of the host that recorded, as its capture shows it.

use crate::clock::HostInstant;

/// The host's two clocks are read one after the other, and UTC is slewed: less than this is no jump.
const JUMP_NS: u64 = 500_000_000;

/// Notices that UTC was set.
#[derive(Default)]
pub(super) struct HostClock {
    utc_minus_monotonic_ns: Option<u64>,
}

impl HostClock {
    /// By how much the clock was set since the instant before, seconds, if it was.
    pub(super) fn set_by_s(&mut self, at: HostInstant) -> Option<f64> {
        let difference_ns = at.utc_ns.wrapping_sub(at.monotonic_ns);
        let before_ns = self.utc_minus_monotonic_ns.replace(difference_ns)?;
        let jump_ns = difference_ns.wrapping_sub(before_ns).cast_signed();
        (jump_ns.unsigned_abs() > JUMP_NS).then_some(jump_ns as f64 * 1e-9)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_clock_that_is_set_is_noticed_and_one_that_is_slewed_is_not() {
        let mut clock = HostClock::default();
        let at = |monotonic_ns, utc_ns| HostInstant { monotonic_ns, utc_ns };
        assert_eq!(clock.set_by_s(at(5, 105)), None);
        assert_eq!(clock.set_by_s(at(1_000_000_005, 1_000_100_105)), None);
        assert_eq!(clock.set_by_s(at(1_000_000_006, 3_601_000_100_106)), Some(3600.0));
        assert_eq!(clock.set_by_s(at(1_000_000_007, 1_000_100_107)), Some(-3600.0));
    }
}
