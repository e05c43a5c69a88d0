//! The clock of the connected board relative to the host's, from reads and pings.

use slitpose_protocol::{ClockSource, Pong};

use crate::clock::{ClockFit, HostInstant, HostTime};
use crate::link::Asked;
use crate::link::DeviceId;

/// Most pings that wait for their answers: those of four seconds.
const PINGS: usize = 8;

/// Reads, pings and the fit to them.
#[derive(Debug, Default)]
pub(super) struct BoardClock {
    /// Time of the read of the bytes being decoded.
    at: Option<HostInstant>,
    /// The last pings without an answer, the oldest at `next`.
    asked: [Option<Asked>; PINGS],
    next: usize,
    board: Option<(DeviceId, u32)>,
    fit: Option<ClockFit>,
}

impl BoardClock {
    /// The link was reopened: pending pings are lost, and the board may be another one.
    pub(super) fn reopen(&mut self) {
        self.asked = [None; PINGS];
        if let (Some(fit), Some((_, tick_hz))) = (&mut self.fit, self.board) {
            fit.restart(tick_hz);
        }
    }

    /// A ping was sent.
    pub(super) fn ask(&mut self, asked: Asked) {
        self.asked[self.next] = Some(asked);
        self.next = (self.next + 1) % PINGS;
    }

    /// The next bytes were read at `at`.
    pub(super) fn read(&mut self, at: Option<HostInstant>) {
        self.at = at;
    }

    /// Time of the read of the bytes being decoded.
    pub(super) fn at(&self) -> Option<HostInstant> {
        self.at
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

    /// A ping was answered.
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

    /// Sets the source of the board's clock.
    pub(super) fn set_source(&mut self, source: ClockSource) {
        if let Some(fit) = &mut self.fit {
            fit.set_source(source);
        }
    }

    /// Rate error of the board's clock, ppm; positive if fast.
    pub(super) fn drift_ppm(&self) -> Option<f64> {
        self.fit.as_ref()?.drift_ppm()
    }

    /// Whether the board reports a crystal and its rate has broken the bounds of one.
    pub(super) fn contradicts_crystal(&self) -> bool {
        self.fit.as_ref().is_some_and(ClockFit::contradicts_crystal)
    }

    /// The host's time at `fraction_ticks` after `tick`.
    pub(super) fn time_of(&mut self, tick: u64, fraction_ticks: f64) -> Option<HostTime> {
        self.at?;
        self.fit.as_mut()?.time_of(tick, fraction_ticks)
    }
}
