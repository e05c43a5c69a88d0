//! Emitters whose light has changed by more than all of it has.
//!
//! Where all cells see a little more or less light than calibration found, each by a share of its own, χ² says so before
//! poses are wrong beyond their σ. The shares are then taken for random, with a common variance that makes χ² what it is
//! expected to be, its redundancy (Paule and Mandel, Consensus values and weighting factors, 1982): positions carry the
//! pose as far as they must, and σ owns up to it. One cell that contradicts all others is not such a case.

use crate::plan::Optics;
use crate::scalar::Number;

use super::accept::Fit;
use super::images::is_likely;
use super::levenberg_marquardt::{Minimum, Stopping};
use super::normal_equations::{Problem, Workspace};
use super::outcome::Solution;
use super::weights::{LoosePart, Row};

/// Relative standard deviations between which the change of an emitter's light is looked for: less matters to no pose, and
/// of more there is another reason.
const SIGMAS: [f64; 2] = [1e-4, 0.01];

/// Halvings of the logarithm between these: to a fiftieth of the standard deviation.
const HALVINGS: usize = 7;

/// Share of χ² that is left without the one cell whose matter it is.
const ONE_CELL: f64 = 0.1;

/// Redundancy plus so many standard deviations of χ² is usual.
const USUAL_SIGMAS: f64 = 2.0;

impl<S: Number, P: Optics<S>> Problem<'_, S, P> {
    /// The solution of a frame whose emitters differ, if that explains why the `minimum` fits no better; the last
    /// linearisation is near it. It is a misfit still where noise alone does not explain the frame.
    #[cold]
    #[inline(never)]
    pub fn with_uneven_light(&self, minimum: &Minimum<S>, workspace: &mut Workspace<S>) -> Option<Solution<S>> {
        let readings = self.sorted.usable.len();
        let was_misfit = minimum.chi2 > self.gate();
        // Without level or redundancy, or with planes for want of light, χ² says nothing of this.
        let prior = self.level_information()?;
        let off = workspace.level.as_ref().map_or(S::zero(), |level| level.factor() - S::one());
        // What an unlikely level of all light costs is no matter of single emitters.
        let chi2 = minimum.chi2 - off * off * prior;
        let most = if was_misfit { usual(self.head.redundancy(readings - 1)) } else { S::of(ONE_CELL) * chi2 };
        let is_one_cell = |index| self.least_chi2_without(index, workspace).is_some_and(|without| without <= most);
        if !minimum.converged
            || !workspace.plane_rows.is_empty()
            || is_likely(chi2, self.gate())
            || (0..readings).any(is_one_cell)
        {
            return None;
        }
        let redundancy = self.head.redundancy(readings);
        let chi2_with = |variance: S| self.least_chi2(None, |rows| loosened(*rows, variance), workspace);
        let [mut low, mut high] = SIGMAS.map(|sigma| S::of(sigma * sigma));
        if chi2_with(high)? > usual(redundancy) {
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
        let fit = if was_misfit { Fit::None } else { Fit::Full };
        (problem.fit(&minimum) == Fit::Full).then(|| problem.conclude_near(&minimum, workspace, fit))
    }
}

fn usual<S: Number>(redundancy: usize) -> S {
    let mean = redundancy as f64;
    S::of(mean + USUAL_SIGMAS * libm::sqrt(2.0 * mean))
}

/// The rows of a reading whose emitter's level has a `variance` of its own: (I + v·vᵀ)^(−½) times them, v what one standard
/// deviation does, as in [`super::weights::Whitener`].
fn loosened<S: Number>(rows: [Row<S>; 2], variance: S) -> [Row<S>; 2] {
    let [first, second] = rows;
    let part = LoosePart::new([first.by_level, second.by_level], variance);
    let of = |get: fn(&Row<S>) -> S| part.taken_from([get(&first), get(&second)]);
    let (by_level, residual) = (of(|row| row.by_level), of(|row| row.residual));
    let by_pose: [[S; 2]; 6] = core::array::from_fn(|i| part.taken_from([first.by_pose[i], second.by_pose[i]]));
    [0, 1].map(|k| Row { by_pose: by_pose.map(|pair| pair[k]), by_level: by_level[k], residual: residual[k] })
}
