//! The tool's motion within a frame, eliminated from the normal equations.
//!
//! A cell exposed τ after the reference instant sees the pose advanced by τ·twist. Of a twist that is known
//! only with a covariance P the deviation w is six more unknowns with a prior. With A the whitened rows of one
//! cell,
//!
//! M₀ = ΣAᵀA, M₁ = Στ·AᵀA, M₂ = Στ²·AᵀA, K = M₂ + P⁻¹, information = M₀ − M₁·K⁻¹·M₁,
//!
//! the Schur complement of K, and likewise for the gradient and χ²: the twist is marginalised exactly, with the
//! correlation between cells that it brings.

use crate::scalar::Scalar;

use super::algebra::{Factor, Matrix6, Vector6, add_outer, mirror};
use super::compiled::Prior;
use super::residuals::{ResidualSums, Row};

/// Largest information a prior on the twist can have: it is then known.
const KNOWN: f64 = 1e30;

/// Motion of the tool within a frame, and how well it is known.
#[derive(Clone, Copy, Debug)]
pub(super) struct Motion<S: Scalar> {
    pub(super) linear: S::Vec3,
    pub(super) angular: S::Vec3,
    /// The largest |τ|, seconds; zero if all cells are exposed at one instant.
    pub(super) duration: S,
    /// P⁻¹ of (linear, angular) in units of length scale/duration and 1/duration; `None`: the twist is known.
    pub(super) prior: Option<[S; 2]>,
}

impl<S: Scalar> Motion<S> {
    pub(super) fn new(prior: &Prior<S>, duration: S, length_scale_m: S) -> Self {
        let Prior { twist: [linear, angular], sigmas: [sigma_linear, sigma_angular] } = *prior;
        let information = |sigma: S, unit: S| {
            let share = sigma * duration / unit;
            (share * share).recip().min(S::of(KNOWN))
        };
        let unknown = duration > S::zero() && (sigma_linear > S::zero() || sigma_angular > S::zero());
        let prior = unknown.then(|| [information(sigma_linear, length_scale_m), information(sigma_angular, S::one())]);
        Self { linear, angular, duration, prior }
    }
}

/// Eliminates the twist from normal equations.
#[derive(Clone, Copy, Debug)]
pub(super) struct Elimination<S> {
    /// L of K = L·Lᵀ.
    factor: Factor<S>,
    /// Columns of L⁻¹·M₁.
    mixed: Matrix6<S>,
}

impl<S: Scalar> Elimination<S> {
    /// For M₁ and M₂; `None` if the twist of `motion` is known.
    #[inline(never)]
    pub(super) fn of(motion: &Motion<S>, [mixed, twist]: &mut [Matrix6<S>; 2]) -> Option<Self> {
        let prior = motion.prior?;
        mirror(mixed);
        // The factorisation of a symmetric matrix reads the lower half.
        for (i, row) in twist.iter_mut().enumerate() {
            row[i] += prior[i / 3];
        }
        // Positive definite, by the prior.
        let factor = Factor::of_matrix(twist, S::zero(), S::zero())?;
        Some(Self { mixed: mixed.map(|column| factor.forward(&column)), factor })
    }

    /// Takes its part from the information M₀; χ² and gradient of the pose alone.
    #[inline(never)]
    pub(super) fn reduce(&self, information: &mut Matrix6<S>, sums: &ResidualSums<S>) -> (S, Vector6<S>) {
        for i in 0..6 {
            for j in 0..6 {
                for k in 0..6 {
                    let known = self.mixed[i][k] * self.mixed[j][k];
                    information[i][j] -= known;
                }
            }
        }
        self.apply(sums)
    }

    /// χ² and gradient of the pose alone.
    pub(super) fn apply(&self, sums: &ResidualSums<S>) -> (S, Vector6<S>) {
        let twist = self.factor.forward(&sums.by_twist);
        let mut gradient = sums.by_pose;
        for i in 0..6 {
            for k in 0..6 {
                let known = self.mixed[i][k] * twist[k];
                gradient[i] -= known;
            }
        }
        (twist.iter().fold(sums.chi2, |chi2, &value| chi2 - value * value).max(S::zero()), gradient)
    }
}

/// Adds the `rows` of one reading, exposed at `share` of the motion's duration, to M₁ and M₂.
#[inline(never)]
pub(super) fn add_moments<S: Scalar, const N: usize>(moments: &mut [Matrix6<S>; 2], share: S, rows: &[Row<S>; N]) {
    let own = rows.each_ref().map(|row| &row.by_pose);
    let mut weight = share;
    for moment in moments {
        let weighted = own.map(|row| row.map(|value| weight * value));
        add_outer(moment, weighted.each_ref(), own);
        weight *= share;
    }
}
