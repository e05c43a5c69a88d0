//! The Gauss–Newton step, and what the linearised problem says without taking it.
//!
//! The normal equations (JᵀJ + λ·diag JᵀJ)·s = Jᵀr are solved by Cholesky factorisation. They square the condition
//! number of J. Where that would cost more than half of the digits, J itself is factorised, by QR (Björck 1996,
//! section 2.4).

use crate::plan::Optics;
use crate::pose::Transform;
use crate::rectangle::MOST_MAGNIFICATION;
use crate::scalar::{Linear3, Scalar};

use super::algebra::{Factor, Triangle, Vector6, add_outer, dot, mirror, square};
use super::normal_equations::{NormalEquations, Problem, Workspace};
use super::readings::Usable;
use super::residuals::{ResidualSums, Row};
use super::twist::{Elimination, add_moments};

/// Least ratio of a pivot to its diagonal element, in units of rounding, at which normal equations
/// are trusted: they then keep more than half of the digits.
pub(super) const SAFE_ROUNDINGS: f64 = 1e4;

/// A Gauss–Newton step, damped or not.
#[derive(Clone, Copy, Debug)]
pub(super) struct Step<S> {
    /// L of JᵀJ + λ·diag JᵀJ = L·Lᵀ.
    pub(super) factor: Factor<S>,
    pub(super) step: Vector6<S>,
    /// By how much χ² falls along the step if J stays the same.
    pub(super) predicted_reduction: S,
    /// Whether it comes from the QR factorisation: `factor` then is too inexact to solve with again.
    pub(super) is_by_qr: bool,
}

