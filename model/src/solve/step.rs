//! The Gauss–Newton step, and what the linearised problem says without taking it.
//!
//! The normal equations (JᵀJ + λ·diag JᵀJ)·s = Jᵀr are solved by Cholesky factorisation. They square the condition
//! number of J. Where that would cost more than half of the digits, J itself is factorised, by QR (Björck 1996,
//! section 2.4).

use crate::plan::Optics;
use crate::pose::Transform;
use crate::rectangle::MAX_MAGNIFICATION;
use crate::scalar::{Linear3, Number};

use super::algebra::{Factor, Triangle, Vector6, add_outer, dot, mirror, square};
use super::level::Level;
use super::normal_equations::{NormalEquations, Problem, Workspace};
use super::readings::Usable;
use super::twist::Elimination;
use super::weights::{ResidualSums, Row};

/// Least ratio of a pivot to its diagonal element, in units of rounding, at which normal equations
/// are trusted: they then keep more than half of the digits.
pub const SAFE_ROUNDINGS: f64 = 1e4;

#[derive(Clone, Copy, Debug)]
pub struct Step<S> {
    /// L of JᵀJ + λ·diag JᵀJ = L·Lᵀ.
    pub factor: Factor<S>,
    pub step: Vector6<S>,
    /// By how much χ² falls along the step if J stays the same.
    pub predicted_reduction: S,
    /// Whether it comes from the QR factorisation: `factor` then is too inexact to solve with again.
    pub is_by_qr: bool,
}

