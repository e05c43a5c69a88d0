//! The host's clocks, and a board's clock relative to them.
//!
//! Intervals are measured by the monotonic clock (CLOCK_MONOTONIC, which stops while the host is
//! suspended and is never set), dates by UTC (CLOCK_REALTIME).

mod band;
mod bounds;
mod fit;
#[cfg(test)]
mod tests;
mod utc;

use nix::time::{ClockId, clock_gettime};

pub(crate) use fit::ClockFit;
pub(crate) use utc::UtcWatch;

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
    /// Reads both clocks.
    pub fn now() -> Self {
        Self { monotonic_ns: read(ClockId::CLOCK_MONOTONIC), utc_ns: read(ClockId::CLOCK_REALTIME) }
    }
}

/// Reads a clock, ns; 0 for a clock that cannot be read or is before 1970.
fn read(clock: ClockId) -> u64 {
    clock_gettime(clock).map_or(0, |time| {
        let seconds = u64::try_from(time.tv_sec()).unwrap_or(0);
        seconds.saturating_mul(1_000_000_000).saturating_add(u64::try_from(time.tv_nsec()).unwrap_or(0))
    })
}
