//! Errors of poses, gathered.

use slitpose_model::Pose;

use super::method::Solved;

/// Sums over many poses.
#[derive(Clone, Debug, Default)]
pub(super) struct Errors {
    squares_m2: Vec<f64>,
    squares_rad2: Vec<f64>,
    tried: usize,
    iterations: usize,
}

impl Errors {
    /// Counts one solve.
    pub(super) fn add(&mut self, solved: &Solved, truth: &Pose) {
        self.tried += 1;
        self.iterations += solved.iterations;
        if let Some(pose) = &solved.pose {
            let (dt, dr) = pose.displacement_from(truth);
            self.squares_m2.push(dt.length_squared());
            self.squares_rad2.push(dr.length_squared());
        }
    }

    /// Of many solves.
    pub(super) fn of<'a>(solves: impl IntoIterator<Item = (Solved, &'a Pose)>) -> Self {
        let mut errors = Self::default();
        for (solved, truth) in solves {
            errors.add(&solved, truth);
        }
        errors
    }

    /// Root mean square of the translation's error, metres; NaN without a pose.
    pub(super) fn rms_m(&self) -> f64 {
        mean(&self.squares_m2).sqrt()
    }

    /// Root mean square of the rotation's error, radians; NaN without a pose.
    pub(super) fn rms_rad(&self) -> f64 {
        mean(&self.squares_rad2).sqrt()
    }

    /// Median error of the translation, metres; NaN without a pose.
    pub(super) fn median_m(&self) -> f64 {
        median(self.squares_m2.clone()).sqrt()
    }

    /// Median error of the rotation, radians; NaN without a pose.
    pub(super) fn median_rad(&self) -> f64 {
        median(self.squares_rad2.clone()).sqrt()
    }

    /// Share of the solves that gave a pose.
    pub(super) fn solved(&self) -> f64 {
        self.squares_m2.len() as f64 / self.tried as f64
    }

    /// Mean number of refinement steps.
    pub(super) fn mean_iterations(&self) -> f64 {
        self.iterations as f64 / self.tried as f64
    }
}

/// Root mean squares of translation (metres) and rotation (radians) that covariances allow.
pub(super) fn rms_of_covariances(covariances: impl IntoIterator<Item = [[f64; 6]; 6]>) -> (f64, f64) {
    let (mut square_m2, mut square_rad2, mut count) = (0.0, 0.0, 0.0);
    for covariance in covariances {
        square_m2 += (0..3).map(|axis| covariance[axis][axis]).sum::<f64>();
        square_rad2 += (3..6).map(|axis| covariance[axis][axis]).sum::<f64>();
        count += 1.0;
    }
    ((square_m2 / count).sqrt(), (square_rad2 / count).sqrt())
}

fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len() as f64
}

/// The middle of `values`; NaN of none.
pub(super) fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied().unwrap_or(f64::NAN)
}
