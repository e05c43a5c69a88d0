//! How well the parameters are determined as a whole.

use nalgebra::{DMatrix, SymmetricEigen};

use crate::{Calibration, Parameter};

/// A direction among the parameters.
#[derive(Clone, Debug, PartialEq)]
pub struct Direction<'a> {
    /// σ along it, in units of the prior σ: 1 is unseen.
    pub sigma: f64,
    /// The parameters with the largest shares of it, and these, in units of their prior σ.
    pub shares: Vec<(&'a Parameter, f64)>,
}

/// Parameters named of each direction.
const NAMED: usize = 6;

impl Calibration {
    /// All principal directions of what the data left open, the weakest first.
    pub fn directions(&self) -> Vec<Direction<'_>> {
        let entries = self.parameters();
        let sigma = |k: usize| entries[k].sigma / entries[k].prior_sigma;
        let covariance = DMatrix::from_fn(entries.len(), entries.len(), |i, j| {
            let correlation = match i.cmp(&j) {
                std::cmp::Ordering::Equal => 1.0,
                std::cmp::Ordering::Greater => self.correlation[i][j],
                std::cmp::Ordering::Less => self.correlation[j][i],
            };
            correlation * sigma(i) * sigma(j)
        });
        let eigen = SymmetricEigen::new(covariance);
        let mut order: Vec<usize> = (0..entries.len()).collect();
        order.sort_by(|&a, &b| eigen.eigenvalues[b].total_cmp(&eigen.eigenvalues[a]));
        let direction = |place: usize| {
            let vector = eigen.eigenvectors.column(place);
            let mut shares: Vec<_> = entries.iter().zip(vector.iter().copied()).collect();
            shares.sort_by(|a, b| b.1.abs().total_cmp(&a.1.abs()));
            shares.truncate(NAMED);
            Direction { sigma: eigen.eigenvalues[place].max(0.0).sqrt(), shares }
        };
        order.into_iter().map(direction).collect()
    }
}
