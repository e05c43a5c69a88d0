//! The tool's motion within a frame, eliminated from the normal equations.
//!
//! A cell exposed τ after the reference instant sees the pose advanced by τ·twist + τ²·bend; the bend is half the
//! acceleration. Of a twist that is known only with a covariance P the deviation w is six more unknowns with a prior,
//! of a bend that is known with Q the deviation b another six. With A the whitened rows of one cell and
//! Mₙ = Στⁿ·AᵀA, the Schur complements
//!
//! K = M₂ + P⁻¹, information = M₀ − M₁·K⁻¹·M₁, then
//! K′ = M₄ + Q⁻¹ − M₃·K⁻¹·M₃, N = M₂ − M₃·K⁻¹·M₁, information − Nᵀ·K′⁻¹·N,
//!
//! and likewise for the gradient and χ², marginalise both exactly, with the correlation between cells that they bring.

use arrayvec::ArrayVec;

use crate::pose::Twist;
use crate::scalar::{Number, Vector3};

use super::algebra::{Factor, Matrix6, Vector6, add_outer, mirror};
use super::level::{Level, Unknowns};
use super::weights::{ResidualSums, Row};

/// Largest information a prior on the motion can have: it is then known.
const KNOWN: f64 = 1e30;

/// What is known beforehand of the tool's motion within a frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MotionPrior {
    /// The twist that carries each cell's exposure to the reference instant.
    pub twist: Twist,
    /// Standard deviation of its linear part, per axis, m/s.
    pub linear_sigma_m_per_s: f64,
    /// Standard deviation of its angular part, per axis, rad/s.
    pub angular_sigma_rad_per_s: f64,
}

impl MotionPrior {
    /// A tool at rest.
    pub const AT_REST: Self = Self {
        twist: Twist { linear_m_per_s: glam::DVec3::ZERO, angular_rad_per_s: glam::DVec3::ZERO },
        linear_sigma_m_per_s: 0.0,
        angular_sigma_rad_per_s: 0.0,
    };
}

/// [`MotionPrior`] in the solver's numbers.
#[derive(Clone, Copy, Debug)]
pub struct Prior<S: Number> {
    pub twist: [S::Vec3; 2],
    /// Standard deviations of the twist per axis, m/s and rad/s.
    pub sigmas: [S; 2],
    /// How the twist changes; `None`: not at all.
    pub bend: Option<Bend<S>>,
}

/// What is known beforehand of the tool's acceleration within a frame.
#[derive(Clone, Copy, Debug)]
pub struct Bend<S: Number> {
    /// Half the acceleration, linear and angular: m/s² and rad/s².
    pub half_acceleration: [S::Vec3; 2],
    /// Standard deviations of that per axis.
    pub sigmas: [S; 2],
}

impl<S: Number> Prior<S> {
    pub fn of(motion: &MotionPrior) -> Self {
        Self {
            twist: [motion.twist.linear_m_per_s, motion.twist.angular_rad_per_s].map(|v| S::Vec3::of(v)),
            sigmas: [motion.linear_sigma_m_per_s, motion.angular_sigma_rad_per_s].map(S::of),
            bend: None,
        }
    }

    pub fn at_rest() -> Self {
        Self { twist: [S::Vec3::default(); 2], sigmas: [S::zero(); 2], bend: None }
    }
}

/// Motion of the tool within a frame, and how well it is known.
#[derive(Clone, Copy, Debug)]
pub struct Motion<S: Number> {
    /// Linear and angular.
    pub twist: [S::Vec3; 2],
    /// Half the acceleration, as in [`Bend`]; `None`: zero.
    pub bend: Option<[S::Vec3; 2]>,
    /// The largest |τ|, seconds; zero if all cells are exposed at one instant.
    pub duration: S,
    /// P⁻¹ of (linear, angular) in units of length scale/duration and 1/duration; `None`: the twist is known.
    pub prior: Option<[S; 2]>,
    /// Q⁻¹ in those units per duration; `None`: the bend is known, as with a known twist.
    pub bend_prior: Option<[S; 2]>,
}

impl<S: Number> Motion<S> {
    #[inline(always)]
    pub fn new(prior: &Prior<S>, duration: S, length_scale_m: S) -> Self {
        let Prior { twist, bend, sigmas } = *prior;
        // σ by the end of the motion, in units of the scaled pose.
        let prior = |[linear, angular]: [S; 2]| {
            let is_unknown = duration > S::zero() && (linear > S::zero() || angular > S::zero());
            is_unknown.then(|| {
                [linear / length_scale_m, angular].map(|sigma| {
                    let share = sigma * duration;
                    (share * share).recip().min(S::of(KNOWN))
                })
            })
        };
        let twist_prior = prior(sigmas);
        let bend_prior = match (twist_prior, &bend) {
            (Some(_), Some(bend)) => prior(bend.sigmas.map(|sigma| sigma * duration)),
            _ => None,
        };
        Self { twist, bend: bend.map(|bend| bend.half_acceleration), duration, prior: twist_prior, bend_prior }
    }
}

#[derive(Debug)]
pub struct Elimination<S> {
    /// M₁ and M₂ if the twist is not known, M₃ and M₄ if the bend is not; then, in their places, the columns of L⁻¹·M₁, of
    /// L′⁻¹·N and of L⁻¹·M₃.
    blocks: ArrayVec<Matrix6<S>, 4>,
    /// L of K = L·Lᵀ; `None`: the twist is known.
    twist: Option<Factor<S>>,
    /// L′ of K′ = L′·L′ᵀ; `None`: the bend is known.
    bend: Option<Factor<S>>,
}

