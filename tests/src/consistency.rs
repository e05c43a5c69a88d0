//! Poses against the truth: e = [t̂ − t ; log(R̂ Rᵀ)], judged by the covariance that came with them.

use glam::{DQuat, DVec3};
use slitpose_model::Pose;

use crate::statistics::{Matrix6, cholesky, forward};

/// Error of `estimate`: metres, then radians, in the base frame.
pub fn error(estimate: &Pose, truth: &Pose) -> [f64; 6] {
    let dt = estimate.translation_m - truth.translation_m;
    let dr = log(estimate.rotation * truth.rotation.conjugate());
    [dt.x, dt.y, dt.z, dr.x, dr.y, dr.z]
}

/// Rotation vector of a quaternion.
fn log(rotation: DQuat) -> DVec3 {
    let [x, y, z, w] = rotation.to_array();
    let sine = DVec3::new(x, y, z) * w.signum();
    let length = sine.length();
    if length == 0.0 { DVec3::ZERO } else { sine / length * 2.0 * length.atan2(w.abs()) }
}

/// Standard deviations of a covariance.
pub fn sigma(covariance: &Matrix6) -> [f64; 6] {
    std::array::from_fn(|i| covariance[i][i].sqrt())
}

/// Normalised estimation error squared eᵀC⁻¹e: χ² of 6 degrees of freedom if C is honest.
///
/// # Panics
/// If the covariance is not positive definite.
pub fn nees(error: &[f64; 6], covariance: &Matrix6) -> f64 {
    whiten(error, covariance).iter().map(|value| value * value).sum()
}

/// The error in uncorrelated units of σ.
///
/// # Panics
/// If the covariance is not positive definite.
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
}
