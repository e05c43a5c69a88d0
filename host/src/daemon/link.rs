//! What is known of the link to a board, by all threads.

use std::fmt;
use std::sync::{Arc, Mutex, MutexGuard};
use std::time::Instant;

use super::error::{BoardError, with_causes};
use crate::clock::HostInstant;
use crate::device::{DeviceError, DeviceId};
use crate::telemetry::{LinkReport, LinkState};
use crate::threads::lock;

/// Says something to the user.
pub type Talk = dyn Fn(fmt::Arguments<'_>) + Send + Sync;

/// The link to one board.
pub(super) struct Link {
    state: Mutex<State>,
    talk: Arc<Talk>,
}

#[derive(Default)]
struct State {
    report: LinkReport,
    has_run: bool,
    device: Option<DeviceId>,
    is_given_up: bool,
    missed_since: Option<Instant>,
}

impl State {
    fn set(&mut self, state: LinkState, reason: Option<String>) {
        if self.report.state != state {
            self.report.since_utc_ns = HostInstant::now().utc_ns;
        }
        (self.report.state, self.report.reason) = (state, reason);
    }
}

impl Link {
    pub(super) fn new(talk: Arc<Talk>) -> Self {
        let mut state = State::default();
        state.report.since_utc_ns = HostInstant::now().utc_ns;
        Self { state: Mutex::new(state), talk }
    }

    /// How it is now.
    pub(super) fn report(&self) -> LinkReport {
        self.lock().report.clone()
    }

    pub(super) fn is_given_up(&self) -> bool {
        self.lock().is_given_up
    }

    pub(super) fn say(&self, text: fmt::Arguments<'_>) {
        (self.talk)(text);
    }

    /// A port is open, and a board is asked to start.
    pub(super) fn connecting(&self) {
        let mut state = self.lock();
        // Why it was not running until now is known until it does.
        let reason = state.report.reason.take();
        state.set(LinkState::Connecting, reason);
    }

    /// A board has introduced itself on `port`.
    pub(super) fn greeted(&self, device: DeviceId, port: &str) {
        let before = self.lock().device.replace(device);
        if let Some(before) = before.filter(|before| *before != device) {
            self.say(format_args!("the board on {port} is {device} now; before it was {before}"));
        }
    }

    /// Scans come from `port`.
    pub(super) fn running(&self, port: &str) {
        let mut state = self.lock();
        state.set(LinkState::Running, None);
        state.report.reconnects += u64::from(state.has_run);
        state.has_run = true;
        if let Some(since) = state.missed_since.take() {
            drop(state);
            self.say(format_args!(
                "the board on {port} runs; it was missed for {:.1} s",
                since.elapsed().as_secs_f64()
            ));
        }
    }

    /// The board is not there, or will not do: said once for each reason.
    pub(super) fn lost(&self, error: &BoardError) {
        let reason = with_causes(error);
        let mut state = self.lock();
        state.missed_since.get_or_insert_with(Instant::now);
        let kind = match error {
            BoardError::Device(DeviceError::Quiet { .. } | DeviceError::Stopped { .. }) => LinkState::Quiet,
            error if !error.is_passing() => LinkState::Refused,
            _ if state.has_run => LinkState::Gone,
            _ => LinkState::Searching,
        };
        let is_known = state.report.reason.as_ref() == Some(&reason);
        state.set(kind, Some(reason.clone()));
        drop(state);
        if !is_known {
            self.say(format_args!("{reason}; looking for it"));
        }
    }

    /// Nothing comes any more, because all has come or because the board was given up.
    pub(super) fn ended(&self, error: Option<&BoardError>) {
        let mut state = self.lock();
        state.is_given_up = error.is_some();
        state.set(LinkState::Ended, error.map(|error| with_causes(error)));
    }

    fn lock(&self) -> MutexGuard<'_, State> {
        // What a thread that panicked left is as good as ever: every field is written in one go.
        lock(&self.state)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn error(of: fn(String) -> DeviceError) -> BoardError {
        of("port".to_owned()).into()
    }

    #[test]
    fn a_board_that_comes_back_is_a_reconnection_and_said_once() {
        let said = Arc::new(Mutex::new(Vec::new()));
        let ear = Arc::clone(&said);
        let link = Link::new(Arc::new(move |text| ear.lock().unwrap().push(text.to_string())));
        let missing = error(|name| DeviceError::Missing { name });
        link.lost(&missing);
        link.lost(&missing);
        assert_eq!(link.report().state, LinkState::Searching);
        link.connecting();
        link.running("port");
        assert_eq!((link.report().state, link.report().reconnects), (LinkState::Running, 0));
        link.lost(&error(|name| DeviceError::Quiet { name, seconds: 0.5 }));
        assert_eq!(link.report().state, LinkState::Quiet);
        link.lost(&missing);
        assert_eq!(link.report().state, LinkState::Gone);
        link.lost(&error(|name| DeviceError::Busy { name }));
        assert_eq!(link.report().state, LinkState::Refused);
        link.connecting();
        assert!(link.report().reason.is_some(), "why it was missed is known until it runs");
        link.running("other port");
        assert_eq!((link.report().reason, link.report().reconnects), (None, 1));
        let said = said.lock().unwrap();
        let kinds: Vec<bool> = said.iter().map(|text| text.contains("looking for it")).collect();
        assert_eq!(kinds, [true, false, true, true, true, false], "{said:?}");
        assert!(said[5].contains("other port runs"), "{said:?}");
    }
}
