//! What a faulty cell measures.

use rand::seq::SliceRandom;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use slitpose_model::Pair;

/// A fault of one cell, or of the wiring of several.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Fault {
    /// Both electrodes of one cell scatter by 5 % of their current.
    NoisyCell,
    /// The electrodes of one cell are exchanged.
    SwappedElectrodes,
    /// Two cells are exchanged.
    SwappedCells,
    /// One electrode measures the same whatever the light.
    StuckElectrode,
    /// Two cells, drawn anew each scan, are exchanged.
    RandomSwaps,
}

impl Fault {
    /// All of them.
    pub const ALL: [Self; 5] =
        [Self::NoisyCell, Self::SwappedElectrodes, Self::SwappedCells, Self::StuckElectrode, Self::RandomSwaps];

    /// Puts the fault into the currents of a scan; `order` is the run's random order of the cells.
    pub(super) fn apply(self, order: &[usize], light: &mut [Pair<f64>], rng: &mut ChaCha8Rng) {
        let faulty = order[0];
        let pair = &mut light[faulty];
        match self {
            Self::NoisyCell => {
                let mut scatter = || 1.0 + 0.05 * <StandardNormal as Distribution<f64>>::sample(&StandardNormal, rng);
                *pair = Pair { i_x1_a: pair.i_x1_a * scatter(), i_x2_a: pair.i_x2_a * scatter() };
            }
            Self::SwappedElectrodes => std::mem::swap(&mut pair.i_x1_a, &mut pair.i_x2_a),
            Self::SwappedCells => light.swap(faulty, order[1]),
            // About the middle of what an electrode of the default head measures.
            Self::StuckElectrode => pair.i_x2_a = 5e-6,
            Self::RandomSwaps => {
                let mut cells: Vec<usize> = (0..light.len()).collect();
                cells.shuffle(rng);
                light.swap(cells[0], cells[1]);
            }
        }
    }
}
