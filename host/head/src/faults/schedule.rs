//! When a fault acts: device time, counted from the first scan.

/// The spans in which a fault acts, seconds of device time since the first scan.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Window {
    /// Begin of the first span.
    pub from_s: f64,
    /// Duration of a span; infinite: to the end, or to the next span.
    pub for_s: f64,
    /// Time from the begin of a span to that of the next; `None`: there is one span.
    pub every_s: Option<f64>,
}

/// Rounding of times does not move a begin or an end: less than a tick of any board.
const ROUNDING_S: f64 = 1e-9;

impl Window {
    /// How many spans have begun by `time_s`.
    pub fn begun(&self, time_s: f64) -> u64 {
        let since_s = time_s - self.from_s + ROUNDING_S;
        match self.every_s {
            _ if since_s < 0.0 => 0,
            Some(every_s) => 1 + (since_s / every_s) as u64,
            None => 1,
        }
    }

    /// Time since the span under way began; `None` outside of all spans.
    pub fn since_s(&self, time_s: f64) -> Option<f64> {
        let begun = self.begun(time_s).checked_sub(1)?;
        let since_s = (time_s - self.from_s - begun as f64 * self.every_s.unwrap_or(0.0)).max(0.0);
        (since_s + ROUNDING_S < self.for_s).then_some(since_s)
    }

    /// Whether `time_s` lies in a span.
    pub fn is_open(&self, time_s: f64) -> bool {
        self.since_s(time_s).is_some()
    }
}

/// Device time since the first scan, from the ticks of scans. It goes on where a board restarts its counters.
#[derive(Clone, Copy, Debug, Default)]
pub struct FaultClock {
    /// Tick of zero, and the latest tick; `None` before the first scan.
    ticks: Option<(u64, u64)>,
    /// Ticks before the board last began anew.
    earlier_ticks: u64,
}

impl FaultClock {
    /// The device time of a scan that began at `tick`, seconds.
    pub fn take(&mut self, tick: u64, tick_hz: u32) -> f64 {
        let (first, last) = self.ticks.unwrap_or((tick, tick));
        let first = if tick < last {
            self.earlier_ticks += last - first;
            tick
        } else {
            first
        };
        self.ticks = Some((first, tick));
        (self.earlier_ticks + (tick - first)) as f64 / f64::from(tick_hz)
    }

    /// The device time at `tick`, at least that of the latest scan; `None` before the first scan.
    pub fn at(&self, tick: u64, tick_hz: u32) -> Option<f64> {
        let (first, last) = self.ticks?;
        Some((self.earlier_ticks + (tick.max(last) - first)) as f64 / f64::from(tick_hz))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn spans_repeat_and_end() {
        let once = Window { from_s: 1.0, for_s: 0.5, every_s: None };
        assert_eq!([0.0, 0.999, 1.0, 1.4, 1.5, 9.0].map(|t| once.is_open(t)), [false, false, true, true, false, false]);
        let often = Window { from_s: 1.0, for_s: 0.1, every_s: Some(0.3) };
        let opened: Vec<u32> = (0..20).filter(|tenth| often.is_open(f64::from(*tenth) / 10.0)).collect();
        assert_eq!(opened, [10, 13, 16, 19]);
        assert_eq!([0.0, 1.0, 1.29, 1.3, 2.2].map(|t| often.begun(t)), [0, 1, 1, 2, 5]);
        assert!(Window { for_s: f64::INFINITY, ..once }.is_open(1e9));
    }

    #[test]
    fn the_clock_goes_on_where_ticks_begin_anew() {
        let mut clock = FaultClock::default();
        assert_eq!(clock.at(1000, 100), None);
        let times = [1000, 1100, 1250, 40, 90].map(|tick| clock.take(tick, 100));
        assert_eq!(times, [0.0, 1.0, 2.5, 2.5, 3.0]);
        assert_eq!([140, 3].map(|tick| clock.at(tick, 100)), [Some(3.5), Some(3.0)]);
    }
}
