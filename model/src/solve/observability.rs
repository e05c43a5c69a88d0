//! What the data determine, and what they leave free.

use crate::pose::Transform;
use crate::scalar::Number;

use super::algebra::{Factor, Matrix6};
use super::outcome::Directions;

/// A direction is free if its singular value is this far below the largest, in units of the number
/// type's rounding: condition numbers up to 7e13 in `f64`, 1.3e5 in `f32`.
const RANK_ROUNDINGS: f64 = 64.0;

/// A direction is free, too, if its σ exceeds one radian (or its equivalent in translation): the
/// linearisation it stems from holds much less far.
pub(super) const LARGEST_SIGMA: f64 = 1.0;

/// A factor whose diagonal spans less than this has full rank without further proof.
pub(super) const EVEN: f64 = 1e-3;

/// Covariance in metres and radians from the information in scaled coordinates; `None` if a
/// direction is free.
pub(super) fn covariance<S: Number>(factor: &Factor<S>, length_scale_m: S) -> Option<Matrix6<S>> {
    if is_singular(factor) {
        return None;
    }
    let inverse = factor.inverse();
    // Written so that NaN fails, too.
    let is_bounded = inverse.iter().enumerate().all(|(i, row)| row[i] <= S::of(LARGEST_SIGMA * LARGEST_SIGMA));
    if !is_bounded {
        return None;
    }
    Some(unscaled(&inverse, length_scale_m))
}

/// A covariance of scaled coordinates in metres and radians.
#[inline(always)]
pub(super) fn unscaled<S: Number>(covariance: &Matrix6<S>, length_scale_m: S) -> Matrix6<S> {
    let scale = |axis: usize| if axis < 3 { length_scale_m } else { S::one() };
    core::array::from_fn(|i| core::array::from_fn(|j| covariance[i][j] * (scale(i) * scale(j))))
}

/// Whether there are free directions.
pub(super) fn is_singular<S: Number>(factor: &Factor<S>) -> bool {
    !factor.is_even(S::of(EVEN)) && free_directions(factor).is_some()
}

/// The free directions; `None` if there is none.
pub(super) fn free_directions<S: Number>(factor: &Factor<S>) -> Option<Directions> {
    let pairs = factor.singular();
    let largest = pairs[5].0;
    let least = (S::of(RANK_ROUNDINGS) * S::epsilon() * largest).max(S::of(LARGEST_SIGMA.recip()));
    let free: heapless::Vec<[f64; 6], 6> = pairs
        .iter()
        .filter(|(value, _)| *value <= least || value.is_nan())
        .map(|(_, vector)| vector.map(S::as_f64))
        .collect();
    (!free.is_empty()).then(|| Directions::of_free(&free))
}

/// Whether the σ of a direction with this singular value is infinite, or beyond the range of any linearisation.
pub(super) fn is_free<S: Number>(value: S) -> bool {
    // Written so that NaN is.
    let is_held = value > S::of(LARGEST_SIGMA.recip());
    !is_held
}

/// The displacement between two poses, in σ of the data of `factor`.
pub(super) fn sigmas_between<S: Number>(
    factor: &Factor<S>,
    a: &Transform<S>,
    b: &Transform<S>,
    length_scale_m: S,
) -> S {
    let (dt, dr) = b.to_pose().displacement_from(&a.to_pose());
    let dt = dt / length_scale_m.as_f64();
    factor.length(&[dt.x, dt.y, dt.z, dr.x, dr.y, dr.z].map(S::of))
}
