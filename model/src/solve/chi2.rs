//! How large χ² may be by chance.

/// Probability of a larger χ² by chance at which a fit is doubted: 1e-9, six one-sided σ.
const GATE_SIGMAS: f64 = 6.0;

/// Two currents a cell, less six unknowns.
pub(super) fn redundancy(cells: usize) -> usize {
    (2 * cells).saturating_sub(6)
}

/// The χ² that `freedom` degrees of freedom exceed with probability 1e-9 (Wilson and Hilferty
/// 1931). Without redundancy a fit is exact, but for noise that leads past a fold of the currents:
/// counted as one degree.
pub(super) fn chi2_gate(freedom: usize) -> f64 {
    let k = freedom.max(1) as f64;
    let spread = 2.0 / (9.0 * k);
    let root = 1.0 - spread + GATE_SIGMAS * libm::sqrt(spread);
    k * root * root * root
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_gate_of_chi2_is_passed_by_chance_once_in_a_billion() {
        // Quantiles of χ² for 9.9e-10, from its closed form for even degrees of freedom. The cube root is
        // a normal deviate to a few percent, least so for few degrees.
        for (freedom, quantile) in [(2, 41.47), (4, 47.91), (6, 53.37), (10, 62.98), (26, 94.63)] {
            let ratio = chi2_gate(freedom) / quantile;
            assert!((0.99..1.2).contains(&ratio), "{freedom}: {ratio}");
        }
    }
}
