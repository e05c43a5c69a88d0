//! How fast a stream goes, relative to device time.

use std::fmt;
use std::str::FromStr;
use std::time::{Duration, Instant};

/// How fast a stream goes, relative to device time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Speed {
    /// As fast as it can be solved.
    Max,
    /// This many device seconds a second.
    Times(f64),
}

impl FromStr for Speed {
    type Err = &'static str;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        match text {
            "max" => Ok(Self::Max),
            _ => match text.parse::<f64>() {
                Ok(times) if times > 0.0 && times.is_finite() => Ok(Self::Times(times)),
                _ => Err("give `max`, or how many device seconds pass a second, such as 1 or 0.5"),
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

    /// Sleeps until `device_s` may have passed.
    pub fn wait(&self, device_s: f64) {
        if let Speed::Times(times) = self.speed {
            let due = Duration::from_secs_f64(device_s / times);
            std::thread::sleep(due.saturating_sub(self.started.elapsed()));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn speeds_are_read_or_refused() {
        assert_eq!("max".parse(), Ok(Speed::Max));
        assert_eq!("2.5".parse(), Ok(Speed::Times(2.5)));
        for text in ["", "0", "-1", "inf", "nan", "fast"] {
            assert!(text.parse::<Speed>().is_err(), "{text}");
        }
    }
}
