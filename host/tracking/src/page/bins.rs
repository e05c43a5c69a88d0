//! What plots need of every scan: counts, means, extremes and spread of pose and velocity in bins of time.
//!
//! The page plots these bins only, so a motion between two of its frames shows as the range that it covers, and never as a
//! slower motion.

use std::mem::replace;

use crate::pipeline::Record;
use slitpose_calibration::values_of;
use slitpose_model::TwistEstimate;

/// Fine bins per second of the board's clock: twelve in a period of a tool that shakes at 20 Hz.
pub const FINE_HZ: u64 = 240;

/// Coarse bins per second, a whole part of [`FINE_HZ`]: a pixel of a plot of ten minutes covers several.
pub const COARSE_HZ: u64 = 20;

/// Most fine bins in a sample, 24 times those of a board in real time: of a capture that is played faster, plots get the
/// coarse bins only.
pub const MAX_FINE: usize = 192;

/// Six coordinates of the pose, and six of the velocity.
const QUANTITIES: usize = 12;

/// One quantity in one bin.
#[derive(Clone, Copy, Debug, Default)]
struct Moments {
    count: f64,
    mean: f64,
    low: f64,
    high: f64,
    /// Sum of squared deviations from the mean.
    squares: f64,
    /// Sum of the standard deviations that the solver states.
    sigmas: f64,
}

impl Moments {
    fn of(value: f64, variance: f64) -> Self {
        Self { count: 1.0, mean: value, low: value, high: value, squares: 0.0, sigmas: variance.sqrt() }
    }

    /// Chan, Golub and LeVeque 1983, equation (2.1).
    fn merge(&mut self, other: &Self) {
        if self.count == 0.0 || other.count == 0.0 {
            *self = if self.count == 0.0 { *other } else { *self };
            return;
        }
        let (count, apart) = (self.count + other.count, other.mean - self.mean);
        self.squares += other.squares + apart * apart * self.count * other.count / count;
        self.mean += apart * other.count / count;
        (self.low, self.high) = (self.low.min(other.low), self.high.max(other.high));
        (self.count, self.sigmas) = (count, self.sigmas + other.sigmas);
    }
}

/// The scans of a span of time.
#[derive(Clone, Debug, Default)]
pub struct Bin {
    /// It covers device times from `index` to `index + 1`, divided by its rate.
    index: i64,
    scans: u32,
    quantities: [Moments; QUANTITIES],
}

impl Bin {
    fn of(record: &Record) -> Self {
        let index = (record.device_time_s * FINE_HZ as f64).floor() as i64;
        let mut bin = Self { index, scans: 1, ..Self::default() };
        let (pose, velocity) = bin.quantities.split_at_mut(QUANTITIES / 2);
        let fill = |moments: &mut [Moments], values: [f64; 6], covariance: &[[f64; 6]; 6]| {
            moments.iter_mut().enumerate().for_each(|(i, it)| *it = Moments::of(values[i], covariance[i][i]));
        };
        if let Some(estimate) = &record.solution.estimate {
            fill(pose, values_of(&estimate.pose), &estimate.covariance);
        }
        if let Ok(TwistEstimate { twist, covariance }) = &record.twist {
            let [v, w] = [twist.linear_m_per_s, twist.angular_rad_per_s];
            fill(velocity, [v.x, v.y, v.z, w.x, w.y, w.z], covariance);
        }
        bin
    }

    fn merge(&mut self, other: &Self) {
        self.scans += other.scans;
        self.quantities.iter_mut().zip(&other.quantities).for_each(|(own, other)| own.merge(other));
    }

    /// The numbers of a message, in the order and units that `LIVE.md` states; zeros for what has no values.
    pub(super) fn numbers(&self) -> Vec<i64> {
        let of = |column: fn(&Moments) -> f64| {
            let scaled =
                move |(number, it): (usize, &Moments)| column(it) * if number < QUANTITIES / 2 { 1e9 } else { 1e6 };
            self.quantities.iter().enumerate().map(scaled).map(|number| number.round() as i64)
        };
        let [poses, velocities] = [0, QUANTITIES / 2].map(|first| self.quantities[first].count as i64);
        let mut numbers = vec![self.index, self.scans.into(), poses, velocities];
        numbers.extend(of(|it| it.mean).chain(of(|it| it.mean - it.low)).chain(of(|it| it.high - it.mean)));
        numbers.extend(of(|it| (it.squares / it.count).sqrt()).chain(of(|it| it.sigmas / it.count)));
        numbers
    }
}

/// Bins that are complete.
#[derive(Clone, Debug, Default)]
pub struct Bins {
    /// The first ones; if they are 192, others may be missing.
    pub fine: Vec<Bin>,
    /// Wider ones.
    pub coarse: Vec<Bin>,
}

/// Sorts the records of one board into bins.
#[derive(Debug, Default)]
pub struct Binner {
    fine: Bin,
    coarse: Bin,
}

impl Binner {
    /// Adds a record, and to `bins` those that are complete with it. A clock that goes back begins anew.
    pub(super) fn add(&mut self, record: &Record, bins: &mut Bins) {
        let bin = Bin::of(record);
        if bin.index < self.fine.index {
            *self = Self::default();
            *bins = Bins::default();
        }
        let Some(done) = put(&mut self.fine, bin) else { return };
        let index = done.index.div_euclid((FINE_HZ / COARSE_HZ) as i64);
        bins.coarse.extend(put(&mut self.coarse, Bin { index, ..done.clone() }));
        bins.fine.extend((bins.fine.len() < MAX_FINE).then_some(done));
    }
}

/// Merges `bin` into the `open` one if it is of the same time; otherwise opens it and returns the one before, if any.
fn put(open: &mut Bin, bin: Bin) -> Option<Bin> {
    if open.index == bin.index {
        open.merge(&bin);
        return None;
    }
    Some(replace(open, bin)).filter(|done| done.scans > 0)
}
