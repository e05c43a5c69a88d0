//! What the data determine, and what they leave free.

use crate::pose::Transform;
use crate::scalar::Scalar;

use super::DISTINCT_SIGMAS;
use super::algebra::{Cholesky, Matrix6, eigen};
use super::outcome::Directions;

/// A direction is free if its eigenvalue is this far below the largest, in units of the number
/// type's rounding: the information matrix holds squares, so in `f64` it resolves condition
/// numbers to about 1e7, in `f32` to 4e2.
const RANK_ROUNDINGS: f64 = 64.0;

/// A direction is free, too, if its σ exceeds one radian (or its equivalent in translation): the
/// expansion it stems from ends long before.
const LARGEST_SIGMA: f64 = 1.0;

/// Covariance in metres and radians from the information in scaled coordinates; `None` if a
/// direction is free.
pub(super) fn covariance<S: Scalar>(information: &Matrix6<S>, arm: S) -> Option<Matrix6<f64>> {
    // Pivots that stay this large prove full rank without eigenvalues.
    let safe = S::of(1e3 * RANK_ROUNDINGS) * S::epsilon();
    let factor = match Cholesky::factorise(information, S::zero(), safe) {
        Some(factor) => factor,
        None if free_directions(information).is_some() => return None,
        None => Cholesky::factorise(information, S::zero(), S::zero())?,
    };
    let inverse = factor.inverse();
    // Written so that NaN fails, too.
    let is_bounded = inverse.iter().enumerate().all(|(i, row)| row[i].as_f64() <= LARGEST_SIGMA * LARGEST_SIGMA);
    if !is_bounded {
        return None;
    }
    let scale = |axis: usize| if axis < 3 { arm.as_f64() } else { 1.0 };
    Some(core::array::from_fn(|i| {
        core::array::from_fn(|j| 0.5 * (inverse[i][j].as_f64() + inverse[j][i].as_f64()) * scale(i) * scale(j))
    }))
}

/// The free directions; `None` if there is none.
pub(super) fn free_directions<S: Scalar>(information: &Matrix6<S>) -> Option<Directions> {
    let pairs = eigen(&information.map(|row| row.map(S::as_f64)));
    let largest = pairs[5].0;
    let least = (RANK_ROUNDINGS * S::epsilon().as_f64() * largest).max(LARGEST_SIGMA.recip());
    let free: heapless::Vec<[f64; 6], 6> =
        pairs.iter().filter(|(value, _)| *value <= least || value.is_nan()).map(|(_, vector)| *vector).collect();
    (!free.is_empty()).then(|| Directions::of_free(&free))
}

/// Whether two poses differ by more than the data of the first allow.
pub(super) fn distinct<S: Scalar>(information: &Matrix6<S>, a: &Transform<S>, b: &Transform<S>, arm: S) -> bool {
    let (dt, dr) = b.to_pose().displacement_from(&a.to_pose());
    let dt = dt / arm.as_f64();
    let difference = [dt.x, dt.y, dt.z, dr.x, dr.y, dr.z];
    let mut square = 0.0;
    for i in 0..6 {
        for j in 0..6 {
            square += difference[i] * information[i][j].as_f64() * difference[j];
        }
    }
    square > DISTINCT_SIGMAS * DISTINCT_SIGMAS
}
