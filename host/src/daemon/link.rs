//! The state of the link to a board, shared by all threads; and whether it delivers scans, even if other messages come.

use std::sync::{Mutex, MutexGuard};
use std::time::{Duration, Instant};

use crate::device::{DeviceError, Scanless};
use crate::terminal::say;
use slitpose_head::causes::with_causes;
use slitpose_head::threads::lock;
use slitpose_tracking::clock::HostInstant;
use slitpose_tracking::link::DeviceId;
use slitpose_tracking::pipeline::Counts;
use slitpose_tracking::telemetry::{LinkReport, LinkState};

/// A repeated reason is reported again after this time, then after twice this time, and so on: some twenty times a
/// week.
const TOLD_AGAIN: Duration = Duration::from_secs(2);

const REASONS: usize = 8;

pub(super) struct Link(Mutex<State>);

#[derive(Default)]
struct State {
    report: LinkReport,
    has_run: bool,
    device: Option<DeviceId>,
    missed_since: Option<Instant>,
    /// Whether the user has been told of the loss.
    is_loss_told: bool,
    told: Vec<Told>,
}

struct Told {
    /// The reason without its numbers, which differ each time.
    reason: String,
    at: Instant,
    last: Instant,
    /// Time during which it is not reported again.
    pause: Duration,
    /// Repetitions since the last report.
    untold: u64,
}

impl State {
    fn set(&mut self, state: LinkState, reason: Option<String>) {
        if self.report.state != state {
            self.report.since_utc_ns = HostInstant::now().utc_ns;
        }
        (self.report.state, self.report.reason) = (state, reason);
    }

    /// Whether to report `reason` at `now`; the number of repetitions since it was last reported.
    fn is_told(&mut self, reason: &str, now: Instant) -> Option<u64> {
        let reason = reason.replace(|character: char| character.is_ascii_digit(), "");
        let Some(told) = self.told.iter_mut().find(|told| told.reason == reason) else {
            if self.told.len() == REASONS {
                self.told.remove(0);
            }
            let pause = TOLD_AGAIN;
            self.told.push(Told { reason, at: now, last: now, pause, untold: 0 });
            return Some(0);
        };
        let before = std::mem::replace(&mut told.last, now);
        if now - told.at < told.pause {
            told.untold += 1;
            return None;
        }
        // After an equally long time without this reason, it counts as new.
        told.pause = if now - before >= told.pause { TOLD_AGAIN } else { told.pause.saturating_mul(2) };
        told.at = now;
        Some(std::mem::take(&mut told.untold))
    }
}

impl Link {
    pub(super) fn new() -> Self {
        let mut state = State::default();
        state.report.since_utc_ns = HostInstant::now().utc_ns;
        Self(Mutex::new(state))
    }

    pub(super) fn report(&self) -> LinkReport {
        self.lock().report.clone()
    }

    pub(super) fn is_given_up(&self) -> bool {
        let LinkReport { state, reason, .. } = &self.lock().report;
        *state == LinkState::Ended && reason.is_some()
    }

    /// A port is open, and the board is asked to start.
    pub(super) fn connecting(&self) {
        let mut state = self.lock();
        // The reason of the loss is kept until the board runs.
        let reason = state.report.reason.take();
        state.set(LinkState::Connecting, reason);
    }

    pub(super) fn greeted(&self, device: DeviceId, port: &str) {
        let before = self.lock().device.replace(device);
        if let Some(before) = before.filter(|before| *before != device) {
            say(format_args!("the board on {port} is {device} now; before it was {before}"));
        }
    }

    /// The board samples; what the user is told then.
    pub(super) fn running(&self, port: &str) -> Option<String> {
        let mut state = self.lock();
        state.set(LinkState::Running, None);
        state.report.reconnects += u64::from(state.has_run);
        state.has_run = true;
        state.report.attempts = 0;
        let missed_since = state.missed_since.take();
        let is_told = std::mem::take(&mut state.is_loss_told);
        let missed_s = missed_since.filter(|_| is_told)?.elapsed().as_secs_f64();
        Some(format!("the board on {port} runs; it was missed for {missed_s:.1} s"))
    }

