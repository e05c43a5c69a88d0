//! What was measured of the cells at one reference instant.

use arrayvec::ArrayVec;
use heapless::Vec;
use serde::{Deserialize, Serialize};

use crate::response::Pair;
use crate::scalar::Number;
use crate::scene::MAX_CELLS;

use super::outcome::Cells;

/// What is known of one cell.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Reading<T = f64> {
    /// Currents above dark, I_X − I_D/2 for each electrode, at nominal emitter drive: amperes.
    Light(Pair<T>),
    /// A converter or the detector was at its limit.
    Saturated,
    /// No measurement of this cell.
    Missing,
}

/// The photocurrents of all cells of a scene, in the order of its cells.
///
/// ```
/// use slitpose_model::*;
/// let mut currents = Photocurrents::of_pairs([Pair { i_x1_a: 1e-6, i_x2_a: 2e-6 }; 6]);
/// currents.cells[3] = Reading::Saturated;
/// currents.cells[4] = Reading::Missing;
/// assert_eq!(currents.cells.iter().filter(|reading| matches!(reading, Reading::Light(_))).count(), 4);
/// ```
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Photocurrents<T = f64> {
    /// One reading per cell.
    pub cells: Vec<Reading<T>, MAX_CELLS>,
}

impl<T> Photocurrents<T> {
    /// From one pair per cell, currents above dark.
    pub fn of_pairs(pairs: impl IntoIterator<Item = Pair<T>>) -> Self {
        Self { cells: pairs.into_iter().map(Reading::Light).collect() }
    }
}

impl Photocurrents {
    /// In the numbers of a solver.
    pub fn rounded<S: Number>(&self) -> Photocurrents<S> {
        let rounded = |reading: &Reading| match reading {
            Reading::Light(Pair { i_x1_a, i_x2_a }) => {
                Reading::Light(Pair { i_x1_a: S::of(*i_x1_a), i_x2_a: S::of(*i_x2_a) })
            }
            Reading::Saturated => Reading::Saturated,
            Reading::Missing => Reading::Missing,
        };
        Photocurrents { cells: self.cells.iter().map(rounded).collect() }
    }
}

#[derive(Clone, Copy, Debug)]
pub struct Usable<S> {
    pub cell: usize,
    pub pair: [S; 2],
}

#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
pub struct Limits<S> {
    pub faint_a: S,
    /// Above dark.
    pub saturation_a: S,
    /// |I_X2 − I_X1|/I_O beyond which a spot is taken for clipped and left out.
    pub most_share: S,
}

/// The readings of one solve, sorted by use.
#[derive(Clone, Debug)]
pub struct Sorted<S> {
    pub usable: ArrayVec<Usable<S>, MAX_CELLS>,
    pub used: Cells,
    /// Cells that were measured and found without enough light.
    pub faint: Cells,
}

impl<S: Number> Sorted<S> {
    pub fn of(readings: &Photocurrents<S>, limits: &[Limits<S>]) -> Self {
        let mut sorted = Self { usable: ArrayVec::new(), used: Cells::default(), faint: Cells::default() };
        for (cell, (reading, limits)) in readings.cells.iter().zip(limits).enumerate() {
            let Reading::Light(pair) = reading else {
                continue;
            };
            let pair = [pair.i_x1_a, pair.i_x2_a];
            let total = pair[0] + pair[1];
            if !pair[0].is_finite() || !pair[1].is_finite() || total > limits.saturation_a {
                continue;
            }
            if total < limits.faint_a || total <= S::zero() {
                sorted.faint.insert(cell);
                continue;
            }
            if (pair[1] - pair[0]).abs() > limits.most_share * total {
                continue;
            }
            sorted.used.insert(cell);
            // As many as the scene has cells.
            sorted.usable.push(Usable { cell, pair });
        }
        sorted
    }

    /// Refers the readings to the light level of the head's scene, from one `level` times as bright.
    pub fn divide_by(&mut self, level: S) {
        if level != S::one() {
            self.usable.iter_mut().for_each(|reading| reading.pair = reading.pair.map(|current| current / level));
        }
    }

    /// The same without the usable reading `index`; its cell counts as not measured.
    pub fn without(&self, index: usize) -> Self {
        let mut sorted = self.clone();
        sorted.used.remove(sorted.usable.remove(index).cell);
        sorted
    }
}
