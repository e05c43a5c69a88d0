//! Which poses a capture has, besides the bytes from which all of them follow.

/// Chooses poses at a rate of device time.
#[derive(Clone, Copy, Debug)]
pub struct PoseRate {
    every_s: f64,
    /// The device time from which on the next pose is kept, seconds.
    due_s: f64,
}

impl PoseRate {
    /// One pose in so many seconds; zero for every pose.
    pub fn every(every_s: f64) -> Self {
        Self { every_s, due_s: f64::NEG_INFINITY }
    }

    /// Whether a pose of `time_s` is kept.
    pub fn is_due(&mut self, time_s: f64) -> bool {
        let every_s = self.every_s;
        // Device time may restart.
        let is_due = time_s >= self.due_s || time_s < self.due_s - 2.0 * every_s;
        if is_due {
            // One period after the last one was due, so that the rate does not drift; unless that is not the next period.
            let next_s = self.due_s + every_s;
            self.due_s = if next_s > time_s && next_s <= time_s + every_s { next_s } else { time_s + every_s };
        }
        is_due
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn poses_are_kept_at_their_rate_also_when_device_time_restarts() {
        let mut rate = PoseRate::every(0.04);
        // 4 kHz for 10 s, a reset, 4 kHz for 5 s, and a jump ahead by a minute.
        let times = (0..40_000).chain(0..20_000).chain(260_000..264_000).map(|scan| f64::from(scan) / 4000.0);
        let kept: Vec<f64> = times.filter(|&time_s| rate.is_due(time_s)).collect();
        // 25 a second, and one for each new beginning at most.
        assert!((400..=402).contains(&kept.len()), "{}", kept.len());
    }
}
