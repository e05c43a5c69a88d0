//! What comes out of a solve.

use core::fmt;

use crate::pose::{Pose, Rigid};
use crate::scalar::Number;
use crate::scene::MAX_CELLS;

use super::algebra::{Factor, Matrix6};
use super::weights::redundancy;

/// The coordinates of a pose, in the order of the covariance.
pub const AXES: [&str; 6] = ["tx", "ty", "tz", "rx", "ry", "rz"];

/// Whether there is a pose, and how good; else why not.
///
/// ```
/// # let scene: slitpose_model::Scene = include!(concat!(env!("CARGO_MANIFEST_DIR"), "/doc/ring.rs"));
/// // `scene` has six cells in a ring, as in the example of this crate.
/// use slitpose_model::*;
/// let solver = Solver::<f64>::new(&scene, Tier::Exact { tolerance: 1e-6 })?;
/// let dark = Photocurrents { cells: [Reading::Missing; 6].into_iter().collect() };
/// let outcome = solver.solve(&dark, Start::Cold, &MotionPrior::AT_REST).outcome;
/// assert!(!outcome.has_pose());
/// assert_eq!(outcome.as_str(), "unobservable");
/// # Ok::<(), SceneError>(())
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Outcome {
    /// A pose from all cells of the scene, and the data fit it.
    Converged,
    /// A pose, but for the reason given it deserves less trust.
    Degraded(DegradedReason),
    /// Several distinct poses explain the data.
    Ambiguous,
    /// The data leave these directions free.
    Unobservable(Directions),
    /// Too few cells see enough light for six unknowns.
    TooDark,
    /// No pose near the data was found.
    Diverged,
}

/// Why a pose deserves less trust.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DegradedReason {
    /// Some cells are saturated, faint or missing; the others decide.
    FewerCells,
    /// A cell contradicted all others and was left out.
    CellExcluded,
    /// The residuals are larger than the noise explains.
    Misfit,
    /// The solver was told to stop before the minimum.
    Unfinished,
    /// The head is known by the tolerances of its parts alone.
    Uncalibrated,
    /// Scans shortly before contradicted the scene: see the health of the head.
    Doubted,
}

impl DegradedReason {
    /// The word used in tables and messages.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::FewerCells => "fewer_cells",
            Self::CellExcluded => "cell_excluded",
            Self::Misfit => "misfit",
            Self::Unfinished => "unfinished",
            Self::Uncalibrated => "uncalibrated",
            Self::Doubted => "doubted",
        }
    }
}

impl Outcome {
    /// Whether the solution carries a pose.
    pub fn has_pose(&self) -> bool {
        matches!(self, Self::Converged | Self::Degraded(_))
    }

    /// Whether the scene does not explain the currents: they have an outlier, identified or not.
    pub fn is_contradiction(&self) -> bool {
        matches!(self, Self::Degraded(DegradedReason::Misfit | DegradedReason::CellExcluded))
    }

    /// The word used in tables and messages.
    pub fn as_str(&self) -> &'static str {
        match self {
            Self::Converged => "converged",
            Self::Degraded(_) => "degraded",
            Self::Ambiguous => "ambiguous",
            Self::Unobservable(_) => "unobservable",
            Self::TooDark => "too_dark",
            Self::Diverged => "diverged",
        }
    }
}

/// A set of pose coordinates.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Directions(u8);

impl Directions {
    pub(crate) fn all() -> Self {
        Self(0b11_1111)
    }

    /// The coordinates that lie more than half in the space of `free` directions.
    pub(crate) fn of_free(free: &[[f64; 6]]) -> Self {
        let share = |axis: usize| free.iter().map(|vector| vector[axis] * vector[axis]).sum::<f64>();
        Self((0..6).filter(|&axis| share(axis) > 0.25).fold(0, |set, axis| set | 1 << axis))
    }

    /// Their names.
    pub fn names(&self) -> impl Iterator<Item = &'static str> + '_ {
        AXES.into_iter().enumerate().filter(|(axis, _)| self.0 & (1 << axis) != 0).map(|(_, name)| name)
    }
}

impl fmt::Display for Directions {
    /// The names joined by `;`.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (i, name) in self.names().enumerate() {
            write!(f, "{}{name}", if i == 0 { "" } else { ";" })?;
        }
        Ok(())
    }
}

/// A set of cells.
///
/// ```
/// use slitpose_model::Cells;
/// let cells = Cells::from_bits(0b10_0101);
/// assert_eq!(cells.iter().collect::<Vec<_>>(), [0, 2, 5]);
/// assert!(cells.contains(2) && cells.count() == 3);
/// ```
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Cells(u16);

const _: () = assert!(MAX_CELLS <= 16, "one bit per cell");

impl Cells {
    pub(crate) fn insert(&mut self, cell: usize) {
        self.0 |= 1 << cell;
    }

    pub(crate) fn remove(&mut self, cell: usize) {
        self.0 &= !(1 << cell);
    }

