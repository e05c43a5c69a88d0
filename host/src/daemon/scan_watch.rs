//! Detects a link that delivers no scans, even if other messages come.

use std::time::Duration;

use crate::device::Scanless;
use slitpose_tracking::clock::HostInstant;
use slitpose_tracking::pipeline::Counts;

/// Longest time without a scan from a board that runs, even if it sends other messages …
const NO_SCANS: Duration = Duration::from_secs(3);

/// … or this many frames, if that is longer.
const FRAMES: u32 = 3;

/// A change in the scans of a link.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum News {
    /// The first scan has come.
    Begun,
    /// No scan has come for this many seconds; with the most likely cause.
    Missing(f64, Scanless),
}

/// Follows the scans of a link by the time at which their bytes were read, so that a slow host makes no scan late.
#[derive(Debug)]
pub(super) struct ScanWatch {
    limit_ns: u64,
    /// When the link was opened or the last scan came; `None` until a read with a time.
    since: Option<HostInstant>,
    scans: u64,
    begun: bool,
    counts: Counts,
}

impl ScanWatch {
    /// For a board with frames of duration `frame`.
    pub(super) fn new(frame: Duration) -> Self {
        let limit = NO_SCANS.max(frame.saturating_mul(FRAMES));
        Self {
            limit_ns: u64::try_from(limit.as_nanos()).unwrap_or(u64::MAX),
            since: None,
            scans: 0,
            begun: false,
            counts: Counts::default(),
        }
    }

    /// Compares the counters after bytes that were read at `at`; `opened`: these bytes are the first of a link.
    pub(super) fn update(&mut self, opened: bool, counts: &Counts, at: Option<HostInstant>) -> Option<News> {
        let come = counts.scans > self.scans;
        if opened {
            self.begun = false;
        }
        if opened || come {
            (self.since, self.scans, self.counts) = (at, counts.scans, *counts);
            let first = come && !self.begun;
            self.begun |= come;
            return first.then_some(News::Begun);
        }
        let (Some(since), Some(at)) = (self.since.or(at), at) else { return None };
        self.since = Some(since);
        let missing_ns = at.monotonic_ns.saturating_sub(since.monotonic_ns);
        if missing_ns < self.limit_ns {
            return None;
        }
        // Reported again if the link stays as it is.
        self.since = Some(at);
        Some(News::Missing(missing_ns as f64 * 1e-9, self.cause(counts)))
    }

    fn cause(&self, counts: &Counts) -> Scanless {
        let (now, before) = (counts.decoder, self.counts.decoder);
        let unexplained = counts.batches_without_hello - self.counts.batches_without_hello;
        let unreadable = now.unknown + now.malformed + counts.batches_unreadable
            - (before.unknown + before.malformed + self.counts.batches_unreadable);
        let damaged = now.damaged() - before.damaged();
        match [unexplained, unreadable, damaged] {
            [0, 0, 0] => Scanless::Nothing,
            [batches, unreadable, damaged] if batches >= unreadable.max(damaged) => Scanless::Unexplained { batches },
            [_, packets, damaged] if packets >= damaged => Scanless::Unreadable { packets },
            [.., packets] => Scanless::Damaged { packets },
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(seconds: f64) -> Option<HostInstant> {
        Some(HostInstant { monotonic_ns: 1_000_000_000 + (seconds * 1e9) as u64, utc_ns: 0 })
    }

    #[test]
    fn a_link_without_scans_is_reported_with_its_cause_after_three_seconds() {
        let mut scan_watch = ScanWatch::new(Duration::from_micros(250));
        let mut counts = Counts::default();
        assert_eq!(scan_watch.update(true, &counts, at(0.0)), None);
        counts.scans = 4;
        assert_eq!(scan_watch.update(false, &counts, at(0.1)), Some(News::Begun));
        counts.scans = 8;
        assert_eq!(scan_watch.update(false, &counts, at(1.0)), None);
        counts.batches_without_hello = 5;
        assert_eq!(scan_watch.update(false, &counts, at(3.9)), None);
        let cause = Scanless::Unexplained { batches: 5 };
        assert_eq!(scan_watch.update(false, &counts, at(4.0)), Some(News::Missing(3.0, cause)));
        // A new link: earlier counts do not matter.
        assert_eq!(scan_watch.update(true, &counts, at(5.0)), None);
        counts.decoder.malformed = 7;
        counts.decoder.bad_checksum = 6;
        assert_eq!(
            scan_watch.update(false, &counts, at(8.0)),
            Some(News::Missing(3.0, Scanless::Unreadable { packets: 7 }))
        );
        assert_eq!(scan_watch.update(true, &counts, at(9.0)), None);
        assert_eq!(scan_watch.update(false, &counts, at(12.0)), Some(News::Missing(3.0, Scanless::Nothing)));
        counts.scans = 9;
        assert_eq!(scan_watch.update(false, &counts, at(12.1)), Some(News::Begun));
    }

    #[test]
    fn slow_boards_and_streams_without_time_are_given_longer() {
        let mut slow = ScanWatch::new(Duration::from_secs(2));
        let counts = Counts::default();
        assert_eq!(slow.update(true, &counts, at(0.0)), None);
        assert_eq!(slow.update(false, &counts, at(5.9)), None);
        assert!(matches!(slow.update(false, &counts, at(6.0)), Some(News::Missing(..))));
        let mut timeless = ScanWatch::new(Duration::from_micros(250));
        assert!((0..10).all(|number| timeless.update(number == 0, &counts, None).is_none()));
        // The first read with a time starts the watch.
        assert_eq!(timeless.update(false, &counts, at(100.0)), None);
        assert!(matches!(timeless.update(false, &counts, at(103.0)), Some(News::Missing(..))));
    }
}
