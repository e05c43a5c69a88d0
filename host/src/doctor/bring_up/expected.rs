//! What a scene predicts for its head with the tool at home.

use slitpose_model::{Pair, Plan, Pose};

/// Photocurrents at nominal level, amperes.
#[derive(Clone, Debug)]
pub(super) struct Expected {
    /// Light of each cell's own emitter.
    pub(super) own: Vec<Pair<f64>>,
    /// `stray[cell][emitter]`: light of the other emitters, both electrodes together, as a share of the cell's own.
    pub(super) stray: Vec<Vec<f64>>,
}

impl Expected {
    /// By the optics `plan`, and `coarse` ones for light of other emitters.
    pub(super) fn of(plan: &Plan<f64>, coarse: &Plan<f64>) -> Self {
        let cells = 0..plan.cell_count();
        let own: Vec<_> = cells.clone().map(|cell| plan.crosstalk(cell, cell, &Pose::HOME)).collect();
        let share = |cell: usize, emitter: usize| {
            let light = if cell == emitter { own[cell] } else { coarse.crosstalk(cell, emitter, &Pose::HOME) };
            light.total_a() / own[cell].total_a()
        };
        let stray = cells.clone().map(|cell| cells.clone().map(|emitter| share(cell, emitter)).collect()).collect();
        Self { own, stray }
    }
}