impl<S: Number, P: Optics<S>> Problem<'_, S, P> {
    /// The step from `at`; `None` if a damped matrix is singular to the precision of the numbers.
    #[inline]
    pub fn step(&self, at: &NormalEquations<S>, damping: S, workspace: &Workspace<S>) -> Option<Step<S>> {
        let safe = S::of(SAFE_ROUNDINGS) * S::epsilon();
        let factor = if at.is_safe { Factor::of_matrix(&at.information, damping, safe) } else { None };
        match factor {
            Some(factor) => {
                let half_way = factor.forward(&at.gradient);
                let step = factor.backward(&half_way);
                Some(Step { step, predicted_reduction: square(&half_way), factor, is_by_qr: false })
            }
            None if damping > S::zero() => None,
            None if self.has_bend() => Some(self.qr_step::<19>(workspace)),
            None => Some(self.qr_step::<13>(workspace)),
        }
    }

    /// The undamped step by QR factorisation of the rows in `workspace`: slow, but right for any condition
    /// number that the number type resolves. Of `N` unknowns the last six are the pose, those before the twist, the bend
    /// those before that, and the light level is the first.
    #[cold]
    fn qr_step<const N: usize>(&self, workspace: &Workspace<S>) -> Step<S> {
        let mut triangle = Triangle::<S, N>::new();
        let mut prior_of = |unknown: usize, sigma_inverse: S| {
            let mut row = [S::zero(); N];
            row[unknown] = sigma_inverse;
            triangle.add(row, S::zero());
        };
        if let Some(prior) = self.level_information() {
            prior_of(0, prior.root());
        }
        let priors = [self.motion.bend_prior, self.motion.prior];
        for (first, prior) in (1..N - 6).step_by(6).zip(&priors[3 - N / 6..]) {
            let Some(prior) = prior else { continue };
            (0..6).for_each(|i| prior_of(first + i, prior[i / 3].root()));
        }
        let factor = self.level(workspace).map_or(S::one(), Level::factor);
        let mut add = |row: &Row<S>, share: S| {
            let share = if self.motion.prior.is_some() { share } else { S::zero() };
            let powers = [share * share, share, S::one()].map(|power| power * factor);
            let powers = &powers[3 - N / 6..];
            let element = |i: usize| row.by_pose[i % 6] * powers[i / 6];
            let row_of = |i: usize| if i == 0 { row.by_level } else { element(i - 1) };
            triangle.add(core::array::from_fn(row_of), row.residual);
        };
        for (reading, rows) in self.sorted.usable.iter().zip(&workspace.rows) {
            rows.iter().for_each(|row| add(row, self.share(reading)));
        }
        for (index, row) in &workspace.plane_rows {
            add(row, self.share(&self.sorted.usable[*index]));
        }
        let (factor, half_way) = triangle.last_six();
        Step { step: factor.backward(&half_way), predicted_reduction: square(&half_way), factor, is_by_qr: true }
    }

    #[cold]
    #[inline(never)]
    pub fn factor(&self, at: &NormalEquations<S>, workspace: &Workspace<S>) -> Option<Factor<S>> {
        self.step(at, S::zero(), workspace).map(|next| next.factor)
    }

    /// Whether a step of this `length` moves no spot of the last linearisation so far that derivatives jump.
    pub fn is_smooth(&self, length: S, workspace: &Workspace<S>) -> bool {
        let most_moved = S::of(MAX_MAGNIFICATION) * length * self.head.length_scale_m;
        workspace.slacks_m.iter().all(|&slack_m| slack_m > most_moved)
    }

    /// [`Self::is_smooth`] of a `step` from `pose`, the last linearisation's, by how far it moves the emitter of each
    /// cell: on its arm that may be less than the length of the step allows.
    #[cold]
    #[inline(never)]
    pub fn is_smooth_in_each_cell(&self, step: &Vector6<S>, pose: &Transform<S>, workspace: &Workspace<S>) -> bool {
        (0..workspace.slacks_m.len()).all(|index| self.is_smooth_in_cell(index, step, pose, workspace))
    }

    /// [`Self::is_smooth_in_each_cell`] of the cell of one reading.
    pub fn is_smooth_in_cell(
        &self,
        index: usize,
        step: &Vector6<S>,
        pose: &Transform<S>,
        workspace: &Workspace<S>,
    ) -> bool {
        let reading = &self.sorted.usable[index];
        let arm = self.head.plan.arm(reading.cell, pose);
        // The most that a step of that length moves this emitter, by its length.
        let most = (S::one() + arm.dot(arm) / (self.head.length_scale_m * self.head.length_scale_m)).root();
        workspace.slacks_m[index] * most > S::of(MAX_MAGNIFICATION) * self.emitter_moves_m(step, pose, reading)
    }

    /// How far a `step` from `pose` moves the emitter of a reading, metres.
    pub fn emitter_moves_m(&self, step: &Vector6<S>, pose: &Transform<S>, reading: &Usable<S>) -> S {
        let shift = S::Vec3::new(step[0], step[1], step[2]) * self.head.length_scale_m;
        let turn = S::Vec3::new(step[3], step[4], step[5]);
        (shift + turn.cross(self.head.plan.arm(reading.cell, pose))).length()
    }

    /// The least share of an error in one cell's currents that stays visible in its residuals, over all
    /// cells: the redundancy number of Baarda (1968), the smaller eigenvalue of I − A·C·Aᵀ, A the cell's rows
    /// and C = (L·Lᵀ)⁻¹. The rest of the error goes into the pose.
    pub fn least_visible(&self, factor: &Factor<S>, workspace: &Workspace<S>) -> S {
        workspace.rows.iter().fold(S::one(), |least, rows| {
            let reduced = |row: &Row<S>| match self.level(workspace) {
                Some(level) => level.reduced(row),
                None => (row.by_pose, S::zero()),
            };
            let [(u, p), (v, q)] = rows.each_ref().map(|row| {
                let (by_pose, by_level) = reduced(row);
                (factor.forward(&by_pose), by_level)
            });
            let (uu, vv, uv) = (square(&u) + p * p, square(&v) + q * q, dot(&u, &v) + p * q);
            let half_difference = S::half() * (uu - vv);
            let radius = (half_difference * half_difference + uv * uv).root();
            least.min(S::one() - S::half() * (uu + vv) - radius)
        })
    }

    /// The least χ² without reading `index`, by the last linearisation; `None` if that leaves a direction
    /// free.
    #[inline(never)]
    pub fn least_chi2_without(&self, index: usize, workspace: &Workspace<S>) -> Option<S> {
        let (mut information, mut elimination) = ([[S::zero(); 6]; 6], Elimination::new());
        elimination.begin(&self.motion);
        let mut level = self.level_information().map(Level::of_prior);
        let mut sums = ResidualSums::none();
        let of_readings = workspace.rows.iter().enumerate().filter(|(reading, _)| *reading != index);
        if let Some(level) = &mut level {
            for (reading, rows) in of_readings.clone() {
                self.add_level(level, rows, &self.sorted.usable[reading]);
            }
        }
        let of_readings = of_readings.map(|(reading, rows)| (reading, rows.as_slice()));
        let of_planes = workspace.plane_rows.iter().map(|(reading, row)| (*reading, core::slice::from_ref(row)));
        for (reading, rows) in of_readings.chain(of_planes).filter(|(reading, _)| *reading != index) {
            let reading = &self.sorted.usable[reading];
            for row in rows {
                add_outer(&mut information, [&row.by_pose], [&row.by_pose]);
                elimination.add(self.share(reading), &[*row]);
            }
            sums.add(rows, self.share(reading), self.has_bend());
        }
        mirror(&mut information);
        let normal = self.marginalised(information, sums, level.as_mut(), &mut elimination);
        let safe = S::of(SAFE_ROUNDINGS) * S::epsilon();
        let factor = Factor::of_matrix(&normal.information, S::zero(), safe).filter(|_| normal.is_safe)?;
        Some(normal.chi2 - square(&factor.forward(&normal.gradient)))
    }
}

