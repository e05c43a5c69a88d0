//! A board's ticks by the host's clocks.
//!
//! Bytes sent at a tick arrive after that tick, by an unknown delay; and the tick of a pong is later than
//! the instant at which its ping was about to be sent. So every arrival is an upper bound of the host's
//! time of a tick, and every answered ping a lower one. Straight lines fit in the band between them: their
//! extremes bound the error, and the likeliest is used (`band.rs` has the derivation). Only the least
//! delays matter.
//!
//! # What is promised
//! * The true time of a tick lies within ±[`HostTime::uncertainty_ns`] for any delays, as long as the
//!   board's rate is within 2.5 % of the host's and changes by at most 25 ppm per second; within 200 ppm
//!   and by 0.25 ppm per second once the board reports a crystal ([`RateBounds`]). The division of
//!   the least round trip between its two directions is unknown, so the uncertainty is never less than
//!   about half the least round trip.
//! * A time is never after the arrival of its scan, and never before the previous time: not when the
//!   fit is renewed, nor when the board restarts or the host is suspended. While the fit lies before the
//!   previous time, as it may after the first pongs of a busy host, times advance at half the pace; where
//!   that would pass the arrival, to the middle between the two. Scans share a time only across a restart,
//!   and where none is left to the arrival.
//! * Times approach a new fit within about a second; only a time outside the bounds is corrected at
//!   once.
//! * UTC is the monotonic time plus the difference of the clocks when the last bytes arrived. If the
//!   host's UTC is set forward, times follow within 0.2 s. If it is set back, times advance at half the
//!   pace until it has caught up; meanwhile the uncertainty is that of the monotonic time alone.
//! * The same calls give the same bits. Nothing is allocated after the start; a call costs some
//!   nanoseconds, and twenty times per second some microseconds.
//!
//! # When there is no time
//! * Before the first pong: nothing bounds the constant part of the delay.
//! * After a contradiction, when no line fits between the points of the last seconds: either a clock has
//!   jumped (the monotonic clock stops while the host is suspended, the ticks continue), or the board
//!   does not keep time, such as an emulated one at a third of real time. The older half of the points is
//!   dropped until the rest agrees. If no two pongs 0.4 s apart remain, times resume once there are. If
//!   the next contradiction follows soon, the required time doubles, up to 3.2 s. A board that reports a
//!   crystal may have none, or NTP may correct the host's clock faster than a crystal explains: after a
//!   contradiction the bounds of an internal oscillator hold until the fit is restarted.
//!
//! From the first pong to the second the rate is unknown. The uncertainty then spans from the last ping
//! to the last arrival.

use slitpose_protocol::ClockSource;

use super::band::{Band, Envelope, RateBounds, WINDOW_NS};
use super::{HostInstant, HostTime, UtcOffset};

/// Least time between pongs that shows that a board keeps time. Pings come twice per second.
const PROOF_NS: i64 = 400_000_000;

/// Time constant of the approach to a new fit.
const STEERING_NS: f64 = 1e9;

/// Finds the host's time of a board's ticks.
#[derive(Debug)]
pub struct ClockFit {
    tick_hz: u32,
    arrivals: Envelope,
    questions: Envelope,
    run: Run,
    /// Arrival of the newest bytes.
    newest_ns: u64,
    utc: UtcOffset,
    given: Option<HostTime>,
}

/// What a fit knows since its last restart, besides its points.
#[derive(Debug, Default)]
struct Run {
    /// Source of the board's clock; `None` until the board reports it.
    source: Option<ClockSource>,
    /// The board reports a crystal, and points have contradicted its bounds.
    contradicts_crystal: bool,
    origin: Option<Origin>,
    band: Option<Band>,
    /// The line in use: y at x₀ and the rate from there.
    steered: Option<Steered>,
    trust: Trust,
    last_arrived: Option<u64>,
    last_answered: Option<u64>,
    /// Device time of the last time given; `None` before the first.
    given_x_ns: Option<i64>,
}

/// Origin of device time and host time.
#[derive(Clone, Copy, Debug)]
struct Origin {
    tick: u64,
    host_ns: u64,
}

#[derive(Clone, Copy, Debug)]
struct Steered {
    x0_ns: i64,
    y0_ns: f64,
    rate: f64,
}

impl Steered {
    fn at(&self, x_ns: i64) -> f64 {
        self.y0_ns + self.rate * (x_ns - self.x0_ns) as f64
    }
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
enum Trust {
    #[default]
    New,
    /// Pongs over [`PROOF_NS`] agree.
    Proven {
        doubted: Option<Doubt>,
    },
    Lost(Doubt),
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Doubt {
    since_ns: i64,
    /// Device time over which pongs must agree again.
    proof_ns: i64,
}

impl ClockFit {
    /// A fit for a board that counts `tick_hz` ticks per second.
    pub fn new(tick_hz: u32) -> Self {
        Self {
            tick_hz: tick_hz.max(1),
            arrivals: Envelope::new(1.0),
            questions: Envelope::new(-1.0),
            run: Run::default(),
            newest_ns: 0,
            utc: UtcOffset::default(),
            given: None,
        }
    }

