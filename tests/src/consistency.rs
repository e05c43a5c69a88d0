//! Poses against the truth: e = [t̂ − t ; log(R̂ Rᵀ)], judged by the covariance that came with them; and how far chance
//! goes.

use std::ops::Range;

use glam::{DQuat, DVec3};
use slitpose_model::Pose;

/// A 6×6 matrix, row by row.
pub type Matrix6 = [[f64; 6]; 6];

/// Error of `estimate`: metres, then radians, in the base frame.
pub fn error(estimate: &Pose, truth: &Pose) -> [f64; 6] {
    let dt = estimate.translation_m - truth.translation_m;
    let dr = log(estimate.rotation * truth.rotation.conjugate());
    [dt.x, dt.y, dt.z, dr.x, dr.y, dr.z]
}

fn log(rotation: DQuat) -> DVec3 {
    let [x, y, z, w] = rotation.to_array();
    let sine = DVec3::new(x, y, z) * w.signum();
    let length = sine.length();
    if length == 0.0 { DVec3::ZERO } else { sine / length * 2.0 * length.atan2(w.abs()) }
}

pub fn sigma(covariance: &Matrix6) -> [f64; 6] {
    std::array::from_fn(|i| covariance[i][i].sqrt())
}

/// Normalised estimation error squared eᵀC⁻¹e: χ² of 6 degrees of freedom if C is honest.
pub fn nees(error: &[f64; 6], covariance: &Matrix6) -> f64 {
    whiten(error, covariance).iter().map(|value| value * value).sum()
}

/// The error in uncorrelated units of σ.
pub fn whiten(error: &[f64; 6], covariance: &Matrix6) -> [f64; 6] {
    // Metres and radians differ in size: scaled by σ the factorisation sees correlations.
    let sigma = sigma(covariance);
    let correlation = std::array::from_fn(|i| std::array::from_fn(|j| covariance[i][j] / (sigma[i] * sigma[j])));
    forward(&cholesky(&correlation), &std::array::from_fn(|i| error[i] / sigma[i]))
}

/// The largest error of an axis in units of its σ.
pub fn worst_axis(error: &[f64; 6], covariance: &Matrix6) -> f64 {
    error.iter().zip(sigma(covariance)).map(|(error, sigma)| error.abs() / sigma).fold(0.0, f64::max)
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
    pub fn of(errors: impl IntoIterator<Item = ([f64; 6], Matrix6)>) -> Self {
        let errors: Vec<_> = errors.into_iter().collect();
        let rms = |axes: Range<usize>| {
            let square = errors.iter().flat_map(|(error, _)| &error[axes.clone()]).map(|axis| axis * axis).sum::<f64>();
            (square / (errors.len() * axes.len()) as f64).sqrt()
        };
        let worst = || errors.iter().map(|(error, covariance)| worst_axis(error, covariance));
        let honesty = Self {
            poses: errors.len(),
            median_nees: Sorted::of(errors.iter().map(|(error, covariance)| nees(error, covariance))).median(),
            beyond_five_sigma: worst().filter(|sigmas| *sigmas > 5.0).count(),
            worst_sigmas: worst().fold(0.0, f64::max),
            rms_m: rms(0..3),
            rms_rad: rms(3..6),
            largest_m: errors.iter().flat_map(|(error, _)| &error[..3]).fold(0.0, |most, axis| most.max(axis.abs())),
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

/// Lower Cholesky factor of a symmetric positive definite matrix.
pub fn cholesky(matrix: &Matrix6) -> Matrix6 {
    let mut factor = [[0.0; 6]; 6];
    for i in 0..6 {
        for j in 0..=i {
            let sum: f64 = (0..j).map(|k| factor[i][k] * factor[j][k]).sum();
            let rest = matrix[i][j] - sum;
            factor[i][j] = if i == j {
                assert!(rest > 0.0, "not positive definite: pivot {i} is {rest:e}");
                rest.sqrt()
            } else {
                rest / factor[j][j]
            };
        }
    }
    factor
}

/// Solves L·x = b for a lower triangular L.
pub fn forward(factor: &Matrix6, right: &[f64; 6]) -> [f64; 6] {
    let mut x = [0.0; 6];
    for i in 0..6 {
        let sum: f64 = (0..i).map(|k| factor[i][k] * x[k]).sum();
        x[i] = (right[i] - sum) / factor[i][i];
    }
    x
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn error_is_measured_in_the_base_frame() {
        let truth = Pose { rotation: DQuat::from_rotation_x(1.0), translation_m: DVec3::X };
        // exp(δθ)·R: turned about the base frame's y after R.
        let estimate = Pose {
            rotation: -(DQuat::from_rotation_y(1e-3) * truth.rotation),
            translation_m: DVec3::new(1.0, 2e-3, 0.0),
        };
        let error = error(&estimate, &truth);
        let expected = [0.0, 2e-3, 0.0, 0.0, 1e-3, 0.0];
        assert!(error.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-15), "{error:?}");
    }

    #[test]
    fn nees_knows_correlations() {
        let mut covariance: Matrix6 = Default::default();
        for (i, row) in covariance.iter_mut().enumerate() {
            row[i] = 4.0;
        }
        covariance[0][1] = 3.0;
        covariance[1][0] = 3.0;
        // Inverse of [[4, 3], [3, 4]] is [[4, −3], [−3, 4]]/7.
        let nees = nees(&[1.0, 1.0, 0.0, 0.0, 0.0, 2.0], &covariance);
        assert!((nees - (2.0 / 7.0 + 1.0)).abs() < 1e-14, "{nees}");
        assert_eq!(worst_axis(&[1.0, -3.0, 0.0, 0.0, 0.0, 2.0], &covariance), 1.5);
    }

    #[test]
    fn quantiles_are_members_by_nearest_rank() {
        let times = Sorted::of((1..=1000).rev().map(f64::from));
        for (share, expected) in [(0.0, 1.0), (0.5, 500.0), (0.99, 990.0), (0.999, 999.0), (1.0, 1000.0)] {
            assert_eq!(times.at(share), expected, "{share}");
        }
    }
}