#[cfg(test)]
mod tests {
    extern crate std;

    use std::vec::Vec;

    use glam::DVec3;

    use super::super::fixture::{compiled, currents, pose};
    use super::super::readings::Sorted;
    use super::super::twist::{Bend, Prior};
    use super::*;
    use crate::pose::Pose;

    const OFFSETS_S: [f64; 6] = [-400e-6, -250e-6, -100e-6, 50e-6, 200e-6, 350e-6];
    const TWIST: [DVec3; 2] = [DVec3::new(0.2, -0.1, 0.3), DVec3::new(3.0, 1.0, -2.0)];
    const HALF_ACCELERATION: [DVec3; 2] = [DVec3::new(40.0, 90.0, -70.0), DVec3::new(-300.0, 500.0, 200.0)];

    /// Unknown motion and light level are noise that the cells share: with whitened rows A, exposed at shares τ of the
    /// motion's duration, the residuals have the covariance Σ = 1 + P·ττᵀ∘AAᵀ + Q·τ²τ²ᵀ∘AAᵀ + s²·ccᵀ, c the whitened
    /// currents, and generalised least squares (Aitken 1935) the information Aᵀ·Σ⁻¹·A. Both the elimination and the
    /// factorisation by QR agree with it.
    #[test]
    fn unknown_motion_and_light_level_are_noise_that_the_cells_share() {
        let (mut head, truth) = (compiled(), pose());
        head.offsets_s.extend_from_slice(&OFFSETS_S).expect("six cells");
        let sorted = Sorted::of(&currents(&head.plan, &truth), &head.limits);
        for (sigmas, bend_sigmas) in [([0.5, 5.0], [150.0, 1500.0]), ([0.01, 0.0], [0.0, 40.0]), ([0.2, 2.0], [0.0; 2])]
        {
            let bend = Some(Bend { half_acceleration: HALF_ACCELERATION, sigmas: bend_sigmas });
            for level_sigma in [None, Some(0.03)] {
                head.level_information = level_sigma.map(|sigma: f64| sigma.powi(-2));
                let problem = head.problem(&sorted, &Prior { twist: TWIST, sigmas, bend });
                let workspace = &mut Workspace::new();
                let start = Transform::of(&truth);
                let at = problem.linearise(&start, workspace);
                let reach =
                    |sigmas: [f64; 2], time_s: f64| [sigmas[0] * time_s / head.length_scale_m, sigmas[1] * time_s];
                let (duration, mut sigma) = (400e-6, [[0.0; 12]; 12]);
                let (p, q) = (reach(sigmas, duration), reach(bend_sigmas, duration * duration));
                // In which rows are multiplied, and the QR factorisation must not do so again.
                let factor = workspace.level.take().as_ref().map_or(1.0, Level::factor);
                for row in workspace.rows.iter_mut().flatten() {
                    row.by_pose = row.by_pose.map(|value| factor * value);
                }
                for (i, a) in workspace.rows.iter().flatten().enumerate() {
                    for (j, b) in workspace.rows.iter().flatten().enumerate() {
                        sigma[i][j] += level_sigma.map_or(0.0, |sigma: f64| sigma * sigma * a.by_level * b.by_level);
                        let both = OFFSETS_S[i / 2] * OFFSETS_S[j / 2] / (duration * duration);
                        for k in 0..6 {
                            let variance = p[k / 3].powi(2) * both + q[k / 3].powi(2) * both * both;
                            sigma[i][j] += variance * a.by_pose[k] * b.by_pose[k];
                        }
                    }
                    sigma[i][i] += 1.0;
                }
                let column = |k: usize| core::array::from_fn(|i| workspace.rows[i / 2][i % 2].by_pose[k]);
                let residuals = core::array::from_fn(|i| workspace.rows[i / 2][i % 2].residual);
                let product = |a: &[f64; 12], b: &[f64; 12]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
                let by_qr = if problem.has_bend() {
                    problem.qr_step::<19>(workspace).factor
                } else {
                    problem.qr_step::<13>(workspace).factor
                };
                let of_residuals = solved(sigma, residuals);
                assert!((product(&residuals, &of_residuals) - at.chi2).abs() < 1e-6 * at.chi2, "{}", at.chi2);
                // Rounding times the square of what the motion adds to the noise, a thousandfold.
                let tolerance = 1e-8;
                for j in 0..6 {
                    let of_column = solved(sigma, column(j));
                    let expected: Vector6<f64> = core::array::from_fn(|i| product(&column(i), &of_column));
                    let unit = by_qr.solve(&expected);
                    for i in 0..6 {
                        let scale = (at.information[i][i] * at.information[j][j]).sqrt();
                        assert!((at.information[i][j] - expected[i]).abs() < tolerance * scale, "{i} {j}");
                        let scale = (at.information[j][j] / at.information[i][i]).sqrt();
                        let kept = if i == j { 1.0 } else { 0.0 };
                        assert!((unit[i] - kept).abs() < 100.0 * tolerance * scale, "{i} {j}, by QR: {}", unit[i]);
                    }
                    let gradient = product(&column(j), &of_residuals);
                    let scale = (at.information[j][j] * at.chi2).sqrt();
                    assert!((at.gradient[j] - gradient).abs() < tolerance * scale, "{j}");
                }
            }
        }
    }