    /// Restarts the fit: the link was reopened, or the ticks restarted, with `tick_hz` of them per second.
    /// New times follow those already given.
    pub fn restart(&mut self, tick_hz: u32) {
        self.tick_hz = tick_hz.max(1);
        self.arrivals.clear();
        self.questions.clear();
        self.run = Run::default();
    }

    /// Sets the source of the board's clock. The first report since a restart narrows the bounds for all points so far.
    /// A report of another source shows that the board has restarted.
    pub fn set_source(&mut self, source: ClockSource) {
        if self.run.source.is_some_and(|before| before != source) {
            self.restart(self.tick_hz);
        }
        self.run.source = Some(source);
    }

    /// Adds an arrival: the host knew at `at` of an event on the board at `tick`, such as the last sample of a batch.
    /// Ticks come in order; a tick before the last one shows that the board has restarted.
    pub fn arrived(&mut self, tick: u64, at: HostInstant) {
        if is_behind(tick, self.run.last_arrived) {
            self.restart(self.tick_hz);
        }
        self.run.last_arrived = Some(tick);
        self.observe(tick, at);
    }

    /// Adds an answered ping: about to be sent at `asked`, read by the board at its `tick`, its answer read at `at`.
    /// As for [`arrived`](Self::arrived), ticks come in order.
    pub fn answered(&mut self, asked: HostInstant, tick: u64, at: HostInstant) {
        if is_behind(tick, self.run.last_answered) {
            self.restart(self.tick_hz);
        }
        self.run.last_answered = Some(tick);
        let (x_ns, origin) = self.device_ns(tick, at);
        let y_ns = since_ns(asked.monotonic_ns, origin) - x_ns;
        self.questions.add((x_ns, y_ns), asked.monotonic_ns, self.rate());
        self.observe(tick, at);
        self.refit(x_ns);
    }

    /// The host's time at `fraction_ticks` after `tick`, if known; see the head of the module. To be called
    /// in the order of the scans, for each after its [`arrived`](Self::arrived).
    pub fn time_of(&mut self, tick: u64, fraction_ticks: f64) -> Option<HostTime> {
        let origin = self.run.origin?;
        let (band, steered) = (self.run.band?, self.run.steered?);
        let x_ns = nominal_ns(tick, origin, self.tick_hz) + nearest(fraction_ticks * 1e9 / f64::from(self.tick_hz));
        let (low_ns, high_ns) = band.at(x_ns);
        let host_ns = |y_ns: f64| instant(origin, x_ns + nearest(y_ns));
        let (earliest_ns, latest_ns) = match self.run.trust {
            Trust::Lost(_) => return None,
            Trust::Proven { .. } => (host_ns(low_ns), host_ns(high_ns).min(self.newest_ns)),
            Trust::New => {
                let (asked_x_ns, asked_y_ns) = self.questions.last_until(x_ns)?;
                (instant(origin, asked_x_ns + asked_y_ns).min(host_ns(low_ns)), self.newest_ns)
            }
        };
        let given_ns = self.given.map_or(0, |given| given.monotonic_ns);
        let passed_ns = self.run.given_x_ns.map_or(0, |given_x_ns| (x_ns - given_x_ns).max(0).cast_unsigned());
        let wanted_ns = host_ns(steered.at(x_ns)).max(given_ns.saturating_add(passed_ns / 2));
        let monotonic_ns = if wanted_ns <= self.newest_ns {
            wanted_ns
        } else {
            self.given.map_or(self.newest_ns, |given| given.monotonic_ns.midpoint(self.newest_ns))
        };
        let utc_ns = self.utc.utc_ns(monotonic_ns);
        let utc_ns = self
            .given
            .map_or(utc_ns, |given| utc_ns.max(given.utc_ns.saturating_add((monotonic_ns - given.monotonic_ns) / 2)));
        let uncertainty_ns = latest_ns.saturating_sub(monotonic_ns).max(monotonic_ns.saturating_sub(earliest_ns));
        self.given = Some(HostTime { monotonic_ns, utc_ns, uncertainty_ns });
        self.run.given_x_ns = Some(x_ns);
        self.given
    }

    fn observe(&mut self, tick: u64, at: HostInstant) {
        self.newest_ns = self.newest_ns.max(at.monotonic_ns);
        self.utc.note(at);
        let (x_ns, origin) = self.device_ns(tick, at);
        let y_ns = since_ns(at.monotonic_ns, origin) - x_ns;
        let is_full = self.arrivals.add((x_ns, y_ns), at.monotonic_ns, self.rate());
        // It arrived before the fit says that it was sent.
        let is_too_early = self.run.steered.is_some_and(|steered| (y_ns as f64) < steered.at(x_ns));
        if is_full || is_too_early {
            self.refit(x_ns);
        }
    }

