//! Whitened residuals with their derivatives, and their sums.

use crate::scalar::Real;

use super::algebra::Vector6;

/// One whitened residual and its derivatives by the scaled pose.
#[derive(Clone, Copy, Debug)]
pub(super) struct Row<S> {
    pub(super) by_pose: Vector6<S>,
    pub(super) residual: S,
}

/// Sums over residuals r: χ² = rᵀr, and Jᵀr by the pose, by the twist and by the bend.
#[derive(Clone, Copy)]
pub(super) struct ResidualSums<S> {
    pub(super) chi2: S,
    pub(super) by_pose: Vector6<S>,
    pub(super) by_twist: Vector6<S>,
    pub(super) by_bend: Vector6<S>,
}

impl<R: Real> ResidualSums<R> {
    #[inline(always)]
    pub(super) fn zero(like: R) -> Self {
        let zero = like.constant(0.0);
        Self { chi2: zero, by_pose: [zero; 6], by_twist: [zero; 6], by_bend: [zero; 6] }
    }

    /// Adds the `rows` of one reading, exposed at `share` of the motion's duration; to `by_bend` only if that is asked for.
    #[inline(always)]
    pub(super) fn add(&mut self, rows: &[Row<R>], share: R, has_bend: bool) {
        let mut own = [share.constant(0.0); 6];
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
        if has_bend {
            for i in 0..6 {
                self.by_bend[i] += share * share * own[i];
            }
        }
    }
}