    /// What of a cell's error is visible where the light level is a seventh unknown, with its prior as one more
    /// observation: I − B·N⁻¹·Bᵀ, B the cell's rows by all seven and N their information.
    #[test]
    fn the_light_level_hides_errors_as_a_seventh_unknown() {
        let (mut head, truth) = (compiled(), pose());
        let sorted = Sorted::of(&currents(&head.plan, &truth), &head.limits);
        let visible: Vec<f64> = [1e6, 0.1, 1e-3]
            .into_iter()
            .map(|prior_sigma: f64| {
                head.level_information = Some(prior_sigma.powi(-2));
                let problem = head.problem(&sorted, &Prior { twist: TWIST, sigmas: [0.0; 2], bend: None });
                let workspace = &mut Workspace::new();
                let at = problem.linearise(&Transform::of(&truth), workspace);
                let row = |row: &Row<f64>| core::array::from_fn(|i| if i < 6 { row.by_pose[i] } else { row.by_level });
                let rows: Vec<[[f64; 7]; 2]> =
                    workspace.rows.iter().map(|rows| [row(&rows[0]), row(&rows[1])]).collect();
                let mut information = [[0.0; 12]; 12];
                for row in rows.iter().flatten() {
                    (0..49).for_each(|k| information[k / 7][k % 7] += row[k / 7] * row[k % 7]);
                }
                information[6][6] += prior_sigma.powi(-2);
                (7..12).for_each(|i| information[i][i] = 1.0);
                let expected = rows.iter().map(|rows| {
                    let product = |a: &[f64; 7], b: &[f64; 7]| {
                        let of_b = solved(information, core::array::from_fn(|i| b.get(i).copied().unwrap_or(0.0)));
                        a.iter().zip(of_b).map(|(a, b)| a * b).sum::<f64>()
                    };
                    let [uu, vv, uv] = [(0, 0), (1, 1), (0, 1)].map(|(i, j)| product(&rows[i], &rows[j]));
                    1.0 - 0.5 * (uu + vv) - (0.25 * (uu - vv) * (uu - vv) + uv * uv).sqrt()
                });
                let expected = expected.fold(1.0, f64::min);
                let factor = Factor::of_matrix(&at.information, 0.0, 1e-12).expect("a pose");
                let visible = problem.least_visible(&factor, workspace);
                // A thousand roundings times the condition of the normal equations, some 10⁶.
                assert!((visible - expected).abs() < 1e-7, "{prior_sigma}: {visible} {expected}");
                visible
            })
            .collect();
        assert!(visible[0] < visible[2], "{visible:?}");
    }