    /// Device time of a tick; the first ever is the origin.
    fn device_ns(&mut self, tick: u64, at: HostInstant) -> (i64, Origin) {
        let origin = *self.run.origin.get_or_insert(Origin { tick, host_ns: at.monotonic_ns });
        (nominal_ns(tick, origin, self.tick_hz), origin)
    }

    /// Rate error of the board's clock, ppm, positive if fast; `None` while unknown.
    pub fn drift_ppm(&self) -> Option<f64> {
        let is_proven = matches!(self.run.trust, Trust::Proven { .. });
        self.run.band.filter(|_| is_proven).map(|band| -band.rate * 1e6)
    }

    /// Whether the board reports a crystal and its rate has broken the bounds of one.
    pub fn contradicts_crystal(&self) -> bool {
        self.run.contradicts_crystal
    }

    fn bounds(&self) -> RateBounds {
        RateBounds::of(self.run.source.filter(|_| !self.run.contradicts_crystal))
    }

    /// The curve's rate as far as it is known.
    fn rate(&self) -> f64 {
        self.run.band.map_or(0.0, |band| band.rate)
    }

    fn refit(&mut self, x_ns: i64) {
        self.arrivals.age(x_ns - WINDOW_NS);
        self.questions.age(x_ns - WINDOW_NS);
        let mut agreed = true;
        let (band, x0_ns) = loop {
            let (Some(above), Some(below)) = (self.arrivals.span_ns(), self.questions.span_ns()) else {
                self.run.band = None;
                self.run.steered = None;
                break (None, x_ns);
            };
            let (first_ns, x0_ns) = (above.0.min(below.0), above.1.max(below.1));
            let band = Band::between(&self.arrivals, &self.questions, x0_ns, self.bounds());
            if band.is_some() {
                break (band, x0_ns);
            }
            agreed = false;
            self.run.contradicts_crystal = self.run.source == Some(ClockSource::Crystal);
            let newer_ns = first_ns + (x0_ns - first_ns) / 2 + 1;
            self.arrivals.forget_before(newer_ns);
            self.questions.forget_before(newer_ns);
        };
        self.judge(agreed, x0_ns);
        let Some(band) = band else {
            return;
        };
        let (low_ns, high_ns) = band.at(x0_ns);
        let followed = self.run.steered.filter(|_| agreed);
        let y0_ns = followed.map_or(band.y0_ns, |steered| steered.at(x0_ns).clamp(low_ns, high_ns));
        let rate = band.rate + (band.y0_ns - y0_ns) / STEERING_NS;
        self.run.band = Some(band);
        self.run.steered = Some(Steered { x0_ns, y0_ns, rate });
    }

    /// Updates whether the board keeps time; `agreed`: the points allow a line.
    fn judge(&mut self, agreed: bool, x0_ns: i64) {
        let pongs_ns = self.questions.span_ns().map_or(0, |(first_ns, last_ns)| last_ns - first_ns);
        if !agreed && pongs_ns < PROOF_NS {
            let before = match self.run.trust {
                Trust::New => None,
                Trust::Proven { doubted } => doubted,
                Trust::Lost(doubt) => Some(doubt),
            };
            let proof_ns = match before {
                Some(doubt) if x0_ns - doubt.since_ns < 2 * WINDOW_NS => (2 * doubt.proof_ns).min(WINDOW_NS / 2),
                _ => PROOF_NS,
            };
            self.run.trust = Trust::Lost(Doubt { since_ns: x0_ns, proof_ns });
            return;
        }
        match self.run.trust {
            Trust::New if pongs_ns >= PROOF_NS => self.run.trust = Trust::Proven { doubted: None },
            Trust::Lost(doubt) if pongs_ns >= doubt.proof_ns => self.run.trust = Trust::Proven { doubted: Some(doubt) },
            _ => {}
        }
    }
}

/// Whether `tick` is before `last` on a counter that may wrap.
fn is_behind(tick: u64, last: Option<u64>) -> bool {
    last.is_some_and(|last| tick.wrapping_sub(last).cast_signed() < 0)
}

/// Device time of a tick, in whole nanoseconds from the origin.
fn nominal_ns(tick: u64, origin: Origin, tick_hz: u32) -> i64 {
    let ticks = i128::from(tick.wrapping_sub(origin.tick).cast_signed());
    let ns = (ticks * 1_000_000_000).div_euclid(i128::from(tick_hz));
    i64::try_from(ns).unwrap_or(if ns < 0 { i64::MIN / 4 } else { i64::MAX / 4 })
}

fn since_ns(host_ns: u64, origin: Origin) -> i64 {
    host_ns.wrapping_sub(origin.host_ns).cast_signed()
}

fn instant(origin: Origin, since_ns: i64) -> u64 {
    origin.host_ns.saturating_add_signed(since_ns)
}

fn nearest(ns: f64) -> i64 {
    ns.round() as i64
}