    /// The board is missing or cannot be used; what the user is told then. Each reason is reported once, then less and less
    /// often while it lasts.
    pub(super) fn lost(&self, error: &anyhow::Error) -> Option<String> {
        let reason = with_causes(error.as_ref());
        let mut state = self.lock();
        state.missed_since.get_or_insert_with(Instant::now);
        state.report.attempts += 1;
        let kind = match error.downcast_ref() {
            Some(DeviceError::Quiet { .. } | DeviceError::NoScans { .. } | DeviceError::Stopped { .. }) => {
                LinkState::Quiet
            }
            Some(error) if error.is_passing() && state.has_run => LinkState::Gone,
            Some(error) if error.is_passing() => LinkState::Searching,
            _ => LinkState::Refused,
        };
        let told = state.is_told(&reason, Instant::now());
        state.is_loss_told |= told.is_some();
        state.set(kind, Some(reason.clone()));
        told.map(|untold| match untold {
            0 => format!("{reason}; looking for it"),
            untold => format!("{reason}; looking for it ({untold} times since this was last said)"),
        })
    }

    /// The stream is complete, or the board was given up.
    pub(super) fn ended(&self, error: Option<&anyhow::Error>) {
        let mut state = self.lock();
        state.set(LinkState::Ended, error.map(|error| with_causes(error.as_ref())));
    }

    fn lock(&self) -> MutexGuard<'_, State> {
        lock(&self.0)
    }
}

// Whether scans come.

/// Longest time without a scan from a board that runs, even if it sends other messages …
const NO_SCANS: Duration = Duration::from_secs(3);

/// … or this many frames, if that is longer.
const FRAMES: u32 = 3;

