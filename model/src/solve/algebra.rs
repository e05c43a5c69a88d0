//! Fixed-size linear algebra for six unknowns: no heap, either number type.

use crate::scalar::Scalar;

/// A vector of the six pose coordinates (translation, rotation).
pub(crate) type Vector6<S> = [S; 6];

/// A symmetric 6×6 matrix, stored in full.
pub(crate) type Matrix6<S> = [[S; 6]; 6];

/// The lower Cholesky factor of a positive definite matrix.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Cholesky<S> {
    lower: Matrix6<S>,
}

impl<S: Scalar> Cholesky<S> {
    /// Factorises `matrix` with its diagonal multiplied by 1 + `damping` (elements that are next to
    /// nothing are damped as if they were a millionth of the largest). `None` if a pivot falls to
    /// `threshold` of the largest diagonal element or below: singular to that precision.
    pub(crate) fn factorise(matrix: &Matrix6<S>, damping: S, threshold: S) -> Option<Self> {
        let largest = (0..6).fold(S::zero(), |largest, i| matrix[i][i].max(largest));
        let least_pivot = threshold * largest;
        let mut lower = [[S::zero(); 6]; 6];
        for i in 0..6 {
            for j in 0..=i {
                let mut sum = matrix[i][j];
                if i == j {
                    sum += damping * matrix[i][i].max(S::of(1e-6) * largest);
                }
                for k in 0..j {
                    sum -= lower[i][k] * lower[j][k];
                }
                if i == j {
                    // Written so that NaN fails, too.
                    let positive = sum > least_pivot;
                    if !positive {
                        return None;
                    }
                    lower[i][i] = sum.sqrt();
                } else {
                    lower[i][j] = sum / lower[j][j];
                }
            }
        }
        Some(Self { lower })
    }

    /// Solves for one right-hand side.
    pub(crate) fn solve(&self, right: &Vector6<S>) -> Vector6<S> {
        let l = &self.lower;
        let mut x = *right;
        for i in 0..6 {
            for k in 0..i {
                let known = l[i][k] * x[k];
                x[i] -= known;
            }
            x[i] /= l[i][i];
        }
        for i in (0..6).rev() {
            for k in i + 1..6 {
                let known = l[k][i] * x[k];
                x[i] -= known;
            }
            x[i] /= l[i][i];
        }
        x
    }

    /// The inverse of the factorised matrix.
    pub(crate) fn inverse(&self) -> Matrix6<S> {
        let mut inverse = [[S::zero(); 6]; 6];
        for (i, row) in inverse.iter_mut().enumerate() {
            let mut unit = [S::zero(); 6];
            unit[i] = S::one();
            *row = self.solve(&unit);
        }
        inverse
    }
}

/// Eigenvalues (ascending) and eigenvectors of a symmetric matrix by Jacobi rotations (Golub and
/// Van Loan, Matrix Computations, §8.5): slow, but right to rounding however ill-conditioned.
pub(crate) fn eigen<S: Scalar>(matrix: &Matrix6<S>) -> [(S, Vector6<S>); 6] {
    /// Cyclic sweeps: convergence is quadratic, six unknowns need about five.
    const SWEEPS: usize = 12;
    let mut a = *matrix;
    let mut vectors: Matrix6<S> =
        core::array::from_fn(|i| core::array::from_fn(|j| if i == j { S::one() } else { S::zero() }));
    for _ in 0..SWEEPS {
        for p in 0..5 {
            for q in p + 1..6 {
                if a[p][q] == S::zero() {
                    continue;
                }
                let theta = (a[q][q] - a[p][p]) / (S::two() * a[p][q]);
                let t = theta.signum() / (theta.abs() + (theta * theta + S::one()).sqrt());
                let c = (t * t + S::one()).sqrt().recip();
                let s = t * c;
                for k in 0..6 {
                    let (x, y) = (a[k][p], a[k][q]);
                    a[k][p] = c * x - s * y;
                    a[k][q] = s * x + c * y;
                }
                for k in 0..6 {
                    let (x, y) = (a[p][k], a[q][k]);
                    a[p][k] = c * x - s * y;
                    a[q][k] = s * x + c * y;
                }
                for row in &mut vectors {
                    let (x, y) = (row[p], row[q]);
                    row[p] = c * x - s * y;
                    row[q] = s * x + c * y;
                }
            }
        }
    }
    let mut pairs: [(S, Vector6<S>); 6] = core::array::from_fn(|i| (a[i][i], vectors.map(|row| row[i])));
    pairs.sort_unstable_by(|x, y| x.0.partial_cmp(&y.0).unwrap_or(core::cmp::Ordering::Equal));
    pairs
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A well-filled positive definite matrix with condition number about `spread`².
    fn example(spread: f64) -> Matrix6<f64> {
        let mut matrix = [[0.0; 6]; 6];
        for k in 0..6 {
            let scale = spread.powf(k as f64 / 5.0);
            let row: [f64; 6] = core::array::from_fn(|i| ((7 * k * k + 3 * i * i + k * i + 1) as f64).sin() * scale);
            for i in 0..6 {
                for j in 0..6 {
                    matrix[i][j] += row[i] * row[j];
                }
            }
        }
        matrix
    }

    #[test]
    fn solving_inverts_multiplying() {
        let matrix = example(10.0);
        let factor = Cholesky::factorise(&matrix, 0.0, 1e-14).expect("positive definite");
        let x = [1.0, -2.0, 3.0, 0.5, 0.0, 1e3];
        let right: [f64; 6] = core::array::from_fn(|i| (0..6).map(|j| matrix[i][j] * x[j]).sum());
        for (a, b) in factor.solve(&right).into_iter().zip(x) {
            assert!((a - b).abs() < 1e-8, "{a} {b}");
        }
    }

    #[test]
    fn a_singular_matrix_is_refused() {
        let mut matrix = example(1.0);
        matrix[5] = matrix[4];
        for row in &mut matrix {
            row[5] = row[4];
        }
        assert!(Cholesky::factorise(&matrix, 0.0, 1e-13).is_none());
    }

    #[test]
    fn eigenvectors_diagonalise() {
        let matrix = example(100.0);
        let pairs = eigen(&matrix);
        let largest = pairs[5].0;
        for (value, vector) in pairs {
            for i in 0..6 {
                let product: f64 = (0..6).map(|j| matrix[i][j] * vector[j]).sum();
                // Backward stable: a few units in the last place of the largest eigenvalue.
                assert!((product - value * vector[i]).abs() < 1e-14 * largest);
            }
        }
    }
}
