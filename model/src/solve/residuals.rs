//! Whitened residuals with their derivatives, and their sums.

use crate::scalar::Scalar;

use super::algebra::Vector6;

/// One whitened residual and its derivatives by the scaled pose.
#[derive(Clone, Copy, Debug)]
pub(super) struct Row<S> {
    pub(super) by_pose: Vector6<S>,
    pub(super) residual: S,
}

/// Sums over residuals r: χ² = rᵀr, Jᵀr by the pose, and Jᵀr by the twist.
#[derive(Clone, Copy)]
pub(super) struct ResidualSums<S> {
    pub(super) chi2: S,
    pub(super) by_pose: Vector6<S>,
    pub(super) by_twist: Vector6<S>,
}

impl<S: Scalar> ResidualSums<S> {
    #[inline(always)]
    pub(super) fn zero() -> Self {
        Self { chi2: S::zero(), by_pose: [S::zero(); 6], by_twist: [S::zero(); 6] }
    }

    /// Adds the `rows` of one reading, exposed at `share` of the motion's duration.
    #[inline(always)]
    pub(super) fn add(&mut self, rows: &[Row<S>], share: S) {
        let mut own = [S::zero(); 6];
        for row in rows {
            self.chi2 += row.residual * row.residual;
            for i in 0..6 {
                own[i] += row.by_pose[i] * row.residual;
            }
        }
        for i in 0..6 {
            self.by_pose[i] += own[i];
            self.by_twist[i] += share * own[i];
        }
    }
}