/// An event of the stream of a board.
#[derive(Debug)]
pub(super) enum StreamEvent {
    /// The first scan of the connection has come.
    Scans,
    /// No scan has come for this many seconds; the second field says what came instead.
    Scanless(f64, Scanless),
    Complete,
    /// The board has stopped by itself, with its last warning or error.
    Stopped(Option<String>),
    Unusable(anyhow::Error),
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
    pub(super) fn update(&mut self, opened: bool, counts: &Counts, at: Option<HostInstant>) -> Option<StreamEvent> {
        let come = counts.scans > self.scans;
        if opened {
            self.begun = false;
        }
        if opened || come {
            (self.since, self.scans, self.counts) = (at, counts.scans, *counts);
            let first = come && !self.begun;
            self.begun |= come;
            return first.then_some(StreamEvent::Scans);
        }
        let (Some(since), Some(at)) = (self.since.or(at), at) else { return None };
        self.since = Some(since);
        let missing_ns = at.monotonic_ns.saturating_sub(since.monotonic_ns);
        if missing_ns < self.limit_ns {
            return None;
        }
        // Reported again if the link stays as it is.
        self.since = Some(at);
        Some(StreamEvent::Scanless(missing_ns as f64 * 1e-9, self.cause(counts)))
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

    fn error(of: fn(String) -> DeviceError) -> anyhow::Error {
        of("port".to_owned()).into()
    }

    #[test]
    fn a_board_that_comes_back_is_counted_and_reported_once() {
        let link = Link::new();
        let mut said = Vec::new();
        let missing = error(|name| DeviceError::Missing { name });
        said.extend(link.lost(&missing));
        said.extend(link.lost(&missing));
        assert_eq!((link.report().state, link.report().attempts), (LinkState::Searching, 2));
        link.connecting();
        said.extend(link.running("port"));
        assert_eq!((link.report().state, link.report().reconnects), (LinkState::Running, 0));
        said.extend(link.lost(&error(|name| DeviceError::Quiet { name, seconds: 0.5 })));
        assert_eq!(link.report().state, LinkState::Quiet);
        said.extend(link.lost(&missing));
        assert_eq!(link.report().state, LinkState::Gone);
        said.extend(link.lost(&error(|name| DeviceError::Busy { name })));
        assert_eq!(link.report().state, LinkState::Refused);
        link.connecting();
        assert!(link.report().reason.is_some(), "why it was missed is known until it runs");
        said.extend(link.running("other port"));
        assert_eq!((link.report().reason, link.report().reconnects, link.report().attempts), (None, 1, 0));
        link.ended(Some(&missing));
        assert!(link.report().state == LinkState::Ended && link.report().reason.is_some() && link.is_given_up());
        link.ended(None);
        assert!(link.report().reason.is_none() && !link.is_given_up());
        let kinds: Vec<bool> = said.iter().map(|text| text.contains("looking for it")).collect();
        assert_eq!(kinds, [true, false, true, true, false], "{said:?}");
        assert!(said[4].contains("other port runs"), "{said:?}");
    }

    #[test]
    fn a_repeated_reason_is_reported_ever_more_rarely() {
        let mut state = State::default();
        let began = Instant::now();
        let mut tell =
            |tenths: u32| state.is_told(&format!("{tenths} bytes came"), began + tenths * Duration::from_millis(100));
        // Ten times a second for a minute.
        let told: Vec<_> = (0..600).filter_map(|tenths| Some((tenths, tell(tenths)?))).collect();
        assert_eq!(told, [(0, 0), (20, 19), (60, 39), (140, 79), (300, 159)]);
        // An hour later it counts as new, and is repeated soon after.
        assert_eq!([36_000, 36_010, 36_020].map(&mut tell), [Some(299), None, Some(1)]);
        // Another reason does not wait.
        assert_eq!(state.is_told("another", began), Some(0));
    }

    fn at(seconds: f64) -> Option<HostInstant> {
        Some(HostInstant { monotonic_ns: 1_000_000_000 + (seconds * 1e9) as u64, utc_ns: 0 })
    }

    #[test]
    fn a_link_without_scans_is_reported_with_its_cause_after_three_seconds() {
        let mut watch = ScanWatch::new(Duration::from_micros(250));
        let mut said = |opened, counts: &Counts, seconds| format!("{:?}", watch.update(opened, counts, at(seconds)));
        let missing = |cause| format!("{:?}", Some(StreamEvent::Scanless(3.0, cause)));
        let mut counts = Counts::default();
        assert_eq!(said(true, &counts, 0.0), "None");
        counts.scans = 4;
        assert_eq!(said(false, &counts, 0.1), "Some(Scans)");
        counts.scans = 8;
        assert_eq!(said(false, &counts, 1.0), "None");
        counts.batches_without_hello = 5;
        assert_eq!(said(false, &counts, 3.9), "None");
        assert_eq!(said(false, &counts, 4.0), missing(Scanless::Unexplained { batches: 5 }));
        // A new link: earlier counts do not matter.
        assert_eq!(said(true, &counts, 5.0), "None");
        counts.decoder.malformed = 7;
        counts.decoder.bad_checksum = 6;
        assert_eq!(said(false, &counts, 8.0), missing(Scanless::Unreadable { packets: 7 }));
        assert_eq!(said(true, &counts, 9.0), "None");
        assert_eq!(said(false, &counts, 12.0), missing(Scanless::Nothing));
        counts.scans = 9;
        assert_eq!(said(false, &counts, 12.1), "Some(Scans)");
    }

    #[test]
    fn slow_boards_and_streams_without_time_are_given_longer() {
        let mut slow = ScanWatch::new(Duration::from_secs(2));
        let counts = Counts::default();
        assert!(slow.update(true, &counts, at(0.0)).is_none());
        assert!(slow.update(false, &counts, at(5.9)).is_none());
        assert!(matches!(slow.update(false, &counts, at(6.0)), Some(StreamEvent::Scanless(..))));
        let mut timeless = ScanWatch::new(Duration::from_micros(250));
        assert!((0..10).all(|number| timeless.update(number == 0, &counts, None).is_none()));
        // The first read with a time starts the watch.
        assert!(timeless.update(false, &counts, at(100.0)).is_none());
        assert!(matches!(timeless.update(false, &counts, at(103.0)), Some(StreamEvent::Scanless(..))));
    }
}