    /// M⁻¹·v, by Gauss and Jordan.
    fn solved(mut m: [[f64; 12]; 12], mut v: [f64; 12]) -> [f64; 12] {
        for i in 0..12 {
            for k in 0..12 {
                if k == i {
                    continue;
                }
                let factor = m[k][i] / m[i][i];
                for j in 0..12 {
                    m[k][j] -= factor * m[i][j];
                }
                v[k] -= factor * v[i];
            }
        }
        core::array::from_fn(|i| v[i] / m[i][i])
    }

    /// Where the tool is at each exposure: the currents of a tool that accelerates fit a prior that says so.
    #[test]
    fn a_known_acceleration_leaves_no_residuals() {
        let (mut head, truth) = (compiled(), pose());
        head.offsets_s.extend_from_slice(&OFFSETS_S).expect("six cells");
        let moved = |i: usize, t: f64| (TWIST[i] + HALF_ACCELERATION[i] * t) * t;
        let at = |t: f64| -> Pose { truth.perturbed(moved(0, t), moved(1, t)) };
        let seen = OFFSETS_S.iter().enumerate().map(|(cell, &t)| head.plan.photocurrents(cell, &at(t)));
        let sorted = Sorted::of(&crate::Photocurrents::of_pairs(seen), &head.limits);
        let chi2 = |bend| {
            let problem = head.problem(&sorted, &Prior { twist: TWIST, sigmas: [0.0; 2], bend });
            problem.linearise(&Transform::of(&truth), &mut Workspace::new()).chi2
        };
        let known = chi2(Some(Bend { half_acceleration: HALF_ACCELERATION, sigmas: [0.0; 2] }));
        // Turns are small ones: the third power of 1.3 mrad.
        assert!(known < 1e-3 && chi2(None) > 100.0, "{known} {}", chi2(None));
    }
}
