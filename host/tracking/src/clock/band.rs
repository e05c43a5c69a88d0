//! Straight lines between points that bound a clock from above and below.
//!
//! Let x be device time, y host time minus device time, both in nanoseconds. The clock's curve y(x)
//! runs below each arrival and above each answered ping. Around x₀, the newest instant, the curve
//! deviates from y₀ + s (x − x₀) by at most ½ρ(x − x₀)², where ρ is the greatest change of the rate per
//! second. So each point, moved away by that much, bounds the straight line (y₀, s), and all points
//! together leave a convex set of lines: [`Band`]. Bounds from its corners hold for any delays. The
//! line chosen in it has the least sum of delays on both sides and is the likeliest for exponential
//! delays: Moon, Skelly and Towsley, "Estimation and removal of clock skew from network delay
//! measurements", INFOCOM 1999, with its linear programme solved for both sides at once.

use std::collections::VecDeque;

use slitpose_protocol::ClockSource;

/// Host time per point kept.
const BUCKET_NS: u64 = 50_000_000;

/// Points kept. ½ρx² of the oldest is 0.5 ms with an internal oscillator, as large as delays of USB: older ones add
/// nothing.
const BUCKETS: usize = 128;

pub(super) const WINDOW_NS: i64 = BUCKETS as i64 * BUCKET_NS as i64;

/// Times are whole nanoseconds: lines that cross by less do not contradict each other.
const ROUNDING_NS: f64 = 1.0;

/// Lines are found to a rate of 5e-2/2²⁴ = 3e-9 within the widest bounds: 0.02 µs over the window.
const BISECTIONS: usize = 24;

#[derive(Clone, Copy, Debug)]
struct Point {
    x_ns: i64,
    y_ns: i64,
}

/// The tightest points of the last seconds on one side of the curve.
#[derive(Clone, Debug)]
pub(super) struct Envelope {
    /// 1 above, −1 below: the factor with which the least y is the tightest.
    sign: f64,
    points: VecDeque<Point>,
    bucket: u64,
}

impl Envelope {
    /// Of points above the curve, which are arrivals (1), or below it, which are pings (−1).
    pub(super) fn new(sign: f64) -> Self {
        Self { sign, points: VecDeque::with_capacity(BUCKETS), bucket: 0 }
    }

    pub(super) fn clear(&mut self) {
        self.points.clear();
    }

    /// Adds a point from host time `host_ns`; `rate` is about that of the curve. Returns whether it begins a new
    /// bucket.
    pub(super) fn add(&mut self, (x_ns, y_ns): (i64, i64), host_ns: u64, rate: f64) -> bool {
        let point = Point { x_ns, y_ns };
        let bucket = host_ns / BUCKET_NS;
        match self.points.back_mut() {
            Some(last) if self.bucket == bucket => {
                let above = (point.y_ns - last.y_ns) as f64 - rate * (point.x_ns - last.x_ns) as f64;
                if self.sign * above < 0.0 {
                    *last = point;
                }
                return false;
            }
            _ => {}
        }
        if self.points.len() == BUCKETS {
            self.points.pop_front();
        }
        self.points.push_back(point);
        self.bucket = bucket;
        true
    }

    pub(super) fn forget_before(&mut self, x_ns: i64) {
        while self.points.front().is_some_and(|point| point.x_ns < x_ns) {
            self.points.pop_front();
        }
    }

    /// Drops all points before `x_ns` except the newest point: an old bound is better than none.
    pub(super) fn age(&mut self, x_ns: i64) {
        while self.points.len() > 1 && self.points[0].x_ns < x_ns {
            self.points.pop_front();
        }
    }

    /// Device times of the oldest and the newest point. Points come nearly in order: a pong may
    /// overtake a batch.
    pub(super) fn span_ns(&self) -> Option<(i64, i64)> {
        let times = || self.points.iter().map(|point| point.x_ns);
        Some((times().min()?, times().max()?))
    }

    /// The last point at or before `x_ns`.
    pub(super) fn last_until(&self, x_ns: i64) -> Option<(i64, i64)> {
        let point = self.points.iter().rev().find(|point| point.x_ns <= x_ns)?;
        Some((point.x_ns, point.y_ns))
    }

    /// The outermost line of a rate: its y at `x0_ns`, and the distance from `x0_ns` back to the point that
    /// it touches.
    fn outermost(&self, rate: f64, x0_ns: i64, bounds: RateBounds) -> (f64, f64) {
        let mut tightest = (f64::INFINITY, 0.0);
        for point in &self.points {
            let dx_ns = (x0_ns - point.x_ns) as f64;
            let y_ns = self.sign * (point.y_ns as f64 + rate * dx_ns) + bounds.bend_ns(dx_ns);
            if y_ns < tightest.0 {
                tightest = (y_ns, dx_ns);
            }
        }
        (self.sign * tightest.0, tightest.1)
    }

    fn mean_dx_ns(&self, x0_ns: i64) -> f64 {
        let sum: f64 = self.points.iter().map(|point| (x0_ns - point.x_ns) as f64).sum();
        sum / self.points.len() as f64
    }
}

#[derive(Clone, Copy, Debug)]
pub(super) struct Band {
    bounds: RateBounds,
    x0_ns: i64,
    /// The extremes of y₀, over all lines.
    lowest_ns: f64,
    highest_ns: f64,
    /// The extremes of s, over all lines.
    least_rate: f64,
    most_rate: f64,
    pub(super) rate: f64,
    pub(super) y0_ns: f64,
}

