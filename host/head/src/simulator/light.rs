//! The light on the detectors of a simulated head.

use std::fmt::Debug;

use slitpose_model::{Pair, Plan, Pose};

/// Optics of a head. [`Plan`] has those of the model; a virtual bench may have more.
pub trait Light: Debug + Send + Sync {
    /// Number of cells.
    fn cell_count(&self) -> usize;

    /// Photocurrents of `cell` above dark, amperes, while the emitters `lit` shine, each at its level relative to
    /// nominal, with the tool at `pose`.
    ///
    /// # Panics
    /// If there is no such cell or emitter.
    fn photocurrents(&self, cell: usize, lit: &[(usize, f64)], pose: &Pose) -> Pair<f64>;
}

impl Light for Plan<f64> {
    fn cell_count(&self) -> usize {
        self.cell_count()
    }

    fn photocurrents(&self, cell: usize, lit: &[(usize, f64)], pose: &Pose) -> Pair<f64> {
        self.photocurrents_of(cell, lit.iter().copied(), pose)
    }
}