    /// Cell k for bit k.
    pub fn from_bits(bits: u16) -> Self {
        Self(bits)
    }

    /// The cells of the set, ascending.
    pub fn iter(&self) -> impl Iterator<Item = usize> + '_ {
        (0..MAX_CELLS).filter(|&cell| self.contains(cell))
    }

    /// Whether `cell` belongs to the set.
    pub fn contains(&self, cell: usize) -> bool {
        cell < MAX_CELLS && self.0 & (1 << cell) != 0
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.0 == 0
    }

    /// Bit k for cell k.
    pub fn bits(&self) -> u16 {
        self.0
    }

    /// How many there are.
    pub fn count(&self) -> usize {
        self.0.count_ones() as usize
    }
}

/// A pose with its covariance.
///
/// ```
/// # let scene: slitpose_model::Scene = include!(concat!(env!("CARGO_MANIFEST_DIR"), "/doc/ring.rs"));
/// // `scene` has six cells in a ring, as in the example of this crate.
/// use slitpose_model::*;
/// let solver = Solver::<f64>::new(&scene, Tier::Exact { tolerance: 1e-6 })?;
/// let currents = Photocurrents::of_pairs((0..6).map(|cell| solver.plan().photocurrents(cell, &Pose::HOME)));
/// let estimate = solver.solve(&currents, Start::Cold, &MotionPrior::AT_REST).estimate.expect("a pose");
/// let [x_m, .., about_z_rad] = estimate.sigma();
/// assert!(x_m > 0.0 && about_z_rad > 0.0);
/// assert!(estimate.nees(&Pose::HOME).expect("a covariance") < 1e-3, "there is no noise");
/// # Ok::<(), SceneError>(())
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Estimate<S = f64> {
    /// `base_from_tool` at the reference instant.
    pub pose: Pose,
    /// Covariance of the perturbation (δt, δθ) in the base frame: m², m·rad, rad².
    pub covariance: Matrix6<S>,
}

impl<S: Number> Estimate<S> {
    /// Standard deviations of (δt, δθ): m and rad.
    pub fn sigma(&self) -> [S; 6] {
        core::array::from_fn(|i| self.covariance[i][i].root())
    }

    /// The same in `f64`.
    pub fn widened(&self) -> Estimate {
        Estimate { pose: self.pose, covariance: self.covariance.map(|row| row.map(S::as_f64)) }
    }

    /// Normalised estimation error squared against the `truth`: eᵀC⁻¹e with
    /// e = [t̂ − t ; log(R̂ Rᵀ)]. Of an honest covariance its mean is 6. `None` if the covariance is
    /// singular.
    pub fn nees(&self, truth: &Pose) -> Option<f64> {
        let (dt, dr) = self.pose.displacement_from(truth);
        let error = [dt.x, dt.y, dt.z, dr.x, dr.y, dr.z];
        // Metres and radians differ in size: scaled by σ the factorisation sees correlations.
        let Estimate { covariance, .. } = self.widened();
        let sigma: [f64; 6] = core::array::from_fn(|i| libm::sqrt(covariance[i][i]));
        let scaled: Matrix6<f64> =
            core::array::from_fn(|i| core::array::from_fn(|j| covariance[i][j] / (sigma[i] * sigma[j])));
        let right: [f64; 6] = core::array::from_fn(|i| error[i] / sigma[i]);
        let factor = Factor::of_matrix(&scaled, 0.0, f64::EPSILON)?;
        Some(factor.forward(&right).iter().map(|value| value * value).sum())
    }
}

/// Mean χ² over redundancy above which frames contradict their scene together: that of a sound head is about 1, and 1.3 when it
/// is 20 K warmer.
pub const MAX_MEAN_MISFIT: f64 = 1.5;

/// Most that one frame counts for in this mean: what is beyond contradicts by itself.
pub const MAX_MISFIT: f64 = 10.0;

/// The result of one solve.
#[derive(Clone, Copy, Debug)]
pub struct Solution<S: Number = f64> {
    /// What happened.
    pub outcome: Outcome,
    /// The pose; present exactly if the outcome carries one.
    pub estimate: Option<Estimate<S>>,
    /// Sum of the squared whitened residuals.
    pub chi2: S,
    /// Data minus unknowns: what χ² is distributed over, and what checked the pose.
    pub redundancy: usize,
    /// Refinement steps taken, over all starts.
    pub iterations: usize,
    /// Evaluations of all cells, with or without derivatives: the cost of the solve, whatever the
    /// processor.
    pub evaluations: usize,
    /// The cells whose currents entered.
    pub cells_used: Cells,
    /// Cells with light that contradict all others, and were left out for that.
    pub excluded: Cells,
    /// External reliability (Baarda 1968): how far, in σ of the pose, an error in the currents of one cell can have
    /// moved the pose and yet be as likely as not to pass the gate of χ², which is the minimal detectable bias.
    /// Infinite where there is no redundancy to check with, and of a [`BoardTracker`](crate::BoardTracker)'s.
    pub unnoticed_sigmas: S,
    /// Factor of the information in scaled coordinates; see [`Self::condition`].
    pub(crate) factor: Option<Factor<S>>,
    /// The pose of the estimate in the solver's own numbers; home without one.
    pub(crate) rigid: Rigid<S>,
}

