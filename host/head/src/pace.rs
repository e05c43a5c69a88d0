//! The speed of a stream relative to device time.

use std::fmt;
use std::str::FromStr;
use std::time::{Duration, Instant};

/// The speed of a stream relative to device time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Speed {
    /// As fast as it can be solved.
    Max,
    /// This many device seconds a second.
    Times(f64),
}

const SLOWEST: f64 = 1e-3;

impl FromStr for Speed {
    type Err = &'static str;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        match text {
            "max" => Ok(Self::Max),
            _ => match text.parse::<f64>() {
                Ok(times) if times >= SLOWEST && times.is_finite() => Ok(Self::Times(times)),
                _ => Err("give `max`, or how many device seconds pass a second, 0.001 at least, such as 1 or 0.5"),
            },
        }
    }
}

impl fmt::Display for Speed {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Max => f.write_str("max"),
            Self::Times(times) => write!(f, "{times}"),
        }
    }
}

/// Longest sleep after which an interrupt is answered.
const MOMENT: Duration = Duration::from_millis(20);

/// Holds a stream to a multiple of device time.
#[derive(Debug)]
pub struct Pace {
    speed: Speed,
    started: Instant,
}

impl Pace {
    /// Device time 0 is now.
    pub fn new(speed: Speed) -> Self {
        Self { speed, started: Instant::now() }
    }

    /// The speed that it was made with.
    pub fn speed(&self) -> Speed {
        self.speed
    }

    /// Whether a device second lasts a second.
    pub fn is_real_time(&self) -> bool {
        self.speed == Speed::Times(1.0)
    }

    /// Time since device time 0, seconds.
    pub fn elapsed_s(&self) -> f64 {
        self.started.elapsed().as_secs_f64()
    }

    /// Sleeps until `device_s` may have passed.
    pub fn wait(&self, device_s: f64) {
        while !self.nap(device_s) {}
    }

    /// Sleeps the same, but for a moment at most; whether `device_s` may have passed then.
    pub fn nap(&self, device_s: f64) -> bool {
        let Speed::Times(times) = self.speed else {
            return true;
        };
        // A clock that has gone back, or to an absurd time, is not waited for.
        let due = Duration::try_from_secs_f64((device_s / times).max(0.0)).unwrap_or(Duration::MAX);
        let left = due.saturating_sub(self.started.elapsed());
        std::thread::sleep(left.min(MOMENT));
        left <= MOMENT
    }

    /// Shifts the start by `lost`, time for which the stream is not to blame.
    pub fn excuse(&mut self, lost: Duration) {
        self.started += lost;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn speeds_are_read_or_refused() {
        assert_eq!("max".parse(), Ok(Speed::Max));
        assert_eq!("2.5".parse(), Ok(Speed::Times(2.5)));
        for text in ["", "0", "1e-30", "-1", "inf", "nan", "fast"] {
            assert!(text.parse::<Speed>().is_err(), "{text}");
        }
    }

    #[test]
    fn clocks_that_jump_are_survived() {
        let pace = Pace::new(Speed::Times(1.0));
        assert!(pace.nap(-5.0) && pace.nap(f64::NAN));
        assert!(!pace.nap(60.0) && !pace.nap(1e300), "at most a moment each");
    }
}
