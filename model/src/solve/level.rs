//! The common light level of a frame, eliminated from the normal equations.
//!
//! What feeds all emitters and warms them with the tool they ride on makes their light brighter or dimmer by one factor
//! 1 + g, which calibration cannot foresee. g is one more unknown of each frame, with a prior of standard deviation s.
//! With A the whitened rows and c the whitened currents, which are their own derivatives by g, the Schur complement
//!
//! D = cᵀc + s⁻², AᵀA − Aᵀc·cᵀA/D, Aᵀr − Aᵀc·cᵀr/D, rᵀr − (cᵀr)²/D
//!
//! marginalises it exactly. The least χ² has g = cᵀr/D: there derivatives by the pose are 1 + g times as large, and so are
//! the rows (Kaufman, A variable projection method for solving separable nonlinear least squares problems, 1975). Rows
//! weighted by the time of their exposure, of a motion that is not known ([`super::twist`]), lose the same part.

use crate::scalar::Real;

use super::algebra::{Matrix6, Vector6};
use super::weights::{ResidualSums, Row};

/// Bounds of 1 + g as a factor of derivatives: far from the minimum it may be anything.
const FACTORS: [f64; 2] = [0.5, 2.0];

/// Sums over rows of the last linearisation.
#[derive(Clone, Copy, Debug)]
pub struct Level<R> {
    /// Aᵀc, of rows weighted by the zeroth, first and second power of their share.
    moments: [Vector6<R>; 3],
    /// D.
    information: R,
    per_information: R,
    /// 1 + g where the rows were linearised.
    factor: R,
}

impl<R: Real> Level<R> {
    /// Without rows yet; `prior`: s⁻².
    #[inline(always)]
    pub fn of_prior(prior: R) -> Self {
        let (zero, one) = (prior.constant(0.0), prior.constant(1.0));
        Self { moments: [[zero; 6]; 3], information: prior, per_information: zero, factor: one }
    }

    /// Adds the rows of one reading, exposed at `share` of the motion's duration, to the first `powers` of the sums.
    #[inline(always)]
    pub fn add(&mut self, rows: &[Row<R>; 2], share: R, powers: usize) {
        let [first, second] = rows;
        self.information += first.by_level * first.by_level + second.by_level * second.by_level;
        let mut weight = share.constant(1.0);
        for moment in &mut self.moments[..powers] {
            let (of_first, of_second) = (weight * first.by_level, weight * second.by_level);
            for i in 0..6 {
                moment[i] += of_first * first.by_pose[i] + of_second * second.by_pose[i];
            }
            weight = weight * share;
        }
    }

    /// Settles D and 1 + g, by the `sums` of the residuals of all rows.
    #[inline(always)]
    pub fn settle(&mut self, sums: &ResidualSums<R>) {
        let one = self.information.constant(1.0);
        self.per_information = self.information.inverse();
        let factor = one + sums.by_level * self.per_information;
        self.factor = factor.at_least(one.constant(FACTORS[0])).at_most(one.constant(FACTORS[1]));
    }

    /// Derivatives by the pose at the level of the last linearisation, of one at the nominal level.
    #[inline(always)]
    pub fn factor(&self) -> R {
        self.factor
    }

    /// Marginalises the level: Σ τⁱ⁺ʲ·AᵀA becomes the information of unknowns with the powers `i` and `j` of the share.
    #[inline(always)]
    pub fn take_from(&self, matrix: &mut Matrix6<R>, [i, j]: [usize; 2]) {
        let square = self.factor * self.factor;
        for (row, &by) in matrix.iter_mut().zip(&self.moments[i]) {
            let share = by * self.per_information;
            for (element, &other) in row.iter_mut().zip(&self.moments[j]) {
                *element = (*element - share * other) * square;
            }
        }
    }

    /// Marginalises the level of χ² and the gradients.
    #[inline(always)]
    pub fn take_from_sums(&self, sums: &mut ResidualSums<R>) {
        let share = sums.by_level * self.per_information;
        sums.chi2 = (sums.chi2 - share * sums.by_level).at_least(share.constant(0.0));
        for (sums, moments) in [&mut sums.by_pose, &mut sums.by_twist, &mut sums.by_bend].into_iter().zip(&self.moments)
        {
            for (sum, &moment) in sums.iter_mut().zip(moments) {
                *sum = (*sum - moment * share) * self.factor;
            }
        }
    }

    /// A row with the level eliminated, and the share c/√D that its residual has in the level.
    #[inline(always)]
    pub fn reduced(&self, row: &Row<R>) -> (Vector6<R>, R) {
        let mut by_pose = row.by_pose;
        let share = row.by_level * self.per_information;
        for (element, &moment) in by_pose.iter_mut().zip(&self.moments[0]) {
            *element = (*element - moment * share) * self.factor;
        }
        (by_pose, row.by_level * self.per_information.root())
    }
}

/// Whether the level's part of the diagonal of the information leaves so much that it has more than `threshold` of its
/// digits.
#[inline(always)]
pub fn keeps_digits<R: Real>(before: &Matrix6<R>, after: &Matrix6<R>, threshold: R) -> R {
    let (zero, one) = (threshold.constant(0.0), threshold.constant(1.0));
    let mut keeps = one;
    for i in 0..6 {
        keeps = R::select_gt(after[i][i], threshold * before[i][i], keeps, zero);
    }
    keeps
}
