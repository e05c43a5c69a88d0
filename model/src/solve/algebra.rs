//! Fixed-size linear algebra for six unknowns: no heap, either number type.
//!
//! Normal equations are quick and good as long as the condition number is well below the inverse
//! root of rounding; a triangle made of the rows themselves ([`Triangle`]) is good up to the inverse
//! of rounding.

use crate::scalar::Number;

/// A vector of the six pose coordinates (translation, rotation).
pub type Vector6<S> = [S; 6];

pub type Matrix6<S> = [[S; 6]; 6];

/// Scalar product.
#[inline(always)]
pub fn dot<S: Number>(a: &Vector6<S>, b: &Vector6<S>) -> S {
    let mut sum = S::zero();
    for (&x, &y) in a.iter().zip(b) {
        sum += x * y;
    }
    sum
}

/// |v|².
#[inline(always)]
pub fn square<S: Number>(v: &Vector6<S>) -> S {
    dot(v, v)
}

/// A lower triangular L with L·Lᵀ the matrix that was factorised.
#[derive(Clone, Copy, Debug)]
pub struct Factor<S> {
    lower: Matrix6<S>,
    /// 1/L_ii.
    inverses: Vector6<S>,
}

impl<S: Number> Factor<S> {
    /// L⁻¹·v.
    #[inline(always)]
    pub fn forward(&self, v: &Vector6<S>) -> Vector6<S> {
        let mut x = *v;
        for i in 0..6 {
            for k in 0..i {
                x[i] -= self.lower[i][k] * x[k];
            }
            x[i] *= self.inverses[i];
        }
        x
    }

    /// L⁻ᵀ·v.
    #[inline(always)]
    pub fn backward(&self, v: &Vector6<S>) -> Vector6<S> {
        let mut x = *v;
        for i in (0..6).rev() {
            for k in i + 1..6 {
                x[i] -= self.lower[k][i] * x[k];
            }
            x[i] *= self.inverses[i];
        }
        x
    }

    /// (L·Lᵀ)⁻¹·v.
    #[inline(always)]
    pub fn solve(&self, v: &Vector6<S>) -> Vector6<S> {
        self.backward(&self.forward(v))
    }

    /// (L·Lᵀ)⁻¹ = L⁻ᵀ·L⁻¹.
    #[inline(always)]
    pub fn inverse(&self) -> Matrix6<S> {
        let zero = S::zero();
        // Columns of L⁻¹, each from its diagonal down.
        let mut columns = [[zero; 6]; 6];
        for j in 0..6 {
            columns[j][j] = self.inverses[j];
            for i in j + 1..6 {
                let mut sum = zero;
                for k in j..i {
                    sum += self.lower[i][k] * columns[j][k];
                }
                columns[j][i] = -(sum * self.inverses[i]);
            }
        }
        let mut inverse = [[zero; 6]; 6];
        for i in 0..6 {
            for j in 0..=i {
                let mut sum = zero;
                for k in i..6 {
                    sum += columns[i][k] * columns[j][k];
                }
                inverse[i][j] = sum;
                inverse[j][i] = sum;
            }
        }
        inverse
    }

    /// The Cholesky factor of `matrix` with its diagonal multiplied by 1 + `damping` (elements that
    /// are next to nothing are damped as if they were a millionth of the largest). `None` if a pivot
    /// falls to `threshold` of its diagonal element or below: then the matrix is too near to a
    /// singular one for its digits. The ratio does not depend on how unknowns are scaled.
    #[inline]
    pub fn of_matrix(matrix: &Matrix6<S>, damping: S, threshold: S) -> Option<Self> {
        let least = if damping > S::zero() {
            S::of(1e-6) * (0..6).fold(S::zero(), |largest, i| matrix[i][i].max(largest))
        } else {
            S::zero()
        };
        let mut factor = Self { lower: [[S::zero(); 6]; 6], inverses: [S::zero(); 6] };
        for i in 0..6 {
            let diagonal = matrix[i][i] + damping * matrix[i][i].max(least);
            let mut pivot = diagonal;
            for j in 0..i {
                let mut sum = matrix[i][j];
                for k in 0..j {
                    sum -= factor.lower[i][k] * factor.lower[j][k];
                }
                factor.lower[i][j] = sum * factor.inverses[j];
            }
            for k in 0..i {
                pivot -= factor.lower[i][k] * factor.lower[i][k];
            }
            // Written so that NaN fails, too.
            let safe = pivot > threshold * diagonal;
            if !safe {
                return None;
            }
            factor.inverses[i] = pivot.inverse_root();
            factor.lower[i][i] = pivot * factor.inverses[i];
        }
        Some(factor)
    }

    pub fn widened(&self) -> Factor<f64> {
        Factor { lower: self.lower.map(|row| row.map(S::as_f64)), inverses: self.inverses.map(S::as_f64) }
    }