impl<S: Scalar, P: Optics<S>> Problem<'_, S, P> {
    /// The step from `at`; `None` if a damped matrix is singular to the precision of the numbers.
    #[inline]
    pub(super) fn step(&self, at: &NormalEquations<S>, damping: S, workspace: &Workspace<S>) -> Option<Step<S>> {
        let safe = S::of(SAFE_ROUNDINGS) * S::epsilon();
        match Factor::of_matrix(&at.information, damping, safe) {
            Some(factor) => {
                let half_way = factor.forward(&at.gradient);
                let step = factor.backward(&half_way);
                Some(Step { step, predicted_reduction: square(&half_way), factor, is_by_qr: false })
            }
            None if damping > S::zero() => None,
            None => Some(self.qr_step(workspace)),
        }
    }

    /// The undamped step by QR factorisation of the rows in `workspace`: slow, but right for any condition
    /// number that the number type resolves.
    #[cold]
    fn qr_step(&self, workspace: &Workspace<S>) -> Step<S> {
        let mut triangle = Triangle::<S, 12>::new();
        if let Some(prior) = self.motion.prior {
            for i in 0..6 {
                let mut row = [S::zero(); 12];
                row[i] = prior[i / 3].root();
                triangle.add(row, S::zero());
            }
        }
        let mut add = |row: &Row<S>, share: S| {
            let twist = if self.motion.prior.is_some() { share } else { S::zero() };
            triangle.add(
                core::array::from_fn(|i| if i < 6 { row.by_pose[i] * twist } else { row.by_pose[i - 6] }),
                row.residual,
            );
        };
        for (reading, rows) in self.readings.iter().zip(&workspace.rows) {
            rows.iter().for_each(|row| add(row, self.share(reading)));
        }
        for (index, row) in &workspace.plane_rows {
            add(row, self.share(&self.readings[*index]));
        }
        let (factor, half_way) = triangle.last_six();
        Step { step: factor.backward(&half_way), predicted_reduction: square(&half_way), factor, is_by_qr: true }
    }

    /// The factor of the undamped information.
    #[cold]
    #[inline(never)]
    pub(super) fn factor(&self, at: &NormalEquations<S>, workspace: &Workspace<S>) -> Option<Factor<S>> {
        self.step(at, S::zero(), workspace).map(|next| next.factor)
    }

    /// Whether a step of this `length` moves no spot of the last linearisation so far that derivatives jump.
    pub(super) fn is_smooth(&self, length: S, workspace: &Workspace<S>) -> bool {
        let most_moved = S::of(MOST_MAGNIFICATION) * length * self.length_scale_m;
        workspace.slacks_m.iter().all(|&slack_m| slack_m > most_moved)
    }

    /// [`Self::is_smooth`] of a `step` from `pose`, the last linearisation's, by how far it moves the emitter of each
    /// cell: on its arm that may be less than the length of the step allows.
    #[cold]
    #[inline(never)]
    pub(super) fn is_smooth_in_each_cell(
        &self,
        step: &Vector6<S>,
        pose: &Transform<S>,
        workspace: &Workspace<S>,
    ) -> bool {
        (0..workspace.slacks_m.len()).all(|index| self.is_smooth_in_cell(index, step, pose, workspace))
    }

    /// [`Self::is_smooth_in_each_cell`] of the cell of one reading.
    pub(super) fn is_smooth_in_cell(
        &self,
        index: usize,
        step: &Vector6<S>,
        pose: &Transform<S>,
        workspace: &Workspace<S>,
    ) -> bool {
        let reading = &self.readings[index];
        let arm = self.plan.arm(reading.cell, pose);
        // The most that a step of that length moves this emitter, by its length.
        let most = (S::one() + arm.dot(arm) / (self.length_scale_m * self.length_scale_m)).root();
        workspace.slacks_m[index] * most > S::of(MOST_MAGNIFICATION) * self.emitter_moves_m(step, pose, reading)
    }

    /// How far a `step` from `pose` moves the emitter of a reading, metres.
    pub(super) fn emitter_moves_m(&self, step: &Vector6<S>, pose: &Transform<S>, reading: &Usable<S>) -> S {
        let shift = S::Vec3::new(step[0], step[1], step[2]) * self.length_scale_m;
        let turn = S::Vec3::new(step[3], step[4], step[5]);
        (shift + turn.cross(self.plan.arm(reading.cell, pose))).length()
    }

    /// The least share of an error in one cell's currents that stays visible in its residuals, over all
    /// cells: the redundancy number of Baarda (1968), the smaller eigenvalue of I − A·C·Aᵀ, A the cell's rows
    /// and C = (L·Lᵀ)⁻¹. The rest of the error goes into the pose.
    pub(super) fn least_visible(&self, factor: &Factor<S>, workspace: &Workspace<S>) -> S {
        workspace.rows.iter().fold(S::one(), |least, rows| {
            let [u, v] = [0, 1].map(|k| factor.forward(&rows[k].by_pose));
            let (uu, vv, uv) = (square(&u), square(&v), dot(&u, &v));
            let half_difference = S::half() * (uu - vv);
            let radius = (half_difference * half_difference + uv * uv).root();
            least.min(S::one() - S::half() * (uu + vv) - radius)
        })
    }

    /// The least χ² without reading `index`, by the last linearisation; `None` if that leaves a direction
    /// free.
    #[inline(never)]
    pub(super) fn least_chi2_without(&self, index: usize, workspace: &Workspace<S>) -> Option<S> {
        let zero = [[S::zero(); 6]; 6];
        let (mut information, mut moments) = (zero, [zero; 2]);
        let mut sums = ResidualSums::zero(S::zero());
        let of_readings = workspace.rows.iter().enumerate().map(|(reading, rows)| (reading, rows.as_slice()));
        let of_planes = workspace.plane_rows.iter().map(|(reading, row)| (*reading, core::slice::from_ref(row)));
        for (reading, rows) in of_readings.chain(of_planes).filter(|(reading, _)| *reading != index) {
            let reading = &self.readings[reading];
            for row in rows {
                add_outer(&mut information, [&row.by_pose], [&row.by_pose]);
                add_moments(&mut moments, self.share(reading), &[*row]);
            }
            sums.add(rows, self.share(reading));
        }
        mirror(&mut information);
        let mut normal = NormalEquations { chi2: sums.chi2, information, gradient: sums.by_pose };
        if let Some(elimination) = Elimination::of(&self.motion, &mut moments) {
            (normal.chi2, normal.gradient) = elimination.reduce(&mut normal.information, &sums);
        }
        let safe = S::of(SAFE_ROUNDINGS) * S::epsilon();
        let factor = Factor::of_matrix(&normal.information, S::zero(), safe)?;
        Some(normal.chi2 - square(&factor.forward(&normal.gradient)))
    }
}
