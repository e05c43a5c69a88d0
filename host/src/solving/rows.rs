//! Rows of currents, each solved from a cold start.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex};

use slitpose_calibration::Head;
use slitpose_head::threads::lock;
use slitpose_model::{
    Batch, MotionPrior, Pair, Photocurrents, Reading, Scene, SceneError, Solution, Solver, Starts, Tier,
};

/// Most numbers of averaged frames whose solvers are kept.
const MOST_SOLVERS: usize = 64;

/// Solves readings of one head that do not belong together.
pub struct RowSolver {
    head: Head,
    tier: Tier,
    without_clipped: bool,
    /// By the frames that a reading is the mean of.
    solvers: Mutex<BTreeMap<u64, Arc<Solver<f64>>>>,
}

impl RowSolver {
    /// For readings of `head`; `without_clipped`: cells whose light falls on an end of the detector are left out.
    ///
    /// # Errors
    /// A scene that cannot be computed.
    pub fn new(head: Head, tier: Tier, without_clipped: bool) -> Result<Self, SceneError> {
        let rows = Self { head, tier, without_clipped, solvers: Mutex::default() };
        rows.with_frames(1.0)?;
        Ok(rows)
    }

    /// How many cells the head has.
    pub fn cells(&self) -> usize {
        self.head.file.scene.cells.len()
    }

    /// Makes ready for readings that are the mean of `frames` frames.
    ///
    /// # Errors
    /// A scene that cannot be computed.
    pub fn with_frames(&self, frames: f64) -> Result<RowsOf<'_>, SceneError> {
        let key = frames.to_bits();
        let known = lock(&self.solvers).get(&key).cloned();
        let solver = match known {
            Some(solver) => solver,
            None => {
                let scene = &self.head.file.scene;
                let noise = scene.noise.map(|noise| noise.averaged(frames));
                let mut solver = Solver::new(&Scene { noise, ..scene.clone() }, self.tier)?;
                if self.without_clipped {
                    solver = solver.without_clipped();
                }
                let mut solvers = lock(&self.solvers);
                if solvers.len() >= MOST_SOLVERS {
                    solvers.clear();
                }
                Arc::clone(solvers.entry(key).or_insert(Arc::new(solver)))
            }
        };
        Ok(RowsOf { head: &self.head, solver })
    }
}

/// Solves readings that are means of as many frames.
#[derive(Clone)]
pub struct RowsOf<'a> {
    head: &'a Head,
    solver: Arc<Solver<f64>>,
}

impl RowsOf<'_> {
    /// One row, from the currents of each cell, dark current included; `None`: not measured.
    pub fn readings(&self, row: impl IntoIterator<Item = Option<Pair<f64>>>) -> Photocurrents {
        let reading = |(pair, cell): (Option<Pair<f64>>, &slitpose_model::Cell)| match pair {
            Some(Pair { i_x1_a, i_x2_a }) => {
                let half_dark_a = 0.5 * cell.detector.dark_current_a;
                Reading::Light(Pair { i_x1_a: i_x1_a - half_dark_a, i_x2_a: i_x2_a - half_dark_a })
            }
            None => Reading::Missing,
        };
        Photocurrents { cells: row.into_iter().zip(&self.head.file.scene.cells).map(reading).collect() }
    }

    /// Passes the solution of each of `rows` to `take`, in their order: the pose behind it, found from a cold start.
    pub fn solve(&self, rows: &[Photocurrents], mut take: impl FnMut(Solution)) {
        Batch::new(&self.solver).solve(rows, Starts::Cold, &MotionPrior::AT_REST, |_, mut solution| {
            self.head.complete(&mut solution);
            take(solution);
        });
    }

    /// Passes the condition number of each of `solutions` to `take`, in their order.
    pub fn conditions(&self, solutions: &[Solution], mut take: impl FnMut(Option<f64>)) {
        Batch::new(&self.solver).conditions(solutions, |_, condition| take(condition));
    }
}
