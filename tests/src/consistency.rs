//! Poses against the truth: e = [t̂ − t ; log(R̂ Rᵀ)], judged by the covariance that came with them; and how far chance
//! goes.

use std::ops::Range;

use slitpose_model::{Estimate, Pose};

/// Error of `estimate`: metres, then radians, in the base frame.
pub fn error(estimate: &Pose, truth: &Pose) -> [f64; 6] {
    let (dt, dr) = estimate.displacement_from(truth);
    [dt.x, dt.y, dt.z, dr.x, dr.y, dr.z]
}

/// The largest error of an axis in units of its σ.
pub fn worst_axis(estimate: &Estimate, truth: &Pose) -> f64 {
    let error = error(&estimate.pose, truth);
    error.iter().zip(estimate.sigma()).map(|(error, sigma)| error.abs() / sigma).fold(0.0, f64::max)
}

/// How well many poses and their covariances agree with the truth.
#[derive(Clone, Debug)]
pub struct Honesty {
    pub poses: usize,
    /// χ² of six degrees of freedom has the median 5.35.
    pub median_nees: f64,
    /// Of 240 000 normal numbers, those of 40 000 poses, 0.14 lie beyond 5 σ.
    pub beyond_five_sigma: usize,
    pub worst_sigmas: f64,
    /// Root mean square of three axes.
    pub rms_m: f64,
    pub rms_rad: f64,
    /// Of one axis.
    pub largest_m: f64,
}

impl Honesty {
    /// Of estimates, each with the true pose.
    pub fn of(poses: impl IntoIterator<Item = (Estimate, Pose)>) -> Self {
        let poses: Vec<_> = poses.into_iter().collect();
        let errors: Vec<_> = poses.iter().map(|(estimate, truth)| error(&estimate.pose, truth)).collect();
        let rms = |axes: Range<usize>| {
            let square = errors.iter().flat_map(|error| &error[axes.clone()]).map(|axis| axis * axis).sum::<f64>();
            (square / (errors.len() * axes.len()) as f64).sqrt()
        };
        let worst = || poses.iter().map(|(estimate, truth)| worst_axis(estimate, truth));
        let nees = |(estimate, truth): &(Estimate, Pose)| estimate.nees(truth).expect("a regular covariance");
        let honesty = Self {
            poses: errors.len(),
            median_nees: median(poses.iter().map(nees)),
            beyond_five_sigma: worst().filter(|sigmas| *sigmas > 5.0).count(),
            worst_sigmas: worst().fold(0.0, f64::max),
            rms_m: rms(0..3),
            rms_rad: rms(3..6),
            largest_m: errors.iter().flat_map(|error| &error[..3]).fold(0.0, |most, axis| most.max(axis.abs())),
        };
        println!("{honesty:?}");
        honesty
    }

    /// Asserts that the covariance is neither too small nor too large, and that few poses are off by what chance never does.
    #[track_caller]
    pub fn assert(&self, median_nees: Range<f64>, most_beyond_five_sigma: usize) {
        assert!(median_nees.contains(&self.median_nees), "{self:?}");
        assert!(self.beyond_five_sigma <= most_beyond_five_sigma, "{self:?}");
    }
}

/// Numbers in order.
#[derive(Clone, Debug, Default)]
pub struct Sorted(pub Vec<f64>);

impl Sorted {
    pub fn of(values: impl IntoIterator<Item = f64>) -> Self {
        let mut values: Vec<f64> = values.into_iter().collect();
        assert!(values.iter().all(|value| !value.is_nan()), "NaN has no place in an order");
        values.sort_by(f64::total_cmp);
        Self(values)
    }

    /// The least number that `share` of them do not exceed; NaN of none.
    pub fn at(&self, share: f64) -> f64 {
        let rank = (share * self.0.len() as f64).ceil() as usize;
        self.0.get(rank.max(1) - 1).copied().unwrap_or(f64::NAN)
    }

    pub fn median(&self) -> f64 {
        self.0.get(self.0.len() / 2).copied().unwrap_or(f64::NAN)
    }

    pub fn most(&self) -> f64 {
        self.at(1.0)
    }
}

pub fn median(values: impl IntoIterator<Item = f64>) -> f64 {
    Sorted::of(values).median()
}
