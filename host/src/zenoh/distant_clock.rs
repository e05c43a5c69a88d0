//! Monotonic times of another host, by the clock of this one.

use crate::clock::HostInstant;
use crate::link::Segment;

/// The least delay is sought within this time, nanoseconds.
const WINDOW_NS: i64 = 5_000_000_000;

/// Most by which times are shifted from one window to the next, nanoseconds: two clocks run apart by 200 ppm at most.
const STEP_NS: i64 = 1_000_000;

/// Shifts the times of another host so that its quickest message came at once. UTC stays that of the other host.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct DistantClock(Option<Shift>);

#[derive(Clone, Copy, Debug)]
struct Shift {
    /// Here minus there.
    ns: i64,
    /// The least delay of the window, and its end by the clock here.
    least_ns: i64,
    ends_ns: i64,
}

impl DistantClock {
    /// Shifts the times of `segment`, which came at `now`.
    pub(super) fn here(&mut self, segment: &mut Segment, now: HostInstant) {
        let Some(sent) = segment.reads.last().and_then(|read| read.at) else { return };
        let (here_ns, there_ns) = (now.monotonic_ns.cast_signed(), sent.monotonic_ns.cast_signed());
        let apart_ns = here_ns.wrapping_sub(there_ns);
        let fresh = Shift { ns: apart_ns, least_ns: i64::MAX, ends_ns: here_ns.saturating_add(WINDOW_NS) };
        let shift = self.0.get_or_insert(fresh);
        shift.least_ns = shift.least_ns.min(apart_ns.wrapping_sub(shift.ns));
        if here_ns >= shift.ends_ns {
            *shift = Shift { ns: shift.ns.wrapping_add(shift.least_ns.clamp(-STEP_NS, STEP_NS)), ..fresh };
        }
        let ns = shift.ns;
        let times = segment.reads.iter_mut().filter_map(|read| read.at.as_mut());
        for at in times.chain(segment.asked.iter_mut().map(|asked| &mut asked.at)) {
            at.monotonic_ns = at.monotonic_ns.wrapping_add_signed(ns);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn delays_are_seen_and_clocks_that_run_apart_are_followed() {
        // 100 ppm apart; a message each 10 ms for a minute, up to 4 ms late.
        let mut clock = DistantClock::default();
        for number in 0..6_000_u64 {
            let there = HostInstant { monotonic_ns: 77_000_000_000 + number * 10_000_000, utc_ns: number };
            let late_ns = number % 5 * 1_000_000;
            let here_ns = 3_000_000_000 + number * 10_001_000 + late_ns;
            let mut segment = Segment::default();
            segment.push(b"x", Some(there));
            clock.here(&mut segment, HostInstant { monotonic_ns: here_ns, utc_ns: 0 });
            let at = segment.reads[0].at.unwrap();
            assert_eq!(at.utc_ns, number);
            let seen_ns = here_ns.wrapping_sub(at.monotonic_ns).cast_signed();
            assert!((seen_ns - late_ns.cast_signed()).abs() <= 1_000_000, "message {number}: {seen_ns} for {late_ns}");
        }
    }
}
