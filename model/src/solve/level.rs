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

use crate::scalar::Number;

use super::algebra::{Matrix6, Vector6};
use super::weights::{ResidualSums, Row};

/// Bounds of 1 + g as a factor of derivatives: far from the minimum it may be anything.
const FACTORS: [f64; 2] = [0.5, 2.0];

/// Sums over rows of the last linearisation.
#[derive(Clone, Copy, Debug)]
pub struct Level<S> {
    /// Aᵀc by the pose; and of rows weighted by their share, and by its square, by the twist and by the bend.
    by_pose: Vector6<S>,
    by_twist: Vector6<S>,
    by_bend: Vector6<S>,
    /// D.
    information: S,
    per_information: S,
    /// 1 + g where the rows were linearised.
    factor: S,
}

impl<S: Number> Level<S> {
    /// Without rows yet; `prior`: s⁻².
    #[inline(always)]
    pub fn of_prior(prior: S) -> Self {
        let none = [S::zero(); 6];
        let (per_information, factor) = (S::zero(), S::one());
        Self { by_pose: none, by_twist: none, by_bend: none, information: prior, per_information, factor }
    }

    /// Adds the rows of one reading.
    #[inline(always)]
    pub fn add(&mut self, [first, second]: &[Row<S>; 2]) {
        self.information += first.by_level * first.by_level + second.by_level * second.by_level;
        for i in 0..6 {
            self.by_pose[i] += first.by_level * first.by_pose[i] + second.by_level * second.by_pose[i];
        }
    }

    /// Settles D and 1 + g of the rows that were added, with these `sums`, and marginalises the level of their information
    /// AᵀA: what the diagonal lost, and whether more than `threshold` of each of its elements is left.
    #[inline(always)]
    pub fn marginalise(
        &mut self,
        information: &mut Matrix6<S>,
        sums: &ResidualSums<S>,
        threshold: S,
    ) -> (Vector6<S>, bool) {
        self.per_information = self.information.recip();
        let factor = S::one() + sums.by_level * self.per_information;
        self.factor = factor.at_least(S::of(FACTORS[0])).at_most(S::of(FACTORS[1]));
        let before = *information;
        self.take(information, &self.by_pose, &self.by_pose);
        let is_safe = (0..6).all(|i| information[i][i] > threshold * before[i][i]);
        let part = self.by_pose.map(|moment| {
            let by_level = moment * self.factor;
            by_level * by_level * self.per_information
        });
        (part, is_safe)
    }

    /// Derivatives by the pose at the level of the last linearisation, of one at the nominal level.
    #[inline(always)]
    pub fn factor(&self) -> S {
        self.factor
    }

    #[inline(always)]
    fn take(&self, matrix: &mut Matrix6<S>, by_row: &Vector6<S>, by_column: &Vector6<S>) {
        let square = self.factor * self.factor;
        for (row, &by) in matrix.iter_mut().zip(by_row) {
            let share = by * self.per_information;
            for (element, &other) in row.iter_mut().zip(by_column) {
                *element = (*element - share * other) * square;
            }
        }
    }

    /// Marginalises the level of χ² and of the gradient by the pose.
    #[inline(always)]
    pub fn take_from_sums(&self, sums: &mut ResidualSums<S>) {
        let share = sums.by_level * self.per_information;
        sums.chi2 = (sums.chi2 - share * sums.by_level).at_least(S::zero());
        self.take_share(&mut sums.by_pose, &self.by_pose, share);
    }

    #[inline(always)]
    fn take_share(&self, sums: &mut Vector6<S>, moments: &Vector6<S>, share: S) {
        for (sum, &moment) in sums.iter_mut().zip(moments) {
            *sum = (*sum - moment * share) * self.factor;
        }
    }

    /// A row with the level eliminated, and the share c/√D that its residual has in the level.
    #[inline(always)]
    pub fn reduced(&self, row: &Row<S>) -> (Vector6<S>, S) {
        let mut by_pose = row.by_pose;
        self.take_share(&mut by_pose, &self.by_pose, row.by_level * self.per_information);
        (by_pose, row.by_level * self.per_information.root())
    }
}

/// The matrices Σ τⁿ·AᵀA of a motion that is not known, by their rows and columns.
#[derive(Clone, Copy)]
pub enum Unknowns {
    PoseTwist,
    Twist,
    PoseBend,
    BendTwist,
    Bend,
}

impl<S: Number> Level<S> {
    /// [`Self::add`] of rows exposed at `share` of the duration of a motion that is not known.
    #[inline(never)]
    pub fn add_moving(&mut self, rows: &[Row<S>; 2], share: S) {
        self.add(rows);
        let [first, second] = rows;
        for i in 0..6 {
            let moment = share * (first.by_level * first.by_pose[i] + second.by_level * second.by_pose[i]);
            self.by_twist[i] += moment;
            self.by_bend[i] += share * moment;
        }
    }

    /// Marginalises the level of such a matrix.
    #[inline(never)]
    pub fn take_from_motion(&self, matrix: &mut Matrix6<S>, of: Unknowns) {
        let (by_row, by_column) = match of {
            Unknowns::PoseTwist => (&self.by_pose, &self.by_twist),
            Unknowns::Twist => (&self.by_twist, &self.by_twist),
            Unknowns::PoseBend => (&self.by_pose, &self.by_bend),
            Unknowns::BendTwist => (&self.by_bend, &self.by_twist),
            Unknowns::Bend => (&self.by_bend, &self.by_bend),
        };
        self.take(matrix, by_row, by_column);
    }

    /// Marginalises the level of the gradients by a motion that is not known.
    #[inline(never)]
    pub fn take_from_motion_sums(&self, sums: &mut ResidualSums<S>) {
        let share = sums.by_level * self.per_information;
        self.take_share(&mut sums.by_twist, &self.by_twist, share);
        self.take_share(&mut sums.by_bend, &self.by_bend, share);
    }
}