impl<S: Number> Elimination<S> {
    /// Of a known motion.
    #[inline(always)]
    pub fn new() -> Self {
        Self { blocks: ArrayVec::new(), twist: None, bend: None }
    }

    /// Without rows yet, of this motion.
    #[inline(always)]
    pub fn begin(&mut self, motion: &Motion<S>) {
        (self.twist, self.bend) = (None, None);
        self.blocks.clear();
        if motion.prior.is_some() {
            let blocks = if motion.bend_prior.is_some() { 4 } else { 2 };
            self.blocks.extend(core::iter::repeat_n([[S::zero(); 6]; 6], blocks));
        }
    }

    /// Whether there is a motion that is not known.
    pub fn is_under_way(&self) -> bool {
        self.twist.is_some()
    }

    /// Adds the `rows` of one reading, exposed at `share` of the motion's duration.
    #[inline(never)]
    pub fn add<const N: usize>(&mut self, share: S, rows: &[Row<S>; N]) {
        let own = rows.each_ref().map(|row| &row.by_pose);
        let mut weight = share;
        for moment in &mut self.blocks {
            let weighted = own.map(|row| row.map(|value| weight * value));
            add_outer(moment, weighted.each_ref(), own);
            weight *= share;
        }
    }

    /// Eliminates the motion of the rows that were added, unless it is known. Takes its part from the information M₀; χ² and
    /// gradient of the pose alone. `level`: what M₀ and `sums` have lost already.
    #[inline(never)]
    pub fn eliminate(
        &mut self,
        motion: &Motion<S>,
        level: Option<&Level<S>>,
        information: &mut Matrix6<S>,
        sums: &ResidualSums<S>,
    ) -> (S, Vector6<S>) {
        let (Some(prior), [mixed, twist, of_bend @ ..]) = (motion.prior, self.blocks.as_mut_slice()) else {
            return (sums.chi2, sums.by_pose);
        };
        mirror(mixed);
        let take_level = |matrix: &mut Matrix6<S>, of| {
            if let Some(level) = level {
                level.take_from_motion(matrix, of);
            }
        };
        // The factorisation of a symmetric matrix reads the lower half.
        let mut with_prior = *twist;
        take_level(mixed, Unknowns::PoseTwist);
        take_level(&mut with_prior, Unknowns::Twist);
        add_prior(&mut with_prior, prior);
        // Positive definite, by the prior.
        let Some(factor) = Factor::of_matrix(&with_prior, S::zero(), S::zero()) else {
            return (sums.chi2, sums.by_pose);
        };
        columns(mixed, &factor);
        take(information, mixed, mixed);
        if let (Some(prior), [with_bend, bend]) = (motion.bend_prior, of_bend) {
            mirror(twist);
            mirror(with_bend);
            take_level(twist, Unknowns::PoseBend);
            take_level(with_bend, Unknowns::BendTwist);
            take_level(bend, Unknowns::Bend);
            columns(with_bend, &factor);
            add_prior(bend, prior);
            take(bend, with_bend, with_bend);
            take(twist, mixed, with_bend);
            self.bend = Factor::of_matrix(bend, S::zero(), S::zero());
            if let Some(factor) = &self.bend {
                columns(twist, factor);
                take(information, twist, twist);
            }
        }
        self.twist = Some(factor);
        self.apply(sums)
    }

    /// χ² and gradient of the pose alone.
    pub fn apply(&self, sums: &ResidualSums<S>) -> (S, Vector6<S>) {
        let (mut chi2, mut gradient) = (sums.chi2, sums.by_pose);
        let (Some(factor), [mixed, bend_mixed, of_bend @ ..]) = (&self.twist, self.blocks.as_slice()) else {
            return (chi2, gradient);
        };
        let twist = factor.forward(&sums.by_twist);
        take_vector(&mut gradient, mixed, &twist);
        chi2 = twist.iter().fold(chi2, |chi2, &value| chi2 - value * value);
        if let (Some(factor), [by_twist, _]) = (&self.bend, of_bend) {
            let mut bend = sums.by_bend;
            take_vector(&mut bend, by_twist, &twist);
            let bend = factor.forward(&bend);
            take_vector(&mut gradient, bend_mixed, &bend);
            chi2 = bend.iter().fold(chi2, |chi2, &value| chi2 - value * value);
        }
        (chi2.max(S::zero()), gradient)
    }
}

/// The columns of L⁻¹ times a matrix, in its place.
#[inline(always)]
fn columns<S: Number>(matrix: &mut Matrix6<S>, factor: &Factor<S>) {
    *matrix = matrix.map(|column| factor.forward(&column));
}

#[inline(always)]
fn add_prior<S: Number>(matrix: &mut Matrix6<S>, prior: [S; 2]) {
    for (i, row) in matrix.iter_mut().enumerate() {
        row[i] += prior[i / 3];
    }
}

/// Takes the products of the columns of `left` and `right` from `matrix`.
#[inline(always)]
fn take<S: Number>(matrix: &mut Matrix6<S>, left: &Matrix6<S>, right: &Matrix6<S>) {
    for i in 0..6 {
        for j in 0..6 {
            for k in 0..6 {
                let known = left[i][k] * right[j][k];
                matrix[i][j] -= known;
            }
        }
    }
}

/// Takes the products of the `columns` and of `unknowns` from `vector`.
#[inline(always)]
fn take_vector<S: Number>(vector: &mut Vector6<S>, columns: &Matrix6<S>, unknowns: &Vector6<S>) {
    for i in 0..6 {
        for k in 0..6 {
            let known = columns[i][k] * unknowns[k];
            vector[i] -= known;
        }
    }
}