impl Band {
    /// The lines within `bounds` between `above` and `below`, neither of which is empty, seen from `x0_ns`, before
    /// which all points lie. `None` if there are none.
    pub(super) fn between(above: &Envelope, below: &Envelope, x0_ns: i64, bounds: RateBounds) -> Option<Self> {
        // Gap between the envelopes for lines of this rate, a concave function of the rate, and its derivative.
        let room = |rate| {
            let ((high_ns, high_dx_ns), (low_ns, low_dx_ns)) =
                (above.outermost(rate, x0_ns, bounds), below.outermost(rate, x0_ns, bounds));
            (high_ns - low_ns + ROUNDING_NS, high_dx_ns - low_dx_ns)
        };
        // Newton's method ends in finitely many steps because the function is piecewise linear, and never
        // oversteps the root because the function is concave: an early stop is on the safe side.
        let edge = |outermost: f64| {
            let mut rate = outermost;
            for _ in 0..BUCKETS {
                let (room_ns, slope_ns) = room(rate);
                if room_ns >= 0.0 {
                    break;
                }
                let next = rate - room_ns / slope_ns;
                let widens_inwards = slope_ns * outermost < 0.0;
                if !widens_inwards || next.abs() > bounds.most_rate {
                    return None;
                }
                rate = next;
            }
            Some(rate)
        };
        let (least_rate, most_rate) = (edge(-bounds.most_rate)?, edge(bounds.most_rate)?);
        let mean_ns = above.mean_dx_ns(x0_ns) - below.mean_dx_ns(x0_ns);
        let (mut left, mut right) = (least_rate, most_rate);
        for _ in 0..BISECTIONS {
            let middle = 0.5 * (left + right);
            let rise_ns = room(middle).1 - mean_ns;
            // With few points several rates are equally likely: the least is taken.
            let is_level = rise_ns.abs() < ROUNDING_NS;
            let lies_right = if is_level { middle < 0.0 } else { rise_ns > 0.0 };
            if lies_right {
                left = middle;
            } else {
                right = middle;
            }
        }
        let rate = 0.5 * (left + right);
        // All points lie before x₀, so a greater rate gives a higher y there.
        let (highest_ns, _) = above.outermost(most_rate, x0_ns, bounds);
        let (lowest_ns, _) = below.outermost(least_rate, x0_ns, bounds);
        let y0_ns = 0.5 * (above.outermost(rate, x0_ns, bounds).0 + below.outermost(rate, x0_ns, bounds).0);
        Some(Self { bounds, x0_ns, lowest_ns, highest_ns, least_rate, most_rate, rate, y0_ns })
    }

    /// Lower and upper bound of the curve's y at `x_ns`.
    pub(super) fn at(&self, x_ns: i64) -> (f64, f64) {
        let dx_ns = (x_ns - self.x0_ns) as f64;
        let (falling, rising) =
            if dx_ns < 0.0 { (self.most_rate, self.least_rate) } else { (self.least_rate, self.most_rate) };
        let slack_ns = self.bounds.bend_ns(dx_ns) + ROUNDING_NS;
        (self.lowest_ns + falling * dx_ns - slack_ns, self.highest_ns + rising * dx_ns + slack_ns)
    }
}

/// Bounds on the rate of a board's clock relative to the host's. The rate is host seconds per board second, minus one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct RateBounds {
    pub(super) most_rate: f64,
    /// Greatest change of the rate per second.
    pub(super) most_wander_per_s: f64,
}

impl RateBounds {
    /// The MCU's internal oscillator. Rate: HSI16 of the STM32G474 has 1 % at 30 °C and another 1 % from 0 to 85 °C
    /// (DS12288, table of HSI16 characteristics), with a margin of 0.5 %. Wander: those 2 % in 85 K, on a board that
    /// warms by 0.1 K per second, are 24 ppm per second.
    const OSCILLATOR: Self = Self { most_rate: 0.025, most_wander_per_s: 25e-6 };

    /// A crystal on the board.
    ///
    /// Rate: ±50 ppm of the board's crystal (20 at 25 °C, 30 over temperature and ageing), ±100 ppm of the host's clock
    /// (50 of its own crystal, 50 of NTP's correction), and a margin of 50 ppm.
    ///
    /// Wander: the rate of an AT-cut crystal changes by at most 1 ppm/K, at the ends of its temperature range. At 0.1 K
    /// per second, as above, that is 0.1 ppm per second, the same again for the host's crystal, and a margin of 0.05.
    ///
    /// NTP may correct a host's clock faster for some minutes after its start (ntpd by up to 500 ppm). The fit falls
    /// back to [`Self::OSCILLATOR`] when its points contradict these bounds.
    const CRYSTAL: Self = Self { most_rate: 200e-6, most_wander_per_s: 0.25e-6 };

    /// The bounds for a clock source; the widest if it is unknown.
    pub(super) fn of(source: Option<ClockSource>) -> Self {
        match source {
            Some(ClockSource::Crystal) => Self::CRYSTAL,
            Some(ClockSource::Internal | ClockSource::CrystalFailed) | None => Self::OSCILLATOR,
        }
    }

    /// Greatest distance of the curve from a straight line at `dx_ns` from the point where they touch.
    pub(super) fn bend_ns(&self, dx_ns: f64) -> f64 {
        0.5e-9 * self.most_wander_per_s * dx_ns * dx_ns
    }
}
