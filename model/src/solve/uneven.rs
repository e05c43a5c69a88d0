//! Emitters whose light has changed by more than all of it has.
//!
//! Where all cells see a little more or less light than calibration found, each by a share of its own, χ² says so before
//! poses are wrong beyond their σ. The shares are then taken for random, with a common variance that makes χ² what it is
//! expected to be, its redundancy (Paule and Mandel, Consensus values and weighting factors, 1982): positions carry the
//! pose as far as they must, and σ owns up to it. One cell that contradicts all others is not such a case.

use crate::plan::Optics;
use crate::scalar::Number;

use super::accept::Fit;
use super::images::HARDLY_NOISE;
use super::levenberg_marquardt::{Minimum, Stopping};
use super::normal_equations::{Problem, Workspace};
use super::outcome::Solution;
use super::weights::Row;

/// Relative standard deviations between which the change of an emitter's light is looked for: less matters to no pose, and
/// of more there is another reason.
const SIGMAS: [f64; 2] = [1e-4, 0.01];

/// Halvings of the logarithm between these: to a fiftieth of the standard deviation.
const HALVINGS: usize = 7;

/// Share of χ² that is left without the one cell whose matter it is.
const ONE_CELL: f64 = 0.1;

/// Redundancy plus so many standard deviations of χ² is likely.
const LIKELY_SIGMAS: f64 = 2.0;

/// What a frame says whose emitters have changed each by its own share.
pub struct Uneven<'a, S: Number, P> {
    pub problem: Problem<'a, S, P>,
    pub minimum: Minimum<S>,
    /// Whether noise alone does not explain the frame.
    pub was_misfit: bool,
}

impl<'a, S: Number, P: Optics<S>> Problem<'a, S, P> {
    /// The frame with emitters that differ, if that explains why the `minimum` fits no better; the last linearisation is
    /// near it.
    #[cold]
    #[inline(never)]
    pub fn with_uneven_light(&self, minimum: &Minimum<S>, workspace: &mut Workspace<S>) -> Option<Uneven<'a, S, P>> {
        let readings = self.sorted.usable.len();
        let was_misfit = minimum.chi2 > self.gate();
        // Without level or redundancy, or with planes for want of light, χ² says nothing of this.
        let prior = self.level_information()?;
        let off = workspace.level.as_ref().map_or(S::zero(), |level| level.factor() - S::one());
        // What an unlikely level of all light costs is no matter of single emitters.
        let chi2 = minimum.chi2 - off * off * prior;
        let most = if was_misfit { likely(self.head.redundancy(readings - 1)) } else { S::of(ONE_CELL) * chi2 };
        let is_one_cell = |index| self.least_chi2_without(index, workspace).is_some_and(|without| without <= most);
        if !minimum.converged
            || !workspace.plane_rows.is_empty()
            || chi2 <= S::of(HARDLY_NOISE) * self.gate()
            || (0..readings).any(is_one_cell)
        {
            return None;
        }
        let redundancy = self.head.redundancy(readings);
        let chi2_with = |variance: S| self.least_chi2(None, |rows| loosened(*rows, variance), workspace);
        let [mut low, mut high] = SIGMAS.map(|sigma| S::of(sigma * sigma));
        if chi2_with(high)? > likely(redundancy) {
            return None;
        }
        for _ in 0..HALVINGS {
            let middle = (low * high).root();
            if chi2_with(middle)? > S::of(redundancy as f64) {
                low = middle;
            } else {
                high = middle;
            }
        }
        let loosened = self.sorted.usable.iter().zip(&self.whiteners);
        let whiteners = loosened.map(|(reading, whitener)| whitener.loosened(reading.pair, high)).collect();
        let problem = Self { whiteners, ..*self };
        let minimum = problem.minimise(minimum.pose, Stopping::near(), workspace);
        (problem.fit(&minimum) == Fit::Full).then_some(Uneven { problem, minimum, was_misfit })
    }
}

impl<S: Number, P: Optics<S>> Uneven<'_, S, P> {
    /// The solution, which is a misfit still where noise alone does not explain the frame.
    pub fn conclude_near(&self, workspace: &mut Workspace<S>) -> Solution<S> {
        let fit = if self.was_misfit { Fit::None } else { Fit::Full };
        self.problem.conclude_near(&self.minimum, workspace, fit)
    }
}

fn likely<S: Number>(redundancy: usize) -> S {
    let mean = redundancy as f64;
    S::of(mean + LIKELY_SIGMAS * libm::sqrt(2.0 * mean))
}

/// The rows of a reading whose emitter's level has a `variance` of its own: (I + v·vᵀ)^(−½) times them, v what one standard
/// deviation does, as in [`super::weights::Whitener`].
fn loosened<S: Number>(rows: [Row<S>; 2], variance: S) -> [Row<S>; 2] {
    let [first, second] = rows;
    let (a, b) = (first.by_level, second.by_level);
    let root = (S::one() + variance * (a * a + b * b)).root();
    let factor = variance / (root * (S::one() + root));
    let along = |x: S, y: S| factor * (a * x + b * y);
    let by_pose: [S; 6] = core::array::from_fn(|i| along(first.by_pose[i], second.by_pose[i]));
    let (by_level, residual) = (along(a, b), along(first.residual, second.residual));
    let reduced = |row: Row<S>, share: S| Row {
        by_pose: core::array::from_fn(|i| row.by_pose[i] - share * by_pose[i]),
        by_level: row.by_level - share * by_level,
        residual: row.residual - share * residual,
    };
    [reduced(first, a), reduced(second, b)]
}
