//! The parameters of a head as one vector.

use heapless::Vec as FixedVec;
use slitpose_model::{Cell, MAX_CELLS, Scene};

use crate::parameter::{Quantity, cell_with};

/// One parameter: what was known, and what is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Parameter {
    /// The cell it belongs to; `None`: shared by all cells.
    pub cell: Option<usize>,
    /// What it is.
    pub quantity: Quantity,
    /// Most probable value before calibration, in the unit of the quantity.
    pub prior: f64,
    /// Its standard deviation.
    pub prior_sigma: f64,
    /// Value now.
    pub value: f64,
    /// Its standard deviation.
    pub sigma: f64,
}

impl Parameter {
    pub(crate) fn at_prior(cell: Option<usize>, quantity: Quantity, prior: f64, prior_sigma: f64) -> Self {
        Self { cell, quantity, prior, prior_sigma, value: prior, sigma: prior_sigma }
    }

    /// Name with the cell, for people and files.
    pub fn name(&self) -> String {
        match self.cell {
            Some(cell) => format!("cell {cell} {}", self.quantity),
            None => self.quantity.to_string(),
        }
    }

    /// Shift from the prior, in its standard deviations.
    pub fn shift(&self) -> f64 {
        (self.value - self.prior) / self.prior_sigma
    }
}

/// All parameters of a head.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Parameters {
    pub(crate) entries: Vec<Parameter>,
    /// Current at the top code of the converters, amperes.
    pub(crate) full_scale_a: f64,
}

impl Parameters {
    /// The cell whose parameters are those of the emitter of `cell`, cell `number`: two axes of a detector have one.
    pub(crate) fn emitter_of(cell: &Cell, number: usize) -> usize {
        cell.other_axis().map_or(number, |other| other.min(number))
    }

    /// Which parameters act on `cell`, cell `number`, which sees light of the emitters `lit_together`, too: places in
    /// [`Self::entries`].
    pub(crate) fn acting_on(&self, cell: &Cell, number: usize, lit_together: u16) -> Vec<usize> {
        let emitters = lit_together | 1 << Self::emitter_of(cell, number);
        let acts = |parameter: &Parameter| match parameter.cell {
            None => true,
            Some(own) => own == number || emitters >> own & 1 == 1 && parameter.quantity.is_of_emitter(),
        };
        (0..self.entries.len()).filter(|&k| acts(&self.entries[k])).collect()
    }

    /// Cell `number` with the parameters in force, that at place `changed.0` with another value.
    pub(crate) fn cell(&self, nominal: &Cell, number: usize, changed: Option<(usize, f64)>) -> Cell {
        let emitter = Self::emitter_of(nominal, number);
        let acts = |entry: &Parameter| {
            entry.cell.is_none_or(|own| own == if entry.quantity.is_of_emitter() { emitter } else { number })
        };
        let of_cell = self.entries.iter().enumerate().filter(|(_, entry)| acts(entry));
        let values = of_cell.map(|(k, entry)| match changed {
            Some((place, value)) if place == k => (entry.quantity, value),
            _ => (entry.quantity, entry.value),
        });
        cell_with(nominal, self.full_scale_a, values)
    }

    /// The scene with the parameters in force.
    pub(crate) fn scene(&self, nominal: &Scene) -> Scene {
        let cells = nominal.cells.iter().enumerate().map(|(number, cell)| self.cell(cell, number, None));
        Scene { cells: cells.collect::<FixedVec<_, MAX_CELLS>>(), ..nominal.clone() }
    }
}
