//! How far chance goes, and the little linear algebra that takes.

/// A 6×6 matrix, row by row.
pub type Matrix6 = [[f64; 6]; 6];

/// The middle of `values`.
///
/// # Panics
/// If there are none, or one is not a number.
pub fn median(values: impl IntoIterator<Item = f64>) -> f64 {
    let mut values: Vec<f64> = values.into_iter().collect();
    assert!(!values.is_empty() && values.iter().all(|value| !value.is_nan()), "no median of nothing or NaN");
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}

/// The χ² of `freedom` degrees of freedom at `sigmas` one-sided standard deviations of a normal
/// distribution (Wilson and Hilferty 1931; within 1 % for 6 degrees and up to ±6 σ).
pub fn chi2_quantile(freedom: f64, sigmas: f64) -> f64 {
    let spread = 2.0 / (9.0 * freedom);
    freedom * (1.0 - spread + sigmas * spread.sqrt()).powi(3)
}

/// Lower Cholesky factor of a symmetric positive definite matrix.
///
/// # Panics
/// If it is not.
pub fn cholesky(matrix: &Matrix6) -> Matrix6 {
    let mut factor = [[0.0; 6]; 6];
    for i in 0..6 {
        for j in 0..=i {
            let sum: f64 = (0..j).map(|k| factor[i][k] * factor[j][k]).sum();
            let rest = matrix[i][j] - sum;
            factor[i][j] = if i == j {
                assert!(rest > 0.0, "not positive definite: pivot {i} is {rest:e}");
                rest.sqrt()
            } else {
                rest / factor[j][j]
            };
        }
    }
    factor
}

/// Solves L·x = b for a lower triangular L.
pub fn forward(factor: &Matrix6, right: &[f64; 6]) -> [f64; 6] {
    let mut x = [0.0; 6];
    for i in 0..6 {
        let sum: f64 = (0..i).map(|k| factor[i][k] * x[k]).sum();
        x[i] = (right[i] - sum) / factor[i][i];
    }
    x
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantiles_are_those_of_the_tables() {
        // Abramowitz and Stegun, table 26.8: χ² of 6 degrees, 5 % above (1.645 σ) and 0.1 % (3.090 σ).
        for (sigmas, expected) in [(1.645, 12.592), (3.090, 22.458), (-1.645, 1.635)] {
            let quantile = chi2_quantile(6.0, sigmas);
            assert!((quantile - expected).abs() < 0.01 * expected, "{sigmas}: {quantile}");
        }
    }

    #[test]
    fn a_factor_multiplies_back() {
        let matrix: Matrix6 =
            std::array::from_fn(|i| std::array::from_fn(|j| if i == j { 3.0 } else { 1.0 / (1.0 + (i + j) as f64) }));
        let factor = cholesky(&matrix);
        let right = [1.0, -2.0, 3.0, 0.5, 0.0, 7.0];
        let x = forward(&factor, &right);
        for i in 0..6 {
            let row: f64 = (0..6).map(|k| factor[i][k] * x[k]).sum();
            assert!((row - right[i]).abs() < 1e-14, "{row} {}", right[i]);
            let diagonal: f64 = factor[i].iter().map(|value| value * value).sum();
            assert!((diagonal - matrix[i][i]).abs() < 1e-14, "{diagonal}");
        }
    }
}
