//! Faults in a stream that a sound board never shows, and their effect on the poses.

use thiserror::Error;

use super::PoseFault;
use crate::link::DeviceId;

/// A fault in a stream that a sound board never shows. Poses continue.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
pub enum Oddity {
    /// Number and tick of a scan do not fit those of the previous scan.
    #[error(
        "the board's clock jumped by {seconds:+.6} s between the scans {before} and {after}: device times before and \
         after it do not compare; if it comes again, reset the board"
    )]
    ClockJump {
        /// Size of the jump, positive if forward.
        seconds: f64,
        /// Number of the last scan before the jump.
        before: u64,
        /// Number of the first scan after the jump.
        after: u64,
    },
    /// True poses from a board that says it measures; only simulated boards have them.
    #[error(
        "the board says that it measures, and sends true poses as simulated ones do: they are left out; flash its \
         firmware anew"
    )]
    Truth,
    /// The board solves poses by another head than this one.
    #[error(
        "the board's poses are of another head than that of the scene and the calibration given: they are left out; \
         store this head with `slitpose device set`, or give the scene and the calibration that the board has"
    )]
    OtherHead,
    /// A pose of the board cannot be right.
    #[error(
        "the board's pose of scan {sequence} cannot be right: {fault}; it is left out, as {count} in all so far; build \
         firmware and program from the same source, and use --stream raw until then"
    )]
    Pose {
        /// Number of the scan.
        sequence: u64,
        /// The fault.
        fault: PoseFault,
        /// Poses left out so far.
        count: u64,
    },
    /// The board's number changed although the link was not reopened.
    #[error(
        "the board calls itself {now} in the midst of its stream, and was {before}: the poses that follow are told as \
         those of {now}; see that one board alone is on this port, then reset it"
    )]
    Renamed {
        /// The board's number before.
        before: DeviceId,
        /// The board's number now.
        now: DeviceId,
    },
}

/// Finds jumps of a board's clock: between two scans, the ticks must advance by one frame per number.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct ClockWatch {
    /// Number and tick of the last scan of this link and this session.
    last: Option<(u64, u64)>,
    jumps: u64,
}

impl ClockWatch {
    /// Restarts the check for another link, configuration or board.
    pub(super) fn begin_anew(&mut self) {
        self.last = None;
    }

    /// Checks the next scan of a board whose frames last `frame_ticks`. Of many jumps, the first, second, fourth,
    /// eighth … are reported.
    pub(super) fn check(&mut self, sequence: u64, tick: u64, frame_ticks: u32, tick_hz: f64) -> Option<Oddity> {
        let (before, before_tick) = self.last.replace((sequence, tick))?;
        // A number that goes back means that the board has restarted.
        let frames = sequence.checked_sub(before)?;
        let expected = i128::from(before_tick) + i128::from(frames) * i128::from(frame_ticks);
        let ahead = i128::from(tick) - expected;
        if ahead.unsigned_abs() <= u128::from(frame_ticks / 2) {
            return None;
        }
        self.jumps += 1;
        let seconds = ahead as f64 / tick_hz;
        self.jumps.is_power_of_two().then_some(Oddity::ClockJump { seconds, before, after: sequence })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn clock_jumps_are_reported_and_gaps_and_restarts_are_not() {
        let mut watch = ClockWatch::default();
        let mut check = |sequence, tick| watch.check(sequence, tick, 1000, 1e6);
        for (sequence, tick) in [(10, 500), (11, 1500), (20, 10_500), (0, 70), (1, 1070), (2, 2500), (3, 3100)] {
            assert_eq!(check(sequence, tick), None, "{sequence}");
        }
        assert_eq!(check(4, 5100), Some(Oddity::ClockJump { seconds: 1e-3, before: 3, after: 4 }));
        assert_eq!(check(5, 100), Some(Oddity::ClockJump { seconds: -6e-3, before: 4, after: 5 }));
        assert_eq!(check(6, 1100), None);
        // The third is not reported, the fourth is.
        assert_eq!(check(7, u64::MAX), None);
        assert!(matches!(check(8, 0), Some(Oddity::ClockJump { seconds, .. }) if seconds < -1e13));
        watch.begin_anew();
        assert_eq!(watch.check(9, 77, 1000, 1e6), None);
    }
}