/// How well the data checked a pose that carries no other doubt.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Verified {
    /// An error in one cell that moves the pose by 30 σ is detected: six cells hardly do better.
    Well,
    /// A cell can move the pose by more than 30 σ unnoticed, but not by more than 300 σ.
    Weakly,
    /// Nothing, or next to nothing, is left over to check with.
    Not,
}

impl Verified {
    /// The word used in messages.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Well => "well",
            Self::Weakly => "weakly",
            Self::Not => "not",
        }
    }
}

impl<S: Number> Solution<S> {
    /// A pose, or why there is none, from a solver elsewhere that tells no more than this. Nothing is known of its steps,
    /// its condition, and what an error in one cell would have done.
    pub fn reported(
        outcome: Outcome,
        estimate: Option<Estimate<S>>,
        chi2: S,
        cells_used: Cells,
        excluded: Cells,
    ) -> Self {
        Self {
            rigid: estimate.as_ref().map_or_else(Rigid::home, |estimate| Rigid::of(&estimate.pose)),
            estimate,
            chi2,
            redundancy: redundancy(cells_used.count(), false),
            excluded,
            ..Self::without_pose(outcome, cells_used)
        }
    }

    /// The pose in the solver's own numbers: translation in metres, rotation as a unit quaternion x, y, z, w.
    pub fn pose_numbers(&self) -> Option<([S; 3], [S; 4])> {
        self.estimate.is_some().then(|| self.rigid.numbers())
    }

    pub(crate) fn without_pose(outcome: Outcome, cells_used: Cells) -> Self {
        Self {
            outcome,
            estimate: None,
            chi2: S::nan(),
            redundancy: 0,
            iterations: 0,
            evaluations: 0,
            cells_used,
            excluded: Cells::default(),
            unnoticed_sigmas: S::infinity(),
            factor: None,
            rigid: Rigid::home(),
        }
    }

    /// With the covariance of a misfit scaled by χ² over redundancy: by as much as all errors are larger than they were
    /// taken for (Björck 1996, section 1.4).
    ///
    /// In place: on the board a copy of a solution takes hundreds of cycles.
    #[inline]
    pub(crate) fn inflate_covariance(&mut self) {
        if let (Outcome::Degraded(DegradedReason::Misfit), Some(estimate)) = (self.outcome, &mut self.estimate) {
            let factor = (self.chi2 / S::of(self.redundancy.max(1) as f64)).max(S::one());
            estimate.covariance = estimate.covariance.map(|row| row.map(|value| value * factor));
        }
    }

    /// The same in `f64`.
    pub fn widened(&self) -> Solution {
        Solution {
            outcome: self.outcome,
            estimate: self.estimate.map(|estimate| estimate.widened()),
            chi2: self.chi2.as_f64(),
            redundancy: self.redundancy,
            iterations: self.iterations,
            evaluations: self.evaluations,
            cells_used: self.cells_used,
            excluded: self.excluded,
            unnoticed_sigmas: self.unnoticed_sigmas.as_f64(),
            factor: self.factor.map(|factor| factor.widened()),
            rigid: self.rigid.widened(),
        }
    }

    /// How well redundancy checked the pose: see [`Self::unnoticed_sigmas`].
    pub fn verified(&self) -> Verified {
        match self.unnoticed_sigmas {
            shift if shift <= S::of(30.0) => Verified::Well,
            shift if shift <= S::of(300.0) => Verified::Weakly,
            _ => Verified::Not,
        }
    }

    /// Condition number (ratio of the extreme singular values) of the whitened Jacobian, with
    /// translations counted in units of the emitters' root-mean-square distance from the tool's
    /// origin, so that metres and radians compare. `None` without solution.
    pub fn condition(&self) -> Option<S> {
        let [least, largest] = self.factor.as_ref()?.extreme_singular_values();
        Some(largest / least)
    }
}

impl fmt::Display for Cells {
    /// The numbers joined by `;`.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (i, cell) in self.iter().enumerate() {
            write!(f, "{}{cell}", if i == 0 { "" } else { ";" })?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_checks_a_pose_is_put_into_words_by_how_far_it_may_have_been_moved() {
        let verified = |unnoticed_sigmas| {
            let nothing = Solution::<f64>::without_pose(Outcome::Converged, Cells::default());
            Solution { unnoticed_sigmas, ..nothing }.verified()
        };
        assert_eq!([0.0, 29.9].map(verified), [Verified::Well; 2]);
        assert_eq!([30.1, 299.0].map(verified), [Verified::Weakly; 2]);
        assert_eq!([301.0, 2999.0, f64::INFINITY, f64::NAN].map(verified), [Verified::Not; 4]);
    }
}
