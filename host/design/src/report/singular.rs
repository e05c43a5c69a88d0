//! Singular values of tall matrices with six columns.
//!
//! One-sided Jacobi (Hestenes 1958): columns are turned in pairs until all are perpendicular. Small
//! singular values keep their relative accuracy (Demmel and Veselić 1992), which forming AᵀA would
//! lose: a condition number of 1e12 is a condition number of 1e12 here, not of 1e8.

/// Sweeps after which the columns are perpendicular to rounding; six or so suffice.
const MOST_SWEEPS: usize = 30;

/// Singular values, descending, each with its right singular vector.
pub(super) fn singular_values(rows: &[[f64; 6]]) -> [(f64, [f64; 6]); 6] {
    let mut columns: [Vec<f64>; 6] = std::array::from_fn(|j| rows.iter().map(|row| row[j]).collect());
    let mut vectors: [[f64; 6]; 6] = std::array::from_fn(|j| std::array::from_fn(|i| if i == j { 1.0 } else { 0.0 }));
    for _ in 0..MOST_SWEEPS {
        let mut turned = false;
        for p in 0..6 {
            for q in p + 1..6 {
                let (a, b, c) =
                    (dot(&columns[p], &columns[p]), dot(&columns[q], &columns[q]), dot(&columns[p], &columns[q]));
                if c.abs() <= f64::EPSILON * (a * b).sqrt() {
                    continue;
                }
                turned = true;
                let zeta = (b - a) / (2.0 * c);
                let tangent = zeta.signum() / (zeta.abs() + zeta.hypot(1.0));
                let cosine = tangent.hypot(1.0).recip();
                let sine = cosine * tangent;
                let (first, second) = columns.split_at_mut(q);
                turn(&mut first[p], &mut second[0], cosine, sine);
                let (first, second) = vectors.split_at_mut(q);
                turn(&mut first[p], &mut second[0], cosine, sine);
            }
        }
        if !turned {
            break;
        }
    }
    let mut values: [(f64, [f64; 6]); 6] = std::array::from_fn(|j| (dot(&columns[j], &columns[j]).sqrt(), vectors[j]));
    values.sort_by(|a, b| b.0.total_cmp(&a.0));
    values
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

fn turn(a: &mut [f64], b: &mut [f64], cosine: f64, sine: f64) {
    for (a, b) in a.iter_mut().zip(b) {
        (*a, *b) = (cosine * *a - sine * *b, sine * *a + cosine * *b);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The product of two matrices of reflections (orthogonal) around a diagonal one.
    fn with_values(values: [f64; 6]) -> Vec<[f64; 6]> {
        let reflect = |row: [f64; 6], axis: [f64; 6]| -> [f64; 6] {
            let share = 2.0 * dot(&row, &axis) / dot(&axis, &axis);
            std::array::from_fn(|i| row[i] - share * axis[i])
        };
        let right = [1.0, -2.0, 0.5, 3.0, 1.0, -1.0];
        // Left factor: 12×6 with perpendicular unit columns.
        let left = |i: usize, j: usize| {
            let angle = std::f64::consts::PI * (i as f64 + 0.5) * (j as f64 + 1.0) / 12.0;
            angle.cos() * (2.0_f64 / 12.0).sqrt()
        };
        (0..12)
            .map(|i| {
                let row = std::array::from_fn(|j| left(i, j) * values[j]);
                reflect(row, right)
            })
            .collect()
    }

    #[test]
    fn known_singular_values_are_found_over_seven_decades() {
        let expected = [3.0, 1.0, 0.5, 1e-2, 1e-4, 1e-7];
        let found = singular_values(&with_values(expected));
        for ((value, vector), expected) in found.into_iter().zip(expected) {
            // The matrix itself is only rounded numbers: relative to the largest value.
            assert!((value - expected).abs() < 1e-15 * 3.0, "{value:e} {expected:e}");
            assert!((dot(&vector, &vector) - 1.0).abs() < 1e-13);
        }
    }

    #[test]
    fn columns_of_very_different_size_keep_their_digits() {
        let rows: Vec<[f64; 6]> =
            (0..7).map(|i| std::array::from_fn(|j| if i == j { 10f64.powi(-4 * j as i32) } else { 0.0 })).collect();
        for (j, (value, _)) in singular_values(&rows).into_iter().enumerate() {
            assert!((value * 10f64.powi(4 * j as i32) - 1.0).abs() < 1e-14, "{j}: {value:e}");
        }
    }

    #[test]
    fn a_rank_is_what_it_is() {
        let rows = [[1.0; 6]; 8];
        let found = singular_values(&rows);
        assert!((found[0].0 - 48f64.sqrt()).abs() < 1e-13 && found[1].0 < 1e-14, "{found:?}");
    }
}
