//! A solver small enough for a microcontroller, made where there is room.

use thiserror::Error;

use crate::plan::{CompactPlan, NODES, Plan, Tier};
use crate::pose::Pose;
use crate::scalar::Scalar;
use crate::scene::{Scene, SceneError};

use super::solver::Solver;
use super::starts;

/// Relative error of the currents that a rule may have: a hundredth of what noise does to them in a frame at 4 kHz.
const TOLERANCE: f64 = 2e-5;

/// Of the currents that it is measured by.
const TRUE_TOLERANCE: f64 = 1e-9;

/// Poses of the reach at which it is measured, and home.
const LOOKS: usize = 64;

/// Why a head cannot be held by a microcontroller.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum CompactError {
    /// It cannot be held by anything.
    #[error(transparent)]
    Scene(#[from] SceneError),
    /// It has too many cells.
    #[error("{cells} cells, and the board has {most}: leave cells out")]
    Cells {
        /// Of the scene.
        cells: usize,
        /// That fit.
        most: usize,
    },
    /// A cell is of a kind that has no place there.
    #[error("cell {cell} has what the board does not compute, {what}: solve on the host, or leave it out")]
    Kind {
        /// Number of the cell.
        cell: usize,
        /// What it has.
        what: &'static str,
    },
    /// The light on a spot is so uneven that no short rule takes it.
    #[error("the spots are too wide or too near for the board: its sums would err by {error:.1e} of the light")]
    Spots {
        /// Relative error of a current by the longest rule.
        error: f64,
    },
}

impl<S: Scalar, const N: usize> Solver<S, CompactPlan<S, N>> {
    /// A solver for `scene` in the exact tier, with one rule for the light of all spots: the shortest whose currents are
    /// right to 2·10⁻⁵ at poses spread over 4 mm and 17° about home. For cells exposed at the reference instant.
    ///
    /// # Errors
    /// If the scene is impossible, has more than `N` cells, or a cell that is not a slit parallel to its detector before
    /// an emitter of the profile cosⁿγ.
    pub fn compact(scene: &Scene) -> Result<Self, CompactError> {
        if scene.cells.len() > N {
            return Err(CompactError::Cells { cells: scene.cells.len(), most: N });
        }
        let truth = Plan::<f64>::compile(scene, Tier::Exact { tolerance: TRUE_TOLERANCE })?;
        if let Some((cell, what)) = truth.not_compact() {
            return Err(CompactError::Kind { cell, what });
        }
        let mut least = f64::INFINITY;
        for nodes in NODES {
            let Some(plan) = CompactPlan::<f64, N>::of(&truth, nodes) else { continue };
            let error = worst_error(&plan, &truth);
            least = least.min(error);
            if error <= TOLERANCE {
                return Self::with_nodes(scene, nodes);
            }
        }
        Err(CompactError::Spots { error: least })
    }

    fn with_nodes(scene: &Scene, nodes: [usize; 2]) -> Result<Self, CompactError> {
        let tier = Tier::Exact { tolerance: TOLERANCE };
        let Solver { compiled, max_steps } = Solver::<S>::new(scene, tier)?;
        let Some(plan) = CompactPlan::of(&compiled.plan, nodes) else { unreachable!("tried before") };
        Ok(Self { compiled: compiled.with_plan(plan), max_steps })
    }
}

/// The greatest relative error of a current of `plan`, over the reach of a head.
fn worst_error<const N: usize>(plan: &CompactPlan<f64, N>, truth: &Plan<f64>) -> f64 {
    let poses = core::iter::once(Pose::HOME).chain((0..LOOKS).map(|index| starts::spread::<f64>(index).to_pose()));
    poses.fold(0.0, |worst: f64, pose| {
        let found = plan.currents_at(&pose);
        found.iter().enumerate().fold(worst, |worst, (cell, found)| {
            let expected = truth.photocurrents(cell, &pose);
            let total = expected.i_x1_a + expected.i_x2_a;
            let off = (found[0] - expected.i_x1_a).abs().max((found[1] - expected.i_x2_a).abs());
            // No light at all is no light on both sides.
            if off == 0.0 { worst } else { worst.max(off / total) }
        })
    })
}
