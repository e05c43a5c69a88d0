//! Rows of currents, each solved from a cold start.

use std::collections::BTreeMap;

use slitpose_calibration::Head;
use slitpose_head::boxed::boxed_solver;
use slitpose_model::{MotionPrior, Pair, Photocurrents, Reading, Scene, SceneError, Solution, Solver, Start, Tier};

/// Most numbers of averaged frames whose solvers are kept.
const MOST_SOLVERS: usize = 64;

/// Solves readings of one head that do not belong together.
pub struct RowSolver {
    head: Head,
    tier: Tier,
    without_clipped: bool,
    /// By the frames that a reading is the mean of.
    solvers: BTreeMap<u64, Box<Solver<f64>>>,
}

impl RowSolver {
    /// For readings of `head`; `without_clipped`: cells whose light falls on an end of the detector are left out.
    ///
    /// # Errors
    /// A scene that cannot be computed.
    pub fn new(head: Head, tier: Tier, without_clipped: bool) -> Result<Self, SceneError> {
        let mut rows = Self { head, tier, without_clipped, solvers: BTreeMap::new() };
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
    pub fn with_frames(&mut self, frames: f64) -> Result<RowsOf<'_>, SceneError> {
        let Self { head, tier, without_clipped, solvers } = self;
        let key = frames.to_bits();
        if !solvers.contains_key(&key) {
            if solvers.len() >= MOST_SOLVERS {
                solvers.clear();
            }
            let scene = &head.file.scene;
            let noise = scene.noise.map(|noise| noise.averaged(frames));
            let mut solver = boxed_solver(&Scene { noise, ..scene.clone() }, *tier)?;
            if *without_clipped {
                *solver = solver.without_clipped();
            }
            solvers.insert(key, solver);
        }
        Ok(RowsOf { head, solver: &solvers[&key] })
    }
}

/// Solves readings that are means of as many frames.
#[derive(Clone, Copy)]
pub struct RowsOf<'a> {
    head: &'a Head,
    solver: &'a Solver<f64>,
}

impl RowsOf<'_> {
    /// The pose behind one row: the currents of each cell, dark current included; `None`: not measured.
    pub fn solve(&self, row: impl IntoIterator<Item = Option<Pair<f64>>>) -> Solution {
        let reading = |(pair, cell): (Option<Pair<f64>>, &slitpose_model::Cell)| match pair {
            Some(Pair { i_x1_a, i_x2_a }) => {
                let half_dark_a = 0.5 * cell.detector.dark_current_a;
                Reading::Light(Pair { i_x1_a: i_x1_a - half_dark_a, i_x2_a: i_x2_a - half_dark_a })
            }
            None => Reading::Missing,
        };
        let cells = row.into_iter().zip(&self.head.file.scene.cells).map(reading).collect();
        let mut solution = self.solver.solve(&Photocurrents { cells }, Start::Cold, &MotionPrior::AT_REST);
        self.head.complete(&mut solution);
        solution
    }
}