    /// |Lᵀ·v|: the length of a displacement in σ.
    pub fn length(&self, v: &Vector6<S>) -> S {
        let element = |i: usize| (i..6).fold(S::zero(), |sum, k| sum + self.lower[k][i] * v[k]);
        (0..6).fold(S::zero(), |sum, i| sum + element(i) * element(i)).root()
    }

    /// Whether the diagonal spans less than `ratio`.
    pub fn is_even(&self, ratio: S) -> bool {
        let diagonal = (0..6).map(|i| self.lower[i][i]);
        diagonal.clone().fold(S::infinity(), S::min) > ratio * diagonal.fold(S::zero(), S::max)
    }

    /// Singular values of Lᵀ (ascending) with their right vectors, by one-sided Jacobi rotations
    /// (Hestenes 1958): slow, but small ones keep their digits.
    pub fn singular(&self) -> [(S, Vector6<S>); 6] {
        let mut vectors: Matrix6<S> =
            core::array::from_fn(|i| core::array::from_fn(|j| if i == j { S::one() } else { S::zero() }));
        let columns = self.orthogonal_columns(|p, q, cosine, sine| rotate(&mut vectors, p, q, cosine, sine));
        let mut pairs: [(S, Vector6<S>); 6] =
            core::array::from_fn(|i| (dot(&columns[i], &columns[i]).root(), vectors[i]));
        pairs.sort_unstable_by(|x, y| x.0.partial_cmp(&y.0).unwrap_or(core::cmp::Ordering::Equal));
        pairs
    }

    #[inline(always)]
    pub fn extreme_singular_values(&self) -> [S; 2] {
        let columns = self.orthogonal_columns(|_, _, _, _| ());
        let mut values = [square(&columns[0]).root(); 2];
        for column in &columns[1..] {
            let value = square(column).root();
            values = [values[0].at_most(value), values[1].at_least(value)];
        }
        values
    }

    /// The columns of Lᵀ after rotations of each two that leave all at right angles; `rotated` is told columns, cosine
    /// and sine of each.
    #[inline(always)]
    fn orthogonal_columns(&self, mut rotated: impl FnMut(usize, usize, S, S)) -> Matrix6<S> {
        /// Cyclic sweeps: convergence is quadratic, six unknowns need about six.
        const SWEEPS: usize = 14;
        // Columns of Lᵀ are rows of L.
        let mut columns = self.lower;
        let (one, quarter) = (S::one(), S::of(0.25) * S::epsilon());
        for _ in 0..SWEEPS {
            let mut is_done = true;
            for p in 0..5 {
                for q in p + 1..6 {
                    let (a, b, c) = (square(&columns[p]), square(&columns[q]), dot(&columns[p], &columns[q]));
                    if c.abs() <= quarter * (a * b).root() {
                        continue;
                    }
                    is_done = false;
                    let theta = (b - a) / (S::two() * c);
                    let size = theta.abs() + (theta * theta + one).root();
                    let t = if theta >= S::zero() { one } else { -one } / size;
                    let cosine = (t * t + one).root().recip();
                    let sine = t * cosine;
                    rotate(&mut columns, p, q, cosine, sine);
                    rotated(p, q, cosine, sine);
                }
            }
            // Another sweep would find the same.
            if is_done {
                break;
            }
        }
        columns
    }
}

/// Rotates the rows `p` and `q` of `rows` by an angle.
#[inline(always)]
fn rotate<S: Number>(rows: &mut Matrix6<S>, p: usize, q: usize, cosine: S, sine: S) {
    for k in 0..6 {
        let (x, y) = (rows[p][k], rows[q][k]);
        rows[p][k] = cosine * x - sine * y;
        rows[q][k] = sine * x + cosine * y;
    }
}

/// The upper triangle R of a growing matrix A = Q·R, and Qᵀ·b of a right-hand side b, row by row
/// with Givens rotations: condition numbers are those of A, not of AᵀA.
#[derive(Clone, Copy, Debug)]
pub struct Triangle<S, const N: usize> {
    upper: [[S; N]; N],
    right: [S; N],
}

impl<S: Number, const N: usize> Triangle<S, N> {
    pub fn new() -> Self {
        Self { upper: [[S::zero(); N]; N], right: [S::zero(); N] }
    }

    /// Adds a row of A and its element of b.
    pub fn add(&mut self, mut row: [S; N], mut right: S) {
        for i in 0..N {
            if row[i] == S::zero() {
                continue;
            }
            // A hypotenuse that neither overflows nor underflows.
            let (a, b) = (self.upper[i][i], row[i]);
            let scale = a.abs().max(b.abs());
            let length = scale * S::norm(a / scale, b / scale);
            let (cosine, sine) = (a / length, b / length);
            for k in i..N {
                let (x, y) = (self.upper[i][k], row[k]);
                self.upper[i][k] = cosine * x + sine * y;
                row[k] = cosine * y - sine * x;
            }
            let (x, y) = (self.right[i], right);
            self.right[i] = cosine * x + sine * y;
            right = cosine * y - sine * x;
        }
    }

