//! The clock of the connected board relative to the host's, from reads and pings.

use slitpose_protocol::Pong;

use crate::clock::{ClockFit, HostInstant, HostTime};
use crate::link::{Asked, DeviceId};

/// Most pings that wait for their answers: those of four seconds.
const PINGS: usize = 8;

/// Reads, pings and the fit to them.
#[derive(Debug, Default)]
pub(super) struct BoardClock {
    /// Time of the read of the bytes being decoded.
    pub(super) at: Option<HostInstant>,
    /// The last pings without an answer, the oldest at `next`.
    asked: [Option<Asked>; PINGS],
    next: usize,
    board: Option<(DeviceId, u32)>,
    pub(super) fit: Option<ClockFit>,
}

impl BoardClock {
    /// The link was reopened: pending pings are lost, and the board may be another one.
    pub(super) fn reopen(&mut self) {
        self.asked = [None; PINGS];
        if let (Some(fit), Some((_, tick_hz))) = (&mut self.fit, self.board) {
            fit.restart(tick_hz);
        }
    }

    pub(super) fn ask(&mut self, asked: Asked) {
        self.asked[self.next] = Some(asked);
        self.next = (self.next + 1) % PINGS;
    }

    /// A board has introduced itself; the fit is kept if it is the same board.
    pub(super) fn meet(&mut self, device: DeviceId, tick_hz: u32) {
        match (&mut self.fit, self.board) {
            (Some(_), Some(known)) if known == (device, tick_hz) => return,
            (Some(fit), Some((known, _))) if known == device => fit.restart(tick_hz),
            _ => self.fit = Some(ClockFit::new(tick_hz)),
        }
        self.board = Some((device, tick_hz));
    }

    pub(super) fn answer(&mut self, pong: &Pong) {
        let matches = |asked: &&mut Option<Asked>| asked.is_some_and(|asked| asked.token == pong.token);
        let Some(asked) = self.asked.iter_mut().find(matches).and_then(Option::take) else {
            return;
        };
        if let (Some(fit), Some(at)) = (&mut self.fit, self.at) {
            fit.answered(asked.at, pong.tick, at);
        }
    }

    /// A batch has come whose last sample was taken at `last_tick`.
    pub(super) fn arrive(&mut self, last_tick: u64) {
        if let (Some(fit), Some(at)) = (&mut self.fit, self.at) {
            fit.arrived(last_tick, at);
        }
    }

    /// The host's time at `fraction_ticks` after `tick`.
    pub(super) fn time_of(&mut self, tick: u64, fraction_ticks: f64) -> Option<HostTime> {
        self.at?;
        self.fit.as_mut()?.time_of(tick, fraction_ticks)
    }
}

/// Tolerance for device times, seconds: they are exact to nanoseconds, and frames are microseconds apart.
const ROUNDING_S: f64 = 1e-9;

#[derive(Debug, Default)]
pub(super) struct Span {
    until_s: Option<f64>,
    first_s: Option<f64>,
    last_s: f64,
    /// Device time between the first scan and the last.
    pub(super) elapsed_s: f64,
    /// Whether the last scan of the span, or a later one, has come.
    pub(super) is_complete: bool,
}

impl Span {
    /// A span that ends `until_s` seconds after its first scan, or never.
    pub(super) fn until(until_s: Option<f64>) -> Self {
        Self { until_s, ..Self::default() }
    }

    /// Whether a scan at `device_time_s` belongs to the span; the next one comes `period_s` later.
    pub(super) fn admits(&mut self, device_time_s: f64, period_s: f64) -> bool {
        let first_s = self.first_s.get_or_insert(device_time_s);
        if device_time_s < self.last_s {
            // The clock restarted: the new times follow the old ones.
            *first_s = device_time_s - self.elapsed_s - period_s;
        }
        self.last_s = device_time_s;
        let elapsed_s = device_time_s - *first_s;
        let ends_by = |time_s: f64| self.until_s.is_some_and(|until_s| time_s >= until_s - ROUNDING_S);
        let admitted = !ends_by(elapsed_s);
        self.is_complete |= !admitted || ends_by(elapsed_s + period_s);
        if admitted {
            self.elapsed_s = elapsed_s;
        }
        admitted
    }

    /// How many scans of the span, `period_s` apart, are still to come; none of a span without end.
    pub(super) fn left(&self, period_s: f64) -> u64 {
        let Some(until_s) = self.until_s.filter(|_| !self.is_complete) else { return 0 };
        let next_s = if self.first_s.is_some() { self.elapsed_s + period_s } else { 0.0 };
        // Saturates.
        ((until_s - ROUNDING_S - next_s) / period_s).ceil().max(0.0) as u64
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_left_of_a_span_ends_before_its_end() {
        let mut span = Span::until(Some(1.0));
        assert_eq!(span.left(0.25), 4);
        for (device_time_s, left) in [(7.0, 3), (7.5, 1), (7.75, 0), (8.0, 0)] {
            span.admits(device_time_s, 0.25);
            assert_eq!(span.left(0.25), left, "{device_time_s}");
        }
        assert_eq!(Span::until(None).left(0.25), 0);
    }

    #[test]
    fn the_last_scan_completes_a_span_and_so_does_a_later_one() {
        let mut span = Span::until(Some(1.0));
        for (device_time_s, admitted, complete) in [(7.25, true, false), (7.75, true, false), (8.0, true, true)] {
            assert_eq!((span.admits(device_time_s, 0.25), span.is_complete), (admitted, complete));
        }
        assert!(!span.admits(8.25, 0.25));
        assert_eq!(span.elapsed_s, 0.75);

        // The last one was lost.
        let mut span = Span::until(Some(1.0));
        assert!(span.admits(0.0, 0.25) && !span.is_complete);
        assert!(!span.admits(1.0, 0.25) && span.is_complete);

        // The board was restarted: its clock begins at 0 again.
        let mut span = Span::until(Some(1.0));
        for (device_time_s, admitted) in [(7.0, true), (7.25, true), (0.5, true), (0.75, true), (1.0, false)] {
            assert_eq!(span.admits(device_time_s, 0.25), admitted, "{device_time_s}");
        }
        assert!(span.is_complete);

        let mut endless = Span::until(None);
        assert!(endless.admits(0.0, 0.25) && endless.admits(1e9, 0.25) && !endless.is_complete);
    }
}
