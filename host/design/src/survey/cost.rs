//! What the exact tier takes for a solver: narrow and tabulated profiles over wide spots take more
//! values of the profile than others, and may meet the limit of work.

use serde::Serialize;
use slitpose_model::{Plan, Pose, SceneError, Tier};

use slitpose_head::scene_file::SceneFile;

use super::sample::{self, Tally};

/// What `solve`, `run`, `replay` and `simulate` ask for unless told otherwise.
const TOLERANCE: f64 = 1e-6;

/// Poses evaluated: the dearest of them is not far from the dearest of all.
const MOST_SAMPLES: usize = 200;

/// One cell's integrals at the tolerance of solving.
#[derive(Clone, Copy, Debug, Serialize)]
pub(crate) struct CellCost {
    /// Number of the cell.
    pub cell: usize,
    /// The tolerance.
    pub tolerance: f64,
    /// Most values of the emission profile for one pair of currents.
    pub most_evaluations: usize,
    /// The greatest error reached: the tolerance, unless the limit of work came first; infinite, in JSON null, if no
    /// light was found by then where there may be some.
    pub relative_error: f64,
}

/// How many poses are looked at, of `samples` of the workspace.
pub(super) fn poses_of(samples: usize) -> usize {
    samples.min(MOST_SAMPLES)
}

impl Tally for CellCost {
    fn add(&mut self, plan: &Plan<f64>, pose: &Pose) {
        if let Some(integration) = plan.respond(self.cell, pose).integration {
            self.raise(integration.evaluations, integration.relative_error);
        }
    }

    fn merge(&mut self, later: Self) {
        self.raise(later.most_evaluations, later.relative_error);
    }
}

impl CellCost {
    fn raise(&mut self, evaluations: usize, relative_error: f64) {
        self.most_evaluations = self.most_evaluations.max(evaluations);
        self.relative_error = self.relative_error.max(relative_error);
    }
}

/// The costs of all cells over some of `samples` poses of the workspace.
pub(super) fn of_cells(
    file: &SceneFile,
    samples: usize,
    progress: impl FnMut(usize),
) -> Result<Vec<CellCost>, SceneError> {
    let tolerance = TOLERANCE;
    let plan = Plan::<f64>::compile(&file.scene, Tier::Exact { tolerance })?;
    let costs: Vec<_> = (0..plan.cell_count())
        .map(|cell| CellCost { cell, tolerance, most_evaluations: 0, relative_error: tolerance })
        .collect();
    Ok(sample::over(&plan, &costs, file.workspace.poses(poses_of(samples)), progress))
}