    /// Factor L of the last six unknowns, the others eliminated, and L⁻¹·Aᵀ·b.
    pub fn last_six(&self) -> (Factor<S>, Vector6<S>) {
        let first = N - 6;
        let lower: Matrix6<S> = core::array::from_fn(|i| {
            core::array::from_fn(|j| if j <= i { self.upper[first + j][first + i] } else { S::zero() })
        });
        let factor = Factor { lower, inverses: core::array::from_fn(|i| lower[i][i].recip()) };
        (factor, core::array::from_fn(|i| self.right[first + i]))
    }
}

/// Whether a processor does a whole square sooner than its lower half: one that has lanes for numbers of 64 bits.
const fn adds_squares<S>() -> bool {
    size_of::<S>() == size_of::<f64>()
}

/// Adds Σ left·rightᵀ, which is symmetric: at least its lower half.
#[inline(always)]
pub fn add_outer<S: Number, const N: usize>(matrix: &mut Matrix6<S>, left: [&Vector6<S>; N], right: [&Vector6<S>; N]) {
    for i in 0..6 {
        let end = if adds_squares::<S>() { 6 } else { i + 1 };
        for j in 0..end {
            let mut sum = matrix[i][j];
            for k in 0..N {
                sum += left[k][i] * right[k][j];
            }
            matrix[i][j] = sum;
        }
    }
}

/// Completes a symmetric matrix whose lower half [`add_outer`] has added up.
#[inline(always)]
pub fn mirror<S: Number>(matrix: &mut Matrix6<S>) {
    if !adds_squares::<S>() {
        for i in 0..6 {
            for j in i + 1..6 {
                matrix[i][j] = matrix[j][i];
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Twelve rows of condition number about `spread`: each column is nearly its neighbour.
    fn rows(spread: f64) -> [[f64; 6]; 12] {
        core::array::from_fn(|k| {
            let mut sum = 0.0;
            core::array::from_fn(|i| {
                let (k, i) = (k as f64, i as f64);
                sum += (7.0 * k * k + 3.0 * i * i + k * i + 1.0).sin() * spread.powf(-i / 5.0);
                sum
            })
        })
    }

    fn normal(rows: &[[f64; 6]]) -> Matrix6<f64> {
        core::array::from_fn(|i| core::array::from_fn(|j| rows.iter().map(|row| row[i] * row[j]).sum()))
    }

    fn triangle(rows: &[[f64; 6]], x: &Vector6<f64>) -> Triangle<f64, 6> {
        let mut triangle = Triangle::new();
        for row in rows {
            triangle.add(*row, row.iter().zip(x).map(|(a, b)| a * b).sum());
        }
        triangle
    }

    #[test]
    fn solving_inverts_multiplying() {
        let matrix = normal(&rows(10.0));
        let factor = Factor::of_matrix(&matrix, 0.0, 1e-12).expect("positive definite");
        let x = [1.0, -2.0, 3.0, 0.5, 0.0, 1e3];
        let right: [f64; 6] = core::array::from_fn(|i| (0..6).map(|j| matrix[i][j] * x[j]).sum());
        for (a, b) in factor.solve(&right).into_iter().zip(x) {
            assert!((a - b).abs() < 1e-9, "{a} {b}");
        }
        let inverse = factor.inverse();
        for i in 0..6 {
            for j in 0..6 {
                let product: f64 = (0..6).map(|k| matrix[i][k] * inverse[k][j]).sum();
                assert!((product - f64::from(u8::from(i == j))).abs() < 1e-12);
            }
        }
    }

    #[test]
    fn rows_solve_what_their_normal_matrix_cannot() {
        let x = [1.0, -2.0, 3.0, 0.5, -0.25, 4.0];
        for spread in [1.0, 1e4, 1e8, 1e12] {
            let rows = rows(spread);
            let (factor, half_way) = triangle(&rows, &x).last_six();
            for (a, b) in factor.backward(&half_way).into_iter().zip(x) {
                // Condition number times rounding, and some workspace.
                assert!((a - b).abs() < 2e-15 * spread.max(10.0), "{spread:e}: {a} {b}");
            }
        }
        assert!(Factor::of_matrix(&normal(&rows(1e9)), 0.0, 1e-12).is_none());
    }

    #[test]
    fn singular_values_keep_their_digits() {
        for spread in [1.0, 1e6, 1e11] {
            let rows = rows(spread);
            let (factor, _) = triangle(&rows, &[0.0; 6]).last_six();
            let pairs = factor.singular();
            assert_eq!(factor.extreme_singular_values(), [pairs[0].0, pairs[5].0], "{spread:e}");
            for (value, vector) in pairs {
                // |A·v| = σ, to the rounding of A's larger elements.
                let length = rows
                    .iter()
                    .map(|row| row.iter().zip(vector).map(|(a, b)| a * b).sum::<f64>().powi(2))
                    .sum::<f64>()
                    .sqrt();
                assert!((length - value).abs() < 1e-13, "{spread:e}: {length} {value}");
            }
        }
    }
}
